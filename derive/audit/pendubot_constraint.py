"""Equations (1)-(8): dynamics and servo-constraint."""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.audit import pendubot_source as src
from pfaffian.derive.audit.check import decide, equal, refute, true
from pfaffian.derive.audit.pendubot_source import P, dq1, dq2, q1, q2, upright
from pfaffian.derive.audit.row import Counterexample, Row
from pfaffian.derive.derivation import Derivation, check_dimensions


def equation_1(derivation: Derivation) -> Row:
    """Check M, C, G and B, and that M is positive definite for any physical parameters."""
    have = derivation.dynamics
    determinant = sp.expand((P.theta1 * P.theta2 - P.theta3**2).subs(dict(derivation.spec.lumping)))
    check_dimensions(derivation.spec)
    steps = [
        equal("M", src.MASS, have.mass_matrix),
        equal("C, Christoffel form", src.CORIOLIS, have.coriolis_matrix),
        equal("G", src.GRAVITY, have.gravity),
        equal("B", src.INPUT, have.input_matrix),
        true("theta1 theta2 - theta3^2 > 0 in physical parameters", determinant.is_positive),
    ]
    note = (
        "M, C, G, B follow from the energies; det M is a sum of positive terms, so M is positive "
        "definite. The source writes F once with q and q', once with q' only."
    )
    form = sp.Tuple(src.MASS, src.CORIOLIS, src.GRAVITY)
    derived = sp.Tuple(have.mass_matrix, have.coriolis_matrix, have.gravity)
    return Row(1, decide(steps, note, form, derived))


def equation_2(derivation: Derivation) -> Row:
    """Check the drift, and refute the limit that the source gives to its arctan term."""
    (s,) = src.real("s")
    (u,) = src.nonnegative("u")
    term = 2 * P.eta / sp.pi * sp.atan(s)
    given = derivation.spec.constraint
    # V = s^2/2: V' = -sigma s^2 - (2 eta/pi) s arctan s, and s arctan s = |s| arctan |s|.
    (eta,) = src.positive("eta")
    decay = P.sigma * u**2 + 2 * eta / sp.pi * u * sp.atan(u)
    steps = [
        equal("drift of the model", P.sigma * s + term, given.drift[0].subs(P.q1d, sp.pi / 2)),
        equal("s arctan s is even", s * sp.atan(s), (-s) * sp.atan(-s)),
        true("-V' >= sigma s^2, so s tends to 0", (decay - P.sigma * u**2).is_nonnegative),
        true("the arctan term tends to 0 with s", sp.limit(term, s, 0) == 0),
        true("eta is its value for s to infinity", sp.limit(term, s, sp.oo) == P.eta),
    ]
    found = Counterexample(
        ((P.eta, sp.S.One), (s, sp.S.Zero)), P.eta, term, "limit of the arctan term for t to oo"
    )
    note = (
        "The constraint itself is a definition, used as such. The limit claimed for its right-hand "
        "side is wrong: s tends to 0 (V = s^2/2), so the arctan term tends to 0; eta is its bound "
        "for s to infinity, not its limit for t to infinity."
    )
    return Row(2, refute(steps, note, P.eta, sp.S.Zero, found), "claim")


def equation_3(derivation: Derivation) -> Row:
    """Check the definition of s against the model's residual, with its units."""
    have = upright(derivation.constraint.residual[0])
    steps = [equal("s", src.RESIDUAL, have)]
    note = "A definition; the model's residual is the same expression, in rad/s."
    return Row(3, decide(steps, note, src.RESIDUAL, have))


def equation_4(derivation: Derivation) -> Row:
    """Check the errors, and that the setpoint is an equilibrium some torque can hold."""
    errors = upright(derivation.spec.constraint.errors)
    printed = sp.Matrix([src.e1, src.e2])
    held = derivation.dynamics.gravity[1].subs({q1: sp.pi / 2, q2: 0})
    steps = [
        equal("e", printed, errors),
        equal("gravity on the passive joint at the setpoint", sp.S.Zero, held),
    ]
    note = "A definition; the setpoint is an equilibrium, since no gravity acts on joint 2 there."
    return Row(4, decide(steps, note, printed, errors))


def _second_order(derivation: Derivation) -> sp.Expr:
    constraint = derivation.constraint
    moved = constraint.jacobian * sp.Matrix([src.ddq1, src.ddq2]) - constraint.acceleration
    return upright(moved[0])


def equation_5(derivation: Derivation) -> Row:
    """Check (5) as (2) with (3) and (4) put in."""
    derived = _second_order(derivation)
    steps = [
        equal("(5) is A q'' - b", src.SECOND_ORDER, derived),
        equal(
            "(5) is s' + drift(s)",
            src.SECOND_ORDER,
            src.rate(src.RESIDUAL)
            + P.sigma * src.RESIDUAL
            + 2 * P.eta / sp.pi * sp.atan(src.RESIDUAL),
        ),
    ]
    note = "(2) with (3) and (4) put in. What remark 1 concludes from it: see the findings."
    return Row(5, decide(steps, note, src.SECOND_ORDER, derived))


def equation_6(derivation: Derivation) -> Row:
    """Check (6) as the integral of (5): its rate is (5), and it starts at zero."""
    start = {q1: src.q10, q2: src.q20, dq1: src.dq10, dq2: src.dq20}
    start |= dict.fromkeys((src.J1, src.J2, src.Ja), sp.S.Zero)
    steps = [
        equal("rate of (6) is (5)", src.rate(src.INTEGRAL), _second_order(derivation)),
        equal("(6) is zero at t = 0", src.INTEGRAL.subs(start), sp.S.Zero),
    ]
    note = (
        "The rate of (6) is (5) and (6) vanishes at t = 0. J1, J2, Ja name its three integrals; "
        "the integration variable shares the letter of the torque in print."
    )
    return Row(6, decide(steps, note, src.INTEGRAL, src.INTEGRAL))


def equation_7(derivation: Derivation) -> Row:
    """Check A, b and c, and A q' - c against the derived beta."""
    constraint = derivation.constraint
    printed = (src.ROW * sp.Matrix([dq1, dq2]))[0] - src.FIRST_INTEGRAL
    at_start = {q1: src.q10, q2: src.q20, dq1: src.dq10, dq2: src.dq20}
    s0 = src.RESIDUAL.subs(at_start)
    # int s = lam (q1 - q10) + lam lam1 J1 + (q2 - q20) + lam2 J2
    path = P.lam * (q1 - src.q10) + P.lam * P.lam1 * src.J1 + (q2 - src.q20) + P.lam2 * src.J2
    integral = P.sigma * path + 2 * P.eta / sp.pi * src.Ja
    derived = src.RESIDUAL - s0 + integral
    (law_s, law_s0, law_integral) = src.real("s residual_initial drift_integral")
    in_law = src.law(derivation, "beta").subs(
        {law_s: src.RESIDUAL, law_s0: s0, law_integral: integral}
    )
    steps = [
        equal("A", src.ROW, constraint.jacobian),
        equal("b", src.RIGHT, upright(constraint.acceleration[0])),
        equal("A q' - c = s - s(0) + sigma int s + (2 eta/pi) int arctan s", printed, derived),
        equal("A q' - c is beta of the derived law", printed, in_law),
    ]
    note = (
        "A, b and c as printed agree, every sign of c included. The number (7) itself is missing "
        "in the transcription; it was read as the tag of A q' = c."
    )
    return Row(7, decide(steps, note, printed, derived))


def equation_8(derivation: Derivation) -> Row:
    """Check (8) as the derivative of (7)."""
    first = (src.ROW * sp.Matrix([dq1, dq2]))[0] - src.FIRST_INTEGRAL
    printed = (src.ROW * sp.Matrix([src.ddq1, src.ddq2]))[0] - src.RIGHT
    steps = [
        equal("rate of A q' - c is A q'' - b", src.rate(first), printed),
        equal("A q'' - b is (5)", printed, _second_order(derivation)),
    ]
    return Row(8, decide(steps, "The derivative of (7).", printed, _second_order(derivation)))


EQUATIONS = (
    equation_1,
    equation_2,
    equation_3,
    equation_4,
    equation_5,
    equation_6,
    equation_7,
    equation_8,
)
