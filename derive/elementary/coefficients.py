"""Coefficients of the emitted elementary functions, computed here and not taken from a library.

The target has no mathematical library, and two libraries never agree in the last bit, so the
emitted C brings its own `sqrt`, `sin`, `cos`, `atan`, `exp`, `expm1` and `tanh`, and where a model
calls them `log`, `asin`, `acos`, `sinh` and `cosh`. Everything those need is computed with mpmath,
at many more digits than a double holds, and rounded once: the polynomials by `fit`, the
tables by `tables`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import mpmath
from pfaffian.derive.elementary.fit import (
    DIGITS,
    Polynomial,
    below,
    fit_atan,
    fit_exp,
    fit_sin,
    fit_versine,
    short_part,
    split,
)
from pfaffian.derive.elementary.further import FURTHER_ULP_BOUNDS, further_context
from pfaffian.derive.elementary.tables import (
    ATAN_OFFSET,
    ATAN_ROWS_PER_OCTAVE,
    SINCOS_ROWS,
    SQRT_SEED_BITS,
    TABLE_ULP,
    AtanRow,
    SincosRow,
    atan_reach,
    atan_rows,
    sincos_reach,
    sincos_rows,
    sqrt_seeds,
)

#: Largest |x| in radians the emitted sine and cosine accept; a NaN is returned beyond it.
SINCOS_MAX = 1.0e5

#: Bit pattern of the one NaN the emitted functions ever return.
QUIET_NAN_BITS = 0x7FF8000000000000

#: Error in units in the last place that each emitted function stays below (tested).
ULP_BOUNDS: dict[str, float] = {
    "sqrt": 0.5,
    "sin": 0.9,
    "cos": 0.9,
    "atan": 0.96,
    "atan2": 0.95,
    "exp": 0.65,
    "expm1": 0.95,
    "tanh": 0.85,
    **FURTHER_ULP_BOUNDS,
}

#: Adding it to |v| < 2^51 rounds v to an integer, which the low word of the sum then holds.
_ROUND_SHIFT = 1.5 * 2.0**52

#: From here on expm1 and exp agree to 2^-57, and expm1(-x) and -1 likewise.
_EXPM1_SPLIT = 40.0

#: tanh differs from 1 by less than 2^-56 from here on; twice it must not exceed the split of expm1.
_TANH_ONE = 20.0

#: Room for an argument that rounding puts just outside its interval.
_SLACK = 1 + 2.0**-20


@dataclass(frozen=True)
class ElementaryCoefficients:
    """Every number the emitted elementary functions of double hold."""

    steps: float
    """Rows of the sine table to a radian, used only to choose the row."""
    step: tuple[float, float, float]
    """A row in radians as a sum: 53 bits, then so few that any multiple is exact, then 53."""
    sin: Polynomial
    """S, |r| <= the reach of the rows: sin r = r + r^3 S(r^2)."""
    versine: Polynomial
    """V, likewise: cos r = 1 - r^2 V(r^2)."""
    sincos_rows: tuple[SincosRow, ...]
    """One turn."""
    atan: Polynomial
    """A, |t| <= `atan_interval`: atan t = t + t^3 A(t^2)."""
    atan_interval: float
    """Largest |t| the rows leave over."""
    atan_rows: tuple[AtanRow, ...]
    """By size of |x|."""
    half_pi: tuple[float, ...]
    """pi/2 as a sum of two doubles."""
    log2_e: float
    """1/ln 2, used only to choose the power of two to divide out."""
    ln2: tuple[float, ...]
    """ln 2 as a sum of two doubles."""
    exp: Polynomial
    """E, degree 10, |r| <= ln(2)/2: exp r = 1 + r + r^2 E(r); error relative to exp r - 1."""
    exp_overflow: float
    """Largest x whose exp is still finite."""
    exp_underflow: float
    """Smallest x whose exp does not round to zero."""
    sqrt_seeds: tuple[int, ...]
    """Words from which a word of x, halved, is subtracted for a first 1/sqrt x."""
    sqrt_seed_error: float
    """Relative error of that first 1/sqrt x."""


@functools.cache
def elementary_coefficients() -> ElementaryCoefficients:
    """Compute all coefficients; the same doubles whichever integers mpmath is built on."""
    with mpmath.workdps(DIGITS):
        reach, interval = mpmath.mpf(sincos_reach()), atan_reach()
        seeds, seed_error = sqrt_seeds()
        ln2 = mpmath.log(2)
        return ElementaryCoefficients(
            steps=float(SINCOS_ROWS / (2 * mpmath.pi)),
            step=_step_parts(),
            sin=fit_sin(reach, 4),
            versine=fit_versine(reach, 4),
            sincos_rows=sincos_rows(),
            atan=fit_atan(mpmath.mpf(interval), 5),
            atan_interval=interval,
            atan_rows=atan_rows(),
            half_pi=split(mpmath.pi / 2),
            log2_e=float(1 / ln2),
            ln2=split(ln2),
            exp=fit_exp(ln2 / 2 * _SLACK, 11),
            exp_overflow=below(mpmath.log(mpmath.mpf(2) ** 1024 - mpmath.mpf(2) ** 970)),
            exp_underflow=-below(1075 * ln2),
            sqrt_seeds=seeds,
            sqrt_seed_error=seed_error,
        )


def render_context() -> dict[str, object]:
    """Return all that the `pf_elementary` templates read, except their `header`."""
    c = elementary_coefficients()
    first_row = int(math.log2(ATAN_OFFSET) + 1023) * ATAN_ROWS_PER_OCTAVE
    return {
        "sincos_max": repr(SINCOS_MAX),
        "sincos_end": literal(math.nextafter(SINCOS_MAX, math.inf)),
        "nan_bits": f"0x{QUIET_NAN_BITS:016x}",
        "ulp": {name: f"{bound:g}" for name, bound in ULP_BOUNDS.items()},
        "table_ulp": f"1/{1 / TABLE_ULP:.0f}",
        "round_shift": literal(_ROUND_SHIFT),
        "steps": literal(c.steps),
        "step": [literal(-part) for part in c.step],
        "step_error": str(math.frexp(math.ulp(c.step[2]) / 2 / c.step[0])[1]),
        "sin": horner(c.sin),
        "versine": horner(c.versine),
        "sincos_rows": [
            {name: literal(getattr(r, name)) for name in ("offset", "sine", "cosine")}
            for r in c.sincos_rows
        ],
        "atan": horner(c.atan),
        "atan_interval": f"{c.atan_interval:.4f}",
        "atan_offset": literal(ATAN_OFFSET),
        "atan_first_row": str(first_row),
        "atan_rows": [
            {"tangent": literal(r.tangent), "angle": literal(r.angle)} for r in c.atan_rows
        ],
        "half_pi": [literal(part) for part in c.half_pi],
        "log2_e": literal(c.log2_e),
        "ln2": [literal(-part) for part in c.ln2],
        "exp": horner(c.exp),
        "exp_overflow": literal(c.exp_overflow),
        "exp_infinite": literal(math.nextafter(c.exp_overflow, math.inf)),
        "exp_underflow": literal(c.exp_underflow),
        "expm1_split": literal(_EXPM1_SPLIT),
        "tanh_one": literal(_TANH_ONE),
        "half": literal(0.5),
        "sqrt_seeds": [f"0x{seed:08x}u" for seed in c.sqrt_seeds],
        "sqrt_seed_shift": str(24 - SQRT_SEED_BITS),
        "sqrt_seed_error": f"2^{math.log2(c.sqrt_seed_error):.1f}",
        "two_54": literal(2.0**54),
        "two_500": literal(2.0**500),
        "two_minus_500": literal(2.0**-500),
        "two_900": literal(2.0**900),
        "two_minus_900": literal(2.0**-900),
        "further": further_context(literal, horner),
    }


def literal(value: float, suffix: str = "") -> dict[str, str]:
    """Return `value` as a C99 literal of the same bits, and in decimal for a comment."""
    mantissa, exponent = value.hex().split("p")
    digits = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
    return {"c": f"{digits}p{exponent}{suffix}", "decimal": repr(value)}


def horner(polynomial: Polynomial, suffix: str = "") -> dict[str, object]:
    """Return a polynomial in the order Horner's scheme takes its coefficients."""
    coefficients: Sequence[float] = polynomial.coefficients
    first, *rest = (literal(value, suffix) for value in reversed(coefficients))
    return {
        "first": first,
        "rest": rest,
        "degree": polynomial.degree,
        "error": f"2^{math.log2(polynomial.error):.1f}",
    }


def _step_parts() -> tuple[float, float, float]:
    """Split a row so that the middle part times any multiple in range has at most 53 bits."""
    step = 2 * mpmath.pi / SINCOS_ROWS
    high = float(step)
    middle = short_part(step - high, 53 - math.ceil(SINCOS_MAX / high).bit_length())
    return high, middle, float(step - high - middle)
