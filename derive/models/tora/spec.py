"""The TORA (RTAC) in the horizontal plane; theta is the arm's angle from across the track."""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.authoring import LABORATORY, ModelBuilder, ModelSpec


def model() -> ModelSpec:
    """Return the TORA's specification."""
    m = ModelBuilder(
        "tora",
        title="Translational oscillator with a rotational actuator",
        source="R. T. Bupp, D. S. Bernstein, V. T. Coppola, A benchmark problem for nonlinear "
        "control design, Int. J. Robust and Nonlinear Control 8(4-5), 307-310, 1998; the "
        "servo-constraint has the library's standard form",
        domain=LABORATORY,
    )
    x, dx = m.coordinate("x", "m", "position of the cart", bound=1e2, rate_bound=1e3)
    theta, dtheta = m.coordinate("theta", "rad", "angle of the arm", bound=1e4, rate_bound=1e4)
    cart = m.parameter("cart_mass", "kg", "mass of the cart", latex="M")
    arm = m.parameter("arm_mass", "kg", "eccentric mass", latex="m")
    eccentricity = m.parameter("eccentricity", "m", "axis to the eccentric mass", latex="e")
    inertia = m.parameter("arm_inertia", "kg*m^2", "inertia about its centre of mass", latex="I")
    stiffness = m.parameter("stiffness", "N/m", "stiffness of the spring", upper=1e6, latex="k")
    m.actuator("u", "N*m", "torque on the arm", on={"theta": sp.S.One})
    centre = sp.Matrix([x + eccentricity * sp.sin(theta), -eccentricity * sp.cos(theta)])
    velocity = centre.diff(x) * dx + centre.diff(theta) * dtheta
    return m.build(
        kinetic_energy=cart * dx**2 / 2
        + arm * velocity.dot(velocity) / 2
        + inertia * dtheta**2 / 2,
        potential_energy=stiffness * x**2 / 2,
    )
