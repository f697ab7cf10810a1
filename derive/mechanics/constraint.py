"""The servo-constraint in Pfaffian and second-order form: A q' = c and A q'' = b, (5)-(8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import sympy as sp
from pfaffian.derive.spec.model_spec import TIME, Matrix, ModelSpec
from pfaffian.derive.spec.source_line import about_constraint
from pfaffian.runtime.base.errors import InputError

if TYPE_CHECKING:
    from pfaffian.derive.mechanics.dynamics import Dynamics


#: Digits in which dependence is decided at a point with nothing special about it.
_DIGITS, _NOTHING = 50, sp.Float("1e-30")


@dataclass(frozen=True)
class Constraint:
    """A (m, n) and b (m, 1) of A q'' = b; s (m, 1); drift (m, 1) with s' + drift = 0.

    `free_motion` (m, 1) is what s' holds besides A q'': (ds/dq) q' + ds/dt.
    """

    jacobian: sp.Matrix
    acceleration: sp.Matrix
    residual: sp.Matrix
    drift: sp.Matrix
    free_motion: sp.Matrix


def servo_constraint(spec: ModelSpec) -> Constraint:
    """Differentiate the residual s of `spec` once: A = ds/dq', b = -(ds/dq) q' - ds/dt - drift.

    Raises `InputError` where their number is not that of the actuators, a residual contains an
    acceleration, or one of them follows from, or contradicts, those before it.
    """
    given, names = spec.constraint, _names(spec)
    q, dq = sp.Matrix(spec.positions), sp.Matrix(spec.velocities)
    residual = sp.Matrix(given.residual)
    if len(residual) != len(spec.actuators):
        raise InputError(
            f"model {spec.name}: {len(residual)} servo-constraints ({', '.join(names)}) for "
            f"{len(spec.actuators)} actuators",
            remedy="give one constraint for each actuator, so that ADB is square",
            about="residual",
        )
    faster = {c.acceleration for c in spec.coordinates} & residual.free_symbols
    if faster:
        first = min(s.name for s in faster)
        name = next(n for n, s in zip(names, residual, strict=True) if s.free_symbols & faster)
        raise InputError(
            f"model {spec.name}: the servo-constraint {name} contains the acceleration {first}",
            remedy="give it as a second-order constraint (residuals.second_order)",
            about=about_constraint(name),
        )
    jacobian = residual.jacobian(dq)
    drift = given.drift.xreplace(dict(zip(given.residual_symbols, residual, strict=True)))
    # A may depend on q, so its own derivative belongs to b as well: (ds/dq) q' covers both.
    free_motion = residual.jacobian(q) * dq + residual.diff(TIME)
    constraint = Constraint(
        jacobian=Matrix(jacobian),
        acceleration=Matrix(-free_motion - sp.Matrix(drift)),
        residual=Matrix(residual),
        drift=Matrix(drift),
        free_motion=Matrix(free_motion),
    )
    _check_rows(spec, constraint)
    return constraint


def _names(spec: ModelSpec) -> list[str]:
    return [s.name for s in spec.constraint.residual_symbols]


def generic_point(*matrices: sp.Matrix) -> dict[sp.Symbol, sp.Rational]:
    """Return a rational value for each symbol, with nothing special about it."""
    symbols = sorted(set().union(*(m.free_symbols for m in matrices)), key=lambda s: s.name)
    return {s: sp.Rational(sp.prime(k + 5), sp.prime(k + 6)) for k, s in enumerate(symbols)}


def _check_rows(spec: ModelSpec, constraint: Constraint) -> None:
    """Raise `InputError` for a row of A that the rows before it span, saying which ones."""
    names = _names(spec)
    point = generic_point(constraint.jacobian, constraint.acceleration)
    rows = constraint.jacobian.subs(point).evalf(_DIGITS)
    for r in range(rows.rows):
        if all(abs(x) <= _NOTHING for x in rows[r, :]):
            moves = constraint.residual[r].has(*spec.positions)
            raise InputError(
                f"model {spec.name}: the servo-constraint {names[r]} does not depend on the "
                f"velocities: its row of A is zero",
                remedy="a constraint on positions is holonomic: give it as such, and it is "
                "differentiated"
                if moves
                else "write it in the coordinates and their velocities",
                about=about_constraint(names[r]),
            )
        weights = _combination(rows[:r, :], rows[r, :])
        if weights is None:
            continue
        used = [k for k, w in enumerate(weights) if abs(w) > _NOTHING]
        others = " and ".join(names[k] for k in used)
        raise InputError(
            f"model {spec.name}: the servo-constraint {names[r]} "
            + (
                f"is redundant: it follows from {others}"
                if _follows(spec, constraint, point, weights, r)
                else f"is inconsistent with {others}: it wants other accelerations of the same "
                f"combination of coordinates"
            ),
            remedy="leave it out, and give one that says something new",
            about=about_constraint(names[r]),
        )


def _follows(
    spec: ModelSpec,
    constraint: Constraint,
    point: Mapping[sp.Symbol, sp.Rational],
    weights: Sequence[sp.Expr],
    row: int,
) -> bool:
    """Return whether the rows before it meet constraint `row`, whose A they span by `weights`.

    Where they stabilise s themselves, constraints of first order are met with their s: b may still
    differ, as the arctan of (2) is not linear. One of second order is met with its b.
    """
    own = {*spec.positions, *spec.velocities}
    used = [row, *(k for k, w in enumerate(weights) if abs(w) > _NOTHING)]
    first = not any(spec.constraint.drift[k].free_symbols & own for k in used)
    for values in (
        (constraint.residual, constraint.acceleration) if first else (constraint.acceleration,)
    ):
        right = values.subs(point).evalf(_DIGITS)
        left = right[row] - sum(w * right[k] for k, w in enumerate(weights))
        if abs(left) <= max(abs(right[row]), sp.Float(1)) * _NOTHING:
            return True
    return False


def _combination(earlier: sp.Matrix, row: sp.Matrix) -> list[sp.Expr] | None:
    """Return w with w `earlier` = `row`, or nothing if there is none."""
    if earlier.rows == 0:
        return None
    normal = earlier * earlier.T  # regular: the earlier rows have passed this test
    weights = normal.LUsolve(earlier * row.T)
    rest = row - weights.T * earlier
    size = max(abs(x) for x in row)
    return list(weights) if all(abs(x) <= size * _NOTHING for x in rest) else None


def check_input_gain(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> None:
    """Raise `InputError` where ADB is singular everywhere, naming the constraint at fault."""
    names = _names(spec)
    matrices = (dynamics.mass_matrix, dynamics.input_matrix, constraint.jacobian)
    point: Mapping[sp.Symbol, sp.Rational] = generic_point(*matrices)
    mass, b, a = (m.subs(point).evalf(_DIGITS) for m in matrices)
    gain = a * mass.LUsolve(b)
    for r, name in enumerate(names):
        if all(abs(x) <= _NOTHING for x in gain[r, :]):
            raise InputError(
                f"model {spec.name}: ADB is identically zero, the actuators do not move "
                + (name if len(names) == 1 else f"s: no actuator moves {name}"),
                remedy="choose a servo-constraint that the actuators reach; differentiate it once "
                "more if they act on its rate",
                about=about_constraint(name),
            )
    if abs(gain.det()) <= _NOTHING:
        raise InputError(
            f"model {spec.name}: ADB is singular everywhere: the actuators move "
            f"{', '.join(names)} only together",
            remedy="choose servo-constraints that the actuators move apart",
            about=about_constraint(names[-1]),
        )
