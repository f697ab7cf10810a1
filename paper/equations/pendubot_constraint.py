"""Equations (1)-(8): dynamics and servo-constraint."""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.spec.check_dimensions import check_dimensions
from pfaffian.paper.audit.check import Step, decide, equal, judge, true
from pfaffian.paper.audit.notation import INTEGRAL
from pfaffian.paper.audit.row import Counterexample, Row
from pfaffian.paper.equations import pendubot_source as src
from pfaffian.paper.equations.pendubot_source import (
    Case,
    P,
    at_start,
    dq1,
    dq2,
    q1,
    q2,
    rate,
    upright,
)

#: What (2), (5)-(8), (47) and (48) share, and how it is judged in each of them.
UNITS_SHARED = "In SI; the unit it hangs on: finding unit-of-time."


def euler_lagrange(case: Case) -> sp.Matrix:
    """Return d/dt dL/dq' - dL/dq + F - B tau from the energies of the model."""
    spec = case.derivation.spec
    lagrangian = spec.kinetic_energy - spec.potential_energy
    rows = []
    for k, (position, speed) in enumerate(((q1, dq1), (q2, dq2))):
        momentum = lagrangian.diff(speed)
        applied = case.derivation.decomposition.force[k] - spec.input_matrix[k] * src.tau
        rows.append(rate(momentum) - lagrangian.diff(position) + applied)
    return sp.Matrix(rows)


def equation_1(case: Case) -> Row:
    """Check M, C, G and B, the whole by Euler and Lagrange, and that M is positive definite."""
    have, lumping = case.derivation.dynamics, dict(case.derivation.spec.lumping)
    check_dimensions(case.derivation.spec)
    printed = {n: case.explicit(1, n) for n in ("M", "C", "G", "B", *_LUMPED)}
    given = {n: printed[n] for n in ("M", "C", "G", "B")}
    left = case.explicit(1, "left", **given) - case.explicit(1, "right", **given)
    physical = {getattr(P, n): printed[n] for n in _LUMPED}
    determinant = sp.expand((P.theta1 * P.theta2 - P.theta3**2).subs(physical))
    steps = [
        equal("M", printed["M"], have.mass_matrix),
        equal("C, Christoffel form", printed["C"], have.coriolis_matrix),
        equal("G", printed["G"], have.gravity),
        equal("B", printed["B"], have.input_matrix),
        *(equal(n, printed[n], lumping[getattr(P, n)]) for n in _LUMPED),
        equal("(1) by Euler and Lagrange", left.subs(physical), euler_lagrange(case)),
        true("theta1 theta2 - theta3^2 > 0 in physical parameters", determinant.is_positive),
    ]
    note = (
        "M, C, G, B follow from the energies; det M is a sum of positive terms, so M is positive "
        "definite. The source writes F once with q and q', once with q' only."
    )
    form = sp.Tuple(*(printed[n] for n in ("M", "C", "G")))
    derived = sp.Tuple(have.mass_matrix, have.coriolis_matrix, have.gravity)
    return Row(1, decide(steps, note, form, derived))


_LUMPED = tuple(f"theta{k}" for k in range(1, 6))


def equation_2(case: Case) -> Row:
    """Check the drift, and refute the limit that the source gives to its arctan term."""
    s, ds = src.real("s ds")
    (u,) = src.nonnegative("u")
    (eta,) = src.positive("eta")
    term = -case.explicit(2, "right", s=s)
    claimed = case.explicit(2, "limit")
    model = upright(case.derivation.spec.constraint.drift[0])
    printed = case.explicit(2, "left", s=s, ds=ds) - case.explicit(2, "right", s=s)
    # V = s^2/2: V' = -sigma s^2 - (2 eta/pi) s arctan s, and s arctan s = |s| arctan |s|.
    decay = P.sigma * u**2 + 2 * eta / sp.pi * u * sp.atan(u)
    itself = equal("s' + drift of the model", printed, ds + model)
    limit = sp.limit(term, s, 0)
    steps = [
        equal("s arctan s is even", s * sp.atan(s), (-s) * sp.atan(-s)),
        true("-V' >= sigma s^2, so s tends to 0", (decay - P.sigma * u**2).is_nonnegative),
        true("eta is its value for s to infinity", sp.limit(term, s, sp.oo) == P.eta),
    ]
    proving = [itself, *steps, equal("the limit for t to infinity", claimed, limit)]
    found = Counterexample(
        ((P.eta, sp.S.One), (s, sp.S.Zero)), claimed, term, "limit of the arctan term for t to oo"
    )
    note = (
        "The constraint itself is a definition, used as such. The limit claimed for its right-hand "
        "side is wrong: s tends to 0 (V = s^2/2), so the arctan term tends to 0; eta is its bound "
        f"for s to infinity, not its limit for t to infinity. {UNITS_SHARED}"
    )
    if not itself.holds:
        return Row(2, decide([itself], note, printed, ds + model))
    return Row(2, judge(steps, found, proving, note, claimed, limit), "claim")


def equation_3(case: Case) -> Row:
    """Check the definition of s against the model's residual, with its units."""
    printed = case.explicit(3, "s", e1=src.e1, e2=src.e2, de1=dq1, de2=dq2)
    steps = [equal("s", printed, case.residual)]
    note = "A definition; the model's residual is the same expression, in rad/s."
    return Row(3, decide(steps, note, printed, case.residual))


def equation_4(case: Case) -> Row:
    """Check the errors, and that the setpoint is the upright equilibrium that a torque can hold."""
    goal = {n: case.explicit(4, n) for n in ("q1d", "q2d")}
    printed = sp.Matrix([case.explicit(4, n, **goal) for n in ("e1", "e2")])
    errors = upright(case.derivation.spec.constraint.errors)
    at_goal = {q1: goal["q1d"], q2: goal["q2d"]}
    held = case.derivation.dynamics.gravity[1].subs(at_goal)
    potential = case.derivation.spec.potential_energy
    bent = (-sp.hessian(potential, (q1, q2)).subs(at_goal)).expand()
    minors = (bent[0, 0], sp.expand(bent.det()))
    steps = [
        equal("e", printed, errors),
        equal("gravity on the passive joint at the setpoint", sp.S.Zero, held),
        true("it is upright: the potential is largest there", all(m.is_positive for m in minors)),
    ]
    note = "A definition; the setpoint is an equilibrium, since no gravity acts on joint 2 there."
    return Row(4, decide(steps, note, printed, errors))


def equation_5(case: Case) -> Row:
    """Check (5) as (2) with (3) and (4) put in."""
    printed = case.explicit(5, "left") - case.explicit(5, "right")
    (s,) = src.real("s")
    drift = upright(case.derivation.spec.constraint.drift[0]).subs(s, case.residual)
    steps = [
        equal("(5) is A q'' - b", printed, case.second_order),
        equal("(5) is s' + drift(s)", printed, rate(case.residual) + drift),
    ]
    note = (
        "(2) with (3) and (4) put in. What remark 1 concludes from it: see the findings. "
        f"{UNITS_SHARED}"
    )
    return Row(5, decide(steps, note, printed, case.second_order))


def equation_6(case: Case) -> Row:
    """Check (6) as the integral of (5): its rate is (5), and it starts at zero."""
    printed = case.explicit(6, "left") - case.explicit(6, "right")
    steps = [
        equal("rate of (6) is (5)", rate(printed), case.second_order),
        equal("(6) is zero at t = 0", at_start(printed), sp.S.Zero),
    ]
    note = (
        "The rate of (6) is (5) and (6) vanishes at t = 0. The integration variable shares the "
        f"letter of the torque in print. {UNITS_SHARED}"
    )
    return Row(6, decide(steps, note, printed, case.second_order))


def beta_of_law(case: Case) -> Step:
    """Show that A q' - c has the rate of the derived law's beta."""
    s, integral = src.real("s drift_integral")
    law = case.law("beta")
    moving = law.diff(s) * rate(case.residual) + law.diff(integral) * case.law_expanded("drift")
    return equal("its rate is that of the derived law's beta", rate(case.following()), moving)


def equation_7(case: Case) -> Row:
    """Check A, b and c, and A q' - c against the derived beta."""
    constraint, printed = case.derivation.constraint, case.following()
    c = case.explicit(7, "c")
    steps = [
        equal("A", case.explicit(7, "A"), constraint.jacobian),
        equal("b", case.explicit(7, "b"), upright(constraint.acceleration[0])),
        true("c holds no q' but in its integrals", not _outside_integrals(c).has(dq1, dq2)),
        equal("A q' - c = 0 at t = 0", at_start(printed), sp.S.Zero),
        beta_of_law(case),
    ]
    note = (
        "A, b and c as printed agree, every sign of c included. The number (7) itself is missing "
        f"in the transcription; it was read as the tag of A, b and c. {UNITS_SHARED}"
    )
    return Row(7, decide(steps, note, printed, case.residual))


def _outside_integrals(c: sp.Expr) -> sp.Expr:
    return c.replace(INTEGRAL, lambda _: sp.S.Zero)


def equation_8(case: Case) -> Row:
    """Check (8) as the derivative of (7)."""
    first, second = case.following(), case.explicit(8, "second")
    steps = [
        equal("rate of A q' - c is A q'' - b", rate(first), case.second_order),
        equal("A q'' - b is (5)", second, case.second_order),
    ]
    note = f"The derivative of (7). {UNITS_SHARED}"
    return Row(8, decide(steps, note, second, case.second_order))


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
