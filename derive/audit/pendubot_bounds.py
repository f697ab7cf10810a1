"""Equations (41)-(48): the bounds of Theorem 1, and the regressor and law of section 5.

a = 2 kappa lambda_min and c = 2 k2/k1 are the two decay rates, x = |ahat - alpha|, y = |beta| and
d = |delta| with d^2 = x^2 + y^2. L1, L2, L3 stand for the underlined kappas of (42).
"""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.audit import pendubot_source as src
from pfaffian.derive.audit.check import at_most, decide, equal, refute, true
from pfaffian.derive.audit.pendubot_source import P, alpha, dq1, dq2, q2
from pfaffian.derive.audit.row import Counterexample, Row
from pfaffian.derive.derivation import Derivation
from pfaffian.derive.dimensions import dimension_of
from pfaffian.runtime.errors import InputError

a, c, L1, L2, L3, k1 = src.positive("a c L1 L2 L3 k1")
g_min, g_max, r, reach = src.positive("gamma_m gamma_M r R")
x, y, d, rho, slack1, slack2, over = src.nonnegative("x y d rho u1 u2 over")
EPS = P.epsilon
_ROOT = sp.sqrt(L2**2 + 4 * L1 * L3)
RADIUS = (L2 + _ROOT) / (2 * L1)
#: V' <= this, the first line of (41).
BOUND = -a * y**2 + EPS / 2 - c * x**2 + c * x * alpha


def equation_41(derivation: Derivation) -> Row:
    """Check the sum of (39) and (40), then the bound in |delta| with rho = 0."""
    size, estimate = src.nonnegative("size ahat")
    gap = estimate - alpha
    total = 2 * size * (alpha - estimate) * src.regressor + 2 * gap * src.regressor * size
    second = -L1 * (x**2 + y**2) + c * alpha * (x + over) + EPS / 2
    room = slack1 * y**2 + slack2 * x**2 + c * alpha * over
    rates = {a: L1 + slack1, c: L1 + slack2}
    steps = [
        equal("the terms in |bhat| cancel", total, sp.S.Zero),
        at_most("|delta| >= |ahat - alpha|", x**2, x**2 + y**2, y**2),
        at_most(
            "second line, L1 = min(a, c), L2 = c alpha, L3 = eps/2",
            BOUND.subs(a, L1 + slack1).subs(c, rates[c]),
            second.subs(c, rates[c]),
            room.subs(c, rates[c]),
        ),
    ]
    note = (
        "Line 1 is (39) + (40). Line 2 holds with K1 = min(2 kappa lambda, 2 k2/k1), "
        "K2 = 2 (k2/k1) |alpha|, K3 = eps/2, that is (42) with rho = 0; for (42) as printed see "
        "there."
    )
    return Row(41, decide(steps, note, BOUND, -L1 * d**2 + L2 * d + L3))


def equation_42(derivation: Derivation) -> Row:
    """Refute the factor 1 + rho: the second line of (41) holds for rho = 0 alone."""
    (signed,) = src.real("rho")
    claimed = (1 + signed) * (-sp.Min(a, c) * (x**2 + y**2) + c * alpha * d + EPS / 2)
    same = ((1 + signed) * (-a * y**2 + a * alpha * y + EPS / 2) - BOUND.subs(x, 0)).subs(c, a)
    steps = [
        equal("rho > 0: margin falls as -rho a y^2", sp.expand(same).coeff(y, 2), -signed * a),
        equal("rho < 0: margin at delta = 0 is rho eps/2", same.subs(y, 0), signed * EPS / 2),
    ]
    point = {a: 2, c: 2, alpha: 1, EPS: 1, x: 0, y: 10, d: 10, signed: 1}
    found = Counterexample(
        tuple((k, sp.Integer(v)) for k, v in point.items()),
        claimed,
        BOUND,
        "the second line of (41) and the first, which should not exceed it "
        "(a = 2 kappa lambda, c = 2 k2/k1, x = |ahat - alpha|, y = |beta|)",
    )
    note = (
        "rho_Omega is never defined: it belongs to input-matrix uncertainty, absent here. For "
        "rho > 0 the second line of (41) fails for large |beta|, for rho < 0 at delta = 0, so only "
        "rho = 0 stands. V of (24) has no such factor either."
    )
    printed = (1 + signed) * sp.Min(a, c)
    return Row(42, refute(steps, note, printed, sp.Min(a, c), found))


def equation_43(derivation: Derivation) -> Row:
    """Check R as the positive root of the bound, and d(r) from the level sets of V."""
    other = (L2 - _ROOT) / (2 * L1)
    (level,) = src.nonnegative("V_below")
    steps = [
        equal("R is a root of -L1 d^2 + L2 d + L3", -L1 * RADIUS**2 + L2 * RADIUS + L3, sp.S.Zero),
        equal(
            "the bound is -L1 (d - R)(d - R')",
            -L1 * d**2 + L2 * d + L3,
            -L1 * (d - RADIUS) * (d - other),
        ),
        equal("R R' = -L3/L1 < 0, so R' < 0", sp.expand(RADIUS * other), -L3 / L1),
        # |delta|^2 <= V/g_min, V = g_max max(r, R)^2 - V_below
        at_most(
            "|delta|^2 <= d(r)^2",
            (g_max * reach**2 - level) / g_min,
            g_max / g_min * reach**2,
            level / g_min,
        ),
    ]
    note = (
        "Garbled: fraction bars in the transcribed R (K2/K2, a root over K1) were read as the "
        "underlines of (42). Then R is the positive root of the right side of (41), V' < 0 beyond "
        "it, and d(r) follows from gamma_m |delta|^2 <= V <= gamma_M |delta|^2."
    )
    return Row(43, decide(steps, note, RADIUS, RADIUS))


def equation_44(derivation: Derivation) -> Row:
    """Refute the printed eigenvalue bounds of V."""
    low = sp.Min(1, 1 / k1)
    (big,) = src.nonnegative("big")
    steps = [
        # k1 = 1 + big: min is 1/k1;  V - |delta|^2/k1 = y^2 big/k1
        at_most(
            "gamma_m = 1/k1 for k1 >= 1",
            (x**2 + y**2) / (1 + big),
            y**2 + x**2 / (1 + big),
            y**2 * big / (1 + big),
        ),
        # 1/k1 = 1 + big: min is 1
        at_most("gamma_m = 1 for k1 <= 1", x**2 + y**2, y**2 + x**2 * (1 + big), x**2 * big),
    ]
    printed = sp.Min(1, 2 / sp.Min(a, c)) * (x**2 + y**2)
    point = ((k1, sp.S(4)), (a, sp.S(2)), (c, sp.S(2)), (x, sp.S(1)), (y, sp.S(0)))
    found = Counterexample(
        point,
        printed,
        y**2 + x**2 / k1,
        "gamma_m |delta|^2 as printed (P = 1, rho = 0) and V, which should not be below it",
    )
    note = (
        "P is undefined; V of (24) gives P = 1 and gamma_m = min(1, 1/k1), gamma_M = max(1, 1/k1). "
        "The printed 2/K1 (1 + rho) is no eigenvalue of that V, underlined or not: with 2/k1 the "
        "same point gives 1/2 > 1/4."
    )
    form = sp.Min(1, 2 * (1 + rho) / L1)
    return Row(44, refute(steps, note, form, low, found))


def equation_45(derivation: Derivation) -> Row:
    """Check the ultimate bound as d(R)."""
    printed = sp.sqrt(g_max / g_min) * RADIUS
    steps = [equal("d(R) of (43)", printed, (sp.sqrt(g_max / g_min) * reach).subs(reach, RADIUS))]
    note = "The bound of (43) at r = R; valid with the corrected gamma_m and gamma_M of (44)."
    return Row(45, decide(steps, note, printed, printed))


def equation_46(derivation: Derivation) -> Row:
    """Check T as a drop of V over its least rate of descent."""
    (bar,) = src.positive("d_bar")
    inner = bar * sp.sqrt(g_min / g_max)
    printed = (g_max * r**2 - (g_min**2 / g_max) * bar**2) / (
        L1 * bar**2 * (g_min / g_max) - L2 * bar * sp.sqrt(g_min / g_max) - L3
    )
    derived = (g_max * r**2 - g_min * reach**2) / (L1 * reach**2 - L2 * reach - L3)
    (beyond,) = src.positive("beyond")
    slope = sp.expand(L1 * (RADIUS + beyond) ** 2 - L2 * (RADIUS + beyond) - L3)
    steps = [
        equal("drop of V over rate of descent", printed, derived.subs(reach, inner)),
        equal("positive beyond R", slope, beyond * (L1 * beyond + _ROOT)),
        true("that product is positive", (beyond * (L1 * beyond + _ROOT)).is_positive),
        equal("V <= gamma_M r^2 = gamma_m d_bar^2 at the edge", g_max * inner**2, g_min * bar**2),
    ]
    note = (
        "V falls from at most gamma_M r^2 to gamma_m rbar^2, rbar = d_bar "
        "(gamma_m/gamma_M)^(1/2), at no less than "
        "K1 rbar^2 - K2 rbar - K3, positive for d_bar above (45); bars of d were guessed."
    )
    return Row(46, decide(steps, note, printed, derived))


def equation_47(derivation: Derivation) -> Row:
    """Refute the sum of unlike units; the code divides by 1 rad and 1 rad/s."""
    units = {"dq1": "rad/s", "dq2": "rad/s", "q1": "rad", "q2": "rad"}
    try:
        dimension_of(src.REGRESSOR, units, "(47)")
        unlike = False
    except InputError:
        unlike = True
    speed, distance, scale = src.nonnegative("speed distance per_second")
    printed = (speed * scale + 1) ** 2 + (distance + 1) ** 2  # rates per unit of time 1/scale
    derived = (speed + 1) ** 2 + (distance + 1) ** 2
    steps = [
        true("|e'| + 1 adds rad/s to a number", unlike),
        equal(
            "in seconds, Pi of the derived law",
            src.REGRESSOR,
            src.law_expanded(derivation, "regressor"),
        ),
    ]
    point = ((speed, sp.S(1)), (distance, sp.S(0)), (scale, sp.S(60)))
    found = Counterexample(
        point, printed, derived, "Pi at |e'| = 1 rad/s: written per minute, and per second"
    )
    note = (
        "The value depends on the unit of time. In SI it is what the toolchain generates, with the "
        "scales 1 rad and 1 rad/s implied. The text derives it from (16); (14) must be meant."
    )
    return Row(47, refute(steps, note, printed, derived, found))


def equation_48(derivation: Derivation) -> Row:
    """Check the braces as beta; refute the factor before them as ADB."""
    beta_printed = src.INTEGRAL
    seventh = (src.ROW * sp.Matrix([dq1, dq2]))[0] - src.FIRST_INTEGRAL
    steps = [equal("the braces are beta, signs included", beta_printed, seventh)]
    point = {P.theta1: 2, P.theta2: 1, P.theta3: 1, P.lam: 2, q2: 0}
    found = Counterexample(
        tuple((k, sp.Integer(v)) for k, v in point.items()),
        src.GAIN_IN_48,
        derivation.input_gain,
        "the factor before the braces and ADB",
    )
    note = (
        "(15) with (20), (21) and (47) put in, but ADB appears in a third form: theta2/det M, not "
        "lam theta2/det M as in (10), and neither is the derived one. The braces are beta, with "
        "the right sign of the arctan term."
    )
    return Row(48, refute(steps, note, src.GAIN_IN_48, derivation.input_gain, found))


EQUATIONS = (
    equation_41,
    equation_42,
    equation_43,
    equation_44,
    equation_45,
    equation_46,
    equation_47,
    equation_48,
)
