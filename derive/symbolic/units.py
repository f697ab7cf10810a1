"""Physical dimensions of units and of symbolic expressions, through pint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sympy as sp
from pfaffian.derive.symbolic.functions import side
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import unit_registry
from sympy.core.relational import Relational

#: Names in the order a person writes them, for units that pint reduced to base units.
_SHORT = (("kilogram", "kg"), ("meter", "m"), ("second", "s"))
#: Units with a name of their own, by their exponents of kg, m and s.
_NAMED = (("N*m", (1, 2, -2)), ("N", (1, 1, -2)))
#: Functions whose arguments have one dimension, and those that look at a sign alone.
_OF_ONE_KIND = (sp.Max, sp.Min, sp.atan2)
_STEPS = (sp.sign, side, sp.Heaviside)


def force_unit(coordinate_unit: str) -> str:
    """Return the unit of the generalised force of a coordinate: J over the coordinate's unit."""
    return unit_product(("J", 1), (coordinate_unit, -1))


def unit_product(*factors: tuple[str, int]) -> str:
    """Return the product of units raised to powers, in base units, radians dropped.

    `unit_product(("rad/s", 1), ("s", -1), ("N*m", -1))` is `1/(kg*m^2)`.
    """
    registry = unit_registry()
    total = registry.Quantity(1, "")
    for unit, power in factors:
        total = total * registry.Quantity(1, registry.parse_units(unit)) ** power
    base = dict(total.to_base_units().unit_items())
    exponents = {short: round(base.get(name, 0)) for name, short in _SHORT}
    for name, parts in _NAMED:
        if exponents == dict(zip(("kg", "m", "s"), parts, strict=True)):
            return name
    above = [_power(s, e) for s, e in exponents.items() if e > 0]
    below = [_power(s, -e) for s, e in exponents.items() if e < 0]
    if not below:
        return "*".join(above)
    denominator = "*".join(below) if len(below) == 1 else f"({'*'.join(below)})"
    return f"{'*'.join(above) or '1'}/{denominator}"


def check_unit(unit: str, where: str, about: str = "") -> None:
    """Raise `InputError` naming `where` unless `unit` is one."""
    try:
        unit_registry().parse_units(unit)
    except Exception as error:  # pint's own family has no common base for bad unit texts
        raise InputError(
            f"{where} has the unit {unit!r}: {error}",
            remedy='give a unit such as "kg*m^2", or "" for none',
            about=about,
        ) from error


def _power(name: str, exponent: int) -> str:
    return name if exponent == 1 else f"{name}^{exponent}"


def dimension_of(expression: sp.Basic, units: Mapping[str, str], where: str) -> Any:
    """Return the pint dimensionality of `expression`, given the unit of each symbol.

    Angles count as dimensionless. Raises `InputError` naming `where` for a sum of unlike
    dimensions, a function of a dimensional argument or a symbol without a unit.
    """
    registry = unit_registry()
    one = registry.Quantity(1, "").dimensionality
    if expression.is_number:
        return one
    if expression.is_Symbol:
        if expression.name not in units:
            raise InputError(
                f"{where}: symbol {expression.name} has no unit",
                remedy="declare it as a parameter or coordinate with its unit",
                about=expression.name,
            )
        return registry.parse_units(units[expression.name]).dimensionality
    if isinstance(expression, sp.Piecewise):
        return _piecewise(expression, units, where)
    parts = [dimension_of(a, units, where) for a in expression.args]
    if expression.is_Add:
        for term, part in zip(expression.args, parts, strict=True):
            if part != parts[0]:
                raise InputError(
                    f"{where}: {term} has dimension {part}, but {expression.args[0]} "
                    f"has {parts[0]}",
                    remedy="mend the units of the symbols in the two terms",
                )
        return parts[0]
    if expression.is_Mul:
        total = one
        for part in parts:
            total = total * part
        return total
    if expression.is_Pow:
        if not expression.exp.is_number:
            _all_one(expression, parts, where)
            return one
        return parts[0] ** float(expression.exp)
    if isinstance(expression, sp.Abs):
        return parts[0]
    if isinstance(expression, _OF_ONE_KIND):
        same = _one_dimension(expression, expression.args, parts, where)
        return one if isinstance(expression, sp.atan2) else same
    if isinstance(expression, _STEPS):
        return one
    _all_one(expression, parts, where)
    return one


def _piecewise(expression: sp.Piecewise, units: Mapping[str, str], where: str) -> Any:
    """Return the dimension of all branches; the sides of each condition must have one too."""
    for relation in expression.atoms(Relational):
        sides = [dimension_of(a, units, where) for a in relation.args]
        _one_dimension(relation, relation.args, sides, where)
    branches = [e for e, _ in expression.args]
    parts = [dimension_of(e, units, where) for e in branches]
    return _one_dimension(expression, branches, parts, where)


def _one_dimension(
    whole: sp.Basic, arguments: Sequence[sp.Basic], parts: Sequence[Any], where: str
) -> Any:
    """Return the dimension that `arguments` share; a zero has any."""
    counted = [(a, p) for a, p in zip(arguments, parts, strict=True) if a != 0]
    if not counted:
        return parts[0]
    first, dimension = counted[0]
    for argument, part in counted[1:]:
        if part != dimension:
            raise InputError(
                f"{where}: in {whole}, {argument} has dimension {part}, but {first} has "
                f"{dimension}",
                remedy="mend the units of the symbols in the two",
            )
    return dimension


def _all_one(expression: sp.Basic, parts: Sequence[Any], where: str) -> None:
    one = unit_registry().Quantity(1, "").dimensionality
    if any(part != one for part in parts):
        raise InputError(
            f"{where}: argument of {expression.func.__name__} in {expression} is not dimensionless",
            remedy="divide the argument by a scale of its own dimension",
        )
