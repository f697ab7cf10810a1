"""Proofs of the emitted sine, cosine and arctangent for Gappa: every rounding, on every row.

Each proof bounds how far the small part, with all its roundings, lies from the same formula
without rounding, by what the stated bound of the function leaves after

- half a unit in the last place for the final addition,
- the error of the formula, measured when it was fitted, and
- the error of the table, at most `TABLE_ULP` of each value by construction.

A row is cut into pieces, and each piece is held to the last place of the smallest result on it.
Around zero the small part is held to a part of the argument instead, as results have no least.
The first quarter turn stands for all four, which differ from it by signs only.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pfaffian.derive.elementary.coefficients import elementary_coefficients
from pfaffian.derive.elementary.fit import Polynomial
from pfaffian.derive.elementary.tables import (
    ATAN_ROWS,
    ATAN_ZERO_ROWS,
    SINCOS_ROWS,
    TABLE_ULP,
    atan_edges,
    sincos_reach,
)

#: What is proved: a little above what is measured, as no input has every rounding at its worst.
PROVED_ULP = 1.0

#: Pieces into which a row is cut.
_PIECES = 6

#: Largest part of r that `low` is beside it, and the least |r| once a multiple is subtracted.
#: Below it there is only x itself, small enough for sine and arctangent to return it.
_LOW_PART, LEAST = 2.0**-10, 2.0**-62

#: Largest `low` where r is not close to zero: half its last place, and the last part of the step.
_LOW = 2.0**-56 * (1 + 2.0**-15)
_POWERS = (0.5, 0.25, 0.125, 0.0625)
_LOW_GIVEN = f"|low| <= {_LOW.hex()}"


@dataclass(frozen=True)
class Case:
    """A claim for one variable in an interval, the rest being as given."""

    variable: str
    low: float
    high: float
    claim: str
    given: tuple[str, ...] = ()

    def hypotheses(self) -> list[str]:
        """Return what the claim may assume."""
        return [
            f"{self.variable} in [{number_text(self.low)}, {number_text(self.high)}]",
            *self.given,
        ]


@dataclass(frozen=True)
class Proof:
    """One piece of code, and claims about it."""

    name: str
    title: str
    meaning: str
    code: tuple[str, ...]
    exact: tuple[str, ...]
    cases: tuple[Case, ...]
    hints: tuple[str, ...]

    def contexts(self) -> list[dict[str, object]]:
        """Return what the template reads, once for each case: Gappa takes one at a time."""
        common = {k: v for k, v in vars(self).items() if k not in ("name", "cases")}
        return [{**common, "case": case} for case in self.cases]


def proofs() -> tuple[Proof, ...]:
    """Return the proofs of all rows of the first quarter turn, and of all of the arctangent."""
    quarter = range(1, SINCOS_ROWS // 4)
    return (
        *_angle(),
        _sine_at_zero(),
        *(_sincos_row(name, row) for name in ("sin", "cos") for row in quarter),
        _cosine_at_zero(),
        _atan_at_zero(),
        *(_atan_row(row) for row in range(ATAN_ZERO_ROWS, ATAN_ROWS)),
        _atan_far(),
    )


def number_text(value: float) -> str:
    """Return a number as Gappa reads it back."""
    return value.hex().replace("0x0.0p+0", "0")


def horner_lines(name: str, polynomial: Polynomial, variable: str) -> tuple[str, str]:
    """Return Horner's scheme with each step rounded, and without rounding."""
    first, *rest = [number_text(c) for c in reversed(polynomial.coefficients)]
    rounded = exact = first
    for coefficient in rest:
        rounded = f"rnd({rounded} * {variable} + {coefficient})"
        exact = f"({exact} * M{variable} + {coefficient})"
    return f"{name} = {rounded};", f"M{name} = {exact};"


def _ulp(value: float) -> float:
    return math.ulp(value)


def _pieces(low: float, high: float, cuts: Sequence[float]) -> list[tuple[float, float]]:
    edges = [low + (high - low) * k / _PIECES for k in range(_PIECES + 1)]
    edges = sorted([*edges, *(cut for cut in cuts if low < cut < high)])
    return list(itertools.pairwise(edges))


def cases_of(
    low: float,
    high: float,
    variable: str,
    allowed: Callable[[float, float], float],
    claim: str,
    given: Sequence[str] = (),
    cuts: Sequence[float] = (),
) -> tuple[Case, ...]:
    """Return a claim for each piece of an interval; `allowed` is what its bound may be.

    Pieces end at `cuts` too: where the result passes a power of two, so that its ulp doubles.
    """
    return tuple(
        Case(variable, a, b, f"{claim} <= {number_text(allowed(a, b))}", tuple(given))
        for a, b in _pieces(low, high, cuts)
    )


def _angle_parts() -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return s = sin(r + low) - r and v = 1 - cos r, as computed and without rounding."""
    c = elementary_coefficients()
    sine, exact_sine = horner_lines("p", c.sin, "z")
    versine, exact_versine = horner_lines("w", c.versine, "z")
    code = ("z = rnd(r * r);", sine, versine, "s = rnd(rnd(r * z) * p + low);", "v = rnd(w * z);")
    exact = ("Mz = r * r;", exact_sine, exact_versine, "Ms = r * Mz * Mp + low;", "Mv = Mw * Mz;")
    return code, exact


def _angle_errors() -> tuple[float, float]:
    """Return how far s and v may be from their formulas: a few ulp, small beside the result's."""
    reach = sincos_reach()
    return 3 * _ulp(reach**3 / 6), 2 * _ulp(reach**2 / 2)


def _angle() -> tuple[Proof, Proof]:
    """Prove what is common to all rows but those on the axes."""
    code, exact = _angle_parts()
    title, meaning = "of a small angle, for all rows.", "Claim: a few ulp of its largest value."
    sine_error, versine_error = _angle_errors()
    reach = sincos_reach()
    claims = (
        cases_of(-reach, reach, "r", lambda a, b: sine_error, "|s - Ms|", (_LOW_GIVEN,)),
        cases_of(-reach, reach, "r", lambda a, b: versine_error, "|v - Mv|"),
    )
    return (
        Proof("angle_s", f"s {title}", meaning, code, exact, claims[0], ("z ~ Mz", "p ~ Mp")),
        Proof(
            "angle_v",
            f"v {title}",
            meaning,
            ("low = 0;", *code),
            exact,
            claims[1],
            ("z ~ Mz", "w ~ Mw", "v ~ Mv"),
        ),
    )


def _sincos_row(name: str, row: int) -> Proof:
    """Prove sine or cosine on a row: value + small, with value the larger one."""
    c = elementary_coefficients()
    centre = c.sincos_rows[row]
    middle, step = row * c.step[0] + centre.offset, c.step[0]
    value, other = centre.sine, centre.cosine
    sign, function, inverse = "-", math.sin, math.asin
    if name == "cos":
        value, other, sign, function, inverse = other, value, "+", math.cos, math.acos
    o, v = number_text(other), number_text(value)
    sine_error, versine_error = _angle_errors()

    def allowed(a: float, b: float) -> float:
        least = min(function(middle + a), function(middle + b))
        size = max(abs(a), abs(b))
        spent = TABLE_ULP * (_ulp(value) + size * _ulp(other))
        spent += value * (versine_error + c.versine.error)
        spent += other * (sine_error + size * c.sin.error) + size * _LOW  # what low adds to v
        return (PROVED_ULP - 0.5) * _ulp(least * (1 - 2**-40)) - spent

    low = (row - 0.5) * step - middle
    reach, most = sincos_reach(), (1 + 2**-20)
    given = (f"|s| <= {number_text(reach**3 / 6)}", f"v in [0, {number_text(reach**2 / 2)}]")
    return Proof(
        name=f"{name}_{row}",
        title=f"{name} on row {row} of {SINCOS_ROWS}: table value and small part.",
        meaning=f"Claim: with half an ulp for the last addition, {PROVED_ULP} ulp hold.",
        code=(f"t = rnd({o} * r + rnd({o} * s {sign} rnd({v} * v)));",),
        exact=(f"Mt = {o} * r + ({o} * s {sign} {v} * v);",),
        cases=cases_of(
            max(low * most, -reach),
            min((low + step) * most, reach),
            "r",
            allowed,
            "|t - Mt|",
            given,
            [inverse(power) - middle for power in _POWERS],
        ),
        hints=(),
    )


def _sine_at_zero() -> Proof:
    """Prove sin r = r + s on row 0, where the value of the row is zero."""
    c = elementary_coefficients()
    code, exact = _angle_parts()
    allowed = (PROVED_ULP - 0.5) * 2.0**-53 - c.sin.error
    return Proof(
        name="sin_0",
        title="sin on row 0: r + s, and cos on row 8 with its sign changed.",
        meaning="Claim: s is right to so small a part of r that rounding r + s is all that counts.",
        code=("low = r * e;", *code),
        exact=exact,
        cases=(
            Case(
                "r",
                LEAST,
                c.step[0] / 2 * (1 + 2**-20),
                f"|(s - Ms) / r| <= {number_text(allowed)}",
                (f"|e| <= {number_text(_LOW_PART)}",),
            ),
        ),
        hints=("z ~ Mz", "p ~ Mp"),
    )


def _cosine_at_zero() -> Proof:
    """Prove cos r = 1 - v on row 0, where no r is added."""
    c = elementary_coefficients()
    code, exact = _angle_parts()
    half = c.step[0] / 2 * (1 + 2**-20)
    allowed = (PROVED_ULP - 0.5) * 2.0**-53 - c.versine.error - half * _LOW
    return Proof(
        name="cos_0",
        title="cos on row 0: 1 - v, and sin on row 8.",
        meaning=f"Claim: with half an ulp for the last subtraction, {PROVED_ULP} ulp hold.",
        code=("low = 0;", *code),
        exact=exact,
        cases=cases_of(-half, half, "r", lambda a, b: allowed, "|v - Mv|"),
        hints=("z ~ Mz", "w ~ Mw", "v ~ Mv"),
    )


def _atan_parts() -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return u = atan t as computed from t, and from Mt without rounding."""
    polynomial, exact = horner_lines("a", elementary_coefficients().atan, "z")
    code = ("z = rnd(t * t);", polynomial, "u = rnd(rnd(t * z) * a + t);")
    return code, ("Mz = Mt * Mt;", exact, "Mu = Mt * Mz * Ma + Mt;")


def _atan_at_zero() -> Proof:
    c = elementary_coefficients()
    code, exact = _atan_parts()
    end = atan_edges(ATAN_ZERO_ROWS)[0] * (1 + 2**-20)
    allowed = (PROVED_ULP - 0.5) * 2.0**-53 - c.atan.error
    return Proof(
        name="atan_0",
        title="atan around zero: t + w.",
        meaning="Claim: w is right to so small a part of t that rounding t + w is all that counts.",
        code=("Mt = t;", *code[:-1], "w = rnd(t * z) * a;"),
        exact=(*exact[:-1], "Mw = Mt * Mz * Ma;"),
        cases=(Case("t", LEAST, end, f"|(w - Mw) / t| <= {number_text(allowed)}"),),
        hints=("z ~ Mz", "a ~ Ma"),
    )


def _atan_row(row: int) -> Proof:
    c = elementary_coefficients()
    centre = c.atan_rows[row]
    code, exact = _atan_parts()
    tangent = number_text(centre.tangent)

    def allowed(a: float, b: float) -> float:
        size = max(abs(math.atan(x) - centre.angle) for x in (a, b))
        spent = TABLE_ULP * _ulp(centre.angle) + size * 1.01 * c.atan.error
        return (PROVED_ULP - 0.5) * _ulp(math.atan(a) * (1 - 2**-40)) - spent

    return Proof(
        name=f"atan_{row}",
        title=f"atan on row {row}: angle of the row and small part.",
        meaning=f"Claim: with half an ulp for the last addition, {PROVED_ULP} ulp hold.",
        code=(f"d = rnd(x * {tangent} + 1);", f"n = x - {tangent};", "t = rnd(n / d);", *code),
        exact=(f"Md = x * {tangent} + 1;", "Mt = n / Md;", *exact),
        cases=cases_of(
            *atan_edges(row), "x", allowed, "|u - Mu|", cuts=[math.tan(p) for p in (*_POWERS, 1.0)]
        ),
        hints=("d ~ Md", "t ~ Mt", "z ~ Mz", "a ~ Ma", "u ~ Mu"),
    )


def _atan_far() -> Proof:
    c = elementary_coefficients()
    code, exact = _atan_parts()
    start, low = atan_edges(ATAN_ROWS)[0], number_text(c.half_pi[1])
    spent = c.atan_interval * c.atan.error + 2.0**-100
    allowed = (PROVED_ULP - 0.5) * _ulp(1.5) - spent
    return Proof(
        name="atan_far",
        title="atan beyond the rows: pi/2 and small part.",
        meaning=f"Claim: with half an ulp for the last addition, {PROVED_ULP} ulp hold.",
        code=(f"t = rnd({low} - rnd(y));", *code),
        exact=(f"Mt = {low} - y; # y = 1/x", *exact),
        cases=cases_of(0.0, 1 / start, "y", lambda a, b: allowed, "|u - Mu|"),
        hints=("t ~ Mt", "z ~ Mz", "a ~ Ma", "u ~ Mu"),
    )
