"""Blocks that judge or complete a parameter set."""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.derivation.plant_blocks import mass_matrix_block
from pfaffian.derive.law.terms import LawUnits
from pfaffian.derive.mechanics.block_terms import (
    define_trigonometry,
    take_measurement,
    take_parameters,
)
from pfaffian.derive.mechanics.constraint import Constraint
from pfaffian.derive.mechanics.cyclic import cyclic_blocks
from pfaffian.derive.mechanics.dynamics import SMALL, Dynamics
from pfaffian.derive.mechanics.mass_solver import define_factors
from pfaffian.derive.mechanics.zero_dynamics import ZeroDynamics
from pfaffian.derive.spec.model_spec import TIME, ModelSpec, symbol_of
from pfaffian.derive.symbolic.block import Block, BlockBuilder
from pfaffian.derive.symbolic.units import force_unit


def design_blocks(
    spec: ModelSpec, dynamics: Dynamics, constraint: Constraint, zeros: ZeroDynamics
) -> tuple[Block, ...]:
    """Blocks that judge a parameter set: they are evaluated when one is read, never emitted."""
    return tuple(
        block
        for block in (
            _lumping(spec),
            _setpoint(spec),
            _minors(spec, dynamics),
            mass_matrix_block(spec, dynamics),
            _rest_force(spec, dynamics),
            _rest_constraint(spec, constraint),
            _rest_reference(spec),
            _polynomial(spec, zeros),
            *cyclic_blocks(spec, dynamics, zeros.cyclic, zeros.at_origin),
            _synthesis(spec, zeros),
            _conditions(spec),
        )
        if block is not None
    )


def _lumping(spec: ModelSpec) -> Block | None:
    if not spec.lumping:
        return None
    builder = BlockBuilder("lumping", f"{spec.title}: lumped parameters", spec.own)
    take_parameters(builder, spec, "physical")
    declared = {symbol_of(p): p for p in spec.parameters}
    for symbol, combination in spec.lumping:
        parameter = declared[symbol]
        builder.give(symbol.name, combination, parameter.unit, parameter.description, "parameter")
    return builder.build()


def _setpoint(spec: ModelSpec) -> Block:
    builder = BlockBuilder("setpoint", f"{spec.title}: setpoint", spec.own)
    take_parameters(builder, spec, "lumped", "plant", "gain")
    for c, value in zip(spec.coordinates, spec.constraint.setpoint, strict=True):
        builder.give(c.name, value, c.unit, f"setpoint of {c.name}")
    return builder.build()


def _minors(spec: ModelSpec, dynamics: Dynamics) -> Block:
    """Give the leading minors of M, or its pivots: all positive where M is positive definite."""
    builder = BlockBuilder("mass_minors", f"{spec.title}: minors or pivots of M", spec.own)
    take_measurement(builder, spec)
    take_parameters(builder, spec, "lumped", "plant")
    n = len(spec.coordinates)
    if n <= SMALL:
        for k in range(1, n + 1):
            builder.give(f"minor{k}", dynamics.mass_matrix[:k, :k].det(), "", f"minor of order {k}")
        return builder.build()
    named = define_trigonometry(builder, list(dynamics.mass_matrix))
    define_factors(builder, dynamics.mass_matrix.xreplace(named))
    for k in range(1, n + 1):
        builder.give(f"pivot{k}", spec.own_symbol(f"pivot{k}"), "", f"pivot of row {k}")
    return builder.build()


def _rest_force(spec: ModelSpec, dynamics: Dynamics) -> Block:
    """Gravity at the setpoint that no actuator reaches: zero where the setpoint can be held."""
    builder = BlockBuilder(
        "rest_force", f"{spec.title}: unactuated gravity at the setpoint", spec.own
    )
    take_parameters(builder, spec, "lumped", "plant", "gain")
    at_rest = dict(zip(spec.positions, spec.constraint.setpoint, strict=True))
    b = dynamics.input_matrix
    left = (sp.eye(b.rows) - b * (b.T * b).inv() * b.T) * dynamics.gravity
    for i, entry in enumerate(left.subs(at_rest)):
        builder.give(
            f"rest_force{i + 1}", entry, force_unit(spec.coordinates[i].unit), f"row {i + 1}"
        )
    return builder.build()


def _rest_constraint(spec: ModelSpec, constraint: Constraint) -> Block | None:
    """s and b at the setpoint at rest: zero where the constraint can stay there.

    There is none where they are zero in any case, as with a residual written in the errors, or
    vary with the time.
    """
    builder = BlockBuilder(
        "rest_constraint", f"{spec.title}: servo-constraint at the setpoint", spec.own
    )
    take_parameters(builder, spec, "lumped", "plant", "synthesised", "gain")
    at_rest = dict(zip(spec.positions, spec.constraint.setpoint, strict=True))
    at_rest |= dict.fromkeys(spec.velocities, sp.S.Zero)
    units, rows = LawUnits(spec), []
    for r, symbol in enumerate(spec.constraint.residual_symbols):
        b_text = f"the right-hand side of {symbol.name}'s A q'' = b"
        rows += [
            (constraint.residual[r], units.residuals[r], f"the residual {symbol.name}"),
            (constraint.acceleration[r], units.drifts[r], b_text),
        ]
    left = [(value.subs(at_rest), unit, text) for value, unit, text in rows]
    left = [row for row in left if row[0] != 0 and TIME not in row[0].free_symbols]
    for k, (value, unit, text) in enumerate(left):
        builder.give(f"rest{k + 1}", value, unit, text)
    return builder.build() if left else None


def _rest_reference(spec: ModelSpec) -> Block | None:
    """What is to vanish of the constraints on positions that move, at the setpoint at time 0."""
    moving = [phi for phi in spec.constraint.references if TIME in phi.free_symbols]
    if not moving:
        return None
    builder = BlockBuilder(
        "rest_reference", f"{spec.title}: moving constraints at time 0", spec.own
    )
    take_parameters(builder, spec, "lumped", "plant", "synthesised", "gain")
    at_rest = dict(zip(spec.positions, spec.constraint.setpoint, strict=True))
    at_rest |= dict.fromkeys([*spec.velocities, TIME], sp.S.Zero)
    for k, phi in enumerate(moving):
        builder.give(f"reference{k + 1}", phi.subs(at_rest), "", "zero where the reference begins")
    return builder.build()


def _polynomial(spec: ModelSpec, zeros: ZeroDynamics) -> Block:
    builder = BlockBuilder(
        "zero_polynomial", f"{spec.title}: zero dynamics at the setpoint", spec.own
    )
    take_parameters(builder, spec, "lumped", "plant", "synthesised", "gain", "uncertainty")
    for symbol, entry in zeros.entries:
        builder.define(symbol.name, entry, "entry of the linearisation")
    degree = len(zeros.coefficients) - 1
    for k, coefficient in enumerate(zeros.coefficients):
        builder.give(f"a{degree - k}", coefficient, "", f"coefficient of p^{degree - k}")
    return builder.build()


def _synthesis(spec: ModelSpec, zeros: ZeroDynamics) -> Block | None:
    if not zeros.gains:
        return None
    builder = BlockBuilder(
        "gain_synthesis", f"{spec.title}: gains from zero-dynamics poles", spec.own
    )
    for k, symbol in enumerate(zeros.wanted):
        builder.take(symbol, f"1/s^{k + 1}", "coefficient of the wanted polynomial", "input")
    take_parameters(builder, spec, "lumped", "plant", "gain")
    units = {p.name: p for p in spec.parameters}
    for gain, expression in zeros.gains:
        declared = units[gain.name]
        builder.give(gain.name, expression, declared.unit, declared.description, "parameter")
    return builder.build()


def _conditions(spec: ModelSpec) -> Block | None:
    if not spec.stability:
        return None
    builder = BlockBuilder("stability", f"{spec.title}: closed-form stability conditions", spec.own)
    take_parameters(builder, spec, "lumped", "plant", "synthesised", "gain")
    for k, condition in enumerate(spec.stability):
        builder.give(f"margin{k + 1}", condition.margin, "", condition.text)
    return builder.build()
