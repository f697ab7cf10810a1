"""Equations (9)-(23): decomposition of the uncertainty, assumptions and control law."""

from __future__ import annotations

import sympy as sp
from pfaffian.paper.audit.check import (
    Step,
    above,
    decide,
    equal,
    judge,
    refute,
    repaired,
    resolved,
    true,
)
from pfaffian.paper.audit.row import Counterexample, Row
from pfaffian.paper.equations import pendubot_source as src
from pfaffian.paper.equations.pendubot_constraint import beta_of_law
from pfaffian.paper.equations.pendubot_source import PLAIN, SINGULAR, Case, P, q2


def at_cosine(expression: sp.Expr, level: sp.Expr) -> sp.Expr:
    """Return `expression` with cos q2 = `level`."""
    return sp.expand(expression.subs(sp.cos(q2), level))


def singular_cosine() -> sp.Expr:
    """Return cos q2 on the singular set: where ADB vanishes."""
    return (P.lam - 1) * P.theta2 / P.theta3


def equation_9(case: Case) -> Row:
    """Check the sum; refute that the mismatched part lies in a null space of B."""
    split = case.derivation.decomposition
    whole, seen = case.explicit(9, "sum"), case.explicit(9, "null")
    itself = equal("F = B Fhat + dF", split.force, whole)
    if not itself.holds:
        return Row(9, decide([itself], "", whole, split.force))
    f1, f2 = split.force
    point = {**PLAIN, P.lam: sp.Integer(3), q2: sp.S.Zero, f1: sp.S.Zero, f2: sp.S.One}
    found = Counterexample(
        tuple(point.items()), sp.S.Zero, seen, "B^T dF (zero if dF were in that null space)"
    )
    note = (
        "The sum holds identically. The claim that dF lies in the null space of B (read: of B^T; "
        "B itself is a column) is wrong: dF of (11) has a component along B wherever f2 acts. It "
        "lies in the null space of AD, as (12) says."
    )
    proving = [itself, equal("that product is zero", seen, sp.S.Zero)]
    return Row(9, judge([itself], found, proving, note, sp.S.Zero, seen), "claim")


def equation_10(case: Case) -> Row:
    """Compare ADB with the derived one; the claim about its sign is a finding of its own."""
    printed, (_, derived) = case.explicit(10, "ADB"), case.reach
    steps = [
        equal("derived ADB is that of the derivation", case.derivation.input_gain, derived),
        equal("ADB", printed, derived),
    ]
    note = "The claim ADB > 0 printed with it is judged in finding adb-changes-sign."
    if not steps[1].holds:
        note = (
            "The term of M that couples the joints is dropped: A D B = (lam theta2 - theta2 - "
            f"theta3 cos q2)/det M. {note}"
        )
    return Row(10, decide(steps, note, printed, case.derivation.input_gain, PLAIN))


def equation_11(case: Case) -> Row:
    """Check Fhat and dF, and that the split is a projection."""
    matched = case.explicit(11, "Fhat")
    mismatched = case.explicit(11, "dF", Fhat=matched)
    split, (ad, adb) = case.derivation.decomposition, case.reach
    projector = case.derivation.dynamics.input_matrix * ad / adb
    steps = [
        equal("Fhat", matched, split.matched[0]),
        equal("dF", mismatched, split.mismatched),
        equal("B (ADB)^-1 AD is a projector", projector * projector, projector),
    ]
    note = "Follows wherever ADB is not zero; the split is an oblique projection along null(AD)."
    return Row(11, decide(steps, note, matched, split.matched[0]))


def equation_12(case: Case) -> Row:
    """Check AD dF = 0 for the dF of the derivation."""
    value = case.explicit(12, "zero")
    note = "Identically zero. The mismatched part leaves beta alone, not the zero dynamics."
    zero = sp.S.Zero
    steps = [
        true("dF is not zero itself", any(case.derivation.decomposition.mismatched)),
        equal("AD dF = 0", value, zero if value.is_commutative else value),
    ]
    if isinstance(value, sp.MatrixBase):
        steps[1] = true("AD dF is a number", False)
    return Row(12, decide(steps, note, value, zero))


def equation_13(case: Case) -> Row:
    """Refute Assumption 1: ADB vanishes in every design whose zero dynamics are stable."""
    squared = case.explicit(13, "left")
    (excess,) = src.positive("excess")
    # lam < 1 + theta3/theta2 means theta3 = (lam - 1) theta2 + excess: then the cosine is below 1.
    level = singular_cosine()
    room = sp.factor(1 - level.subs(P.theta3, (P.lam - 1) * P.theta2 + excess))
    numerator = sp.fraction(sp.together(squared))[0]
    steps = [
        equal("it vanishes at cos q2 = (lam - 1) theta2/theta3", at_cosine(numerator, level), 0),
        equal("that cosine is below 1 where lam < 1 + theta3/theta2", room * _den(room), excess),
    ]
    point = {**SINGULAR, q2: sp.pi / 3, src.lower: sp.S.One}
    found = Counterexample(
        tuple(point.items()),
        case.explicit(13, "bound"),
        squared,
        "the bound and ADB B^T D A^T, which must reach it",
    )
    note = (
        "Assumption 1, as stated for all states, is false: (ADB)^2 = 0 on the singular set, which "
        "exists whenever |lam - 1| theta2 <= theta3, so in every design with stable zero dynamics. "
        "It can hold on a region |q2| < q2* only, and nothing in the proof keeps q2 there."
    )
    return Row(13, refute(steps, note, squared, sp.S.Zero, found))


def _den(expression: sp.Expr) -> sp.Expr:
    return sp.fraction(sp.together(expression))[1]


def equation_14(case: Case) -> Row:
    """Refute Assumption 2 for forces on joint 2: Fhat has a true pole on the singular set."""
    f1, f2 = case.derivation.decomposition.force
    size, at_rest = case.explicit(14, "left"), {src.dq1: 0, src.dq2: 0, src.q1: sp.pi / 2}
    square = sp.together(size.replace(sp.Abs, lambda x: x) ** 2)
    numerator, denominator = sp.fraction(square)
    level = singular_cosine()
    weight = at_cosine(numerator, level).coeff(f2, 2)
    steps = [
        equal("with f2 = 0, |Fhat| = |f1|", square.subs(f2, 0), f1**2),
        equal("its denominator vanishes on the singular set", at_cosine(denominator, level), 0),
        true("and the weight of f2 there does not", sp.expand(weight) != 0),
    ]
    near = sp.acos(sp.Rational(3, 5))  # ADB vanishes at cos q2 = 1/2
    point = {**SINGULAR, q2: near, f1: sp.S.Zero, f2: sp.S.One, src.alpha: sp.S.One}
    bound = case.explicit(14, "bound", Pi=case.explicit(47, "Pi").subs(at_rest))
    found = Counterexample(
        tuple(point.items()),
        bound,
        size,
        "alpha Pi at rest, Pi of (47), and |Fhat|, which it should bound",
    )
    if found.disagrees() and not above(*found.values()):
        steps.append(true("|Fhat| exceeds the bound there", False))
    note = (
        "An assumption on the unknown F. It can hold for matched F (f2 = 0: Fhat = f1). For f2 not "
        "zero, as in section 5.3, it fails for every alpha: Fhat has a pole on the singular set, "
        "since AD keeps the weight 1/theta2 on f2 there, while Pi of (47) stays finite."
    )
    return Row(14, refute(steps, note, case.explicit(14, "bound"), sp.oo, found))


def remark_4(case: Case) -> Counterexample:
    """Return a component of ahat that passes zero: (15) with k = 2 and a Pi of unlike signs."""
    (t,) = src.nonnegative("t")
    component, size = sp.Integer(-1), sp.Integer(4)
    drive = case.explicit(15, "rate", Pi=component, bhat=size, ahat=0)
    gains = {P.k1: sp.S.One, P.k2: sp.S.One}
    # ahat' = drive - k2 ahat from ahat(0) = 1, |bhat| held: for alpha = (4, 1), alpha^T Pi > 0.
    value = (drive + (1 - drive) * sp.exp(-t)).subs(gains)
    return Counterexample(
        ((t, sp.S.One),),
        sp.S.Zero,
        value,
        "what ahat_2(t) should exceed, and its value: k = 2, Pi = (1, -1), alpha = (4, 1), "
        "|bhat| = 4, k1 = k2 = ahat_2(0) = 1",
    )


def equation_15(case: Case) -> Row:
    """Check the adaptation law, and the positivity of remark 4 by variation of constants."""
    printed = case.explicit(15, "rate")
    names = {"bhat": src.bhat, "bound_estimate": src.estimate, "regressor": src.regressor}
    derived = case.in_terms("bound_estimate_rate", **names)
    t, drive = sp.Symbol("t", real=True), sp.Function("w", nonnegative=True)
    (r, start) = (sp.Symbol("r", nonnegative=True), sp.Symbol("a0", positive=True))
    part = sp.Integral(sp.exp(P.k2 * r) * drive(r), (r, 0, t))
    solution = sp.exp(-P.k2 * t) * (start + P.k1 * part)
    forced = case.explicit(15, "rate", Pi=1, bhat=drive(t), ahat=solution)
    residual = sp.expand(solution.diff(t) - forced.subs(sp.Abs(drive(t)), drive(t)))
    steps = [
        equal("the derived adaptation law", printed, derived),
        true("exp(-k2 t)(a0 + k1 int exp(k2 r) w) solves it", sp.powsimp(residual) == 0),
        true("it starts at a0", solution.subs(t, 0).doit() == start),
        true("its integrand is nonnegative", part.function.is_nonnegative),
    ]
    repair = "Pi_i >= 0 for every i is assumed"
    note = (
        "The derived law is the same. Remark 4 calls the first term nonnegative, but Assumption 2 "
        "asks for no sign of the components of Pi: for k > 1 ahat_i passes zero where Pi_i < 0. "
        f"With {repair} (so for k = 1, as in (47)), by variation of constants, ahat_i(t) >= "
        "exp(-k2 (t - t0)) ahat_i(t0) > 0."
    )
    return Row(15, repaired(remark_4(case), repair, steps, note, printed, derived), "claim")


def equation_16(case: Case) -> Row:
    """Check the sum of the three parts."""
    printed = case.explicit(16, "tau")
    derived = case.in_terms("tau", p1=src.p1, p2=src.p2, p3=src.p3)
    steps = [equal("tau", printed, derived)]
    return Row(16, decide(steps, "A definition, used as such.", printed, derived))


def nominal_torque(case: Case) -> sp.Expr:
    """Return the torque that makes A q'' = b for F = 0, from the derived matrices."""
    ad, slope = case.reach
    # A q'' = AD (B tau - C q' - G) is affine in tau, with slope ADB.
    b = src.upright(case.derivation.constraint.acceleration[0])
    return (b + (ad * case.bias)[0]) / slope


def equation_17(case: Case) -> Row:
    """Check p1 against the unique torque that makes A q'' = b without uncertainty."""
    printed, derived = case.explicit(17, "p1"), nominal_torque(case)
    steps = [
        equal("p1 is the torque that solves A q'' = b", printed, derived),
        equal("p1 is that of the derived law", printed, case.law_expanded("p1")),
    ]
    note = "The only torque with A q'' = b for F = 0; exists where ADB is not zero."
    return Row(17, decide(steps, note, printed, derived, PLAIN))


def equation_18(case: Case) -> Row:
    """Check p2."""
    printed, derived = case.explicit(18, "p2"), case.in_terms("p2", bhat=src.bhat)
    return Row(18, decide([equal("p2", printed, derived)], "A definition.", printed, derived))


def equation_19(case: Case) -> Row:
    """Check p3 with the gamma of (23)."""
    printed = case.explicit(19, "p3", gamma=1 / sp.Max(P.epsilon, sp.Abs(src.mu)))
    derived = case.in_terms("p3", effort=src.estimate * src.regressor, mu=src.mu)
    note = "A definition, with gamma of (23) put in; |p3| <= ahat Pi follows."
    return Row(19, decide([equal("p3", printed, derived)], note, printed, derived))


def equation_20(case: Case) -> Row:
    """Check bhat, and that B^T D A^T is ADB."""
    printed, (_, gain) = case.explicit(20, "bhat"), case.reach
    steps = [
        equal("B^T D A^T = ADB", printed.subs(src.beta, 1), gain),
        equal("bhat", printed, case.in_terms("bhat", adb=gain, beta=src.beta)),
    ]
    note = "A definition; D is symmetric, so B^T D A^T = ADB and bhat = ADB beta."
    return Row(20, decide(steps, note, printed, gain * src.beta))


def equation_21(case: Case) -> Row:
    """Check beta through (7), and that it starts at zero."""
    printed = case.explicit(21, "beta", c=case.explicit(7, "c"))
    steps = [
        equal("rate of beta is A q'' - b", src.rate(printed), case.second_order),
        equal("beta(0) = 0", src.at_start(printed), sp.S.Zero),
        beta_of_law(case),
    ]
    note = "A definition; c holds the initial values, so beta(0) = 0 for every initial state."
    return Row(21, decide(steps, note, printed, printed))


def equation_22(case: Case) -> Row:
    """Check mu."""
    printed = case.explicit(22, "mu")
    derived = case.in_terms("mu", effort=src.estimate * src.regressor, bhat=src.bhat)
    return Row(22, decide([equal("mu", printed, derived)], "A definition.", printed, derived))


def layer_cases(case: Case) -> list[tuple[str, sp.Expr, dict[sp.Symbol, sp.Expr]]]:
    """Return points inside, at the edge of and outside the layer of (23), mu of both signs.

    Each has a name, gamma of the derived law there, and the values of mu and epsilon.
    """
    size, gap = src.positive("size gap")
    places = {
        "outside": (size + gap, size),
        "inside": (size, size + gap),
        "at the edge": (size, size),
    }
    found = []
    for name, (magnitude, layer) in places.items():
        for sign in (1, -1):
            at = {src.mu: sign * magnitude, P.epsilon: layer}
            found.append((f"{name}, mu {'>' if sign > 0 else '<'} 0", case.layer.subs(at), at))
    return [(name, resolved(value), at) for name, value, at in found]


def equation_23(case: Case) -> Row:
    """Check both branches of gamma against the derived p3, in and out of the layer."""
    outer, inner = case.explicit(23, "outside"), case.explicit(23, "inside")
    where = case.explicit(23, "where")
    steps: list[Step] = []
    for name, derived, at in layer_cases(case):
        branch = outer if name.startswith("outside") else inner
        side = where.subs(at)
        right = side.is_positive if name.startswith("outside") else side.is_nonpositive
        steps += [true(f"its branch is meant {name}", right)]
        steps += [equal(f"gamma {name}", branch.subs(at), derived)]
    note = "A definition; both branches are 1/max(|mu|, eps), continuous at |mu| = eps."
    shown = sp.Piecewise((outer, where > 0), (inner, True))
    return Row(23, decide(steps, note, shown, case.layer))


EQUATIONS = (
    equation_9,
    equation_10,
    equation_11,
    equation_12,
    equation_13,
    equation_14,
    equation_15,
    equation_16,
    equation_17,
    equation_18,
    equation_19,
    equation_20,
    equation_21,
    equation_22,
    equation_23,
)
