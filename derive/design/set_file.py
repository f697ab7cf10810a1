"""A design written down as a parameter set that `pfaffian generate --params` takes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace

from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.parameter import Parameter
from pfaffian.derive.sets.gains import gain_names
from pfaffian.derive.sets.parameter_set import resolve_set
from pfaffian.derive.sets.raw_set import TABLES, RawSet


def gain_set_toml(
    model: LoweredModel, raw: RawSet, base: str, gains: Mapping[str, float], title: str, target: str
) -> str:
    """Return the TOML of `raw` with `gains` in place of its own, exact to the bit.

    It extends the model's set `base`, or holds every value where there is no such name. Raises
    `InputError` naming `target` for a set that `generate` would refuse.
    """
    own = {n: v for n, v in raw.values.items() if n not in gain_names(model)}
    complete = {**own, **gains}
    resolve_set(model, replace(raw, path=target, values=complete, poles=()))
    lines = [f"title = {_quoted(title)}", f"source = {_quoted(_source(raw))}"]
    if base:
        lines.append(f"extends = {_quoted(base)}")
    written = gains if base else complete
    for table in dict.fromkeys(TABLES.values()):
        rows = [
            f"{p.name} = {_value(p, written[p.name])}"
            for p in model.parameters
            if TABLES.get(p.group) == table and p.name in written
        ]
        if rows:
            lines += ["", f"[{table}]", *rows]
    return "\n".join(lines) + "\n"


def _source(raw: RawSet) -> str:
    suffix = "gains by pfaffian design"
    return f"{raw.source.removesuffix(f'; {suffix}')}; {suffix}" if raw.source else suffix


def _value(parameter: Parameter, value: float) -> str:
    return f'"{value!r} {parameter.unit}"' if parameter.unit else repr(value)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
