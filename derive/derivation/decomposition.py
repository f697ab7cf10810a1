"""The dynamics of a plant split into what is known and what is not, (9)-(11)."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.mechanics.constraint import Constraint
from pfaffian.derive.mechanics.dynamics import SMALL, Dynamics
from pfaffian.derive.mechanics.mass_solver import determinant
from pfaffian.derive.spec.model_spec import Matrix, ModelSpec
from pfaffian.derive.symbolic.normal_form import trigonometric_sum


@dataclass(frozen=True)
class Decomposition:
    """F = B Fhat + dF of (9)-(11) for a free F: Fhat (m, 1) and dF (n, 1) in `force`."""

    force: sp.Matrix
    matched: sp.Matrix
    mismatched: sp.Matrix


def writes_rows_out(dynamics: Dynamics) -> bool:
    """Return whether A D is written out in the plant's own symbols, as M is small or diagonal."""
    return dynamics.mass_matrix.rows <= SMALL or bool(dynamics.mass_matrix.is_diagonal())


def _constraint_rows(
    spec: ModelSpec, dynamics: Dynamics, constraint: Constraint
) -> tuple[sp.Matrix, sp.Expr]:
    """Return (R, d) with A D = R/d: written out for a small M, else in the names ad11, ...

    Written out, the adjugate of a larger mass matrix fills pages that nobody reads.
    """
    if writes_rows_out(dynamics):
        adjugate = dynamics.mass_matrix.adjugate()
        return constraint.jacobian * adjugate, determinant(dynamics, spec.positions)
    m, n = constraint.jacobian.shape
    names = [f"ad{i + 1}" if m == 1 else f"ad{r + 1}{i + 1}" for r in range(m) for i in range(n)]
    return sp.Matrix(m, n, [spec.own_symbol(name) for name in names]), sp.S.One


def input_gain_expression(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> sp.Expr:
    """Return ADB of (10), or its determinant for several actuators, in the plant's symbols."""
    rows, det = _constraint_rows(spec, dynamics, constraint)
    scaled = rows * dynamics.input_matrix
    return sp.factor(trigonometric_sum(scaled.det())) / det**scaled.rows


def decompose(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> Decomposition:
    """Return the decomposition (9)-(11) of a free force."""
    n = dynamics.mass_matrix.rows
    force = Matrix([spec.own_symbol(f"f{i + 1}") for i in range(n)])
    rows, _ = _constraint_rows(spec, dynamics, constraint)
    gain = rows * dynamics.input_matrix
    matched = (gain.adjugate() * rows * force / gain.det()).applyfunc(sp.factor)
    mismatched = (force - dynamics.input_matrix * matched).applyfunc(sp.factor)
    return Decomposition(force, Matrix(matched), Matrix(mismatched))
