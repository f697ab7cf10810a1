"""What the source says between its numbered equations about its mathematics."""

from __future__ import annotations

from collections.abc import Mapping

import sympy as sp
from pfaffian.paper.audit.check import at_most, decide, equal, refute, true, unchecked
from pfaffian.paper.audit.row import Counterexample, Finding
from pfaffian.paper.equations import pendubot_source as src
from pfaffian.paper.equations.pendubot_control import at_cosine, remark_4, singular_cosine
from pfaffian.paper.equations.pendubot_source import Case, P, dq1, dq2, q1, q2


def point_of(values: Mapping[sp.Symbol, object]) -> tuple[tuple[sp.Symbol, sp.Expr], ...]:
    """Return a counter-example point from plain values."""
    return tuple((k, sp.sympify(v)) for k, v in values.items())


def adb_changes_sign(case: Case) -> Finding:
    """Refute ADB > 0."""
    gain = case.derivation.input_gain
    values = {P.theta1: 2, P.theta2: 1, P.theta3: 1, P.lam: 1, q2: 0}
    found = Counterexample(
        point_of(values), sp.S.Zero, gain, "the bound that ADB should exceed, and ADB"
    )
    opposite = gain.subs(q2, sp.pi).subs({P.theta1: 2, P.theta2: 1, P.theta3: 1, P.lam: 1})
    level = singular_cosine().subs(case.gains).subs(case.plant)
    angle = sp.acos(level)
    room = sp.N(angle - sp.Abs(case.value("start of section 5", "q2")), 3)
    upright = gain.subs(q2, 0).subs(case.gains).subs(case.plant)
    steps = [
        true("section 5 has a singular angle", sp.Abs(level) < 1),
        equal(
            "ADB is zero there",
            at_cosine(sp.fraction(gain)[0], level).subs(case.gains).subs(case.plant),
            sp.S(0),
        ),
        true("section 5 starts inside it", room > 0),
        true("ADB < 0 at the upright of section 5", upright < 0),
        true("ADB > 0 at q2 = pi with theta = 2, 1, 1 and lam = 1", opposite > 0),
        equal(
            "numerator",
            sp.fraction(gain)[0],
            (P.lam - 1) * P.theta2 - P.theta3 * sp.cos(q2),
        ),
    ]
    note = (
        "ADB has the sign of (lam - 1) theta2 - theta3 cos q2; where it vanishes no torque moves "
        f"s. With the gains and plant of section 5 that is at |q2| = {sp.N(angle, 4)} rad, "
        f"{room} rad beyond the start of its simulations; at the upright ADB is "
        f"{sp.N(upright, 4)} 1/(kg m^2)."
    )
    verdict = refute(steps, note, sp.Gt(gain, 0, evaluate=False), gain, found)
    return Finding(
        "adb-changes-sign",
        "3.1, beside (10)",
        "ADB is positive, hence invertible",
        verdict,
        (10, 13),
    )


def brackets_do_not_vanish(case: Case) -> Finding:
    """Refute that s = 0 makes both brackets of (3) vanish."""
    first = dq1 + P.lam1 * (q1 - sp.pi / 2)
    values = {P.lam: 1, P.lam1: 1, P.lam2: 1, q1: sp.pi / 2, q2: 0, dq1: 1, dq2: -1}
    steps = [equal("s = 0 there", case.residual.subs(values), sp.S.Zero)]
    found = Counterexample(
        point_of({k: v for k, v in values.items() if k in (q1, dq1, P.lam1)}),
        sp.S.Zero,
        first,
        "e1' + lam1 e1 where s = 0 (dq2 = -1, q2 = 0, lam = lam2 = 1)",
    )
    note = "A sum that vanishes says nothing about its terms: one equation, two unknown brackets."
    verdict = refute(steps, note, sp.S.Zero, first, found)
    claim = "with s, e1' + lam1 e1 and e2' + lam2 e2 vanish at the same time (remark 1)"
    return Finding("remark-1-brackets", "2.2, remark 1", claim, verdict, (3, 5))


def remark_four(case: Case) -> Finding:
    """Refute remark 4 for k > 1 by an exact solution of (15)."""
    found = remark_4(case)
    note = (
        "The first term of (15) has the sign of Pi_i, which Assumption 2 leaves open: it asks for "
        "alpha^T Pi alone. With Pi_i >= 0, and so for k = 1, the remark is right: see (15)."
    )
    verdict = refute(
        [true("alpha^T Pi > 0 there", 4 * 1 + 1 * (-1) > 0)],
        note,
        "ahat_i(t) > 0",
        "ahat_i(t) > 0 where Pi_i >= 0",
        found,
    )
    claim = "ahat_i(t) > 0 for all t, since the first term of (15) is never negative"
    return Finding("remark-4", "3.2, remark 4", claim, verdict, (15, 37))


def stays_away(case: Case) -> Finding:
    """Refute remark 1 by an exact motion of the closed loop: rest, s = 0, away from the upright."""
    gains = {P.lam: 2, P.lam1: 1, P.lam2: 2}
    state = {q1: sp.pi / 3, q2: sp.pi / 6, dq1: 0, dq2: 0}
    tau, plain = src.tau, {**src.PLAIN, **gains}
    _, gain = case.reach
    nominal = case.law_expanded("p1").subs(state).subs(gains)
    forces = (case.derivation.dynamics.input_matrix * tau - case.bias).subs(state)
    rest = forces.subs(tau, nominal)
    steps = [
        equal("s = 0", case.residual.subs(state).subs(gains), sp.S.Zero),
        true("ADB is not zero there for theta = 2, 1, 1", gain.subs(state).subs(plain) != 0),
        equal("no force on joint 1 under tau = p1", rest[0], sp.S.Zero),
        equal("no force on joint 2", rest[1], sp.S.Zero),
    ]
    limit = sp.Symbol("q1_limit", real=True)
    found = Counterexample(
        ((limit, sp.pi / 3),),
        sp.pi / 2,
        limit,
        "the limit claimed for q1 and its value for all t: lam, lam1, lam2 = 2, 1, 2, start at "
        "rest at q1 = pi/3, q2 = pi/6, theta and g such that ADB is not zero, F = 0",
    )
    note = (
        "With lam lam1 = lam2, all positive, every state at rest with q1 + q2 = pi/2 has s = 0 and "
        "is an equilibrium of the closed loop: beta = 0 for ever and q1 never moves."
    )
    verdict = refute(steps, note, sp.pi / 2, sp.pi / 3, found)
    claim = "s to 0 brings q1 and q2 to their setpoints, for positive constants (remark 1)"
    return Finding("remark-1-setpoint", "2.2, below (4) and remark 1", claim, verdict, (2, 3))


def mismatch_returns(case: Case) -> Finding:
    """Refute that the mismatched part leaves the performance alone."""
    c2 = sp.cos(q2)
    weight = P.lam * (P.theta2 + P.theta3 * c2) - P.theta1 - P.theta2 - 2 * P.theta3 * c2
    f1, f2 = case.derivation.decomposition.force
    mismatched = case.derivation.decomposition.mismatched
    coefficient = case.derivation.zero_dynamics.coefficients[1]
    slope = sp.expand(coefficient).coeff(P.joint2_viscous, 1)
    steps = [
        equal("dF1", mismatched[0], f2 * weight / ((P.lam - 1) * P.theta2 - P.theta3 * c2)),
        equal("f1 is not in it", mismatched[0].diff(f1), sp.S.Zero),
        equal("dF2 = f2", mismatched[1], f2),
        equal("viscous friction d2 enters the zero dynamics with weight lam", slope, P.lam),
    ]
    share = P.lam * P.joint2_viscous
    found = Counterexample(
        point_of({P.lam: 1, P.joint2_viscous: 1}),
        sp.S.Zero,
        share,
        "share of joint-2 friction in the p^2 coefficient of the zero dynamics",
    )
    note = (
        "It vanishes from beta, not from the motion: f2 acts on the zero dynamics in full. dF = "
        "[f2 (lam (theta2 + theta3 cos q2) - theta1 - theta2 - 2 theta3 cos q2)/((lam - 1) theta2 "
        "- theta3 cos q2), f2]."
    )
    verdict = refute(steps, note, sp.S.Zero, share, found)
    return Finding(
        "mismatch-returns",
        "3.1, below (12)",
        "the mismatched part disappears from the problem",
        verdict,
        (11, 12),
    )


def not_orthogonal(case: Case) -> Finding:
    """Refute orthogonality, in the Euclidean and in the kinetic metric."""
    split = case.derivation.decomposition
    matched = case.derivation.dynamics.input_matrix * split.matched
    plain = (matched.T * split.mismatched)[0]
    mass = case.derivation.dynamics.mass_matrix
    inverse = mass.adjugate() / mass.det()
    kinetic = (matched.T * inverse * split.mismatched)[0]
    force1, force2 = split.force
    values = {P.theta1: 2, P.theta2: 1, P.theta3: 1, P.lam: 3, q2: 0, force1: 0, force2: 1}
    found = Counterexample(point_of(values), sp.S.Zero, plain, "the inner product of B Fhat and dF")
    steps = [true("nor are they orthogonal in the metric of D", kinetic.subs(values) != 0)]
    note = (
        "The projector B (ADB)^-1 AD is oblique: B Fhat and dF are not orthogonal in the Euclidean "
        "metric, nor in that of D = M^-1, which would need A proportional to B^T."
    )
    verdict = refute(steps, note, sp.S.Zero, plain, found)
    return Finding(
        "not-orthogonal", "3.1, above (11)", "the decomposition is orthogonal", verdict, (9, 11)
    )


def holonomic_or_not(case: Case) -> Finding:
    """Refute the reason for nonholonomy, and give the true condition by Frobenius."""
    w1, w2, wt = P.lam, sp.S.One, P.lam * P.lam1 * src.e1 + P.lam2 * src.e2
    # omega = lam dq1 + dq2 + (h - s(t)) dt: omega ^ d omega has one component.
    frobenius = w1 * wt.diff(q2) - w2 * wt.diff(q1)
    whole = P.lam * src.e1 + src.e2
    steps = [
        equal("omega ^ d omega", frobenius, P.lam * (P.lam2 - P.lam1)),
        equal(
            "with lam1 = lam2, s = E' + lam1 E, E = lam e1 + e2",
            case.residual.subs(P.lam2, P.lam1),
            src.rate(whole) + P.lam1 * whole,
        ),
    ]
    found = Counterexample(
        point_of({P.lam: 1, P.lam1: 1, P.lam2: 1}),
        sp.S.One,
        frobenius,
        "the Frobenius obstruction: anything but zero if nonholonomic (shown: 1), and its value",
    )
    note = (
        "(2) is an autonomous equation in s alone, so it integrates to s = s(t; s(0)), arctan or "
        "not. What is left is nonholonomic exactly when lam1 and lam2 differ: the obstruction is "
        "lam (lam2 - lam1)."
    )
    verdict = refute(steps, note, "nonholonomic", frobenius, found)
    claim = "(5) is nonholonomic because its right-hand side cannot be integrated (remark 1)"
    return Finding("nonholonomic-reason", "2.2, remark 1", claim, verdict, (5, 6))


def no_initial_deviation(case: Case) -> Finding:
    """Refute that the start violates the constraint that is followed."""
    seventh = case.following()
    steps = [equal("beta(0) = 0 for every start", src.at_start(seventh), sp.S.Zero)]
    residual = src.at_start(case.residual).subs({src.q10: sp.pi / 2, src.q20: 0})
    found = Counterexample(
        point_of({src.dq10: 1, src.dq20: 0, P.lam: 1}),
        residual,
        src.at_start(seventh),
        "s(0), which is not zero (q1, q2 upright), and the following error beta(0)",
    )
    note = (
        "c contains the initial values, so beta(0) = 0 always: there is no initial deviation for "
        "p2 to remove, and without uncertainty p1 alone keeps beta = 0. What p2 answers is F."
    )
    verdict = refute(steps, note, residual, sp.S.Zero, found)
    claim = "the start of section 5 does not satisfy the constraint, hence p2 is needed"
    return Finding("no-initial-deviation", "5.1, first paragraph", claim, verdict, (7, 21))


def theorem_one_i(case: Case) -> Finding:
    """Refute |delta(t)| <= r by an exact solution."""
    t = sp.Symbol("t", nonnegative=True)
    gap = sp.exp(-t) - 1  # ahat - alpha with ahat(0) = alpha = k2 = 1 and beta = 0
    rate = -(gap + 1)
    steps = [
        equal("ahat' = -k2 ahat on beta = 0", gap.diff(t), rate),
        equal("delta(0) = 0", gap.subs(t, 0), sp.S.Zero),
        at_most("|delta| = 1 - exp(-t) grows", sp.S.Zero, sp.exp(-t), sp.exp(-t)),
    ]
    found = Counterexample(
        ((t, sp.S.One),),
        sp.Rational(1, 2),
        -gap,
        "r and |delta(1)|, which should not exceed it (F = 0, ahat(0) = alpha = k2 = 1)",
    )
    note = "What the proof supports is |delta(t)| <= d(r) of (43): the leakage alone leaves r."
    verdict = refute(steps, note, "|delta(t)| <= r", "|delta(t)| <= d(r)", found)
    return Finding(
        "theorem-1-i", "4, Theorem 1 (i)", "|delta| stays below its initial bound r", verdict, (43,)
    )


def theorem_one_ii(case: Case) -> Finding:
    """Say how part (ii) was read."""
    note = (
        "Garbled: the bars of d are lost, so it reads d > d. Read as d_bar > d_under with "
        "|delta(t)| <= d_bar for t >= t0 + T(d_bar, r), which (45) and (46) support."
    )
    verdict = unchecked(note, "d > d", "d_bar > d_under")
    return Finding(
        "theorem-1-ii",
        "4, Theorem 1 (ii)",
        "the ultimate bound holds for any d > d",
        verdict,
        (45, 46),
    )


def state_not_bounded(case: Case) -> Finding:
    """Refute that a bounded delta bounds the state: unstable zero dynamics on beta = 0."""
    gains = {P.lam: sp.S(1) / 2, P.lam1: 1, P.lam2: 1}
    plant = {P.theta2: 1, P.theta3: 1, P.theta5: 1, P.g: 1}
    coefficients = frictionless(case)
    p = sp.Symbol("p", real=True)
    values = [c.subs(gains).subs(plant) for c in coefficients]
    polynomial = sum((c * p**k for k, c in enumerate(reversed(values))), sp.S.Zero)
    root = 1 / sp.sqrt(3)
    steps = [equal("a pole at 1/sqrt(3)", polynomial.subs(p, root), sp.S.Zero)]
    found = Counterexample(
        ((p, root),),
        sp.S.Zero,
        p,
        "the bound on Re p for a bounded state, and a pole of the zero dynamics "
        "(lam, lam1, lam2 = 1/2, 1, 1; theta2 = theta3 = theta5 = g = 1)",
    )
    note = (
        "delta holds beta and ahat - alpha, not q: with beta = 0 the state still moves by the zero "
        "dynamics, and for positive gains these may be unstable. Theorem 1 bounds delta, not the "
        "closed loop, and does not keep q2 from the singular set."
    )
    verdict = refute(steps, note, "bounded", polynomial, found)
    claim = "the closed-loop system is uniformly (ultimately) bounded"
    return Finding("state-not-bounded", "abstract; 1; 7", claim, verdict, (24, 43))


def frictionless(case: Case) -> list[sp.Expr]:
    """Return the zero-dynamics coefficients at the upright, without friction, highest first."""
    still = {
        s: 0
        for c in case.derivation.zero_dynamics.coefficients
        for s in c.free_symbols
        if s.name.startswith("joint")
    }
    return [src.upright(c).subs(still) for c in case.derivation.zero_dynamics.coefficients]


def singular_everywhere(case: Case) -> Finding:
    """Refute the verification of Assumption 1 by one recorded run."""
    _, gain = case.reach
    level = singular_cosine().subs(case.gains).subs(case.plant)
    point = {q2: sp.acos(level)}
    squared = (gain**2).subs(case.gains).subs(case.plant)
    (lower,) = src.positive("lambda_min")
    steps = [true("a singular angle exists", level < 1), true("at |cos| < 1", level > -1)]
    found = Counterexample(
        point_of({**point, lower: 1}), lower, squared, "a bound lambda > 0 and (ADB)^2 at q2*"
    )
    note = (
        "One run that keeps away from zero bounds nothing outside it: with the plant and gains of "
        f"section 5, (ADB)^2 = 0 at cos q2 = {level}, |q2| = {sp.N(sp.acos(level), 4)} rad."
    )
    verdict = refute(steps, note, lower, sp.S.Zero, found)
    claim = "a history of (ADB)^2 that stays off zero verifies Assumption 1 (5.2, 5.3)"
    return Finding(
        "assumption-1-from-a-run", "5.2 with Figure 7; 5.3 with Figure 13", claim, verdict, (13,)
    )


def constant_load(case: Case) -> Finding:
    """Prove that a constant matched load leaves no error in s: beta integrates."""
    gain, load = src.positive("ADB_rest load")
    beta = sp.Symbol("beta", real=True)
    rate = -gain * load - P.kappa * gain**2 * beta  # (29) with p3 = 0, divided by 2 beta
    rest = -load / (P.kappa * gain)
    steps = [
        equal("beta' = 0 at beta = -f1/(kappa ADB)", rate.subs(beta, rest), sp.S.Zero),
        true("that is attracting", rate.diff(beta).is_negative),
        equal("beta' = 0 means A q'' = b, (5)", src.rate(case.following()), case.second_order),
    ]
    note = (
        "beta holds the integral of s, so p2 is integral action: for ADB settling at a constant, "
        "beta settles at -f1/(kappa ADB), not at 0, and s still tends to 0 by (2)."
    )
    verdict = decide(steps, note, rest, rest)
    claim = "p2 compensates the constant load of section 5.1"
    return Finding("constant-load", "5.1, below Figure 2", claim, verdict, (18, 29))


FINDINGS = (
    remark_four,
    constant_load,
    adb_changes_sign,
    brackets_do_not_vanish,
    stays_away,
    holonomic_or_not,
    not_orthogonal,
    mismatch_returns,
    singular_everywhere,
    no_initial_deviation,
    theorem_one_i,
    theorem_one_ii,
    state_not_bounded,
)
