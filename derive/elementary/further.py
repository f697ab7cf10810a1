"""Coefficients of the logarithm, arcsine, arccosine and hyperbolic sine and cosine.

Few plants need them: they stand in a header of their own, which only those models get that call
one. The methods are those of the others: a large part that is exact or right to far below the last
place, and a small part with all roundings but the last.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import mpmath
from pfaffian.derive.elementary.fit import (
    DIGITS,
    Polynomial,
    Rounding,
    fit_asin,
    fit_exp,
    fit_log,
    fit_sinh,
    short_part,
    split,
    to_double,
    to_single,
)

#: Error in units in the last place that each function stays below (tested), by precision.
FURTHER_ULP_BOUNDS: dict[str, float] = {
    "log": 0.78,
    "asin": 0.78,
    "acos": 0.75,
    "sinh": 0.65,
    "cosh": 0.65,
}
FURTHER_ULP_BOUNDS_SINGLE: dict[str, float] = {
    "log": 0.78,
    "asin": 0.7,
    "acos": 0.7,
    "sinh": 0.65,
    "cosh": 0.65,
}

#: Up to here the series of the arcsine, and of the hyperbolic sine; beyond, a root, and exp x.
_ASIN_SPLIT = _SINH_SPLIT = 0.5

#: Beyond it sinh and cosh are infinite in both precisions' reductions; their own limits lie below.
_SINH_ROOM = 0.5

_SLACK = 1 + 2.0**-10


@dataclass(frozen=True)
class _Format:
    """What differs between the precisions beside the rounding."""

    rounding: Rounding
    bits: int
    bias: int
    log_terms: int
    asin_terms: int
    sinh_terms: int
    exp_terms: int
    #: Bits that the exponent, a factor of ln 2, may take from the first part of ln 2.
    exponent_bits: int


_DOUBLE = _Format(to_double, 53, 1023, 7, 12, 6, 11, 11)
_SINGLE = _Format(to_single, 24, 127, 3, 6, 3, 6, 8)


@dataclass(frozen=True)
class FurtherCoefficients:
    """Every number these functions hold, in one precision."""

    log: Polynomial
    """L, s = f/(2 + f): log(1 + f) = 2 s + s^3 L(s^2), sqrt(1/2) <= 1 + f <= sqrt 2."""
    log_ln2: tuple[float, float]
    """ln 2 as a sum: so few bits that any exponent times it is exact, then the rest."""
    root_half: float
    """sqrt(1/2), above which significands begin."""
    asin: Polynomial
    """B, |x| <= 1/2: asin x = x + x^3 B(x^2)."""
    half_pi: tuple[float, ...]
    sinh: Polynomial
    """H, |x| <= 1/2: sinh x = x + x^3 H(x^2)."""
    exp: Polynomial
    log2_e: float
    ln2: tuple[float, ...]
    sinh_overflow: float
    """Largest |x| that is looked at; sinh and cosh overflow by themselves just below."""


def _coefficients(form: _Format) -> FurtherCoefficients:
    with mpmath.workdps(DIGITS):
        ln2, rounding = mpmath.log(2), form.rounding
        first = short_part(ln2, form.bits - form.exponent_bits)
        largest = mpmath.log(mpmath.mpf(2) ** (form.bias + 2))
        return FurtherCoefficients(
            log=fit_log((mpmath.sqrt(2) - 1) * _SLACK, form.log_terms, rounding),
            log_ln2=(first, rounding(ln2 - first)),
            root_half=rounding(mpmath.sqrt(mpmath.mpf(1) / 2)),
            asin=fit_asin(mpmath.mpf(_ASIN_SPLIT), form.asin_terms, rounding),
            half_pi=split(mpmath.pi / 2, 2, rounding),
            sinh=fit_sinh(mpmath.mpf(_SINH_SPLIT), form.sinh_terms, rounding),
            exp=fit_exp(ln2 / 2 * _SLACK, form.exp_terms, rounding),
            log2_e=rounding(1 / ln2),
            ln2=split(ln2, 2, rounding),
            sinh_overflow=rounding(largest + mpmath.mpf(_SINH_ROOM) / 1024),
        )


def further_coefficients() -> FurtherCoefficients:
    """Compute the coefficients of double precision."""
    return _coefficients(_DOUBLE)


def further_coefficients_single() -> FurtherCoefficients:
    """Compute those of single precision; each is the double of a single's value."""
    return _coefficients(_SINGLE)


def further_context(
    number: Callable[[float], dict[str, str]],
    polynomial: Callable[[Polynomial], dict[str, object]],
    single: bool = False,
) -> dict[str, object]:
    """Return what the template of these functions reads under `further`, in one precision."""
    form = _SINGLE if single else _DOUBLE
    c = _coefficients(form)
    bounds = FURTHER_ULP_BOUNDS_SINGLE if single else FURTHER_ULP_BOUNDS
    fraction = form.bits - 1
    word = "uint32_t" if single else "uint64_t"
    root_bits = _bits(c.root_half, form)
    one_bits = form.bias << fraction
    return {
        "ulp": {name: f"{bound:g}" for name, bound in bounds.items()},
        "real": "float" if single else "double",
        "f": "f" if single else "",
        "sqrt": "pf_sqrtf" if single else "pf_sqrt_inline",
        "word": word,
        "fraction": str(fraction),
        "bias": str(form.bias),
        "lift": str(fraction + 2),
        "lifted": number(2.0 ** (fraction + 2)),
        "to_one": f"0x{one_bits - root_bits:x}u",
        "one_bits": f"0x{one_bits:x}u",
        "least": number(2.0 ** (1 - form.bias)),
        "most": number((2.0 - 2.0**-fraction) * 2.0**form.bias),
        "log": polynomial(c.log),
        "log_ln2": [number(part) for part in c.log_ln2],
        "asin": polynomial(c.asin),
        "half_pi": [number(part) for part in c.half_pi],
        "pi": [number(2.0 * part) for part in c.half_pi],
        "sinh": polynomial(c.sinh),
        "exp": polynomial(c.exp),
        "log2_e": number(c.log2_e),
        "ln2": [number(-part) for part in c.ln2],
        "round_shift": number(1.5 * 2.0**fraction),
        "sinh_overflow": number(c.sinh_overflow),
        "split": number(_SINH_SPLIT),
        "most_back": "32" if single else "64",
    }


def _bits(value: float, form: _Format) -> int:
    """Return the bits of a positive normal number in the format."""
    mantissa, exponent = math.frexp(value)
    fraction = int(mantissa * 2.0**form.bits) - (1 << (form.bits - 1))
    return ((exponent - 1 + form.bias) << (form.bits - 1)) + fraction
