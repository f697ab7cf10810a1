"""Values with units, through pint. pint is imported only where a conversion is really needed."""

from __future__ import annotations

import functools
import math
import re
from typing import Any

from pfaffian.runtime.errors import InputError

_PLAIN = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")


@functools.cache
def unit_registry() -> Any:
    """Return the one pint registry of this process."""
    import pint

    return pint.UnitRegistry()


def parse_quantity(raw: object, unit: str, where: str) -> float:
    """Return `raw` in the coherent SI `unit`.

    `raw` is a number where `unit` is empty (dimensionless), else a string such as `"0.09 kg"`.
    Raises `InputError` naming `where` for a bare number, an unknown unit or a wrong dimension.
    """
    if isinstance(raw, bool) or not isinstance(raw, int | float | str):
        raise InputError(f"{where}: {raw!r} is not a quantity", remedy=_example(unit))
    if not isinstance(raw, str):
        if unit:
            raise InputError(f"{where}: {raw!r} has no unit", remedy=_example(unit))
        return _finite(float(raw), where)
    match = _PLAIN.fullmatch(raw)
    if match is None:
        raise InputError(f"{where}: {raw!r} is not a number with a unit", remedy=_example(unit))
    number, given = float(match[1]), match[2]
    if given == unit:
        return _finite(number, where)
    return _finite(_convert(number, given, unit, where), where)


def _convert(number: float, given: str, unit: str, where: str) -> float:
    import pint

    registry = unit_registry()
    try:
        wanted = registry.parse_units(unit)
        have = registry.parse_units(given)
    except Exception as error:  # pint raises its own, tokenizer and attribute errors here
        raise InputError(f"{where}: unknown unit {given!r}", remedy=_example(unit)) from error
    try:
        return float(registry.Quantity(number, have).m_as(wanted))
    except pint.DimensionalityError as error:
        raise InputError(
            f"{where}: {given or 'dimensionless'} has dimension {have.dimensionality}, "
            f"but {unit or 'a dimensionless number'} ({wanted.dimensionality}) is needed",
            remedy=_example(unit),
        ) from error


def _finite(value: float, where: str) -> float:
    if not math.isfinite(value):
        raise InputError(f"{where}: {value} is not finite", remedy="give a finite number")
    return value


def _example(unit: str) -> str:
    if not unit:
        return "give a plain number, for instance 2.5"
    return f'give a number with a unit that converts to {unit}, for instance "1.0 {unit}"'
