"""What the source's own numbers imply: gains, parameters, units and the friction model."""

from __future__ import annotations

import re

import sympy as sp
from pfaffian.derive.symbolic.units import dimension_of
from pfaffian.paper.audit.check import decide, equal, refute, true
from pfaffian.paper.audit.notation import read
from pfaffian.paper.audit.row import PROVED, Counterexample, Finding, Verdict
from pfaffian.paper.equations import pendubot_source as src
from pfaffian.paper.equations.pendubot_findings import frictionless, point_of
from pfaffian.paper.equations.pendubot_print import unlike
from pfaffian.paper.equations.pendubot_source import Case, P
from pfaffian.runtime.base.quantity import unit_registry


def hurwitz_conditions(case: Case) -> Finding:
    """Prove the closed form of the stable gain sets by Routh."""
    a3, a2, a1, a0 = frictionless(case)
    routh = sp.expand(a2 * a1 - a3 * a0)
    weight = P.g * P.theta5
    known = {c.text for c in case.derivation.spec.stability}
    spread = P.theta2 + P.theta3
    steps = [
        equal("a3", a3, P.lam * P.theta2 - spread),
        equal("a1", a1, -weight * (P.lam - 1)),
        equal("a0", a0, -weight * (P.lam * P.lam1 - P.lam2)),
        equal("a2 a1 - a3 a0", routh, weight * P.theta3 * P.lam * (P.lam2 - P.lam1)),
        equal(
            "a2 < 0 follows from a3 < 0 and lam1 < lam2",
            -a2,
            -P.lam2 * a3 + P.lam * P.theta2 * (P.lam2 - P.lam1),
        ),
        true("the model states the same four", len(known) == 4),
    ]
    note = (
        "Positive gains do not suffice: without friction the zero dynamics are stable exactly for "
        "lam2 > 0 and 1 < lam lam1/lam2 < lam < 1 + theta3/theta2 (a3 > 0 would need lam < 1 by a1 "
        "and lam > 1 + theta3/theta2 at once). Hence cos q2* = (lam - 1) theta2/theta3 < 1: every "
        "stable design has a singular set within 90 degrees."
    )
    gains = {P.lam: 1, P.lam1: 1, P.lam2: 2}
    found = Counterexample(
        point_of({**gains, P.theta5: 1, P.g: 1}),
        sp.S.One,
        sp.sign(-a0),
        "the sign that -a0 needs for stability, and its sign",
    )
    verdict = refute(steps, note, "lam, lam1, lam2 > 0", routh, found)
    return Finding(
        "stable-gains", "2.2, below (4)", "any positive lam, lam1, lam2 will do", verdict, (2, 3)
    )


def rig_gains(case: Case) -> Finding:
    """Judge lam = 2.25 on the identified plant of section 6."""
    where, lam = "plant of section 6", case.gains[P.lam]
    rig = {getattr(P, n): case.value(where, n) for n in case.paper.said[where]}
    bound = (1 + P.theta3 / P.theta2).subs(rig)
    a3, _, a1, _ = (c.subs(rig).subs(P.lam, lam) for c in frictionless(case))
    steps = [
        true("lam of section 5.1 exceeds the bound", lam > bound),
        true("a3 > 0 and a1 < 0 whatever lam1, lam2", sp.And(a3 > 0, a1 < 0)),
    ]
    found = Counterexample(
        point_of({P.lam: lam, P.theta2: rig[P.theta2], P.theta3: rig[P.theta3]}),
        P.lam,
        1 + P.theta3 / P.theta2,
        "lam and the bound that it must not reach",
    )
    note = (
        f"lam = {sp.N(lam, 3)} is unstable on the identified plant for every lam1, lam2: the bound "
        f"is {bound} = {sp.N(bound, 4)}. The source prints no gains for its experiment, so they "
        "must have been others."
    )
    verdict = refute(steps, note, lam, bound, found)
    return Finding(
        "rig-gains",
        "5.1 and 6, parameters",
        "the gains of section 5 serve the plant of section 6",
        verdict,
    )


def friction_threshold(case: Case) -> Finding:
    """Find the viscous friction on joint 2 at which the source's gains lose stability."""
    d2 = P.joint2_viscous
    others = {
        s: 0
        for c in case.derivation.zero_dynamics.coefficients
        for s in c.free_symbols
        if s.name.startswith("joint") and s != d2
    }
    at = {**case.gains, **case.plant}
    values = [
        src.upright(c).subs(others).subs(at) for c in case.derivation.zero_dynamics.coefficients
    ]
    a3, a2, a1, a0 = (sp.expand(-v) for v in values)  # made positive at d2 = 0
    margins = (a3, a2, a1, a0, sp.expand(a2 * a1 - a3 * a0))
    zeros = [z for m in margins for z in sp.roots(m, d2)]
    threshold = min(z for z in zeros if z.is_real and z > 0)
    steps = [
        true("stable without friction", all(m.subs(d2, 0) > 0 for m in margins)),
        equal("a2 a1 - a3 a0 fails first", margins[-1].subs(d2, threshold), sp.S.Zero),
        true("unstable beyond", margins[-1].subs(d2, sp.Rational(11, 10) * threshold) < 0),
    ]
    found = Counterexample(
        point_of({d2: sp.Rational(1, 500)}),
        sp.S.One,
        sp.sign(margins[-1]),
        "the sign Routh's last minor needs, and its sign at d2 = .002 N m s/rad",
    )
    note = (
        "Joint-2 friction is mismatched and destabilises: the design holds up to d2 = "
        f"{sp.N(threshold, 6)} N m s/rad, the zero of Routh's a2 a1 - a3 a0; the coefficient a2 "
        f"alone would change sign later, at {sp.N(sp.solve(a2, d2)[0], 6)}."
    )
    verdict = refute(steps, note, sp.oo, threshold, found)
    claim = "the gains of section 5 work regardless of mismatched uncertainty"
    return Finding("friction-threshold", "abstract; 5.3", claim, verdict, (12,))


def friction_slope(case: Case) -> Finding:
    """Differentiate the friction model at zero speed."""
    force = case.value("friction of section 5.2", "f", rate=src.dq1)
    slope = force.diff(src.dq1).subs(src.dq1, 0)
    power = force * src.dq1
    found = Counterexample(
        point_of({src.dq1: sp.Rational(1, 10)}),
        sp.S.Zero,
        power,
        "the least power that friction may take out of joint 1, and what it takes out",
    )
    steps = [
        true("its slope at rest is negative", slope < 0),
        true("with the slopes exchanged it is positive", _exchanged(case) > 0),
    ]
    note = (
        f"Its slope at rest is {sp.N(slope, 4)} N m s/rad: on the left-hand side of (1) that "
        "drives slow motion instead of damping it. With the two tanh exchanged it would damp: "
        f"{sp.N(_exchanged(case), 4)} N m s/rad."
    )
    verdict = refute(steps, note, force, slope, found)
    return Finding(
        "friction-slope",
        "5.2 and 5.3, the friction",
        "the force of sections 5.2, 5.3 is a friction",
        verdict,
    )


def _exchanged(case: Case) -> sp.Expr:
    """Return the slope at rest with the first two slopes of the friction model exchanged."""
    text = case.paper.said["friction of section 5.2"]["f"]
    first, second = re.findall(r"tanh\(([\d.]+)\*rate\)", text)[:2]
    swapped = text.replace(first, "?").replace(second, first).replace("?", second)
    return read(swapped, {"rate": src.dq1}).diff(src.dq1).subs(src.dq1, 0)


def norm_of_delta(case: Case) -> Finding:
    """Refute the norm that adds a rate and a torque."""
    beta, gap, scale = src.positive("beta gap per_second")
    norm = beta**2 + gap**2
    steps = [true("its terms have unlike units", unlike(norm, {"beta": "rad/s", "gap": "N*m"}))]
    found = Counterexample(
        ((beta, sp.S.One), (gap, sp.S.One), (scale, sp.Integer(60))),
        (beta * scale) ** 2 + gap**2 * scale**4,
        beta**2 + gap**2,
        "|delta|^2 for beta = 1 rad/s, ahat - alpha = 1 N m: in minutes and in seconds",
    )
    note = (
        "delta stacks a rate and a torque, so |delta|, d, R and T change with the units; V of (24) "
        "does not mix them, since k1 carries N^2 m^2 s^2."
    )
    verdict = refute(steps, note, norm, beta**2 + gap**2 / P.k1, found)
    return Finding(
        "norm-of-delta",
        "4, above (41)",
        "|delta|^2 = |beta|^2 + |ahat - alpha|^2",
        verdict,
        (41, 43),
    )


def stable_in_simulation(case: Case) -> Finding:
    """Prove that the source's gains are stable on its own frictionless plant."""
    values = [c.subs(case.gains).subs(case.plant) for c in frictionless(case)]
    a3, a2, a1, a0 = (-v for v in values)
    facts = (a3 > 0, a2 > 0, a1 > 0, a0 > 0, a2 * a1 - a3 * a0 > 0)
    held = all(bool(f) for f in facts)
    p = sp.Symbol("p")
    roots = sp.Poly([a3, a2, a1, a0], p).nroots(n=6)
    note = (
        "Stable without friction, by Routh, exactly; the poles are "
        f"{', '.join(str(sp.N(z, 4)) for z in roots)} 1/s, barely damped."
    )
    shown = sp.Poly([a3, a2, a1, a0], p).as_expr()
    if not held:
        raise ValueError("the gains of section 5 are not stable on its plant")
    verdict = Verdict(PROVED, note, shown, shown, None, ("Routh",))
    return Finding(
        "sim-gains", "5.1, first paragraph", "the gains of section 5 suit its plant", verdict
    )


def units_of_the_law(case: Case) -> Finding:
    """Prove that (15) and (18)-(23) agree in unit, given Pi and the arctan as numbers."""
    registry = unit_registry()
    units = {p.name: p.unit for p in case.derivation.spec.parameters}
    units |= {"adb": "1/(kg*m^2)", "beta": "rad/s", "ahat": "N*m", "f1": "N*m"}
    adb, beta, ahat, load = src.real("adb beta ahat f1")
    mu = adb * beta * ahat
    wanted = (
        ("(9), (16): p2 is a torque", -P.kappa * adb * beta + load, "N*m"),
        ("(19): p3 is a torque", -mu * ahat / P.epsilon + load, "N*m"),
        ("(23): eps is a mu", mu + P.epsilon, "1/s^3"),
        ("(15): both terms are torque rates", P.k1 * adb * beta - P.k2 * ahat, "N*m/s"),
        ("(24): both terms of V", beta**2 + ahat**2 / P.k1, "1/s^2"),
    )
    steps = [
        true(what, dimension_of(value, units, what) == registry.parse_units(unit).dimensionality)
        for what, value, unit in wanted
    ]
    note = (
        "With Pi a number the gains take units: kappa N m kg m^2 s, eps 1/s^3, k1 N^2 m^2 s^2, "
        "k2 1/s. The source prints its gains without any."
    )
    verdict = decide(steps, note, P.kappa, P.kappa)
    claim = "the gains of section 5 can carry units that make the law homogeneous"
    return Finding(
        "units-of-the-law", "5.1 and 5.2, parameters", claim, verdict, (15, 18, 19, 23, 24)
    )


FINDINGS = (
    units_of_the_law,
    hurwitz_conditions,
    stable_in_simulation,
    rig_gains,
    friction_threshold,
    friction_slope,
    norm_of_delta,
)
