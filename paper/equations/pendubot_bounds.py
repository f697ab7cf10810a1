"""Equations (41)-(48): the bounds of Theorem 1, and the regressor and law of section 5.

x = |ahat - alpha|, y = |beta| and d = |delta| with d^2 = x^2 + y^2; a = 2 kappa lower and
c = 2 k2/k1 are the two decay rates. L1, L2, L3 stand for the underlined kappas of (42).
"""

from __future__ import annotations

import sympy as sp
from pfaffian.paper.audit.check import (
    Step,
    above,
    at_most,
    decide,
    equal,
    judge,
    repaired,
    resolved,
    true,
    vanishes,
)
from pfaffian.paper.audit.row import Counterexample, Row
from pfaffian.paper.equations import pendubot_source as src
from pfaffian.paper.equations.pendubot_source import Case, P, alpha

L1, L2, L3, k1, base = src.positive("L1 L2 L3 k1 k1_below")
g_min, g_max, r, reach, d_bar = src.positive("gamma_m gamma_M r R d_bar")
x, y, over, big = src.nonnegative("x y over big")
(slack,) = src.nonnegative("slack")
EPS = P.epsilon
_KAPPAS = ("K1", "K2", "K3")
_LAMBDAS = {"K1": L1, "K2": L2, "K3": L3}
_CORRECTED = "gamma_m = min(1, 1/k1) and gamma_M = max(1, 1/k1) for (44)"
RADIUS = (L2 + sp.sqrt(L2**2 + 4 * L1 * L3)) / (2 * L1)


def first_line(case: Case) -> sp.Expr:
    """Return the first line of (41) in y = |beta| and x = |ahat - alpha|."""
    return case.scalar(41, "line1", beta=y, ahat=alpha + x)


def second_line(case: Case, rho: sp.Expr, size: sp.Expr) -> sp.Expr:
    """Return the second line of (41) with the constants of (42), |delta| = `size`."""
    constants = {n: case.scalar(42, n, rho=rho) for n in _KAPPAS}
    return case.scalar(41, "line2", delta=size, **constants)


def second_above_first(case: Case) -> list[Step]:
    """Show that the second line of (41) is above the first with rho = 0, for a <= c and c <= a."""
    steps, size = [], x + over  # |delta| >= |ahat - alpha|
    square = over * (2 * x + over)  # |beta|^2 = |delta|^2 - |ahat - alpha|^2
    for name, a, c in (("a <= c", L1, L1 + slack), ("c <= a", L1 + slack, L1)):
        rates = {P.kappa: a / (2 * src.lower), P.k2: P.k1 * c / 2}
        given = {"beta": sp.sqrt(square), "ahat": alpha + x}
        lower = case.scalar(41, "line1", **given).subs(rates)
        upper = resolved(second_line(case, sp.S.Zero, size).subs(rates))
        steps.append(at_most(f"second line with rho = 0, {name}", lower, upper))
    return steps


def rho_counterexample(case: Case) -> Counterexample:
    """Return where the second line of (41) is below the first for rho = 1."""
    values = {P.kappa: 1, src.lower: 1, P.k1: 1, P.k2: 1, alpha: 1, EPS: 1, x: 0, y: 10, src.rho: 1}
    upper = second_line(case, src.rho, sp.sqrt(x**2 + y**2))
    return Counterexample(
        tuple((k, sp.Integer(v)) for k, v in values.items()),
        upper,
        first_line(case),
        "the second line of (41) with (42) for rho = 1, and the first, which should not exceed it "
        "(x = |ahat - alpha|, y = |beta|)",
    )


def equation_41(case: Case) -> Row:
    """Check line 1 as the sum of (39) and (40), then line 2 with rho = 0."""
    first = case.scalar(41, "line1")
    total = case.scalar(39, "right") + case.scalar(40, "line5")
    square = case.scalar(41, "square", beta=y, ahat=alpha + x)
    steps = [
        equal("line 1 is (39) + (40)", first, total),
        equal("|delta|^2", square, x**2 + y**2),
        *second_above_first(case),
    ]
    found = rho_counterexample(case)
    repair = "rho = 0 in (42)"
    note = (
        "Line 1 is (39) + (40). Line 2 with (42) as printed fails; it holds with "
        f"{repair}, that is K1 = min(2 kappa lambda, 2 k2/k1), K2 = 2 (k2/k1) |alpha|, K3 = eps/2."
    )
    shown = case.scalar(41, "line2", delta=reach, **_LAMBDAS)
    return Row(41, repaired(_exceeding(found), repair, steps, note, first, shown))


def _exceeding(found: Counterexample) -> Counterexample | None:
    """Return `found` where its second value exceeds its first, as a broken bound does."""
    return found if found.disagrees() and above(*found.values()) else None


def equation_42(case: Case) -> Row:
    """Refute the factor 1 + rho: the second line of (41) holds for rho = 0 alone."""
    (a,) = src.positive("a")
    same = {P.kappa: a / (2 * src.lower), P.k2: P.k1 * a / 2}
    margin = resolved((second_line(case, src.rho, y) - first_line(case).subs(x, 0)).subs(same))
    steps = [
        equal("margin falls as -rho a y^2", sp.expand(margin).coeff(y, 2), -src.rho * a),
        equal("margin at delta = 0 is rho eps/2", margin.subs(y, 0), src.rho * EPS / 2),
        *second_above_first(case),
    ]
    note = (
        "rho_Omega is never defined: it belongs to input-matrix uncertainty, absent here. For "
        "rho > 0 the second line of (41) fails for large |beta|, for rho < 0 at delta = 0, so only "
        "rho = 0 stands. V of (24) has no such factor either."
    )
    printed = {n: case.scalar(42, n) for n in _KAPPAS}
    free = not any(f.has(src.rho) for f in printed.values())
    proving = [true("no undefined symbol", free), *second_above_first(case)]
    found = rho_counterexample(case)
    derived = case.scalar(42, "K1", rho=0)
    return Row(42, judge(steps, found, proving, note, printed["K1"], derived))


def lyapunov(case: Case, along: str, size: sp.Expr) -> sp.Expr:
    """Return V of (24) for beta = `size`, or for ahat - alpha = `size`."""
    given = {"beta": size, "ahat": alpha} if along == "beta" else {"beta": 0, "ahat": alpha + size}
    return case.scalar(24, "V", **given)


#: The cases of k1: its value, the direction in which V is flat, and that in which it is steep.
CASES = (
    ("k1 >= 1", 1 + big, "ahat", "beta"),
    ("k1 <= 1", 1 / (1 + big), "beta", "ahat"),
)


def worst(case: Case, number: int, part: str, start: sp.Expr, **given: sp.Expr) -> list[Step]:
    """Show that a bound on |delta| is the largest |delta| on the level set of V that starts with
    |delta| = `start`: V there, in its flat direction, is V of the start in the steep one.
    """
    steps = []
    for name, value, flat, steep in CASES:
        low, high = (resolved(f(1, 1 / value)) for f in (sp.Min, sp.Max))
        bound = case.scalar(number, part, gm=low, gM=high, **given)
        level, begun = lyapunov(case, flat, bound), lyapunov(case, steep, start)
        step = equal(f"({number}) {part}, {name}", *(v.subs(P.k1, value) for v in (level, begun)))
        steps.append(step)
    return steps


def printed_bounds(case: Case) -> tuple[sp.Expr, sp.Expr]:
    """Return gamma_m and gamma_M of (44) as printed, with P = 1, and (42) for the kappa in them."""
    given = {"K1": case.scalar(42, "K1"), "P": sp.S.One}
    return case.scalar(44, "gm", **given), case.scalar(44, "gM", **given)


def eigenvalue_counterexample(case: Case) -> Counterexample:
    """Return where gamma_m |delta|^2 with (44) as printed exceeds V."""
    low, _ = printed_bounds(case)
    point = {P.k1: 4, P.kappa: 1, src.lower: 1, P.k2: 4, src.rho: 0, x: 1}
    return Counterexample(
        tuple((k, sp.Integer(v)) for k, v in point.items()),
        lyapunov(case, "ahat", x),
        low * x**2,
        "V, and gamma_m |delta|^2 with (44) as printed (P = 1), which should not exceed it "
        "(beta = 0, x = |ahat - alpha|)",
    )


def equation_43(case: Case) -> Row:
    """Check R as the positive root of the bound, and d(r) on the level sets of V."""
    radius = case.scalar(43, "R", **_LAMBDAS)
    transcribed = case.scalar(43, "R_transcribed", **_LAMBDAS)

    def bound(size: sp.Expr) -> sp.Expr:
        return case.scalar(41, "line2", delta=size, **_LAMBDAS)

    steps = [
        equal("R is a root of the second line of (41)", bound(radius), sp.S.Zero),
        true("it is positive", radius.is_positive),
        equal("and the only one: R R' = -L3/L1", radius * (L2 / L1 - radius), -L3 / L1),
        *worst(case, 43, "within", reach, R=reach),
        *worst(case, 43, "beyond", r, r=r),
    ]
    values = {L1: 2, L2: 3, L3: 5}
    found = Counterexample(
        tuple((k, sp.Integer(v)) for k, v in values.items()),
        sp.S.Zero,
        bound(transcribed),
        "zero, and the second line of (41) at R as transcribed",
    )
    repair = f"fraction bars of R are read as the underlines of (42); {_CORRECTED}"
    note = (
        "Garbled: fraction bars in the transcribed R (K2/K2, a root over K1) were read as the "
        "underlines of (42). Then R is the positive root of the right side of (41), V' < 0 beyond "
        "it, and d(r) follows with min(1, 1/k1) and max(1, 1/k1) for gamma_m and gamma_M."
    )
    return Row(43, repaired(found, repair, steps, note, transcribed, radius))


def equation_44(case: Case) -> Row:
    """Refute the printed eigenvalue bounds of V."""
    low, high = printed_bounds(case)
    proving, refuting = [], []
    for name, value, flat, steep in CASES:
        exact = [resolved(f(1, 1 / value)) for f in (sp.Min, sp.Max)]
        for letter, form, along, factor in zip(
            "mM", (low, high), (flat, steep), exact, strict=True
        ):
            seen = lyapunov(case, along, x).subs(P.k1, value)
            refuting.append(equal(f"true gamma_{letter}, {name}", seen, factor * x**2))
            printed = resolved(form.subs(P.k1, value))
            proving.append(equal(f"gamma_{letter}, {name}", printed, factor))
    found = eigenvalue_counterexample(case)
    note = (
        "P is undefined; V of (24) gives P = 1 and gamma_m = min(1, 1/k1), gamma_M = max(1, 1/k1). "
        "The printed 2/K1 (1 + rho) is no eigenvalue of that V, underlined or not: with 2/k1 the "
        "same point gives 1/2 > 1/4."
    )
    derived = sp.Min(1, 1 / P.k1)
    return Row(44, judge(refuting, found, proving, note, low, derived))


def equation_45(case: Case) -> Row:
    """Check the ultimate bound as the largest |delta| on the level set around |delta| <= R."""
    printed = case.scalar(45, "d_under", gm=g_min, gM=g_max, R=reach)
    steps = worst(case, 45, "d_under", reach, R=reach)
    note = (
        "The bound of (43) at r = R: the level set of V around all |delta| <= R reaches so far and "
        f"no farther, with {_CORRECTED}; with (44) as printed it bounds nothing."
    )
    found = _exceeding(eigenvalue_counterexample(case))
    return Row(45, repaired(found, _CORRECTED, steps, note, printed, printed))


def equation_46(case: Case) -> Row:
    """Check T as the drop of V over its least rate of descent."""
    names = {"gm": g_min, "gM": g_max, "d_bar": d_bar, "r": r}
    inner = case.scalar(46, "edge", **names)
    duration = case.scalar(46, "T", **names, **_LAMBDAS)
    descent = -case.scalar(41, "line2", delta=inner, **_LAMBDAS)
    (beyond,) = src.positive("beyond")
    later = -case.scalar(41, "line2", delta=RADIUS + beyond, **_LAMBDAS)
    root = sp.sqrt(L2**2 + 4 * L1 * L3)
    steps = [
        equal("d(edge) is d_bar", sp.sqrt(g_max / g_min) * inner, d_bar),
        equal("after T: V <= gamma_m edge^2", g_max * r**2 - duration * descent, g_min * inner**2),
        equal("V falls beyond R", sp.expand(later), beyond * (L1 * beyond + root)),
        true("that is positive", (beyond * (L1 * beyond + root)).is_positive),
    ]
    repair = f"{_CORRECTED}, and the lost bars of d"
    note = (
        "V falls from at most gamma_M r^2 to gamma_m edge^2, edge = d_bar (gamma_m/gamma_M)^(1/2), "
        "at no less than K1 edge^2 - K2 edge - K3, positive for d_bar above (45); from there on "
        f"|delta| <= d(edge) = d_bar. With {repair}."
    )
    found = _exceeding(eigenvalue_counterexample(case))
    derived = (g_max * r**2 - g_min * inner**2) / descent
    return Row(46, repaired(found, repair, steps, note, duration, derived))


def equation_47(case: Case) -> Row:
    """Check Pi against the regressor of the derived law."""
    printed, derived = case.explicit(47, "Pi"), case.law_expanded("regressor")
    steps = [equal("Pi of the derived law", printed, derived)]
    note = (
        "A definition; the toolchain generates the same, with 1 rad and 1 rad/s implied. The text "
        "derives it from (16); (14) must be meant. In SI; the unit it hangs on: finding "
        "unit-of-time."
    )
    return Row(47, decide(steps, note, printed, derived))


def equation_48(case: Case) -> Row:
    """Check (48) but for the factor before the braces; refute that as ADB."""
    factor, braces = case.explicit(48, "factor"), case.explicit(48, "braces")
    size = src.bhat
    rate = case.explicit(48, "rate", factor=1, braces=size, Pi=src.regressor)
    law = case.in_terms(
        "bound_estimate_rate", bhat=size, regressor=src.regressor, bound_estimate=src.estimate
    )
    holding = [
        equal("the braces are beta, signs included", braces, case.following()),
        equal("Pi is (47)", case.explicit(48, "Pi"), case.law_expanded("regressor")),
        equal("the rest is (15)", rate, law),
    ]
    note = (
        "(15) with (20), (21) and (47) put in, but ADB appears in a third form: theta2/det M, not "
        "lam theta2/det M as in (10), and neither is the derived one. The braces are beta, with "
        "the right sign of the arctan term. In SI; see finding unit-of-time."
    )
    gain = case.derivation.input_gain
    failed = [s for s in holding if not s.holds]
    if failed:
        return Row(48, decide(holding, "Besides its factor.", braces, case.following()))
    point = {P.theta1: 2, P.theta2: 1, P.theta3: 1, P.lam: 2, src.q2: 0}
    found = Counterexample(
        tuple((k, sp.Integer(v)) for k, v in point.items()),
        factor,
        gain,
        "the factor before the braces and ADB",
    )
    proving = [*holding, true("the factor is ADB", vanishes(factor - gain))]
    return Row(48, judge(holding, found, proving, note, factor, gain))


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
