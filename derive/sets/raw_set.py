"""Declared parameters, and parameter sets read from TOML. Imports neither SymPy nor pint eagerly.

A set names every parameter of one plant with its unit, for instance `m1 = "0.09 kg"`. Values are
converted to the declared coherent SI unit; a wrong dimension, a missing or an unknown key and a
value out of bounds are each refused with the file and the key.
"""

from __future__ import annotations

import cmath
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from pfaffian.derive.ir.names import POLES_KEY
from pfaffian.derive.ir.parameter import Parameter
from pfaffian.runtime.base.errors import InputError, refuse_all
from pfaffian.runtime.base.quantity import last_place, parse_quantity
from pfaffian.runtime.base.toml import read_toml, shown, suggestion

#: TOML table of each parameter group.
TABLES = {
    "physical": "parameters",
    "lumped": "parameters",
    "plant": "parameters",
    "gain": "gains",
    "synthesised": "gains",
    "target": "target",
    "swing_up": "swing_up",
}
#: Groups of which a set holds one or the other, and what the group that stands in for it is.
_ALTERNATIVES = {"physical": "lumped", "lumped": "physical"}
#: What stands in a set for a value that is still to be filled in, before its unit.
BLANK = "?"


@dataclass(frozen=True)
class RawSet:
    """A parameter set as read: values in SI by name, and wanted zero-dynamics poles if given.

    `last_places` has one unit of the last digit written of each gain, in SI units; `written` what
    stands in the file for each value, and for the poles under `POLES_KEY`.
    """

    name: str
    title: str
    source: str
    path: str
    values: Mapping[str, float]
    poles: tuple[complex, ...] = ()
    last_places: Mapping[str, float] = field(default_factory=dict)
    written: Mapping[str, object] = field(default_factory=dict)


def parse_poles(raw: object, where: str) -> tuple[complex, ...]:
    """Return wanted poles from a list of numbers and strings; raise `InputError` for others."""
    remedy = 'give numbers or strings such as [-6, "-4+2j", "-4-2j"], complex ones in pairs'
    if not isinstance(raw, list) or not raw:
        raise InputError(f"{where}: must be a list of poles in 1/s", remedy=remedy)
    poles = tuple(_parse_pole(p, where, remedy) for p in raw)
    check_poles(poles, where)
    return poles


def _parse_pole(raw: object, where: str, remedy: str) -> complex:
    if isinstance(raw, int | float | str) and not isinstance(raw, bool):
        text = raw.replace(" ", "").replace("i", "j") if isinstance(raw, str) else raw
        try:
            pole = complex(text)
        except (ValueError, OverflowError):
            pole = complex("nan")
        if cmath.isfinite(pole):
            return pole
    raise InputError(f"{where}: {shown(raw)} is not a finite pole", remedy=remedy)


def check_poles(poles: tuple[complex, ...], where: str) -> None:
    """Raise `InputError` unless `poles` are stable and closed under conjugation."""
    unstable = [p for p in poles if not p.real < 0.0]
    if unstable:
        raise InputError(
            f"{where}: {unstable[0]:g} is not a stable pole", remedy="give negative real parts"
        )
    key = lambda p: (p.real, p.imag)  # noqa: E731
    if sorted(poles, key=key) != sorted((p.conjugate() for p in poles), key=key):
        raise InputError(
            f"{where}: complex poles must come in conjugate pairs",
            remedy="add the conjugate of each complex pole",
        )


def _table(document: Mapping[str, object], table: str, path: Path) -> dict[str, object]:
    raw = document.get(table, {})
    if not isinstance(raw, dict):
        raise InputError(
            f"{path}: {table} must be a table", remedy=f"write [{table}] on a line of its own"
        )
    return raw


def _check_keys(document: Mapping[str, object], known: Mapping[str, list[str]], path: Path) -> None:
    tops = ["title", "source", "extends", *known]
    for key in document:
        if key not in tops:
            raise InputError(f"{path}: unknown key {key}", remedy=suggestion(key, tops))
        if key not in known and not isinstance(document[key], str):
            raise InputError(f"{path}: {key} must be a string", remedy=f'write {key} = "..."')
    for table, names in known.items():
        for key in _table(document, table, path):
            if key not in names:
                raise InputError(
                    f"{path}: unknown key {table}.{key}", remedy=suggestion(key, names)
                )


def _check_filled(document: Mapping[str, object], path: Path) -> None:
    """Refuse what a template left to be filled in, all of it at once."""
    tables = {key: part for key, part in document.items() if isinstance(part, dict)}
    blank = [key for key, value in document.items() if value == BLANK]
    blank += [
        f"{table}.{key}" + (f" [{unit}]" if (unit := value.removeprefix(BLANK).strip()) else "")
        for table, part in tables.items()
        for key, value in part.items()
        if isinstance(value, str) and value.startswith(BLANK)
    ]
    if blank:
        raise InputError(
            f"{path}: still to fill in: {', '.join(blank)}",
            remedy=f'write a value in place of each "{BLANK}"',
        )


def read_set(path: Path, declared: tuple[Parameter, ...], known_sets: Mapping[str, Path]) -> RawSet:
    """Read the parameter set in `path`, its `extends` base first.

    Raises `InputError` for malformed TOML, unknown keys, wrong dimensions and values out of
    bounds. Completeness is judged later, when lumped and synthesised values are known.
    """
    return _read_set(path, declared, known_sets, ())


def _read_set(
    path: Path,
    declared: tuple[Parameter, ...],
    known_sets: Mapping[str, Path],
    above: tuple[Path, ...],
) -> RawSet:
    document = read_toml(path)
    _check_keys(document, _names_by_table(declared), path)
    _check_filled(document, path)
    if path in above:
        chain = " -> ".join(str(p) for p in (*above, path))
        raise InputError(f"{path}: extends itself ({chain})", remedy="break the circle")
    base = _base_of(document, path, declared, known_sets, (*above, path))
    return _raw_set(document, declared, base, path)


def changed_set(
    base: RawSet, changes: Mapping[str, object], declared: tuple[Parameter, ...]
) -> RawSet:
    """Return `base` with `changes` by name, as a set that extends it would have them.

    Values are what may stand in a TOML file: "0.8 kg". Raises `InputError` as `read_set` does.
    """
    where = Path(f"{base.name}-changed")
    tables = {n: table for table, names in _names_by_table(declared).items() for n in names}
    document: dict[str, object] = {"title": f"{base.title}, changed"}
    parts: dict[str, dict[str, object]] = {}
    for name, value in changes.items():
        if name not in tables:
            raise InputError(
                f"{where}: unknown parameter {name}", remedy=suggestion(name, list(tables))
            )
        parts.setdefault(tables[name], {})[name] = value
    return replace(_raw_set(document | parts, declared, base, where), name=str(where))


def _names_by_table(declared: tuple[Parameter, ...]) -> dict[str, list[str]]:
    """Return the names that may stand in each table of a set."""
    by_table: dict[str, list[str]] = {table: [] for table in dict.fromkeys(TABLES.values())}
    for parameter in declared:
        if parameter.group in TABLES:
            by_table[TABLES[parameter.group]].append(parameter.name)
    by_table["gains"].append(POLES_KEY)
    return by_table


def _raw_set(
    document: Mapping[str, object],
    declared: tuple[Parameter, ...],
    base: RawSet | None,
    path: Path,
) -> RawSet:
    """Return the set in `document`, whose keys are known, over the `base` that it extends."""
    own, poles = _own_values(document, declared, path)
    places = dict(base.last_places) if base else {}
    groups = {p.name: p.group for p in declared}
    given = {groups[name] for name in own}
    if poles and "synthesised" in given:
        raise InputError(
            f"{path}: gains.{POLES_KEY} and {_first(own, groups, 'synthesised')} are both given",
            remedy="give the poles or the gains that follow from them, not both",
        )
    if {"physical", "lumped"} <= given:
        raise InputError(
            f"{path}: {_first(own, groups, 'physical')} (physical) and "
            f"{_first(own, groups, 'lumped')} (lumped) are both given",
            remedy="describe the plant in one form: all physical or all lumped parameters",
        )
    replaced = {_ALTERNATIVES[g] for g in given if g in _ALTERNATIVES}
    replaced |= {"synthesised"} if poles else set()
    values = {k: v for k, v in base.values.items() if groups[k] not in replaced} if base else {}
    inherited = base.poles if base and "synthesised" not in given else ()
    kept = {*values, *own, *([POLES_KEY] if poles or inherited else [])}
    written = {**(base.written if base else {}), **_written(document)}
    return RawSet(
        name=path.stem,
        title=str(document.get("title", path.stem)),
        source=str(document.get("source", base.source if base else "")),
        path=str(path),
        values=values | own,
        poles=poles or inherited,
        last_places=places | _last_places(document, declared, own),
        written={name: value for name, value in written.items() if name in kept},
    )


def _written(document: Mapping[str, object]) -> dict[str, object]:
    tables = [part for part in document.values() if isinstance(part, dict)]
    return {name: value for part in tables for name, value in part.items()}


def _last_places(
    document: Mapping[str, object], declared: tuple[Parameter, ...], own: Mapping[str, float]
) -> dict[str, float]:
    """Return one unit of the last digit written of each gain in `own`, in SI units."""
    gains = document.get("gains", {})
    raw = gains if isinstance(gains, dict) else {}
    return {
        p.name: last_place(raw[p.name], p.unit)
        for p in declared
        if p.group == "gain" and p.name in own
    }


def _first(own: Mapping[str, float], groups: Mapping[str, str], group: str) -> str:
    return next(name for name in own if groups[name] == group)


def _base_of(
    document: Mapping[str, object],
    path: Path,
    declared: tuple[Parameter, ...],
    known_sets: Mapping[str, Path],
    above: tuple[Path, ...],
) -> RawSet | None:
    if "extends" not in document:
        return None
    name = str(document["extends"])
    if name not in known_sets:
        raise InputError(
            f"{path}: extends names no parameter set: {name}",
            remedy=suggestion(name, sorted(known_sets)),
        )
    return _read_set(known_sets[name], declared, known_sets, above)


def _own_values(
    document: Mapping[str, object], declared: tuple[Parameter, ...], path: Path
) -> tuple[dict[str, float], tuple[complex, ...]]:
    values: dict[str, float] = {}
    wrong: list[InputError] = []
    for parameter in declared:
        if parameter.group not in TABLES:
            continue
        table = TABLES[parameter.group]
        raw = _table(document, table, path).get(parameter.name)
        if raw is None:
            continue
        where = f"{path}: {table}.{parameter.name}"
        try:
            value = parse_quantity(raw, parameter.unit, where, drops_angles=parameter.drops_angles)
            values[parameter.name] = parameter.check(value, where)
        except InputError as error:
            wrong.append(error)
    refuse_all(wrong)
    poles = _table(document, "gains", path).get(POLES_KEY)
    return values, parse_poles(poles, f"{path}: gains.{POLES_KEY}") if poles is not None else ()
