"""The two-wheeled self-balancing robot in the plane, rolling without slipping.

phi is the angle of the wheels in space, so that the axle is at R phi; psi is the pitch of the body
from the upright. The motors sit in the body: their torque turns the wheels forwards and the body
backwards, and their rotors turn with n (phi' - psi').
"""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.authoring import LABORATORY, ModelBuilder, ModelSpec


def model() -> ModelSpec:
    """Return the robot's specification; wheels, motors and torque count both sides together."""
    m = ModelBuilder(
        "two_wheeled",
        title="Two-wheeled self-balancing robot",
        source="Y. Yamamoto, NXTway-GS model-based design: control of self-balancing two-wheeled "
        "robot built with LEGO Mindstorms NXT, 2008; the servo-constraint has the library's "
        "standard form",
        domain=LABORATORY,
    )
    phi, dphi = m.coordinate("phi", "rad", "angle of the wheels", bound=1e4, rate_bound=1e3)
    psi, dpsi = m.coordinate("psi", "rad", "pitch from the upright", bound=1e4, rate_bound=1e3)
    wheel = m.parameter("wheel_mass", "kg", "mass of one wheel", latex="m")
    radius = m.parameter("radius", "m", "radius of the wheels", latex="R")
    wheel_inertia = m.parameter("wheel_inertia", "kg*m^2", "inertia of one wheel", latex="J_w")
    body = m.parameter("body_mass", "kg", "mass of the body", latex="M")
    height = m.parameter("height", "m", "axle to the body's centre of mass", latex="L")
    inertia = m.parameter(
        "body_inertia", "kg*m^2", "inertia of the body about its centre of mass", latex="J_\\psi"
    )
    rotor = m.parameter("rotor_inertia", "kg*m^2", "inertia of one motor's rotor", latex="J_m")
    gear = m.parameter("gear", "", "turns of the rotor for one of the wheel", latex="n")
    g = m.parameter("g", "m/s^2", "acceleration of gravity", upper=100.0)
    m.actuator("u", "N*m", "torque of both motors", on={"phi": sp.S.One, "psi": -sp.S.One})
    axle = radius * dphi
    centre = sp.Matrix([radius * phi + height * sp.sin(psi), height * sp.cos(psi)])
    velocity = centre.diff(phi) * dphi + centre.diff(psi) * dpsi
    return m.build(
        kinetic_energy=2 * (wheel * axle**2 + wheel_inertia * dphi**2) / 2
        + body * velocity.dot(velocity) / 2
        + inertia * dpsi**2 / 2
        + 2 * rotor * gear**2 * (dphi - dpsi) ** 2 / 2,
        potential_energy=body * g * centre[1],
    )
