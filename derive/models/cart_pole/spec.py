"""The cart-pole with the force on the cart; theta is measured from the upright, to the right."""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.authoring import LABORATORY, ModelBuilder, ModelSpec


def model() -> ModelSpec:
    """Return the cart-pole's specification."""
    m = ModelBuilder(
        "cart_pole",
        title="Cart-pole",
        source="A. G. Barto, R. S. Sutton, C. W. Anderson, Neuronlike adaptive elements that can "
        "solve difficult learning control problems, IEEE Trans. SMC 13(5), 834-846, 1983; the "
        "servo-constraint has the library's standard form",
        domain=LABORATORY,
    )
    x, dx = m.coordinate("x", "m", "position of the cart", bound=1e3, rate_bound=1e3)
    theta, dtheta = m.coordinate(
        "theta", "rad", "angle of the pole from the upright", bound=1e4, rate_bound=1e3
    )
    cart = m.parameter("cart_mass", "kg", "mass of the cart", latex="m_c")
    pole = m.parameter("pole_mass", "kg", "mass of the pole", latex="m_p")
    length = m.parameter("half_length", "m", "hinge to the centre of mass", latex="l")
    inertia = m.parameter("pole_inertia", "kg*m^2", "inertia about the centre of mass", latex="I")
    g = m.parameter("g", "m/s^2", "acceleration of gravity", upper=100.0)
    m.actuator("u", "N", "force on the cart", on={"x": sp.S.One})
    m.swing_up(kP=7.2, kD=1.25, kE=1.0, kV=0.27)
    centre = sp.Matrix([x + length * sp.sin(theta), length * sp.cos(theta)])
    velocity = centre.diff(x) * dx + centre.diff(theta) * dtheta
    return m.build(
        kinetic_energy=cart * dx**2 / 2
        + pole * velocity.dot(velocity) / 2
        + inertia * dtheta**2 / 2,
        potential_energy=pole * g * centre[1],
    )
