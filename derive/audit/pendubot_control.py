"""Equations (9)-(23): decomposition of the uncertainty, assumptions and control law."""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.audit import pendubot_source as src
from pfaffian.derive.audit.check import at_most, decide, equal, refute, true
from pfaffian.derive.audit.pendubot_source import PLAIN, P, f1, f2, law, nominal_gain, q2
from pfaffian.derive.audit.row import Counterexample, Row
from pfaffian.derive.derivation import Derivation

#: A point of the singular set: ADB = 0 with M positive definite.
SINGULAR = {P.theta1: sp.Integer(5), P.theta2: sp.S.One, P.theta3: sp.Integer(2), P.lam: sp.S(2)}


def printed_split(derivation: Derivation) -> tuple[sp.Matrix, sp.Matrix]:
    """Return Fhat and dF of (11), computed from the derived M, A and B."""
    force = sp.Matrix([f1, f2])
    ad, adb = nominal_gain(derivation)
    matched = ad * force / adb
    return matched, force - derivation.dynamics.input_matrix * matched


def equation_9(derivation: Derivation) -> Row:
    """Check the sum; refute that the mismatched part lies in a null space of B."""
    split = derivation.decomposition
    whole = derivation.dynamics.input_matrix * split.matched + split.mismatched
    seen = (derivation.dynamics.input_matrix.T * split.mismatched)[0]
    steps = [
        equal("F = B Fhat + dF", split.force, whole),
        true("B^T dF is not identically zero", sp.together(seen) != 0),
    ]
    point = {**PLAIN, P.lam: sp.Integer(3), q2: sp.S.Zero, f2: sp.S.One}
    found = Counterexample(
        tuple(point.items()), sp.S.Zero, seen, "B^T dF (zero if dF were in that null space)"
    )
    note = (
        "The sum holds identically. The claim that dF lies in the null space of B (read: of B^T; "
        "B itself is a column) is wrong: dF of (11) has a component along B wherever f2 acts. It "
        "lies in the null space of AD, as (12) says."
    )
    return Row(9, refute(steps, note, sp.S.Zero, seen, found), "claim")


def equation_10(derivation: Derivation, printed: sp.Expr = src.INPUT_GAIN) -> Row:
    """Compare ADB with the derived one; the claim about its sign is a finding of its own."""
    _, derived = nominal_gain(derivation)
    steps = [
        equal("derived ADB is that of the derivation", derivation.input_gain, derived),
        equal("ADB", printed, derived),
    ]
    note = "The claim ADB > 0 printed with it is judged in finding adb-changes-sign."
    if not steps[1].holds:
        note = (
            "The term of M that couples the joints is dropped: A D B = (lam theta2 - theta2 - "
            f"theta3 cos q2)/det M. {note}"
        )
    return Row(10, decide(steps, note, printed, derivation.input_gain, PLAIN))


def equation_11(derivation: Derivation) -> Row:
    """Check Fhat and dF, and that the split is a projection."""
    matched, mismatched = printed_split(derivation)
    split = derivation.decomposition
    ad, adb = nominal_gain(derivation)
    projector = derivation.dynamics.input_matrix * ad / adb
    steps = [
        equal("Fhat", matched, split.matched.subs(dict(zip(split.force, (f1, f2), strict=True)))),
        equal("dF", mismatched, split.mismatched),
        equal("B (ADB)^-1 AD is a projector", projector * projector, projector),
    ]
    note = "Follows wherever ADB is not zero; the split is an oblique projection along null(AD)."
    return Row(11, decide(steps, note, matched, split.matched))


def equation_12(derivation: Derivation) -> Row:
    """Check AD dF = 0."""
    ad, _ = nominal_gain(derivation)
    _, mismatched = printed_split(derivation)
    value = (ad * mismatched)[0]
    note = "Identically zero. The mismatched part leaves beta alone, not the zero dynamics."
    zero = sp.S.Zero
    return Row(12, decide([equal("AD dF = 0", value, zero)], note, zero, zero))


def equation_13(derivation: Derivation) -> Row:
    """Refute Assumption 1: ADB vanishes in every design whose zero dynamics are stable."""
    _, gain = nominal_gain(derivation)
    (excess,) = src.positive("excess")
    # lam < 1 + theta3/theta2 means theta3 = (lam - 1) theta2 + excess: then the cosine is below 1.
    level = (P.lam - 1) * P.theta2 / P.theta3
    room = sp.factor(1 - level.subs(P.theta3, (P.lam - 1) * P.theta2 + excess))
    numerator = sp.fraction(derivation.input_gain)[0]
    steps = [
        equal("ADB = 0 at cos q2 = (lam - 1) theta2/theta3", _at_cosine(numerator, level), sp.S(0)),
        equal("that cosine is below 1 where lam < 1 + theta3/theta2", room * _den(room), excess),
    ]
    point = {**SINGULAR, q2: sp.pi / 3, src.lower: sp.S.One}
    squared = gain**2
    found = Counterexample(
        tuple(point.items()), src.lower, squared, "the bound and ADB B^T D A^T, which must reach it"
    )
    note = (
        "Assumption 1, as stated for all states, is false: (ADB)^2 = 0 on the singular set, which "
        "exists whenever |lam - 1| theta2 <= theta3, so in every design with stable zero dynamics. "
        "It can hold on a region |q2| < q2* only, and nothing in the proof keeps q2 there."
    )
    return Row(13, refute(steps, note, squared, sp.S.Zero, found))


def _at_cosine(expression: sp.Expr, level: sp.Expr) -> sp.Expr:
    return sp.expand(expression.subs(sp.cos(q2), level))


def _den(expression: sp.Expr) -> sp.Expr:
    return sp.fraction(sp.together(expression))[1]


def equation_14(derivation: Derivation) -> Row:
    """Refute Assumption 2 for forces on joint 2: Fhat has a true pole on the singular set."""
    matched, _ = printed_split(derivation)
    ad, _ = nominal_gain(derivation)
    det = derivation.dynamics.mass_matrix.det()
    level = (P.lam - 1) * P.theta2 / P.theta3
    steps = [
        equal("with f2 = 0, Fhat = f1", matched[0].subs(f2, 0), f1),
        equal(
            "AD reaches f2 on the singular set with weight 1/theta2",
            _at_cosine(sp.cancel(ad[1] * det), level),
            _at_cosine(sp.expand(det), level) / P.theta2,
        ),
    ]
    near = sp.acos(sp.Rational(3, 5))  # ADB vanishes at cos q2 = 1/2
    point = {**SINGULAR, q2: near, f1: sp.S.Zero, f2: sp.S.One, src.alpha: sp.S.One}
    at_rest = src.REGRESSOR.subs({src.dq1: 0, src.dq2: 0, src.q1: sp.pi / 2})
    found = Counterexample(
        tuple(point.items()),
        src.alpha * at_rest,
        sp.sqrt(matched[0] ** 2),
        "alpha Pi at rest, Pi of (47), and |Fhat|, which it should bound",
    )
    note = (
        "An assumption on the unknown F. It can hold for matched F (f2 = 0: Fhat = f1). For f2 not "
        "zero, as in section 5.3, it fails for every alpha: Fhat has a pole on the singular set, "
        "since AD keeps the weight 1/theta2 on f2 there, while Pi of (47) stays finite."
    )
    return Row(14, refute(steps, note, src.alpha * src.regressor, sp.oo, found))


def equation_15(derivation: Derivation) -> Row:
    """Check the adaptation law, and its positivity by variation of constants."""
    (bhat, ahat, pi_, t) = src.real("bhat bound_estimate regressor t")
    printed = P.k1 * pi_ * sp.Abs(bhat) - P.k2 * ahat
    derived = law(derivation, "bound_estimate_rate")
    drive = sp.Function("w", nonnegative=True)
    (r, start) = (sp.Symbol("r", nonnegative=True), sp.Symbol("a0", positive=True))
    part = sp.Integral(sp.exp(P.k2 * r) * drive(r), (r, 0, t))
    solution = sp.exp(-P.k2 * t) * (start + P.k1 * part)
    residual = sp.expand(solution.diff(t) + P.k2 * solution - P.k1 * drive(t))
    steps = [
        equal("the derived adaptation law", printed, derived),
        true("exp(-k2 t)(a0 + k1 int exp(k2 r) w) solves it", sp.powsimp(residual) == 0),
        true("it starts at a0", solution.subs(t, 0).doit() == start),
        true("its integrand is nonnegative", part.function.is_nonnegative),
    ]
    note = (
        "The derived law is the same. Remark 4 is right: by variation of constants ahat(t) >= "
        "exp(-k2 (t - t0)) ahat(t0) > 0."
    )
    return Row(15, decide(steps, note, printed, derived))


def equation_16(derivation: Derivation) -> Row:
    """Check the sum of the three parts."""
    p1, p2, p3 = src.real("p1 p2 p3")
    steps = [equal("tau", p1 + p2 + p3, law(derivation, "tau"))]
    return Row(16, decide(steps, "A definition, used as such.", p1 + p2 + p3, p1 + p2 + p3))


def printed_nominal(derivation: Derivation) -> sp.Expr:
    """Return p1 of (17) as printed, with D and C, G derived."""
    ad, adb = nominal_gain(derivation)
    return (src.RIGHT + (ad * src.bias(derivation))[0]) / adb


def equation_17(derivation: Derivation, printed: sp.Expr | None = None) -> Row:
    """Check p1 against the unique torque that makes A q'' = b without uncertainty."""
    ad, slope = nominal_gain(derivation)
    given = printed_nominal(derivation) if printed is None else printed
    # A q'' = AD (B tau - C q' - G) is affine in tau, with slope ADB.
    derived = src.upright(derivation.constraint.acceleration[0]) + (ad * src.bias(derivation))[0]
    derived = derived / slope
    steps = [
        equal("p1 is the torque that solves A q'' = b", given, derived),
        equal("p1 is that of the derived law", given, src.law_expanded(derivation, "p1")),
    ]
    note = "The only torque with A q'' = b for F = 0; exists where ADB is not zero."
    return Row(17, decide(steps, note, given, derived, PLAIN))


def equation_18(derivation: Derivation) -> Row:
    """Check p2."""
    (bhat,) = src.real("bhat")
    printed = -P.kappa * bhat
    derived = law(derivation, "p2")
    return Row(18, decide([equal("p2", printed, derived)], "A definition.", printed, derived))


def equation_19(derivation: Derivation) -> Row:
    """Check p3 with the gamma of (23)."""
    mu, ahat, pi_ = src.real("mu bound_estimate regressor")
    printed = -mu * ahat * pi_ / sp.Max(P.epsilon, sp.Abs(mu))
    derived = _with_effort(derivation, "p3")
    note = "A definition, with gamma of (23) put in; |p3| <= ahat Pi follows."
    return Row(19, decide([equal("p3", printed, derived)], note, printed, derived))


def _with_effort(derivation: Derivation, name: str) -> sp.Expr:
    (effort,) = src.real("effort")
    return law(derivation, name).subs(effort, law(derivation, "effort"))


def equation_20(derivation: Derivation) -> Row:
    """Check bhat, and that B^T D A^T is ADB."""
    mass = derivation.dynamics.mass_matrix
    row = derivation.constraint.jacobian
    inverse = mass.adjugate() / mass.det()
    _, gain = nominal_gain(derivation)
    other = (derivation.dynamics.input_matrix.T * inverse * row.T)[0]
    adb, beta = src.real("adb beta")
    steps = [
        equal("B^T D A^T = ADB", other, gain),
        equal("bhat", adb * beta, law(derivation, "bhat")),
    ]
    note = "A definition; D is symmetric, so B^T D A^T = ADB and bhat = ADB beta."
    return Row(20, decide(steps, note, other * beta, adb * beta))


def equation_21(derivation: Derivation) -> Row:
    """Check beta through (7), and that it starts at zero."""
    seventh = (src.ROW * sp.Matrix([src.dq1, src.dq2]))[0] - src.FIRST_INTEGRAL
    start = {src.q1: src.q10, q2: src.q20, src.dq1: src.dq10, src.dq2: src.dq20}
    start |= dict.fromkeys((src.J1, src.J2, src.Ja), sp.S.Zero)
    steps = [
        equal("rate of beta is A q'' - b", src.rate(seventh), src.SECOND_ORDER),
        equal("beta(0) = 0", seventh.subs(start), sp.S.Zero),
    ]
    note = "A definition; c holds the initial values, so beta(0) = 0 for every initial state."
    return Row(21, decide(steps, note, seventh, seventh))


def equation_22(derivation: Derivation) -> Row:
    """Check mu."""
    bhat, ahat, pi_ = src.real("bhat bound_estimate regressor")
    derived = _with_effort(derivation, "mu")
    printed = bhat * ahat * pi_
    return Row(22, decide([equal("mu", printed, derived)], "A definition.", printed, derived))


def equation_23(derivation: Derivation) -> Row:
    """Check gamma: continuous at the layer's edge, and 1/max(|mu|, eps)."""
    (gap,) = src.nonnegative("gap")
    (size,) = src.positive("size")
    outer, inner = 1 / size, 1 / P.epsilon
    smooth = 1 / sp.Max(size, P.epsilon)
    (mu, effort) = src.real("mu effort")
    derived = law(derivation, "p3")
    steps = [
        equal("continuous at |mu| = eps", outer.subs(size, P.epsilon), inner),
        equal("outside: 1/max", outer.subs(size, P.epsilon + gap), 1 / (P.epsilon + gap)),
        at_most("gamma |mu| <= 1 inside", size / (size + gap), sp.S.One, gap / (size + gap)),
        equal("the derived p3", -mu * effort / sp.Max(P.epsilon, sp.Abs(mu)), derived),
    ]
    note = "A definition; both branches are 1/max(|mu|, eps), continuous at |mu| = eps."
    shown = sp.Piecewise((outer, size > P.epsilon), (inner, True))
    return Row(23, decide(steps, note, shown, smooth))


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
