"""Identities that every derivation must satisfy, each proved by normal form, never sampled."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.mechanics.constraint import Constraint
from pfaffian.derive.mechanics.dynamics import SMALL, Dynamics
from pfaffian.derive.spec.model_spec import ModelSpec
from pfaffian.derive.symbolic.normal_form import is_zero, zero_matrix


@dataclass(frozen=True)
class Identity:
    """A named statement, its LaTeX, and whether its normal form came out as zero."""

    name: str
    latex: str
    proved: bool


def prove_identities(
    spec: ModelSpec, dynamics: Dynamics, constraint: Constraint
) -> tuple[Identity, ...]:
    """Prove the identities of the dynamics, of the decomposition (9)-(12) and of p1, (27)."""
    q, dq = sp.Matrix(spec.positions), sp.Matrix(spec.velocities)
    mass, coriolis, gravity = (dynamics.mass_matrix, dynamics.coriolis_matrix, dynamics.gravity)
    mass_rate = sum(
        (mass.diff(qi) * vi for qi, vi in zip(q, dq, strict=True)), sp.zeros(*mass.shape)
    )
    skew = mass_rate - 2 * coriolis
    kinetic = (dq.T * mass * dq)[0] / 2 - dynamics.kinetic_energy
    # d/dt(T + V) along M q'' = B tau - C q' - G must be the power of the actuators.
    tau = sp.Matrix(sp.symbols(f"tau1:{len(spec.actuators) + 1}", real=True, cls=sp.Dummy))
    forces = dynamics.input_matrix * tau - coriolis * dq - gravity
    power = (
        (dq.T * forces)[0]
        + (dq.T * mass_rate * dq)[0] / 2
        + (gravity.T * dq)[0]
        - (dq.T * dynamics.input_matrix * tau)[0]
    )
    ad = _constraint_rows(mass, constraint)
    adb = ad * dynamics.input_matrix
    force = sp.Matrix(sp.symbols(f"f1:{len(q) + 1}", real=True, cls=sp.Dummy))
    # Not adb.inv(): its search for a pivot that is not zero costs more than all the proofs.
    inverse = adb.adjugate() / adb.det()
    matched = inverse * ad * force
    mismatched = force - dynamics.input_matrix * matched
    # What is multiplied by AD here is any vector: as symbols the proof is shorter, and as good.
    bias = sp.Matrix(sp.symbols(f"h1:{len(q) + 1}", real=True, cls=sp.Dummy))
    right = sp.Matrix(sp.symbols(f"b1:{len(tau) + 1}", real=True, cls=sp.Dummy))
    nominal = inverse * (right + ad * bias)
    followed = ad * (dynamics.input_matrix * nominal - bias) - right
    return (
        Identity("M is symmetric", "M = M^T", zero_matrix(mass - mass.T)),
        Identity(
            "M' - 2C is skew-symmetric",
            "(\\dot M - 2C) + (\\dot M - 2C)^T = 0",
            zero_matrix(skew + skew.T),
        ),
        Identity(
            "T is the quadratic form of M", "T = \\tfrac12 \\dot q^T M \\dot q", is_zero(kinetic)
        ),
        Identity(
            "energy changes by the actuators' power alone",
            "\\dot T + \\dot V = \\dot q^T B \\tau",
            is_zero(power),
        ),
        Identity(
            "the mismatched part vanishes from the constraint, (12)",
            "AD\\,\\Delta\\tilde F = 0",
            zero_matrix(ad * mismatched),
        ),
        Identity(
            "p1 follows the constraint exactly, (27)",
            "AD[(-C\\dot q - G) + Bp_1] - b = 0",
            zero_matrix(followed),
        ),
    )


def _constraint_rows(mass: sp.Matrix, constraint: Constraint) -> sp.Matrix:
    """Return A D (m, n), D = M^-1; entry by entry a symbol where M is large.

    Both identities that use it hold for every A D with ADB regular, so nothing is lost.
    """
    m, n = constraint.jacobian.shape
    if n > SMALL:
        return sp.Matrix(m, n, sp.symbols(f"x1:{m * n + 1}", real=True, cls=sp.Dummy))
    return constraint.jacobian * mass.adjugate() / mass.det()
