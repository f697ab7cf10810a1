"""Values with units, through pint. pint is imported only where a conversion is really needed."""

from __future__ import annotations

import functools
import math
import re
from decimal import Decimal
from typing import Any

from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.toml import shown

_PLAIN = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")
#: An exponent a unit may have: a short number, and no further power on top of it.
_EXPONENT = re.compile(r"(?:\*\*|\^)\s*\(?[+-]?\d{1,2}(?:[./]\d{1,2})?\)?(?!\s*(?:\*\*|\^|\d))")
#: A number that is not part of a name, and the one a unit may have: the numerator of 1/s.
_NUMBER = re.compile(r"(?<![\w.])[\d.]+")
_NUMERATOR = re.compile(r"(^|\()\s*1\s*(?=/)")
#: What a unit is written in beside its exponents: names, products, quotients and parentheses.
_WRITTEN = re.compile(r"%|(?:[^\W\d]\w*|°|\*(?!\*)|/(?!/)|[()·\s])*")
_LONGEST_UNIT = 100
#: Words for different amounts in different countries or trades, and what says which is meant.
_AMBIGUOUS = (
    (r"(?:kilo|mega|k|M)?tons?", "t for 1000 kg, else short_ton or long_ton"),
    (r"ton_force|force_tons?", "kN"),
    (r"hundredweights?|cwt|quarters?", "kg"),
    (r"hp|horsepower", "W, or metric_horsepower"),
    (r"mils?", "mrad or mm"),
    (r"gallons?|gal|pints?|quarts?", "l, the litre"),
)
_AMBIGUOUS_WORDS = tuple((re.compile(rf"(?<!\w)(?:{w})(?!\w)"), use) for w, use in _AMBIGUOUS)


@functools.cache
def unit_registry() -> Any:
    """Return the one pint registry of this process."""
    import pint

    return pint.UnitRegistry()


def parse_quantity(raw: object, unit: str, where: str, *, drops_angles: bool = False) -> float:
    """Return `raw` in the coherent SI `unit`.

    `raw` is a number where `unit` is empty (dimensionless), else a string such as `"0.09 kg"`.
    Angles count as a dimension of their own, so that kg*deg is no mass; they may be left out, and
    be added where the `unit` is one that `drops_angles`, as those of the law's own gains do.
    Raises `InputError` naming `where` for a bare number, an unknown or ambiguous unit, and a wrong
    dimension.
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
    _check_meaning(given, unit, where)
    return _finite(_convert(number, given, unit, where, drops_angles), where)


def last_place(raw: object, unit: str) -> float:
    """Return one unit of the last digit written in a quantity that `parse_quantity` takes.

    Of "0.82 rad" it is 0.01, of "45 deg" one degree in radians.
    """
    text = raw if isinstance(raw, str) else repr(raw)
    match = _PLAIN.fullmatch(text)
    if match is None:
        return 0.0
    exponent = Decimal(match[1]).as_tuple().exponent
    given = f"1e{exponent} {match[2]}".strip()
    return parse_quantity(given if unit or match[2] else float(given), unit, "", drops_angles=True)


def _float(number: int | float) -> float:
    try:
        return float(number)
    except OverflowError:
        return math.inf


def _is_plain(given: str) -> bool:
    """Return whether a unit is short, and no arithmetic: pint would compute 9**9**9**9 as told."""
    rest = _NUMERATOR.sub(r"\1", _EXPONENT.sub("", given))
    short = len(given) <= _LONGEST_UNIT
    return short and not _NUMBER.search(rest) and _WRITTEN.fullmatch(rest) is not None


def _check_meaning(given: str, unit: str, where: str) -> None:
    """Refuse a word that is the name of several units."""
    for word, use in _AMBIGUOUS_WORDS:
        if found := word.search(given):
            raise InputError(
                f"{where}: {found[0]!r} in {shown(given)} is the name of several units",
                remedy=f"write {use}; or give {unit or 'a plain number'}",
            )


def _angles(units: Any) -> dict[str, Any]:
    """Return the units of no dimension in `units`, such as degrees, with their powers."""
    registry = unit_registry()
    one = registry.Quantity(1, "").dimensionality
    powers = registry.Quantity(1, units).unit_items()
    return {n: power for n, power in powers if registry.Unit(n).dimensionality == one}


def _angles_fit(have: Any, wanted: Any, unit: str, drops_angles: bool) -> bool:
    """Return whether what `have` says of angles can be meant by the `wanted` unit."""
    given, asked = _angles(have), _angles(wanted)
    if not given or not unit or sum(given.values()) == sum(asked.values()) != 0:
        return True
    # A plain name, such as that of a mass or a length, leaves out no angle.
    return drops_angles or (set(given) == {"radian"} and not unit.isalpha())


def _convert(number: float, given: str, unit: str, where: str, drops_angles: bool) -> float:
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
        value = float(registry.Quantity(number, have).m_as(wanted))
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
    if not _angles_fit(have, wanted, unit, drops_angles):
        raise InputError(
            f"{where}: {given} has {', '.join(_angles(have))} in it, but {unit} is needed",
            remedy=_example(unit),
        )
    return value


def _finite(value: float, where: str) -> float:
    if not math.isfinite(value):
        raise InputError(f"{where}: {value} is not finite", remedy="give a finite number")
    return value


def _example(unit: str) -> str:
    if not unit:
        return "give a plain number, for instance 2.5"
    return f'give a number with a unit that converts to {unit}, for instance "1.0 {unit}"'
