"""What a complete controller needs beside its laws: encoders, capture, supervision, read from TOML.

One file a parameter set, `control/SET.toml` beside the model's `spec.py`. Quantities carry units,
as in a parameter set; what is out of bounds is refused by the C modules' own rules when the
controller is initialised, what is misspelt or of another dimension here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pfaffian.derive.ir.lowered import CoordinateInterface, LoweredModel
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import parse_quantity
from pfaffian.runtime.base.toml import read_toml, suggestion
from pfaffian.runtime.contract.runtime_structs import (
    BALANCE_LAWS,
    ESTIMATORS,
    MEASURES,
    SWING_UP_LAWS,
)

#: Measures of the capture set beside the coordinates' errors, with their units.
SCALARS = {
    "energy": "J",
    "residual": "",
    "singular_ratio": "",
    "torque_jump": "",
    "form": "",
}
#: Of an encoder beside what a count is worth and where count 0 begins, which are in the unit of its
#: coordinate.
_ENCODER = {
    "bandwidth": ("rad/s", 300.0),
    "damping": ("", math.sqrt(0.5)),
    "counter_bits": ("", 32),
    "counter_zero": ("", 0),
    "largest_jump": ("", 100),
    "longest_gap": ("", 8),
    "direction": ("", 1),
}
_SUPERVISOR = {
    "capture_periods": ("", 1),
    "release_periods": ("", 1),
    "shortest_period": ("", 0.5),
    "longest_period": ("", 1.5),
    "overruns": ("", 0),
    "watchdog_time": ("s", 0.0),
    "swing_up_timeout": ("s", 0.0),
    "attempts": ("", 0),
}
_TOP = ("title", "source", "swing_up", "balance", "encoder", "capture", "release", "form")
_TABLES = (*_TOP, "feedback", "rest", "plan", "rezero", "supervisor")
Values = Mapping[str, Any]
#: Counts of a turn unless given, and what a count is worth at most and at least: pf_sensing takes 4
#: to 2^32 counts a turn.
_COUNTS = 5000.0
_COARSEST, _FINEST = 2.0 * math.pi / 4.0, 2.0 * math.pi / 2.0**32
#: A limit that nothing reaches.
_NONE = 1e300


@dataclass(frozen=True)
class ControllerSettings:
    """The constants of one complete controller, in SI units.

    `encoders` holds the members of `pf_sensing_params_t` by coordinate, `supervisor` those of
    `pf_supervisor_params_t`, `own` the controller's own members, all by name in C.
    """

    name: str
    title: str
    source: str
    encoders: Mapping[str, Values]
    supervisor: Values
    own: Values


def control_paths(folder: Path) -> dict[str, Path]:
    """Return the files of the complete controllers of the model in `folder`, by parameter set."""
    return {p.stem: p for p in sorted((folder / "control").glob("*.toml"))}


def state_names(model: LoweredModel) -> tuple[str, ...]:
    """Return the names of q and q', in that order."""
    names = [c.name for c in model.coordinates]
    return (*names, *(f"d{n}" for n in names))


def form_names(model: LoweredModel) -> list[tuple[str, str, str]]:
    """Return (member, x_i, x_j) for each entry of the upper triangle of the quadratic form."""
    x = state_names(model)
    return [(f"form_{a}_{b}", a, b) for i, a in enumerate(x) for b in x[i:]]


def read_control(
    path: Path, model: LoweredModel, law: Mapping[str, float], plans: tuple[str, ...]
) -> ControllerSettings:
    """Read the controller in `path` for the parameter set `law` of its name.

    Raises `InputError` for an unknown key, a wrong unit, a table of another shape, or a plan that
    is wanted and not there.
    """
    document = read_toml(path)
    _check_keys(document, _TABLES, f"{path}")
    time = law["sample_time"]
    encoders = {}
    for c in model.coordinates:
        table = _table(_table(document, "encoder", path), c.name, path)
        encoders[c.name] = {**_encoder(table, c, path), "sample_time": time}
    return ControllerSettings(
        name=path.stem,
        title=str(document.get("title", path.stem)),
        source=str(document.get("source", "")),
        encoders=encoders,
        supervisor=_supervisor(document, model, time, path),
        own=_own(document, model, plans, path),
    )


def _encoder(table: Values, c: CoordinateInterface, path: Path) -> dict[str, Any]:
    """Return the members of one channel; C counts 2 pi of the coordinate's unit as one turn."""
    where = f"{path}: encoder.{c.name}"
    schema = {"counts_per_turn": ("", _COUNTS), "offset": (c.unit, 0.0), **_ENCODER}
    values = _values(table, schema, where, ("quantum", "estimator", "turns"))
    if "quantum" in table:
        if "counts_per_turn" in table:
            raise InputError(
                f"{where}: quantum and counts_per_turn are both given",
                remedy="give one: what a count is worth, or how many there are in a turn",
            )
        quantum = parse_quantity(table["quantum"], c.unit, f"{where}.quantum")
        if not _FINEST <= quantum <= _COARSEST:
            raise InputError(
                f"{where}.quantum = {quantum:g} {c.unit} is out of its bounds",
                remedy=f"give what a count is worth, {_FINEST:.3g} to {_COARSEST:.3g} {c.unit}",
            )
        values["counts_per_turn"] = 2.0 * math.pi / quantum
    elif c.unit != "rad":
        raise InputError(
            f"{where}: an encoder in {c.unit} has no turns",
            remedy=f'give quantum, what a count is worth, for instance "0.0001 {c.unit}"',
        )
    return {**values, "estimator": _word(table, "estimator", ESTIMATORS, "tracking", where)}


def _own(
    document: Mapping[str, object], model: LoweredModel, plans: tuple[str, ...], path: Path
) -> dict[str, float | int]:
    own: dict[str, float | int] = {}
    x = state_names(model)
    units = {c.name: c.unit for c in model.coordinates}
    units |= {f"d{c.name}": f"{c.unit}/s" for c in model.coordinates}
    feedback, rest = _table(document, "feedback", path), _table(document, "rest", path)
    for a in model.actuators:
        gains = _row(feedback.get(a.name, [0.0] * len(x)), len(x), f"{path}: feedback.{a.name}")
        own |= {f"feedback_{a.name}_{n}": g for n, g in zip(x, gains, strict=True)}
        own[f"rest_{a.name}"] = parse_quantity(
            rest.get(a.name, f"0 {a.unit}"), a.unit, f"{path}: rest.{a.name}"
        )
    own |= _form(_table(document, "form", path), model, path)
    table = _table(document, "plan", path)
    schema: dict[str, tuple[str, float]] = {}
    for c in model.coordinates:
        schema |= {f"start_{c.name}": (c.unit, 0.0), f"start_d{c.name}": (units[f"d{c.name}"], 0.0)}
        schema[f"error_{c.name}"] = (c.unit, 0.0)
    schema["patience"] = ("s", 0.0)
    own |= {f"plan_{k}": v for k, v in _values(table, schema, f"{path}: plan").items()}
    own |= _rezero(_table(document, "rezero", path), model, path)
    encoders = _table(document, "encoder", path)
    for c in model.coordinates:
        turns = _table(encoders, c.name, path).get("turns", c.unit == "rad")
        own[f"{c.name}_turns"] = int(bool(turns))
    has_energy = model.has_program("swing_up")
    default = "energy" if has_energy else "none"
    swing_up = _word(document, "swing_up", SWING_UP_LAWS, default, f"{path}")
    if swing_up == SWING_UP_LAWS["energy"] and not has_energy:
        raise InputError(
            f"{path}: swing_up = energy, but model {model.name} has no energy law",
            remedy="take plan, or none and bring it there by hand",
        )
    if swing_up == SWING_UP_LAWS["plan"] and path.stem not in plans:
        raise InputError(
            f"{path}: swing_up = plan, but there is no plan for parameter set {path.stem}",
            remedy=f"plan one: pfaffian plan {model.name} --set {path.stem}",
        )
    own["plan"] = plans.index(path.stem) + 1 if path.stem in plans else 0
    own["swing_up"] = swing_up
    own["balance"] = _word(document, "balance", BALANCE_LAWS, "robust", f"{path}")
    return own


def _rezero(table: Values, model: LoweredModel, path: Path) -> dict[str, float | int]:
    """Return the known place of the order REZERO, and how long the plant must rest there."""
    where = f"{path}: rezero"
    schema: dict[str, tuple[str, Any]] = {c.name: (c.unit, 0.0) for c in model.coordinates}
    values = _values(table, schema | {"periods": ("", 0)}, where)
    if table and (values["periods"] < 1 or any(name not in table for name in schema)):
        raise InputError(
            f"{where} is not whole",
            remedy=f"give periods, from 1, and the place: {', '.join(schema)}",
        )
    found: dict[str, float | int] = {f"home_{n}": values[n] for n in schema}
    return {**found, "rezero_periods": values["periods"]}


def _form(table: Values, model: LoweredModel, path: Path) -> dict[str, float]:
    """Return the upper triangle of the symmetric matrix `weights`, zero where it is not given."""
    x = state_names(model)
    rows = table.get("weights", [[0.0] * len(x)] * len(x))
    where = f"{path}: form.weights"
    if not isinstance(rows, list) or len(rows) != len(x):
        raise InputError(f"{where} has not {len(x)} rows", remedy=f"order: {', '.join(x)}")
    matrix = [_row(row, len(x), where) for row in rows]
    if any(matrix[i][j] != matrix[j][i] for i in range(len(x)) for j in range(i)):
        raise InputError(f"{where} is not symmetric", remedy="give w_ij = w_ji")
    entries = [(i, j) for i in range(len(x)) for j in range(i, len(x))]
    names = [name for name, _, _ in form_names(model)]
    return {n: matrix[i][j] for n, (i, j) in zip(names, entries, strict=True)}


def _supervisor(
    document: Mapping[str, object], model: LoweredModel, time: float, path: Path
) -> dict[str, Any]:
    schema = {c.name: (c.unit, math.inf) for c in model.coordinates}
    schema |= {name: (unit, math.inf) for name, unit in SCALARS.items()}
    if len(schema) > MEASURES:
        raise InputError(
            f"{path}: {len(schema)} measures for {len(model.coordinates)} coordinates",
            remedy=f"a supervisor looks at {MEASURES}: three coordinates at most",
        )
    release = _limits(document, "release", schema, path)
    capture = _limits(document, "capture", schema, path)
    for name, limit in release.items():
        given = name in _table(document, "capture", path)
        if given and capture[name] > limit:
            raise InputError(
                f"{path}: capture.{name} = {capture[name]:g} is above release.{name} = {limit:g}",
                remedy="release later than you capture, or the controller goes to and fro",
            )
        capture[name] = capture[name] if given else limit
    spare = [_NONE] * (MEASURES - len(schema))
    limits = {
        "capture_limit": [*capture.values(), *spare],
        "release_limit": [*release.values(), *spare],
    }
    values = _values(_table(document, "supervisor", path), _SUPERVISOR, f"{path}: supervisor")
    return {**limits, **values, "sample_time": time}


def _limits(
    document: Mapping[str, object], kind: str, schema: Mapping[str, tuple[str, float]], path: Path
) -> dict[str, float]:
    found = _values(_table(document, kind, path), schema, f"{path}: {kind}")
    return {name: min(value, _NONE) for name, value in found.items()}


def _values(
    table: Values, schema: Mapping[str, tuple[str, Any]], where: str, also: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Return every value of `schema`: a default that is an int asks for a whole number."""
    _check_keys(table, (*schema, *also), where)
    found: dict[str, Any] = {}
    for key, (unit, default) in schema.items():
        raw = table.get(key, default)
        if key not in table:
            found[key] = raw
        elif isinstance(default, int):
            if isinstance(raw, bool) or not isinstance(raw, int):
                raise InputError(f"{where}.{key} is no whole number", remedy=f"give {default}")
            found[key] = raw
        else:
            found[key] = parse_quantity(raw, unit, f"{where}.{key}")
    return found


def _check_keys(table: Mapping[str, object], known: tuple[str, ...], where: str) -> None:
    for key in table:
        if key not in known:
            raise InputError(f"{where}: unknown key {key}", remedy=suggestion(key, list(known)))


def _table(document: Mapping[str, object], key: str, path: Path) -> Values:
    table = document.get(key, {})
    if not isinstance(table, dict):
        raise InputError(f"{path}: {key} must be a table", remedy=f"write [{key}] above it")
    return table


def _word(
    table: Mapping[str, object], key: str, known: Mapping[str, int], default: str, where: str
) -> int:
    word = table.get(key, default)
    if not isinstance(word, str) or word not in known:
        raise InputError(f"{where}.{key} = {word!r}", remedy=suggestion(str(word), list(known)))
    return known[word]


def _row(raw: object, count: int, where: str) -> list[float]:
    if not isinstance(raw, list) or len(raw) != count:
        raise InputError(f"{where} is no row of {count} numbers", remedy="order: q, then q'")
    return [parse_quantity(v, "", where) for v in raw]
