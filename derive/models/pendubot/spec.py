"""The Pendubot with the servo-constraint (2)-(8) and the control law (15)-(23) of the paper.

Paper: "Adaptive robust control for Pendubot with matched-mismatched uncertainty via
constraint-following". Equation numbers are the paper's. q1 is measured from the horizontal, q2
relative to link 1; the motor acts on link 1 only.
"""

from __future__ import annotations

from types import SimpleNamespace

import sympy as sp
from pfaffian.derive.authoring import (
    Actuator,
    Coordinate,
    Matrix,
    ModelSpec,
    Parameter,
    ServoConstraint,
    StabilityCondition,
    SwingUpGains,
    standard_law,
    standard_swing_up,
    swing_up_parameters,
    symbols_of,
)

_INERTIA = "kg*m^2"


def _physical(name: str, unit: str, text: str, upper: float, latex: str) -> Parameter:
    return Parameter(name, unit, text, "physical", 0.0, upper, lower_open=True, latex=latex)


def _lumped(name: str, unit: str, text: str, latex: str) -> Parameter:
    return Parameter(name, unit, text, "lumped", 0.0, 1e4, lower_open=True, latex=latex)


def _gain(
    name: str, unit: str, text: str, latex: str, group: str = "gain", **kw: float
) -> Parameter:
    bounds = {"lower": 0.0, "upper": 1e4, "lower_open": True, **kw}
    return Parameter(name, unit, text, group, latex=latex, **bounds)  # type: ignore[arg-type]


def _friction(joint: int) -> tuple[Parameter, ...]:
    rows = (
        ("load", "N*m", "constant load torque", "d"),
        ("viscous", "N*m*s", "viscous friction", "v"),
        ("friction1", "N*m", "friction model, Stribeck torque", "\\varphi_1"),
        ("friction2", "s", "friction model, first Stribeck slope", "\\varphi_2"),
        ("friction3", "s", "friction model, second Stribeck slope", "\\varphi_3"),
        ("friction4", "N*m", "friction model, Coulomb torque", "\\varphi_4"),
        ("friction5", "s", "friction model, Coulomb slope", "\\varphi_5"),
        ("friction6", "N*m*s", "friction model, viscous part", "\\varphi_6"),
    )
    return tuple(
        Parameter(
            f"joint{joint}_{name}",
            unit,
            f"{text} on joint {joint}",
            "uncertainty",
            -1e3,
            1e3,
            default=0.0,
            latex=f"{latex}^{{({joint})}}",
        )
        for name, unit, text, latex in rows
    )


PARAMETERS = (
    _physical("m1", "kg", "mass of link 1", 1e3, "m_1"),
    _physical("m2", "kg", "mass of link 2", 1e3, "m_2"),
    _physical("l1", "m", "length of link 1", 1e2, "l_1"),
    _physical("lc1", "m", "joint 1 to the centre of mass of link 1", 1e2, "l_{c1}"),
    _physical("lc2", "m", "joint 2 to the centre of mass of link 2", 1e2, "l_{c2}"),
    _physical("I1", _INERTIA, "moment of inertia of link 1 about its centre of mass", 1e4, "I_1"),
    _physical("I2", _INERTIA, "moment of inertia of link 2 about its centre of mass", 1e4, "I_2"),
    _lumped("theta1", _INERTIA, "m1 lc1^2 + m2 l1^2 + I1", "\\theta_1"),
    _lumped("theta2", _INERTIA, "m2 lc2^2 + I2", "\\theta_2"),
    _lumped("theta3", _INERTIA, "m2 l1 lc2", "\\theta_3"),
    _lumped("theta4", "kg*m", "m1 lc1 + m2 l1", "\\theta_4"),
    _lumped("theta5", "kg*m", "m2 lc2", "\\theta_5"),
    Parameter("g", "m/s^2", "acceleration of gravity", "plant", 0.0, 100.0, True, latex="g"),
    _gain("lam", "", "weight of joint 1 in the servo-constraint, (3)", "\\lambda", "synthesised"),
    _gain("lam1", "1/s", "rate of e1 in the servo-constraint, (3)", "\\lambda_1", "synthesised"),
    _gain("lam2", "1/s", "rate of e2 in the servo-constraint, (3)", "\\lambda_2", "synthesised"),
    _gain("sigma", "1/s", "decay rate of the servo-constraint, (2)", "\\varsigma"),
    _gain("eta", "rad/s^2", "bound of the arctan term, (2)", "\\eta", lower_open=False),
    _gain("kappa", "N*m*kg*m^2*s", "gain of p2, (18)", "\\kappa", upper=1e6),
    _gain("epsilon", "1/s^3", "layer of p3, (23)", "\\varepsilon"),
    _gain("k1", "N^2*m^2*s^2", "adaptation rate, (15)", "\\kappa_1", lower_open=False),
    _gain("k2", "1/s", "leakage rate, (15)", "\\kappa_2"),
    _gain(
        "bound_initial",
        "N*m",
        "initial estimate of the uncertainty bound, (15)",
        "\\hat\\alpha(t_0)",
        lower_open=False,
    ),
    Parameter("q1d", "rad", "setpoint of q1, (4)", "gain", -1e3, 1e3, latex="q_{1d}"),
    Parameter("q2d", "rad", "setpoint of q2, (4)", "gain", -1e3, 1e3, latex="q_{2d}"),
    Parameter("sample_time", "s", "period of the controller", "target", 1e-6, 1.0, latex="T"),
    Parameter(
        "torque_limit",
        "N*m",
        "largest torque commanded",
        "target",
        0.0,
        1e4,
        True,
        latex="\\tau_{\\max}",
    ),
    Parameter(
        "slew_limit",
        "N*m/s",
        "largest rate of change of the torque commanded",
        "target",
        0.0,
        1e9,
        True,
        default=1e9,
        latex="\\dot\\tau_{\\max}",
    ),
    Parameter(
        "singular_threshold",
        "1/(kg*m^2)",
        "least |ADB| the law divides by",
        "target",
        1e-9,
        1e6,
        latex="\\underline{a}",
    ),
    # Section 6 gives three of the gains and no kV.
    *swing_up_parameters("rad", SwingUpGains(position=66.35, rate=9.45, energy=1.0, damping=2.0)),
    *_friction(1),
    *_friction(2),
)


def _energies(
    p: SimpleNamespace, q1: sp.Symbol, q2: sp.Symbol, dq1: sp.Symbol, dq2: sp.Symbol
) -> tuple[sp.Expr, sp.Expr]:
    """Return T and V from the positions of the two centres of mass."""
    along1 = Matrix([sp.cos(q1), sp.sin(q1)])
    along2 = Matrix([sp.cos(q1 + q2), sp.sin(q1 + q2)])
    centre1 = p.lc1 * along1
    centre2 = p.l1 * along1 + p.lc2 * along2
    kinetic, potential = sp.S.Zero, sp.S.Zero
    for mass, inertia, centre, spin in (
        (p.m1, p.I1, centre1, dq1),
        (p.m2, p.I2, centre2, dq1 + dq2),
    ):
        velocity = centre.diff(q1) * dq1 + centre.diff(q2) * dq2
        kinetic += mass * velocity.dot(velocity) / 2 + inertia * spin**2 / 2
        potential += mass * p.g * centre[1]
    return kinetic, potential


def _uncertain_force(p: SimpleNamespace, joint: int, rate: sp.Symbol) -> sp.Expr:
    """Return f(q') of one joint: load, viscous part and the friction model of sections 5.2, 5.3."""
    k = {
        n: getattr(p, f"joint{joint}_{n}")
        for n in ("load", "viscous", *(f"friction{i}" for i in range(1, 7)))
    }
    return (
        k["load"]
        + k["viscous"] * rate
        + k["friction1"] * (sp.tanh(k["friction2"] * rate) - sp.tanh(k["friction3"] * rate))
        + k["friction4"] * sp.tanh(k["friction5"] * rate)
        + k["friction6"] * rate
    )


def model() -> ModelSpec:
    """Return the Pendubot's specification."""
    p = symbols_of(PARAMETERS)
    coordinates = (
        Coordinate("q1", "rad", "angle of link 1 from the horizontal", 1e4, 1e3),
        Coordinate("q2", "rad", "angle of link 2 relative to link 1", 1e4, 1e3),
    )
    q1, q2 = (c.position for c in coordinates)
    dq1, dq2 = (c.velocity for c in coordinates)
    kinetic, potential = _energies(p, q1, q2, dq1, dq2)
    s = sp.Symbol("s", real=True)
    e1, e2 = q1 - p.q1d, q2 - p.q2d
    return ModelSpec(
        name="pendubot",
        title="Pendubot",
        source="Adaptive robust control for Pendubot with matched-mismatched uncertainty "
        "via constraint-following",
        coordinates=coordinates,
        actuators=(Actuator("tau", "N*m", "motor torque on link 1"),),
        parameters=PARAMETERS,
        kinetic_energy=kinetic,
        potential_energy=potential,
        input_matrix=Matrix([1, 0]),
        uncertain_force=Matrix([_uncertain_force(p, 1, dq1), _uncertain_force(p, 2, dq2)]),
        constraint=ServoConstraint(
            residual=Matrix([p.lam * (dq1 + p.lam1 * e1) + (dq2 + p.lam2 * e2)]),
            residual_symbols=(s,),
            residual_units=("rad/s",),
            drift=Matrix([p.sigma * s + 2 * p.eta / sp.pi * sp.atan(s)]),
            errors=Matrix([e1, e2]),
            setpoint=(p.q1d, p.q2d),
        ),
        law=standard_law(p, p.torque_limit, slews=(p.slew_limit,)),
        swing_up=standard_swing_up(p),
        lumping=(
            (p.theta1, p.m1 * p.lc1**2 + p.m2 * p.l1**2 + p.I1),
            (p.theta2, p.m2 * p.lc2**2 + p.I2),
            (p.theta3, p.m2 * p.l1 * p.lc2),
            (p.theta4, p.m1 * p.lc1 + p.m2 * p.l1),
            (p.theta5, p.m2 * p.lc2),
        ),
        eliminated=(p.I1, p.I2, p.lc1, p.lc2, p.l1),
        stability=(
            StabilityCondition("lam2 > 0", p.lam2),
            StabilityCondition("lam lam1/lam2 > 1", p.lam * p.lam1 / p.lam2 - 1),
            StabilityCondition("lam > lam lam1/lam2", p.lam - p.lam * p.lam1 / p.lam2),
            StabilityCondition("1 + theta3/theta2 > lam", 1 + p.theta3 / p.theta2 - p.lam),
        ),
    )
