"""The PVTOL aircraft of Hauser, Sastry and Meyer: thrust and rolling moment, coupled by epsilon.

x and y are the position of the centre of mass, theta the roll angle. The rolling moment also pushes
sideways by the factor `coupling`, which makes the horizontal motion non-minimum phase.
"""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.authoring import (
    Actuator,
    Coordinate,
    Matrix,
    ModelSpec,
    Parameter,
    ServoConstraint,
    standard_law,
    symbols_of,
)


def _plant(name: str, unit: str, text: str, latex: str) -> Parameter:
    return Parameter(name, unit, text, "plant", 0.0, 1e4, True, latex=latex)


def _gain(
    name: str, unit: str, text: str, group: str = "gain", lower: float = -1e4, latex: str = ""
) -> Parameter:
    return Parameter(name, unit, text, group, lower, 1e6, latex=latex)


PARAMETERS = (
    _plant("mass", "kg", "mass of the aircraft", "m"),
    _plant("inertia", "kg*m^2", "moment of inertia about the roll axis", "J"),
    _plant("coupling", "1/m", "sideways force per rolling moment", "\\epsilon"),
    Parameter("g", "m/s^2", "acceleration of gravity", "plant", 0.0, 100.0, True, latex="g"),
    _gain("weight_x", "1/m", "weight of x in the roll constraint", "synthesised", latex="w_x"),
    _gain("rate_x", "1/s", "rate of the error of x", "synthesised", latex="r_x"),
    _gain("rate_theta", "1/s", "rate of the error of theta", "synthesised", latex="r_\\theta"),
    _gain("rate_y", "1/s", "rate of the error of y", "synthesised", latex="r_y"),
    _gain(
        "sigma", "1/s", "decay rate of the servo-constraints, (2)", lower=1e-6, latex="\\varsigma"
    ),
    _gain("eta", "1/s^2", "bound of the arctan term, (2)", lower=0.0, latex="\\eta"),
    _gain("kappa", "kg^2*m^2/s", "gain of p2, (18)", lower=1e-9, latex="\\kappa"),
    _gain("epsilon", "1/s^3", "layer of p3, (23)", lower=1e-9, latex="\\varepsilon"),
    _gain("k1", "kg^2*m^2/s^2", "adaptation rate, (15)", lower=0.0, latex="\\kappa_1"),
    _gain("k2", "1/s", "leakage rate, (15)", lower=1e-6, latex="\\kappa_2"),
    _gain(
        "bound_initial",
        "N",
        "initial estimate of the uncertainty bound, (15)",
        lower=0.0,
        latex="\\hat\\alpha(t_0)",
    ),
    _gain("xd", "m", "setpoint of x", latex="x_d"),
    _gain("yd", "m", "setpoint of y", latex="y_d"),
    Parameter("sample_time", "s", "period of the controller", "target", 1e-6, 1.0, latex="T"),
    Parameter(
        "thrust_limit", "N", "largest thrust commanded", "target", 0.0, 1e6, True, latex="u_{\\max}"
    ),
    Parameter(
        "moment_limit",
        "N*m",
        "largest rolling moment commanded",
        "target",
        0.0,
        1e6,
        True,
        latex="v_{\\max}",
    ),
    Parameter(
        "singular_threshold",
        "1/(kg^2*m^2)",
        "least |det ADB| the law divides by",
        "target",
        1e-9,
        1e6,
        latex="\\underline{a}",
    ),
    Parameter("x_load", "N", "constant sideways load", "uncertainty", -1e3, 1e3, default=0.0),
    Parameter("y_load", "N", "constant vertical load", "uncertainty", -1e3, 1e3, default=0.0),
    Parameter("x_drag", "N*s/m", "viscous drag on x", "uncertainty", -1e3, 1e3, default=0.0),
    Parameter("y_drag", "N*s/m", "viscous drag on y", "uncertainty", -1e3, 1e3, default=0.0),
    Parameter(
        "theta_damping",
        "N*m*s",
        "viscous damping of the roll",
        "uncertainty",
        -1e3,
        1e3,
        default=0.0,
    ),
)


def model() -> ModelSpec:
    """Return the PVTOL's specification: altitude and a mixed roll-and-position constraint."""
    p = symbols_of(PARAMETERS)
    coordinates = (
        Coordinate("x", "m", "horizontal position", 1e3, 1e3),
        Coordinate("y", "m", "vertical position", 1e3, 1e3),
        Coordinate("theta", "rad", "roll angle", 1e3, 1e3),
    )
    x, y, theta = (c.position for c in coordinates)
    dx, dy, dtheta = (c.velocity for c in coordinates)
    s1, s2 = sp.symbols("s1 s2", real=True)
    sine, cosine = sp.sin(theta), sp.cos(theta)
    drift = [p.sigma * s + 2 * p.eta / sp.pi * sp.atan(s) for s in (s1, s2)]
    return ModelSpec(
        name="pvtol",
        title="PVTOL aircraft",
        source="J. Hauser, S. Sastry, G. Meyer, Nonlinear control design for slightly "
        "non-minimum phase systems: application to V/STOL aircraft, Automatica 28(4), 665-679, "
        "1992; the servo-constraints are the library's own",
        coordinates=coordinates,
        actuators=(
            Actuator("thrust", "N", "thrust along the body's vertical"),
            Actuator("moment", "N*m", "rolling moment"),
        ),
        parameters=PARAMETERS,
        kinetic_energy=p.mass * (dx**2 + dy**2) / 2 + p.inertia * dtheta**2 / 2,
        potential_energy=p.mass * p.g * y,
        input_matrix=Matrix([[-sine, p.coupling * cosine], [cosine, p.coupling * sine], [0, 1]]),
        uncertain_force=Matrix(
            [p.x_load + p.x_drag * dx, p.y_load + p.y_drag * dy, p.theta_damping * dtheta]
        ),
        constraint=ServoConstraint(
            residual=Matrix(
                [
                    dy + p.rate_y * (y - p.yd),
                    p.weight_x * (dx + p.rate_x * (x - p.xd)) + dtheta + p.rate_theta * theta,
                ]
            ),
            residual_symbols=(s1, s2),
            residual_units=("m/s", "rad/s"),
            drift=Matrix(drift),
            errors=Matrix([x - p.xd, y - p.yd, theta]),
            setpoint=(p.xd, p.yd, sp.S.Zero),
        ),
        law=standard_law(p, p.thrust_limit, p.moment_limit),
    )
