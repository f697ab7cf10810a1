"""Coefficients of the emitted elementary functions, computed here and not taken from a library.

The target has no mathematical library, and two libraries never agree in the last bit, so the
emitted C brings its own `sqrt`, `sin`, `cos`, `atan`, `exp`, `expm1` and `tanh`. Everything those
need is computed below with mpmath, at many more digits than a double holds, and rounded once.

Each polynomial interpolates a power series at Chebyshev points, which comes within a small factor
of the best possible polynomial and, unlike an exchange algorithm, has nothing to converge. Where
the polynomial is later multiplied by its argument, the points are stretched so that one of them
falls on zero and is dropped: this levels the error of the product, the one that counts.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath

#: Largest |x| in radians the emitted sine and cosine accept; a NaN is returned beyond it.
SINCOS_MAX = 1.0e5

#: Bit pattern of the one NaN the emitted functions ever return.
QUIET_NAN_BITS = 0x7FF8000000000000

#: Error in units in the last place that each emitted function stays below (tested).
ULP_BOUNDS: dict[str, float] = {
    "sqrt": 0.5,
    "sin": 0.8,
    "cos": 0.8,
    "atan": 0.65,
    "exp": 0.65,
    "expm1": 0.95,
    "tanh": 0.85,
}

#: Adding it to |v| < 2^51 rounds v to an integer, which the low word of the sum then holds.
_ROUND_SHIFT = 1.5 * 2.0**52

#: Below it sin, atan, tanh and expm1 return their argument: the next term is under 2^-56 of it.
_TINY = 2.0**-55

#: From here on expm1 and exp agree to 2^-57, and expm1(-x) and -1 likewise.
_EXPM1_SPLIT = 40.0

#: tanh differs from 1 by less than 2^-56 from here on; twice it must not exceed the split of expm1.
_TANH_ONE = 20.0

#: From here on atan is pi/2 to the last bit.
_ATAN_HUGE = 2.0**55

_DIGITS = 60
_SERIES_TERMS = 60
_ERROR_POINTS = 97


@dataclass(frozen=True)
class ElementaryCoefficients:
    """Every number the emitted elementary functions hold.

    Polynomials are listed from the constant term up. Each `*_error` is the largest relative error
    found when the rounded coefficients are evaluated exactly; the rounding errors of evaluating
    them in double come on top. For scale: one rounding to double is off by at most 2^-53.
    """

    two_over_pi: float
    """2/pi, used only to choose the multiple of pi/2 to subtract."""
    half_pi: tuple[float, float, float]
    """pi/2 as a sum: 53 bits, then so few that a multiple up to `SINCOS_MAX` is exact, then 53."""
    sin: tuple[float, ...]
    """S, degree 5, |r| <= pi/4: sin r = r + r^3 S(r^2)."""
    sin_error: float
    """Relative error of sin r."""
    cos: tuple[float, ...]
    """C, degree 5, |r| <= pi/4: cos r = 1 - r^2/2 + r^4 C(r^2)."""
    cos_error: float
    """Relative error of cos r."""
    atan: tuple[float, ...]
    """A, degree 8, |t| <= `atan_interval`: atan t = t + t^3 A(t^2)."""
    atan_error: float
    """Relative error of atan t."""
    atan_interval: float
    """Largest |t| left over by the sectors, close to tan 15 deg."""
    atan_breaks: tuple[float, float, float]
    """Where one sector ends and the next begins, close to tan 15, 45 and 75 deg."""
    atan_sectors: tuple[tuple[float, float, float], tuple[float, float, float]]
    """Per middle sector: the tangent of its centre, and its angle as a sum of two doubles."""
    log2_e: float
    """1/ln 2, used only to choose the power of two to divide out."""
    ln2: tuple[float, float]
    """ln 2 as a sum of two doubles."""
    exp: tuple[float, ...]
    """E, degree 10, |r| <= ln(2)/2: exp r = 1 + r + r^2 E(r)."""
    exp_error: float
    """Relative error of exp r - 1, the harder of its two uses."""
    exp_overflow: float
    """Largest x whose exp is still finite."""
    exp_underflow: float
    """Smallest x whose exp does not round to zero."""
    sqrt_seed: tuple[float, ...]
    """R, degree 4, 1 <= f <= 2: a first 1/sqrt f."""
    sqrt_seed_error: float
    """Relative error of that first 1/sqrt f."""
    sqrt_half: float
    """sqrt(1/2), which takes the seed from f to 2 f."""


@functools.cache
def elementary_coefficients() -> ElementaryCoefficients:
    """Compute all coefficients; the same doubles whichever integers mpmath is built on."""
    with mpmath.workdps(_DIGITS):
        slack = 1 + mpmath.mpf(2) ** -20  # the multiple subtracted is chosen in double
        sectors, breaks, interval = _atan_sectors()
        quarter, half_ln2 = mpmath.pi / 4 * slack, mpmath.log(2) / 2 * slack
        sin, sin_error = _fit_sin(quarter)
        cos, cos_error = _fit_cos(quarter)
        atan, atan_error = _fit_atan(mpmath.mpf(interval) * slack)
        exp, exp_error = _fit_exp(half_ln2)
        seed, seed_error = _fit_sqrt_seed()
        ln2 = mpmath.log(2)
        return ElementaryCoefficients(
            two_over_pi=float(2 / mpmath.pi),
            half_pi=_half_pi_parts(),
            sin=sin,
            sin_error=sin_error,
            cos=cos,
            cos_error=cos_error,
            atan=atan,
            atan_error=atan_error,
            atan_interval=interval,
            atan_breaks=breaks,
            atan_sectors=sectors,
            log2_e=float(1 / ln2),
            ln2=_split(ln2),
            exp=exp,
            exp_error=exp_error,
            exp_overflow=_below(mpmath.log(mpmath.mpf(2) ** 1024 - mpmath.mpf(2) ** 970)),
            exp_underflow=-_below(1075 * ln2),
            sqrt_seed=seed,
            sqrt_seed_error=seed_error,
            sqrt_half=float(mpmath.sqrt(0.5)),
        )


def render_context() -> dict[str, object]:
    """Return all that the two `pf_elementary` templates read, except their `header`."""
    c = elementary_coefficients()
    return {
        "sincos_max": repr(SINCOS_MAX),
        "sincos_end": _literal(math.nextafter(SINCOS_MAX, math.inf)),
        "nan_bits": f"0x{QUIET_NAN_BITS:016x}",
        "ulp": {name: f"{bound:g}" for name, bound in ULP_BOUNDS.items()},
        "tiny": _literal(_TINY),
        "round_shift": _literal(_ROUND_SHIFT),
        "two_over_pi": _literal(c.two_over_pi),
        "half_pi": [_literal(part) for part in c.half_pi],
        "half_pi_error": str(math.frexp(math.ulp(c.half_pi[2]) / 2)[1]),
        "sin": _horner(c.sin, c.sin_error),
        "cos": _horner(c.cos, c.cos_error),
        "atan": _horner(c.atan, c.atan_error),
        "atan_interval": f"{c.atan_interval:.4f}",
        "atan_breaks": [_literal(edge) for edge in c.atan_breaks],
        "atan_sectors": [[_literal(part) for part in sector] for sector in c.atan_sectors],
        "atan_quarter_turn": [_literal(part) for part in _quarter_turn()],
        "atan_huge": _literal(_ATAN_HUGE),
        "log2_e": _literal(c.log2_e),
        "ln2": [_literal(part) for part in c.ln2],
        "exp": _horner(c.exp, c.exp_error),
        "exp_overflow": _literal(c.exp_overflow),
        "exp_infinite": _literal(math.nextafter(c.exp_overflow, math.inf)),
        "exp_underflow": _literal(c.exp_underflow),
        "expm1_split": _literal(_EXPM1_SPLIT),
        "tanh_one": _literal(_TANH_ONE),
        "sqrt_seed": _horner(c.sqrt_seed, c.sqrt_seed_error),
        "sqrt_half": _literal(c.sqrt_half),
        "two_54": _literal(2.0**54),
    }


def _literal(value: float) -> dict[str, str]:
    """Return `value` as a C99 literal of the same bits, and in decimal for a comment."""
    mantissa, exponent = value.hex().split("p")
    return {"c": f"{mantissa.rstrip('0').rstrip('.')}p{exponent}", "decimal": repr(value)}


def _horner(coefficients: Sequence[float], error: float) -> dict[str, object]:
    """Return a polynomial in the order Horner's scheme takes its coefficients."""
    first, *rest = (_literal(value) for value in reversed(coefficients))
    return {
        "first": first,
        "rest": rest,
        "degree": len(coefficients) - 1,
        "error": f"2^{math.log2(error):.1f}",
    }


def _split(value: Any) -> tuple[float, float]:
    """Return the double nearest `value` and the double nearest what that leaves."""
    high = float(value)
    return high, float(value - high)


def _below(value: Any) -> float:
    """Return the largest double not above `value`."""
    nearest = float(value)
    return nearest if nearest <= value else math.nextafter(nearest, -math.inf)


def _half_pi_parts() -> tuple[float, float, float]:
    """Split pi/2 so that the middle part times any multiple in range has at most 53 bits."""
    half_pi = mpmath.pi / 2
    high = float(half_pi)
    rest = half_pi - high
    bits = 53 - math.ceil(SINCOS_MAX / high).bit_length()
    unit = mpmath.mpf(2) ** (mpmath.frexp(rest)[1] - bits)
    middle = float(mpmath.nint(rest / unit) * unit)
    return high, middle, float(rest - middle)


def _quarter_turn() -> tuple[float, float]:
    """Return pi/2 as a sum of two doubles."""
    with mpmath.workdps(_DIGITS):
        return _split(mpmath.pi / 2)


_Sector = tuple[float, float, float]


def _atan_sectors() -> tuple[tuple[_Sector, _Sector], tuple[float, float, float], float]:
    """Return the middle sectors of atan, the three breaks, and the largest |t| left over.

    Twelve steps of 15 deg make pi: one step around 0, two around each centre at 30 and 60 deg,
    one below 90 deg. Centres and breaks are rounded to multiples of 1/64, so that x - centre is
    exact in each sector.
    """
    first, last = (round(64 * math.tan(math.radians(deg))) / 64 for deg in (15, 75))
    centres = [round(64 * math.tan(math.radians(deg))) / 64 for deg in (30, 60)]
    breaks = (first, 1.0, last)
    left_over = [first, 1 / last]
    for centre, low, high in zip(centres, breaks[:2], breaks[1:], strict=True):
        left_over += [abs(edge - centre) / (1 + edge * centre) for edge in (low, high)]
    low_sector, high_sector = ((c, *_split(mpmath.atan(c))) for c in centres)
    return (low_sector, high_sector), breaks, max(left_over)


def _stretched_points(top: Any, count: int) -> list[Any]:
    """Return the Chebyshev points in (0, top) when one more is made to fall on zero."""
    angle = mpmath.pi / (2 * (count + 1))
    edge = mpmath.cos(angle)
    return [top * (mpmath.cos((2 * j + 1) * angle) + edge) / (1 + edge) for j in range(count)]


def _chebyshev_points(low: Any, high: Any, count: int) -> list[Any]:
    """Return the Chebyshev points of (low, high)."""
    middle, radius = (high + low) / 2, (high - low) / 2
    return [
        middle + radius * mpmath.cos(mpmath.pi * (2 * j + 1) / (2 * count)) for j in range(count)
    ]


def _interpolate(function: Callable[[Any], Any], points: list[Any]) -> tuple[float, ...]:
    """Return the polynomial through `function` at `points`, its coefficients rounded."""
    rows = mpmath.matrix([[point**power for power in range(len(points))] for point in points])
    values = mpmath.matrix([function(point) for point in points])
    return tuple(float(value) for value in mpmath.lu_solve(rows, values))


def _evaluate(coefficients: Sequence[Any], point: Any) -> Any:
    """Evaluate a polynomial listed from its constant term up, at the working precision."""
    return functools.reduce(lambda total, c: total * point + c, reversed(coefficients))


def _series(term: Callable[[int], Any]) -> Callable[[Any], Any]:
    """Return the power series with coefficients term(0), term(1), ..."""
    terms = [term(k) for k in range(_SERIES_TERMS)]
    return lambda point: _evaluate(terms, point)


def _worst(
    approximate: Callable[[Any], Any], exact: Callable[[Any], Any], low: Any, high: Any
) -> float:
    """Return the largest relative error over an even grid that skips zero."""
    points = [low + (high - low) * k / _ERROR_POINTS for k in range(_ERROR_POINTS + 1)]
    errors = [abs(approximate(x) / exact(x) - 1) for x in points if x != 0]
    return float(max(errors))


def _fit_sin(top: Any) -> tuple[tuple[float, ...], float]:
    """Fit S in sin r = r + r^3 S(r^2) on |r| <= top."""
    series = _series(lambda k: mpmath.mpf((-1) ** (k + 1)) / mpmath.factorial(2 * k + 3))
    fit = _interpolate(series, _stretched_points(top**2, 6))
    return fit, _worst(lambda r: r + r**3 * _evaluate(fit, r * r), mpmath.sin, 0, top)


def _fit_cos(top: Any) -> tuple[tuple[float, ...], float]:
    """Fit C in cos r = 1 - r^2/2 + r^4 C(r^2) on |r| <= top."""
    series = _series(lambda k: mpmath.mpf((-1) ** k) / mpmath.factorial(2 * k + 4))
    fit = _interpolate(series, _stretched_points(top**2, 6))

    def approximate(r: Any) -> Any:
        return 1 - r**2 / 2 + r**4 * _evaluate(fit, r * r)

    return fit, _worst(approximate, mpmath.cos, 0, top)


def _fit_atan(top: Any) -> tuple[tuple[float, ...], float]:
    """Fit A in atan t = t + t^3 A(t^2) on |t| <= top."""
    series = _series(lambda k: mpmath.mpf((-1) ** (k + 1)) / (2 * k + 3))
    fit = _interpolate(series, _stretched_points(top**2, 9))
    return fit, _worst(lambda t: t + t**3 * _evaluate(fit, t * t), mpmath.atan, 0, top)


def _fit_exp(top: Any) -> tuple[tuple[float, ...], float]:
    """Fit E in exp r = 1 + r + r^2 E(r) on |r| <= top."""
    series = _series(lambda k: 1 / mpmath.factorial(k + 2))
    fit = _interpolate(series, _chebyshev_points(-top, top, 11))
    return fit, _worst(lambda r: r + r**2 * _evaluate(fit, r), mpmath.expm1, -top, top)


def _fit_sqrt_seed() -> tuple[tuple[float, ...], float]:
    """Fit 1/sqrt f on 1 <= f <= 2."""
    one, two = mpmath.mpf(1), mpmath.mpf(2)

    def exact(f: Any) -> Any:
        return 1 / mpmath.sqrt(f)

    fit = _interpolate(exact, _chebyshev_points(one, two, 5))
    return fit, _worst(lambda f: _evaluate(fit, f), exact, one, two)
