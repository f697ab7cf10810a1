"""The derivation stage: a model specification in, everything symbolic about it out."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.block import Block, BlockBuilder
from pfaffian.derive.constraint import Constraint, check_input_gain, servo_constraint
from pfaffian.derive.continuous_law import continuous_law
from pfaffian.derive.control_terms import (
    LawUnits,
    define_dynamics,
    define_trigonometry,
    take_measurement,
    take_parameters,
)
from pfaffian.derive.cyclic import cyclic_blocks
from pfaffian.derive.definiteness import MASS_MATRIX
from pfaffian.derive.dimensions import dimension_of, force_unit
from pfaffian.derive.following_law import following_law
from pfaffian.derive.forms import grouped
from pfaffian.derive.hurwitz import HurwitzConditions, hurwitz_blocks, hurwitz_conditions
from pfaffian.derive.identities import Identity, prove_identities
from pfaffian.derive.lagrange import Dynamics, lagrangian_dynamics
from pfaffian.derive.linear_solve import SMALL, define_factors, determinant
from pfaffian.derive.linearisation import linearisation_blocks
from pfaffian.derive.normal_form import trigonometric_sum
from pfaffian.derive.sampled_law import prepared_values, sampled_law
from pfaffian.derive.spec import TIME, Matrix, ModelSpec, symbol_of
from pfaffian.derive.swing_up import check_swing_up, swing_up_blocks, swing_up_identities
from pfaffian.derive.zero_dynamics import ZeroDynamics, zero_dynamics
from pfaffian.runtime.errors import InputError
from pfaffian.runtime.quantity import unit_registry


@dataclass(frozen=True)
class Decomposition:
    """F = B Fhat + dF of (9)-(11) for a free F: Fhat (m, 1) and dF (n, 1) in `force`."""

    force: sp.Matrix
    matched: sp.Matrix
    mismatched: sp.Matrix


@dataclass(frozen=True)
class Derivation:
    """All that follows from a specification, in SymPy; `blocks` are what is lowered.

    `input_gain` is ADB, or its determinant where there are several actuators.
    """

    spec: ModelSpec
    dynamics: Dynamics
    constraint: Constraint
    input_gain: sp.Expr
    decomposition: Decomposition
    zero_dynamics: ZeroDynamics
    hurwitz: HurwitzConditions
    identities: tuple[Identity, ...]
    blocks: tuple[Block, ...]

    def block(self, name: str) -> Block:
        """Return the block called `name`."""
        return next(b for b in self.blocks if b.name == name)


def derive(spec: ModelSpec) -> Derivation:
    """Derive `spec`. Raises `InputError` where the specification is at fault."""
    check_dimensions(spec)
    check_swing_up(spec)
    dynamics = lagrangian_dynamics(spec)
    constraint = servo_constraint(spec)
    check_input_gain(spec, dynamics, constraint)
    zeros = zero_dynamics(spec, dynamics, constraint)
    hurwitz = hurwitz_conditions(spec, zeros)
    follow = following_law(spec, dynamics)
    return Derivation(
        spec=spec,
        dynamics=dynamics,
        constraint=constraint,
        input_gain=_input_gain_expression(spec, dynamics, constraint),
        decomposition=_decompose(spec, dynamics, constraint),
        zero_dynamics=zeros,
        hurwitz=hurwitz,
        identities=(
            *prove_identities(spec, dynamics, constraint),
            *swing_up_identities(spec, dynamics),
        ),
        blocks=(
            sampled_law(spec, dynamics, constraint),
            prepared_values(spec),
            *([follow] if follow else []),
            continuous_law(spec, dynamics, constraint),
            _acceleration(spec, dynamics),
            _energy(spec, dynamics),
            _input_gain(spec, dynamics, constraint),
            *_design_blocks(spec, dynamics, constraint, zeros),
            *hurwitz_blocks(spec, zeros, hurwitz),
            *linearisation_blocks(spec, dynamics, constraint),
            *swing_up_blocks(spec, dynamics),
        ),
    )


def check_dimensions(spec: ModelSpec) -> None:
    """Raise `InputError` unless T and V are energies and each lumped parameter has its unit."""
    units = {p.name: p.unit for p in spec.parameters}
    for c in spec.coordinates:
        units |= {c.name: c.unit, c.velocity.name: f"{c.unit}/s"}
    registry = unit_registry()
    wanted = [
        ("kinetic energy", spec.kinetic_energy, "J", "kinetic_energy"),
        ("potential energy", spec.potential_energy, "J", "potential_energy"),
    ]
    wanted += [(s.name, combination, units[s.name], s.name) for s, combination in spec.lumping]
    for what, expression, unit, field in wanted:
        where = f"model {spec.name}: {what}"
        if expression == 0:
            continue  # nothing at all is an energy too
        try:
            have = dimension_of(expression, units, where)
        except InputError as error:
            error.about = f"{error.about} {field}"
            raise
        if have != registry.parse_units(unit).dimensionality:
            raise InputError(
                f"{where} has dimension {have}, but {unit} is needed",
                remedy="mend the unit of one of its symbols",
                about=field,
            )


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


def _input_gain_expression(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> sp.Expr:
    rows, det = _constraint_rows(spec, dynamics, constraint)
    scaled = rows * dynamics.input_matrix
    return sp.factor(trigonometric_sum(scaled.det())) / det**scaled.rows


def _decompose(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> Decomposition:
    n = dynamics.mass_matrix.rows
    force = Matrix([spec.own_symbol(f"f{i + 1}") for i in range(n)])
    rows, _ = _constraint_rows(spec, dynamics, constraint)
    gain = rows * dynamics.input_matrix
    matched = (gain.adjugate() * rows * force / gain.det()).applyfunc(sp.factor)
    mismatched = (force - dynamics.input_matrix * matched).applyfunc(sp.factor)
    return Decomposition(force, Matrix(matched), Matrix(mismatched))


def _acceleration(spec: ModelSpec, dynamics: Dynamics) -> Block:
    """q'' = M^-1 (B tau - C q' - G - F): the plant that is simulated."""
    builder = BlockBuilder("acceleration", f"{spec.title}: forward dynamics, (1)", spec.own)
    take_measurement(builder, spec)
    torques = sp.Matrix(
        [
            builder.take(sp.Symbol(a.name, real=True), a.unit, a.description, "torque")
            for a in spec.actuators
        ]
    )
    take_parameters(builder, spec, "lumped", "plant", "uncertainty")
    _, solver, bias = define_dynamics(builder, spec, dynamics)
    applied = dynamics.input_matrix * torques - bias - dynamics.uncertain_force
    forces = [
        builder.define(
            f"force{i + 1}", applied[i], "row of B tau - C q' - G - F", force_unit(c.unit)
        )
        for i, c in enumerate(spec.coordinates)
    ]
    units = [f"{c.unit}/s^2" for c in spec.coordinates]
    solved = solver.define_solution(sp.Matrix(forces), "solved", "acceleration", units)
    for c, unit, value in zip(spec.coordinates, units, solved, strict=True):
        builder.give(c.acceleration.name, value, unit, f"acceleration of {c.name}")
    return builder.build()


def _energy(spec: ModelSpec, dynamics: Dynamics) -> Block:
    builder = BlockBuilder("energy", f"{spec.title}: total energy", spec.own)
    take_measurement(builder, spec)
    take_parameters(builder, spec, "lumped", "plant")
    forms = (dynamics.kinetic_form, dynamics.potential_form)
    named = define_trigonometry(builder, forms)
    kinetic, potential = (
        builder.define(name, form.xreplace(named), text, "J")
        for name, form, text in zip(("kinetic", "potential"), forms, ("T", "V"), strict=True)
    )
    builder.give("energy", kinetic + potential, "J", "T + V")
    return builder.build()


def _input_gain(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> Block:
    builder = BlockBuilder("input_gain", f"{spec.title}: ADB, (10)", spec.own)
    take_measurement(builder, spec)
    take_parameters(builder, spec, "lumped", "plant", "synthesised")
    _, solver, _ = define_dynamics(builder, spec, dynamics)
    units, m = LawUnits(spec), constraint.jacobian.rows
    rows = [
        solver.define_row(constraint.jacobian[r, :], f"row{r + 1}_", "", [""] * len(spec.positions))
        for r in range(m)
    ]
    gain = sp.Matrix(rows) * dynamics.input_matrix
    text = "input gain of the constraint, (10)" if m == 1 else "determinant of ADB, (10)"
    builder.give("adb", gain.det(), units.adb if m == 1 else units.adb_det, text)
    return builder.build()


def _design_blocks(
    spec: ModelSpec, dynamics: Dynamics, constraint: Constraint, zeros: ZeroDynamics
) -> tuple[Block, ...]:
    """Blocks that judge a parameter set: they are evaluated when one is read, never emitted."""
    return tuple(
        block
        for block in (
            _lumping(spec),
            _setpoint(spec),
            _minors(spec, dynamics),
            _mass_matrix(spec, dynamics),
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


def _mass_matrix(spec: ModelSpec, dynamics: Dynamics) -> Block:
    """Give the upper triangle of M, row by row: what is judged where its minors vanish."""
    builder = BlockBuilder(MASS_MATRIX, f"{spec.title}: M")
    take_measurement(builder, spec)
    take_parameters(builder, spec, "lumped", "plant")
    n, mass = len(spec.coordinates), dynamics.mass_matrix
    for i, j in ((r, c) for r in range(n) for c in range(r, n)):
        value = grouped(mass[i, j], spec.positions)
        builder.give(f"m_{i + 1}_{j + 1}", value, "", f"M, row {i + 1}, column {j + 1}")
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
