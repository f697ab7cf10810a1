"""What must hold of a specification's servo-constraints and forces: known symbols, right units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import sympy as sp
from pfaffian.derive.constraint import about_constraint
from pfaffian.derive.dimensions import dimension_of
from pfaffian.derive.spec import TIME, ModelSpec, symbol_of
from pfaffian.derive.supported import check_supported
from pfaffian.runtime.errors import InputError
from pfaffian.runtime.quantity import unit_registry


def check_constraints(spec: ModelSpec) -> None:
    """Raise `InputError` for constraints or forces that cannot be evaluated, or in a wrong unit."""
    given = spec.constraint
    names = [s.name for s in given.residual_symbols]
    for name, times in Counter(names).items():
        if times > 1:
            raise InputError(
                f"model {spec.name}: {times} servo-constraints are called {name}",
                remedy="rename one of them",
                about=about_constraint(name),
            )
    taken = [n for c in spec.coordinates for n in (c.name, f"d{c.name}", f"dd{c.name}")]
    taken += [TIME.name, *(p.name for p in spec.parameters)]
    for name in (n for n in names if n in taken):
        raise InputError(
            f"model {spec.name}: the servo-constraint {name} has the name of something else",
            remedy="rename it",
            about=about_constraint(name),
        )
    motion = {*spec.positions, *spec.velocities}
    own = {symbol_of(p) for p in spec.parameters}
    faster = {c.acceleration for c in spec.coordinates}  # has a message of its own
    allowed = motion | own | faster | {TIME}
    for name, residual, drift in zip(names, given.residual, given.drift, strict=True):
        what = f"the servo-constraint {name}"
        _check_symbols(spec, what, residual, allowed, about_constraint(name))
        law = allowed | set(given.residual_symbols)
        _check_symbols(spec, f"the drift of {name}", drift, law, about_constraint(name))
    for c, error, point in zip(spec.coordinates, given.errors, given.setpoint, strict=True):
        _check_symbols(spec, f"the error of {c.name}", error, allowed, "errors")
        _check_symbols(spec, f"the setpoint of {c.name}", point, own, "setpoint")
    for what, entries in (
        ("friction", spec.uncertain_force),
        ("the input matrix", spec.input_matrix),
    ):
        for entry in entries:
            _check_symbols(spec, what, entry, motion | own, "uncertain_force input_matrix")
    _check_dimensions(spec)


def _check_symbols(
    spec: ModelSpec, what: str, value: sp.Expr, allowed: set[sp.Symbol], about: str
) -> None:
    if value.has(sp.zoo, sp.nan, sp.oo, -sp.oo):
        raise InputError(
            f"model {spec.name}: {what} is not finite: {value}",
            remedy="look for a division by zero",
            about=about,
        )
    check_supported(value, f"model {spec.name}: {what}", about)
    strange = sorted(value.free_symbols - allowed, key=lambda s: str(s.name))
    if not strange:
        return
    first = strange[0]
    known = {s.name for s in allowed}
    if first == TIME:
        reason, remedy = "the time", "only servo-constraints and errors may vary with the time"
    elif first.name in known:
        reason = f"a second symbol {first.name} with other assumptions"
        remedy = "use the symbols that the declarations return"
    else:
        reason = f"{first.name}, which is declared nowhere"
        remedy = "declare it as a parameter or gain with its unit"
    raise InputError(
        f"model {spec.name}: {what} contains {reason}",
        remedy=remedy,
        about=about if first == TIME else f"{about} {first.name}",
    )


def _check_dimensions(spec: ModelSpec) -> None:
    """Raise `InputError` unless s has its unit, and the drift of second order that unit by 1/s.

    The drift of (2) takes the arctan of s in its unit, so that there is nothing to check.
    """
    units = {p.name: p.unit for p in spec.parameters} | {TIME.name: "s"}
    for c in spec.coordinates:
        units |= {c.name: c.unit, c.velocity.name: f"{c.unit}/s", c.acceleration.name: ""}
    given, motion = spec.constraint, {*spec.positions, *spec.velocities}
    for symbol, unit, residual, drift in zip(
        given.residual_symbols, given.residual_units, given.residual, given.drift, strict=True
    ):
        _check_dimension(spec, symbol.name, residual, unit, units)
        if drift.free_symbols & motion and not drift.free_symbols & set(given.residual_symbols):
            _check_dimension(spec, symbol.name, drift, f"({unit})/s", units)


def _check_dimension(
    spec: ModelSpec, name: str, value: sp.Expr, unit: str, units: Mapping[str, str]
) -> None:
    faster = {c.acceleration for c in spec.coordinates}
    if value == 0 or value.has(sp.Piecewise) or value.free_symbols & faster:
        return
    where = f"model {spec.name}: the servo-constraint {name}"
    try:
        have = dimension_of(value, units, where)
    except InputError as error:
        error.about = f"{error.about} {about_constraint(name)}"
        raise
    if have != unit_registry().parse_units(unit).dimensionality:
        raise InputError(
            f"{where} has dimension {have}, but {unit} is needed",
            remedy="mend the unit of one of its symbols, or its own",
            about=about_constraint(name),
        )
