"""The servo-constraint in Pfaffian and second-order form: A q' = c and A q'' = b, (5)-(8)."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.spec import Matrix, ModelSpec
from pfaffian.runtime.errors import InputError


@dataclass(frozen=True)
class Constraint:
    """A (m, n) and b (m, 1) of A q'' = b; s (m, 1); drift (m, 1) with s' + drift = 0."""

    jacobian: sp.Matrix
    acceleration: sp.Matrix
    residual: sp.Matrix
    drift: sp.Matrix


def servo_constraint(spec: ModelSpec) -> Constraint:
    """Differentiate the residual s of `spec` once: A = ds/dq', b = -(ds/dq) q' - drift(s).

    Raises `InputError` where s is not affine in the velocities or their number is not that of the
    actuators.
    """
    given = spec.constraint
    q, dq = sp.Matrix(spec.positions), sp.Matrix(spec.velocities)
    residual = sp.Matrix(given.residual)
    if len(residual) != len(spec.actuators):
        raise InputError(
            f"model {spec.name}: {len(residual)} servo-constraints for "
            f"{len(spec.actuators)} actuators",
            remedy="give one constraint for each actuator, so that ADB is square",
        )
    jacobian = residual.jacobian(dq)
    if any(entry.has(*spec.velocities) for entry in jacobian):
        raise InputError(
            f"model {spec.name}: the servo-constraint is not affine in the velocities",
            remedy="write s(q, q') = A(q) q' + a(q)",
        )
    drift = given.drift.subs(dict(zip(given.residual_symbols, residual, strict=True)))
    # A may depend on q, so its own derivative belongs to b as well: (ds/dq) q' covers both.
    acceleration = -(residual.jacobian(q) * dq) - sp.Matrix(drift)
    return Constraint(Matrix(jacobian), Matrix(acceleration), Matrix(residual), Matrix(drift))
