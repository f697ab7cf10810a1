"""Test vectors for a build on hardware we do not have: periods with results at 60 digits.

Written by `python -m pfaffian.derive.verify.vectors MODEL > runtime/vectors/MODEL_vectors.h`, which
`make vectors` does; `runtime/vectors/check_vectors.c` holds a build against them. Parameters are
those of the model's sets, states and measurements are drawn, results come from the oracle alone.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pfaffian.derive.emit.names import snake
from pfaffian.derive.emit.templates import fill
from pfaffian.derive.verify.condition import Condition
from pfaffian.derive.verify.oracle import Oracle
from pfaffian.derive.verify.sampling import draw
from pfaffian.derive.verify.ulp_unit import DOUBLE_UNIT
from pfaffian.runtime.base.arrays import Array

COUNT = 48
#: The tolerance in condition-scaled units in the last place: what `pfaffian verify` demands.
LIMIT_ULP = 4.0
_SEED = 20_260_707
#: What stands in the state before a period, prepared from parameters or remembered.
_GIVEN = ("state", "prepared")


def vectors(reference: str, count: int = COUNT) -> str:
    """Return the header of `count` vectors for the model called `reference`.

    Samples on the boundary of a branch are left out: there either side is right.
    """
    from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
    from pfaffian.derive.spec.library import find_model

    source = find_model(reference)
    model, block = lowered_model(source), derivation_of(source).block("step")
    sets = library_sets(model, source)
    rng = np.random.default_rng(_SEED)
    drawn = draw(model, block.inputs, [s.as_dict() for s in sets], 4 * count, rng, block=block)
    which = np.arange(4 * count) % len(sets)
    values = dict(drawn.values)
    for k, s in enumerate(sets):
        for name, value in s.values:
            if name in values:
                values[name] = np.where(which == k, value, values[name])
    rows, tolerances, clear = _answers(block, values)
    kept = np.flatnonzero(clear & np.isfinite(rows).all(axis=1))[:count]
    if len(kept) < count:
        raise RuntimeError(f"only {len(kept)} of {count} vectors are decided")
    members = {s.name: s for s in block.inputs}
    taken = [
        (k, s.name, _place(s.name, s.group))
        for k, s in enumerate(block.outputs)
        if s.group in ("output", "next_state")
    ]
    context = {
        "model": model.name,
        "sha256": model.sha256,
        "digits": 60,
        "limit": LIMIT_ULP,
        "state": [n for n, s in members.items() if s.group in _GIVEN],
        "input": [n for n, s in members.items() if s.group == "input"],
        "taken": [{"name": n, "place": p} for _, n, p in taken],
        "rows": [
            {
                "set": f"{model.name}_params_{snake(sets[which[i]].name)}",
                "given": _hex([values[n][i] for n in members if members[n].group in _GIVEN]),
                "measured": _hex([values[n][i] for n in members if members[n].group == "input"]),
                "wanted": _hex([rows[i, k] for k, _, _ in taken]),
                "tolerance": _hex([tolerances[i, k] for k, _, _ in taken]),
            }
            for i in kept
        ],
    }
    return fill("c/vectors.h.j2", context)


def _answers(block: Any, values: Mapping[str, Array]) -> tuple[Array, Array, Array]:
    """Return exact results rounded once, (N, outputs), tolerances, and what is decided, (N,)."""
    oracle, condition = Oracle(block), Condition(block)
    names = list(values)
    rows = zip(*(values[n].tolist() for n in names), strict=True)
    answers = [oracle(dict(zip(names, row, strict=True))) for row in rows]
    limit = LIMIT_ULP * 2.0**-DOUBLE_UNIT.digits
    clear = np.array([c for _, c in answers]) & ~condition.close_calls(values, limit)
    exact = np.array([[float(v) for v in outputs] for outputs, _ in answers])
    named, _ = condition(values)
    scales = [np.maximum(np.abs(exact[:, k]), named[s.name]) for k, s in enumerate(block.outputs)]
    units = np.stack([DOUBLE_UNIT.last_place(s) for s in scales], axis=1)
    return exact, LIMIT_ULP * units, clear


def _place(name: str, group: str) -> str:
    return f"state->{name}" if group == "next_state" else f"output->{name}"


def _hex(values: Sequence[float]) -> list[str]:
    return [float(v).hex() for v in values]


if __name__ == "__main__":
    sys.stdout.write(vectors(sys.argv[1]))
