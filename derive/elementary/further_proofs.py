"""Proofs for Gappa of the logarithm, arcsine, arccosine and hyperbolic sine: every rounding.

They claim what those of `proofs` claim: the small part, with all its roundings, lies so
close to the same formula without rounding that one unit in the last place holds. A part `lost`
holds exactly what the sum before it rounded off. Where sinh and cosh take both exponentials they
are measured, as exp is.
"""

from __future__ import annotations

import itertools
import math

from pfaffian.derive.elementary.fit import Polynomial
from pfaffian.derive.elementary.further import further_coefficients
from pfaffian.derive.elementary.proofs import (
    LEAST,
    PROVED_ULP,
    Case,
    Proof,
    cases_of,
    horner_lines,
    number_text,
)

_SMALL = "Claim: the small part is right to so small a part of x that the last rounding counts."
_LARGE = f"Claim: with half an ulp for the last addition, {PROVED_ULP} ulp hold."
#: What is left of one unit after the last rounding, by the size of a result's last place.
_ROOM = PROVED_ULP - 0.5
#: What `low`, at most 2^-53 of the root, would add to the series, at most 0.05: left out.
_LOW_LEFT = 2.0**-53 * 0.05


def further_proofs() -> tuple[Proof, ...]:
    """Return the proofs of all branches but those that take an exponential."""
    c = further_coefficients()
    return (
        _odd_series("asin", c.asin),
        _odd_series("sinh", c.sinh),
        _around_an_angle("asin_far", math.pi / 6, c.half_pi[1]),
        _around_an_angle("acos_far", 2 * math.pi / 3, 2 * c.half_pi[1]),
        _acos_middle(),
        _acos_near(),
        _log_near(),
        _log_far(),
    )


def _odd_series(name: str, series: Polynomial) -> Proof:
    """Prove x + x^3 P(x^2) on 0 < x <= 1/2; it is odd in every bit."""
    polynomial, exact = horner_lines("b", series, "z")
    allowed = _ROOM * 2.0**-53 - series.error
    return Proof(
        name=f"{name}_0",
        title=f"{name} up to 1/2: x + w.",
        meaning=_SMALL,
        code=("z = rnd(x * x);", polynomial, "w = rnd(x * z) * b;"),
        exact=("Mz = x * x;", exact, "Mw = x * Mz * Mb;"),
        cases=(Case("x", LEAST, 0.5, f"|(w - Mw) / x| <= {number_text(allowed)}"),),
        hints=("z ~ Mz", "b ~ Mb"),
    )


def _root_given() -> tuple[str, ...]:
    """Return what is known of s, the rounded root of z, and of low, the rest of it."""
    return ("s in [0, 0.5]", "|low| <= 0x1p-54", "|lost| <= 0x1p-51")


def _around_an_angle(name: str, least: float, angle_low: float) -> Proof:
    """Prove pi/2 or pi less 2 asin sqrt z: the large part is exact but for `lost`."""
    c = further_coefficients()
    polynomial, exact = horner_lines("b", c.asin, "z")
    low = number_text(angle_low)
    allowed = _ROOM * math.ulp(least * (1 - 2**-40)) - 1.05 * c.asin.error - _LOW_LEFT
    claim = f"|t - Mt| <= {number_text(allowed)}"
    return Proof(
        name=name,
        title=f"{name}: an angle less 2 (root + low + root z B(z)).",
        meaning=_LARGE,
        code=(
            f"rest = rnd(lost + rnd({low} - 2 * low));",
            polynomial,
            "q = rnd(2 * s * z);",
            "w = q * b;",
            "t = rnd(rest - w);",
        ),
        exact=(
            exact.replace("Mz", "z"),
            f"Mrest = lost + ({low} - 2 * low);",
            "Mq = 2 * s * z;",
            "Mw = Mq * Mb;",
            "Mt = Mrest - Mw;",
        ),
        cases=(Case("z", 0.0, 0.25, claim, _root_given()),),
        hints=("rest ~ Mrest", "q ~ Mq", "b ~ Mb", "w ~ Mw", "t ~ Mt"),
    )


def _acos_middle() -> Proof:
    c = further_coefficients()
    polynomial, exact = horner_lines("b", c.asin, "z")
    low = number_text(c.half_pi[1])
    allowed = _ROOM * math.ulp(1.04) - 0.53 * c.asin.error - 2.0**-100
    return Proof(
        name="acos_middle",
        title="acos up to 1/2: pi/2 less x and the series.",
        meaning=_LARGE,
        code=(
            f"rest = rnd(lost + {low});",
            "z = rnd(x * x);",
            polynomial,
            "t = rnd(rest - rnd(x * z) * b);",
        ),
        exact=("Mz = x * x;", exact, f"Mt = lost + {low} - x * Mz * Mb;"),
        cases=cases_of(-0.5, 0.5, "x", lambda a, b: allowed, "|t - Mt|", ("|lost| <= 0x1p-53",)),
        hints=("z ~ Mz", "b ~ Mb"),
    )


def _acos_near() -> Proof:
    """Prove 2 (root + small) for x > 1/2: a root by a power of two rounds as it does."""
    c = further_coefficients()
    polynomial, exact = horner_lines("b", c.asin, "z")
    allowed = 0.25 * (_ROOM * 2.0**-53 - c.asin.error - _LOW_LEFT)
    return Proof(
        name="acos_near",
        title="acos from 1/2: twice the root, taken between 1/4 and 1/2, and small part.",
        meaning=_SMALL,
        code=("q = rnd(s * z);", polynomial, "w = q * b;", "t = rnd(w + low);"),
        exact=(
            "Mq = s * z;",
            exact.replace("Mz", "z"),
            "Mw = Mq * Mb;",
            "Mt = Mw + low;",
        ),
        cases=(
            Case(
                "z",
                0.0,
                0.25,
                f"|t - Mt| <= {number_text(allowed)}",
                ("s in [0.25, 0.5]", "|low| <= 0x1p-54"),
            ),
        ),
        hints=("q ~ Mq", "b ~ Mb", "w ~ Mw", "t ~ Mt"),
    )


def _log_parts() -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return s, z = s^2, L and third = z L + f^2/2, as computed and without rounding."""
    polynomial, exact = horner_lines("l", further_coefficients().log, "z")
    code = (
        "d = rnd(2 + f);",
        "s = rnd(f / d);",
        "z = rnd(s * s);",
        polynomial,
        "h = rnd(0.5 * f * f);",
        "third = rnd(z * l + h);",
    )
    return code, (
        "Md = 2 + f;",
        "Ms = f / Md;",
        "Mz = Ms * Ms;",
        exact,
        "Mh = 0.5 * f * f;",
        "Mthird = Mz * Ml + Mh;",
    )


_LOG_HINTS = ("d ~ Md", "s ~ Ms", "z ~ Mz", "l ~ Ml", "h ~ Mh", "third ~ Mthird")


def _log_near() -> Proof:
    """Prove log(1 + f) = f - f^2/2 + s third, no exponent beside it, relative to f."""
    c = further_coefficients()
    code, exact = _log_parts()
    top = math.sqrt(2.0) - 1.0 + 2.0**-40

    def claim(a: float, b: float) -> Case:
        size = max(abs(a), abs(b))
        share = 1.0 if b < 0.0 else math.log1p(size) / size  # of f in the result, at least
        allowed = share * (_ROOM * 2.0**-53 - c.log.error) - 2.0**-100
        return Case("f", a, b, f"|(t - Mt) / f| <= {number_text(allowed)}")

    edges = [LEAST, *(top * k / 8 for k in range(1, 9))]
    pieces = [claim(a, b) for a, b in itertools.pairwise(edges)]
    pieces += [claim(-b, -a) for a, b in itertools.pairwise(edges) if b < 0.32]
    return Proof(
        name="log_near",
        title="log between sqrt(1/2) and sqrt 2: f and small part.",
        meaning=_SMALL,
        code=(*code, "u = rnd(s * third);", "t = rnd(u - 0.5 * f * f);"),
        exact=(*exact, "Mu = Ms * Mthird;", "Mt = Mu - 0.5 * f * f;"),
        cases=tuple(pieces),
        hints=(*_LOG_HINTS, "u ~ Mu"),
    )


def _log_far() -> Proof:
    """Prove e ln 2 + log(1 + f) for e other than 0, where the result is at least log(2)/2."""
    c = further_coefficients()
    code, exact = _log_parts()
    exponents = 1074 + 54
    most = exponents * abs(c.log_ln2[1]) + 2.0**-43
    spent = exponents * math.ulp(c.log_ln2[1]) + 0.35 * c.log.error + 2.0**-80
    # Larger results have a larger last place: the least one, at e = 1 or -1, stands for all.
    allowed = _ROOM * math.ulp(0.34657) - spent
    low, high = math.sqrt(0.5) - 1.0 - 2.0**-40, math.sqrt(2.0) - 1.0 + 2.0**-40
    return Proof(
        name="log_far",
        title="log elsewhere: e ln 2 + f and small part.",
        meaning=_LARGE,
        code=(*code, "u = rnd(s * third + lost);", "t = rnd(u - 0.5 * f * f);"),
        exact=(*exact, "Mu = Ms * Mthird + lost;", "Mt = Mu - 0.5 * f * f;"),
        cases=cases_of(
            low,
            high,
            "f",
            lambda a, b: allowed,
            "|t - Mt|",
            (f"|lost| <= {number_text(most)}",),
        ),
        hints=_LOG_HINTS,
    )
