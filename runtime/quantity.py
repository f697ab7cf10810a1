"""Values with units, through pint. pint is imported only where a conversion is really needed."""

from __future__ import annotations

import functools
import math
import re
from typing import Any

from pfaffian.runtime.documents import shown
from pfaffian.runtime.errors import InputError

_PLAIN = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")
#: An exponent a unit may have: a short number, and no further power on top of it.
_EXPONENT = re.compile(r"(?:\*\*|\^)\s*\(?[+-]?\d{1,2}(?:[./]\d{1,2})?\)?(?!\s*(?:\*\*|\^|\d))")
#: A number that is not part of a name.
_NUMBER = re.compile(r"(?<![\w.])[\d.]+")
_LONGEST_UNIT = 100


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
        raise InputError(f"{where}: {shown(raw)} is not a quantity", remedy=_example(unit))
    if not isinstance(raw, str):
        if unit:
            raise InputError(f"{where}: {shown(raw)} has no unit", remedy=_example(unit))
        return _finite(_float(raw), where)
    match = _PLAIN.fullmatch(raw)
    if match is None:
        raise InputError(
            f"{where}: {shown(raw)} is not a number with a unit", remedy=_example(unit)
        )
    number, given = float(match[1]), match[2]
    if given == unit:
        return _finite(number, where)
    return _finite(_convert(number, given, unit, where), where)


def _float(number: int | float) -> float:
    try:
        return float(number)
    except OverflowError:
        return math.inf


def _is_plain(given: str) -> bool:
    """Return whether a unit is short, and no arithmetic: pint would compute 9**9**9**9 as told."""
    rest = _EXPONENT.sub("", given)
    numbers = set(_NUMBER.findall(rest))
    return len(given) <= _LONGEST_UNIT and numbers <= {"1"} and "**" not in rest and "^" not in rest


def _convert(number: float, given: str, unit: str, where: str) -> float:
    import pint

    registry = unit_registry()
    try:
        if not _is_plain(given):
            raise ValueError(given)
        wanted = registry.parse_units(unit)
        have = registry.parse_units(given)
    except Exception as error:  # pint raises its own, tokenizer and attribute errors here
        raise InputError(f"{where}: unknown unit {shown(given)}", remedy=_example(unit)) from error
    try:
        return float(registry.Quantity(number, have).m_as(wanted))
    except pint.DimensionalityError as error:
        raise InputError(
            f"{where}: {given or 'dimensionless'} has dimension {have.dimensionality}, "
            f"but {unit or 'a dimensionless number'} ({wanted.dimensionality}) is needed",
            remedy=_example(unit),
        ) from error
    except Exception as error:  # decibels and the like, which pint multiplies with nothing
        raise InputError(
            f"{where}: {given!r} does not convert to {unit or 'a plain number'}",
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
