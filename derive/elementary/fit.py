"""Polynomials and split constants for the emitted elementary functions, at many digits.

Each polynomial interpolates a power series at Chebyshev points, which comes within a small factor
of the best possible polynomial and, unlike an exchange algorithm, has nothing to converge. Where
the polynomial is later multiplied by its argument, the points are stretched so that one of them
falls on zero and is dropped: this levels the error of the product, the one that counts.

Everything here is deterministic: fixed digits, fixed points, one rounding at the end.
"""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath

#: Decimal digits of every computation before its one rounding.
DIGITS = 60

_SERIES_TERMS = 60
_ERROR_POINTS = 97

#: Rounds an mpmath value to the nearest value of the format the code computes in.
Rounding = Callable[[Any], float]


def to_double(value: Any) -> float:
    """Return the double nearest `value`."""
    return float(value)


def to_single(value: Any) -> float:
    """Return the single nearest `value`, as the double of the same value."""
    return _nearest_single(value)


def _nearest_single(value: Any) -> float:
    """Round to 24 bits in one step: by way of a double, a tie could go the wrong way."""
    if value == 0:
        return 0.0
    unit = mpmath.mpf(2) ** (mpmath.frexp(value)[1] - 24)
    (single,) = struct.unpack("<f", struct.pack("<f", float(mpmath.nint(value / unit) * unit)))
    return float(single)


@dataclass(frozen=True)
class Polynomial:
    """Coefficients from the constant term up, and the relative error of the formula they serve.

    The error is the largest found when the rounded coefficients are evaluated exactly; the
    rounding errors of evaluating them on the machine come on top.
    """

    coefficients: tuple[float, ...]
    error: float

    @property
    def degree(self) -> int:
        """Return the degree."""
        return len(self.coefficients) - 1


def split(value: Any, parts: int = 2, rounding: Rounding = to_double) -> tuple[float, ...]:
    """Return `value` as a sum of numbers, each the one nearest what the earlier ones leave."""
    result = []
    for _ in range(parts):
        result.append(rounding(value))
        value = value - result[-1]
    return tuple(result)


def short_part(value: Any, bits: int) -> float:
    """Return `value` rounded to `bits` bits."""
    unit = mpmath.mpf(2) ** (mpmath.frexp(value)[1] - bits)
    return float(mpmath.nint(value / unit) * unit)


def below(value: Any) -> float:
    """Return the largest double not above `value`."""
    nearest = float(value)
    return nearest if nearest <= value else math.nextafter(nearest, -math.inf)


def evaluate(coefficients: Sequence[Any], point: Any) -> Any:
    """Evaluate a polynomial listed from its constant term up, at the working precision."""
    return functools.reduce(lambda total, c: total * point + c, reversed(coefficients))


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


def _interpolate(
    function: Callable[[Any], Any], points: list[Any], rounding: Rounding
) -> tuple[float, ...]:
    """Return the polynomial through `function` at `points`, its coefficients rounded."""
    rows = mpmath.matrix([[point**power for power in range(len(points))] for point in points])
    values = mpmath.matrix([function(point) for point in points])
    return tuple(rounding(value) for value in mpmath.lu_solve(rows, values))


def _series(term: Callable[[int], Any]) -> Callable[[Any], Any]:
    """Return the power series with coefficients term(0), term(1), ..."""
    terms = [term(k) for k in range(_SERIES_TERMS)]
    return lambda point: evaluate(terms, point)


def _worst(
    approximate: Callable[[Any], Any], exact: Callable[[Any], Any], low: Any, high: Any
) -> float:
    """Return the largest relative error over an even grid that skips zero."""
    points = [low + (high - low) * k / _ERROR_POINTS for k in range(_ERROR_POINTS + 1)]
    errors = [abs(approximate(x) / exact(x) - 1) for x in points if x != 0]
    return float(max(errors))


def fit_sin(top: Any, terms: int, rounding: Rounding = to_double) -> Polynomial:
    """Fit S in sin r = r + r^3 S(r^2) on |r| <= top."""
    series = _series(lambda k: mpmath.mpf((-1) ** (k + 1)) / mpmath.factorial(2 * k + 3))
    fit = _interpolate(series, _stretched_points(top**2, terms), rounding)
    error = _worst(lambda r: r + r**3 * evaluate(fit, r * r), mpmath.sin, 0, top)
    return Polynomial(fit, error)


def fit_versine(top: Any, terms: int, rounding: Rounding = to_double) -> Polynomial:
    """Fit V in cos r = 1 - r^2 V(r^2) on |r| <= top."""
    series = _series(lambda k: mpmath.mpf((-1) ** k) / mpmath.factorial(2 * k + 2))
    fit = _interpolate(series, _stretched_points(top**2, terms), rounding)
    error = _worst(lambda r: 1 - r**2 * evaluate(fit, r * r), mpmath.cos, 0, top)
    return Polynomial(fit, error)


def fit_atan(top: Any, terms: int, rounding: Rounding = to_double) -> Polynomial:
    """Fit A in atan t = t + t^3 A(t^2) on |t| <= top."""
    series = _series(lambda k: mpmath.mpf((-1) ** (k + 1)) / (2 * k + 3))
    fit = _interpolate(series, _stretched_points(top**2, terms), rounding)
    error = _worst(lambda t: t + t**3 * evaluate(fit, t * t), mpmath.atan, 0, top)
    return Polynomial(fit, error)


def fit_exp(top: Any, terms: int, rounding: Rounding = to_double) -> Polynomial:
    """Fit E in exp r = 1 + r + r^2 E(r) on |r| <= top; the error is relative to exp r - 1."""
    series = _series(lambda k: 1 / mpmath.factorial(k + 2))
    fit = _interpolate(series, _chebyshev_points(-top, top, terms), rounding)
    error = _worst(lambda r: r + r**2 * evaluate(fit, r), mpmath.expm1, -top, top)
    return Polynomial(fit, error)


def fit_log(top: Any, terms: int, rounding: Rounding = to_double) -> Polynomial:
    """Fit L in log(1 + f) = 2 s + s^3 L(s^2), s = f/(2 + f), for 0 <= f <= top."""
    end = top / (2 + top)
    series = _series(lambda k: mpmath.mpf(2) / (2 * k + 3))
    fit = _interpolate(series, _stretched_points(end**2, terms), rounding)
    error = _worst(
        lambda s: 2 * s + s**3 * evaluate(fit, s * s),
        lambda s: mpmath.log((1 + s) / (1 - s)),
        0,
        end,
    )
    return Polynomial(fit, error)


def fit_asin(top: Any, terms: int, rounding: Rounding = to_double) -> Polynomial:
    """Fit B in asin x = x + x^3 B(x^2) on |x| <= top."""
    series = _series(
        lambda k: mpmath.binomial(2 * k + 2, k + 1) / mpmath.mpf(4) ** (k + 1) / (2 * k + 3)
    )
    fit = _interpolate(series, _stretched_points(top**2, terms), rounding)
    error = _worst(lambda x: x + x**3 * evaluate(fit, x * x), mpmath.asin, 0, top)
    return Polynomial(fit, error)


def fit_sinh(top: Any, terms: int, rounding: Rounding = to_double) -> Polynomial:
    """Fit H in sinh x = x + x^3 H(x^2) on |x| <= top."""
    series = _series(lambda k: 1 / mpmath.factorial(2 * k + 3))
    fit = _interpolate(series, _stretched_points(top**2, terms), rounding)
    error = _worst(lambda x: x + x**3 * evaluate(fit, x * x), mpmath.sinh, 0, top)
    return Polynomial(fit, error)
