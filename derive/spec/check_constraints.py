"""What must hold of a specification's servo-constraints and forces: known symbols, right units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import sympy as sp
from pfaffian.derive.spec.model_spec import TIME, ModelSpec, symbol_of
from pfaffian.derive.spec.source_line import about_constraint
from pfaffian.derive.symbolic.supported import check_supported
from pfaffian.derive.symbolic.units import dimension_of
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import unit_registry
from sympy.core.function import AppliedUndef

#: What to do instead of an energy that varies with the time.
_WITH_TIME = (
    "let servo-constraints or their errors vary with it; what is moved from outside is a "
    "coordinate with an actuator of its own"
)


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
    motion = {*spec.positions, *spec.velocities}
    own = {symbol_of(p) for p in spec.parameters}
    faster = {c.acceleration for c in spec.coordinates}  # has a message of its own
    allowed = motion | own | faster | {TIME}
    for name, residual, drift in zip(names, given.residual, given.drift, strict=True):
        what = f"the servo-constraint {name}"
        check_symbols(spec, what, residual, allowed, about_constraint(name))
        law = allowed | set(given.residual_symbols)
        check_symbols(spec, f"the drift of {name}", drift, law, about_constraint(name))
    for c, error, point in zip(spec.coordinates, given.errors, given.setpoint, strict=True):
        check_symbols(spec, f"the error of {c.name}", error, allowed, "errors")
        check_symbols(spec, f"the setpoint of {c.name}", point, own, "setpoint")
    for what, entries in (
        ("friction", spec.uncertain_force),
        ("the input matrix", spec.input_matrix),
    ):
        for entry in entries:
            check_symbols(spec, what, entry, motion | own, "uncertain_force input_matrix")
    _check_dimensions(spec)


def check_symbols(
    spec: ModelSpec, what: str, value: sp.Expr, allowed: set[sp.Symbol], about: str
) -> None:
    """Raise `InputError` where `value`, which is `what`, is not finite or not in these symbols."""
    if value.has(sp.zoo, sp.nan, sp.oo, -sp.oo):
        raise InputError(
            f"model {spec.name}: {what} is not finite: {value}",
            remedy="look for a division by zero",
            about=about,
        )
    functions = sorted(value.atoms(AppliedUndef), key=str)
    if functions:
        name = functions[0].func.__name__
        raise InputError(
            f"model {spec.name}: {what} contains {functions[0]}, a function of SymPy's such as "
            "dynamicsymbols makes",
            remedy=f"write it in the symbols that coordinate() returns: {name} and d{name}",
            about=about,
        )
    check_supported(value, f"model {spec.name}: {what}", about)
    strange = sorted(value.free_symbols - allowed, key=lambda s: str(s.name))
    if not strange:
        return
    first = strange[0]
    known = {s.name for s in allowed}
    energy = what.endswith("energy")
    if first == TIME and energy:
        reason, remedy = "the time: energies may not vary with it", _WITH_TIME
    elif first == TIME:
        reason, remedy = "the time", "only servo-constraints and errors may vary with the time"
    elif first.name in known:
        reason = f"a second symbol {first.name}, made apart from the one that is declared"
        remedy = "use the symbols that the declarations return"
    elif first in {c.acceleration for c in spec.coordinates}:
        reason, remedy = f"the acceleration {first.name}", "write it in coordinates and their rates"
    else:
        reason = f"{first.name}, which is declared nowhere"
        other = "coordinate" if energy else "gain"
        remedy = f"declare it as a parameter or {other} with its unit"
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
