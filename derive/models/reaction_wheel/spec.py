"""The reaction-wheel pendulum; theta from the upright, phi the wheel relative to the pendulum.

The energies do not depend on phi: its equation is that of angular momentum, and the setpoint of phi
is any angle one likes.
"""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.authoring import LABORATORY, ModelBuilder, ModelSpec


def model() -> ModelSpec:
    """Return the reaction-wheel pendulum's specification."""
    m = ModelBuilder(
        "reaction_wheel",
        title="Reaction-wheel pendulum",
        source="M. W. Spong, P. Corke, R. Lozano, Nonlinear control of the Reaction Wheel "
        "Pendulum, Automatica 37(11), 1845-1851, 2001; the servo-constraint has the library's "
        "standard form",
        domain=LABORATORY,
    )
    theta, dtheta = m.coordinate(
        "theta", "rad", "angle of the pendulum from the upright", bound=1e4, rate_bound=1e3
    )
    _, dphi = m.coordinate(
        "phi", "rad", "angle of the wheel relative to the pendulum", bound=1e6, rate_bound=1e4
    )
    pendulum = m.parameter("pendulum_mass", "kg", "mass of the pendulum", latex="m_p")
    centre = m.parameter("pendulum_centre", "m", "pivot to its centre of mass", latex="l_p")
    inertia = m.parameter(
        "pendulum_inertia", "kg*m^2", "inertia about its centre of mass", latex="J_p"
    )
    wheel = m.parameter("wheel_mass", "kg", "mass of wheel and rotor", latex="m_r")
    length = m.parameter("wheel_centre", "m", "pivot to the axis of the wheel", latex="l_r")
    rotor = m.parameter("wheel_inertia", "kg*m^2", "inertia about the wheel's axis", latex="J_r")
    g = m.parameter("g", "m/s^2", "acceleration of gravity", upper=100.0)
    m.actuator("tau", "N*m", "torque on the wheel against the pendulum", on={"phi": sp.S.One})
    moment = pendulum * centre + wheel * length
    return m.build(
        kinetic_energy=(pendulum * centre**2 + wheel * length**2 + inertia) * dtheta**2 / 2
        + rotor * (dtheta + dphi) ** 2 / 2,
        potential_energy=moment * g * sp.cos(theta),
    )
