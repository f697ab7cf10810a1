"""The plant and the constraint linearised at the setpoint, and the gains a given row determines.

At the setpoint at rest, with x = (q - q_d, q'), the plant reads M x2' + D x2 + K x1 = B tau and
the residual s = S0 x1 + S1 x2. A wanted row (r0, r1) of s = r0 x1 + r1 x2 (such as B^T P of
a Riccati equation) is matched up to its scale by the gains of the model's own residual.
"""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.mechanics.block_terms import take_parameters
from pfaffian.derive.mechanics.constraint import Constraint
from pfaffian.derive.mechanics.dynamics import Dynamics
from pfaffian.derive.spec.model_spec import TIME, Matrix, ModelSpec, symbol_of
from pfaffian.derive.symbolic.block import Block, BlockBuilder


@dataclass(frozen=True)
class Linearisation:
    """M, D, K (n, n), B (n, m) at the setpoint at rest; S0, S1 (m, n) of the residual there.

    K includes the input matrix's own slope under the torque that holds the setpoint.
    """

    mass: sp.Matrix
    damping: sp.Matrix
    stiffness: sp.Matrix
    input: sp.Matrix
    position_row: sp.Matrix
    rate_row: sp.Matrix


def linearise(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> Linearisation:
    """Linearise (1) and the residual (3) of `spec` at its setpoint, frozen at time 0."""
    q, dq = sp.Matrix(spec.positions), sp.Matrix(spec.velocities)
    at_rest = dict(zip(spec.positions, spec.constraint.setpoint, strict=True))
    at_rest |= dict.fromkeys([*spec.velocities, TIME], sp.S.Zero)
    b = sp.Matrix(dynamics.input_matrix)
    held = ((b.T * b).inv() * b.T * dynamics.gravity).subs(at_rest)
    return Linearisation(
        mass=Matrix(dynamics.mass_matrix.subs(at_rest)),
        damping=Matrix(dynamics.uncertain_force.jacobian(dq).subs(at_rest)),
        stiffness=Matrix((dynamics.gravity - b * held).jacobian(q).subs(at_rest)),
        input=Matrix(b.subs(at_rest)),
        position_row=Matrix(constraint.residual.jacobian(q).subs(at_rest)),
        rate_row=Matrix(constraint.residual.jacobian(dq).subs(at_rest)),
    )


def linearisation_blocks(
    spec: ModelSpec, dynamics: Dynamics, constraint: Constraint
) -> tuple[Block, ...]:
    """Return the blocks `linearisation` and, where a row determines the gains, `row_gains`."""
    linear = linearise(spec, dynamics, constraint)
    builder = BlockBuilder(
        "linearisation", f"{spec.title}: linearised at the setpoint, at rest", spec.own
    )
    take_parameters(builder, spec, "lumped", "plant", "synthesised", "gain", "uncertainty")
    for letter, matrix, text in (
        ("mass", linear.mass, "M"),
        ("damping", linear.damping, "dF/dq'"),
        ("stiffness", linear.stiffness, "d(G - B tau)/dq"),
        ("input", linear.input, "B"),
        ("position_row", linear.position_row, "ds/dq"),
        ("rate_row", linear.rate_row, "ds/dq'"),
    ):
        for i in range(matrix.rows):
            for j in range(matrix.cols):
                name = f"{letter}_{i + 1}_{j + 1}"
                builder.give(name, matrix[i, j], "", f"{text}, row {i + 1}, column {j + 1}")
    matching = _row_gains(spec, linear)
    return (builder.build(), matching) if matching else (builder.build(),)


def _row_gains(spec: ModelSpec, linear: Linearisation) -> Block | None:
    """Solve (S0, S1) = scale (r0, r1) for the synthesised gains, or return nothing.

    There is no such block for several inputs, or where the residual has fewer gains than a row
    has directions: then not every row can be met.
    """
    gains = [symbol_of(p) for p in spec.parameters_in("synthesised")]
    n = len(spec.coordinates)
    if len(spec.actuators) != 1 or not gains:
        return None
    wanted = [
        spec.own_symbol(f"{base}_{i + 1}")
        for base in ("row_position", "row_rate")
        for i in range(n)
    ]
    scale = spec.own_symbol("row_scale")
    own = [*linear.position_row, *linear.rate_row]
    equations = [have - scale * want for have, want in zip(own, wanted, strict=True)]
    solutions = sp.solve(equations, [*gains, scale], dict=True)
    if len(solutions) != 1 or any(g not in solutions[0] for g in gains):
        return None
    builder = BlockBuilder("row_gains", f"{spec.title}: gains from a row of the residual", spec.own)
    for symbol in wanted:
        builder.take(symbol, "", "entry of the wanted row, up to a common scale", "input")
    take_parameters(builder, spec, "lumped", "plant", "gain")
    declared = {p.name: p for p in spec.parameters}
    for gain in gains:
        parameter = declared[gain.name]
        value = sp.factor(solutions[0][gain])
        builder.give(gain.name, value, parameter.unit, parameter.description, "parameter")
    return builder.build()
