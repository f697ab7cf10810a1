"""The overhead crane in the plane; theta is the angle of the rope from hanging straight down."""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.authoring import LABORATORY, ModelBuilder, ModelSpec


def model() -> ModelSpec:
    """Return the crane's specification: a rope of fixed length, a load that is a point."""
    m = ModelBuilder(
        "crane",
        title="Overhead crane",
        source="Y. Fang, W. E. Dixon, D. M. Dawson, E. Zergeroglu, Nonlinear coupling control laws "
        "for an underactuated overhead crane system, IEEE/ASME Trans. Mechatronics 8(3), 418-423, "
        "2003; the servo-constraint has the library's standard form",
        domain=LABORATORY,
    )
    x, dx = m.coordinate("x", "m", "position of the trolley", bound=1e3, rate_bound=1e3)
    theta, dtheta = m.coordinate(
        "theta", "rad", "angle of the rope from hanging down", bound=1e4, rate_bound=1e3
    )
    trolley = m.parameter("trolley_mass", "kg", "mass of the trolley", latex="M")
    load = m.parameter("load_mass", "kg", "mass of the load", latex="m")
    rope = m.parameter("rope_length", "m", "length of the rope", latex="l")
    g = m.parameter("g", "m/s^2", "acceleration of gravity", upper=100.0)
    m.actuator("u", "N", "force on the trolley", on={"x": sp.S.One})
    centre = sp.Matrix([x + rope * sp.sin(theta), -rope * sp.cos(theta)])
    velocity = centre.diff(x) * dx + centre.diff(theta) * dtheta
    return m.build(
        kinetic_energy=trolley * dx**2 / 2 + load * velocity.dot(velocity) / 2,
        potential_energy=load * g * centre[1],
    )
