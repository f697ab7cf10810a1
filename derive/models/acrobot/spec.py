"""The acrobot with the torque at the elbow; q1 from the horizontal, q2 relative to link 1."""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.authoring import LABORATORY, ModelBuilder, ModelSpec


def model() -> ModelSpec:
    """Return the acrobot's specification."""
    m = ModelBuilder(
        "acrobot",
        title="Acrobot",
        source="M. W. Spong, The swing up control problem for the acrobot, IEEE Control Systems "
        "Magazine 15(1), 49-55, 1995; the servo-constraint has the library's standard form",
        domain=LABORATORY,
    )
    q1, dq1 = m.coordinate(
        "q1", "rad", "angle of link 1 from the horizontal", bound=1e4, rate_bound=1e3
    )
    q2, dq2 = m.coordinate(
        "q2", "rad", "angle of link 2 relative to link 1", bound=1e4, rate_bound=1e3
    )
    m1 = m.parameter("m1", "kg", "mass of link 1", latex="m_1")
    m2 = m.parameter("m2", "kg", "mass of link 2", latex="m_2")
    l1 = m.parameter("l1", "m", "length of link 1", latex="l_1")
    lc1 = m.parameter("lc1", "m", "joint 1 to the centre of mass of link 1", latex="l_{c1}")
    lc2 = m.parameter("lc2", "m", "joint 2 to the centre of mass of link 2", latex="l_{c2}")
    i1 = m.parameter("I1", "kg*m^2", "inertia of link 1 about its centre of mass", latex="I_1")
    i2 = m.parameter("I2", "kg*m^2", "inertia of link 2 about its centre of mass", latex="I_2")
    g = m.parameter("g", "m/s^2", "acceleration of gravity", upper=100.0)
    m.actuator("tau", "N*m", "motor torque on link 2 against link 1", on={"q2": sp.S.One})
    along1 = sp.Matrix([sp.cos(q1), sp.sin(q1)])
    along2 = sp.Matrix([sp.cos(q1 + q2), sp.sin(q1 + q2)])
    kinetic, potential = sp.S.Zero, sp.S.Zero
    for mass, inertia, centre, spin in (
        (m1, i1, lc1 * along1, dq1),
        (m2, i2, l1 * along1 + lc2 * along2, dq1 + dq2),
    ):
        velocity = centre.diff(q1) * dq1 + centre.diff(q2) * dq2
        kinetic += mass * velocity.dot(velocity) / 2 + inertia * spin**2 / 2
        potential += mass * g * centre[1]
    return m.build(kinetic_energy=kinetic, potential_energy=potential)
