"""The Furuta pendulum with the torque on the arm.

theta is the arm's angle, alpha the pendulum's from the upright, positive where the pendulum leans
towards the arm's positive motion. The pendulum is slender: `pendulum_inertia` holds about both axes
across it, the one along it has none.
"""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.authoring import LABORATORY, ModelBuilder, ModelSpec


def model() -> ModelSpec:
    """Return the Furuta pendulum's specification."""
    m = ModelBuilder(
        "furuta",
        title="Furuta pendulum",
        source="B. S. Cazzolato, Z. Prime, On the dynamics of the Furuta pendulum, Journal of "
        "Control Science and Engineering, 2011, 528341, slender pendulum; the servo-constraint has "
        "the library's standard form",
        domain=LABORATORY,
    )
    theta, dtheta = m.coordinate("theta", "rad", "angle of the arm", bound=1e4, rate_bound=1e3)
    alpha, dalpha = m.coordinate(
        "alpha", "rad", "angle of the pendulum from the upright", bound=1e4, rate_bound=1e3
    )
    arm = m.parameter(
        "arm_inertia", "kg*m^2", "inertia of motor, hub and arm about the motor's axis", latex="J_a"
    )
    reach = m.parameter("arm_length", "m", "motor's axis to the pendulum's hinge", latex="L_a")
    mass = m.parameter("pendulum_mass", "kg", "mass of the pendulum", latex="m_p")
    length = m.parameter("half_length", "m", "hinge to the centre of mass", latex="l")
    inertia = m.parameter(
        "pendulum_inertia", "kg*m^2", "inertia across the pendulum, at its centre", latex="I"
    )
    g = m.parameter("g", "m/s^2", "acceleration of gravity", upper=100.0)
    m.actuator("tau", "N*m", "motor torque on the arm", on={"theta": sp.S.One})
    m.swing_up(kP=75.0, kD=1.56, kE=1e5, kV=1.8)
    outwards = sp.Matrix([sp.cos(theta), sp.sin(theta), 0])
    onwards = sp.Matrix([-sp.sin(theta), sp.cos(theta), 0])
    upwards = sp.Matrix([0, 0, 1])
    axis = sp.sin(alpha) * onwards + sp.cos(alpha) * upwards
    centre = reach * outwards + length * axis
    velocity = centre.diff(theta) * dtheta + centre.diff(alpha) * dalpha
    turning = axis.diff(theta) * dtheta + axis.diff(alpha) * dalpha
    return m.build(
        kinetic_energy=arm * dtheta**2 / 2
        + mass * velocity.dot(velocity) / 2
        + inertia * turning.dot(turning) / 2,
        potential_energy=mass * g * centre[2],
    )
