"""The derivation stage: a model specification in, everything symbolic about it out."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.block import Block, BlockBuilder
from pfaffian.derive.constraint import Constraint, servo_constraint
from pfaffian.derive.continuous_law import continuous_law
from pfaffian.derive.control_terms import (
    LawUnits,
    define_dynamics,
    define_trigonometry,
    take_measurement,
    take_parameters,
)
from pfaffian.derive.dimensions import dimension_of, force_unit
from pfaffian.derive.hurwitz import HurwitzConditions, hurwitz_blocks, hurwitz_conditions
from pfaffian.derive.identities import Identity, prove_identities
from pfaffian.derive.lagrange import Dynamics, lagrangian_dynamics
from pfaffian.derive.linearisation import linearisation_blocks
from pfaffian.derive.normal_form import trigonometric_sum
from pfaffian.derive.sampled_law import prepared_values, sampled_law
from pfaffian.derive.spec import Matrix, ModelSpec, symbol_of
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
    dynamics = lagrangian_dynamics(spec)
    constraint = servo_constraint(spec)
    zeros = zero_dynamics(spec, dynamics, constraint)
    hurwitz = hurwitz_conditions(spec, zeros)
    ad = constraint.jacobian * dynamics.mass_matrix.adjugate()
    scaled, det = ad * dynamics.input_matrix, sp.expand(dynamics.mass_matrix.det())
    input_gain = sp.factor(trigonometric_sum(scaled.det())) / det**scaled.rows
    return Derivation(
        spec=spec,
        dynamics=dynamics,
        constraint=constraint,
        input_gain=input_gain,
        decomposition=_decompose(dynamics, constraint),
        zero_dynamics=zeros,
        hurwitz=hurwitz,
        identities=prove_identities(spec, dynamics, constraint),
        blocks=(
            sampled_law(spec, dynamics, constraint),
            prepared_values(spec),
            continuous_law(spec, dynamics, constraint),
            _acceleration(spec, dynamics),
            _energy(spec, dynamics),
            _input_gain(spec, dynamics, constraint),
            *_design_blocks(spec, dynamics, zeros),
            *hurwitz_blocks(spec, zeros, hurwitz),
            *linearisation_blocks(spec, dynamics, constraint),
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


def _decompose(dynamics: Dynamics, constraint: Constraint) -> Decomposition:
    n = dynamics.mass_matrix.rows
    force = Matrix(sp.symbols(f"f1:{n + 1}", real=True))
    ad = constraint.jacobian * dynamics.mass_matrix.adjugate()
    matched = ((ad * dynamics.input_matrix).inv() * ad * force).applyfunc(sp.factor)
    mismatched = (force - dynamics.input_matrix * matched).applyfunc(sp.factor)
    return Decomposition(force, Matrix(matched), Matrix(mismatched))


def _acceleration(spec: ModelSpec, dynamics: Dynamics) -> Block:
    """q'' = M^-1 (B tau - C q' - G - F): the plant that is simulated."""
    builder = BlockBuilder("acceleration", f"{spec.title}: forward dynamics, (1)")
    take_measurement(builder, spec)
    torques = sp.Matrix(
        [
            builder.take(sp.Symbol(a.name, real=True), a.unit, a.description, "torque")
            for a in spec.actuators
        ]
    )
    take_parameters(builder, spec, "lumped", "plant", "uncertainty")
    mass, det, bias = define_dynamics(builder, spec, dynamics)
    applied = dynamics.input_matrix * torques - bias - dynamics.uncertain_force
    forces = sp.Matrix(
        [
            builder.define(
                f"force{i + 1}",
                applied[i],
                "row of B tau - C q' - G - F",
                force_unit(spec.coordinates[i].unit),
            )
            for i in range(len(spec.coordinates))
        ]
    )
    for c, row in zip(spec.coordinates, mass.adjugate() * forces, strict=True):
        builder.give(f"dd{c.name}", row / det, f"{c.unit}/s^2", f"acceleration of {c.name}")
    return builder.build()


def _energy(spec: ModelSpec, dynamics: Dynamics) -> Block:
    builder = BlockBuilder("energy", f"{spec.title}: total energy")
    take_measurement(builder, spec)
    take_parameters(builder, spec, "lumped", "plant")
    mass, _, _ = define_dynamics(builder, spec, dynamics)
    rates = sp.Matrix(spec.velocities)
    kinetic = builder.define("kinetic", (rates.T * mass * rates)[0] / 2, "q'^T M q'/2", "J")
    named = define_trigonometry(builder, [dynamics.potential_energy])
    potential = builder.define("potential", dynamics.potential_energy.xreplace(named), "V", "J")
    builder.give("energy", kinetic + potential, "J", "T + V")
    return builder.build()


def _input_gain(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> Block:
    builder = BlockBuilder("input_gain", f"{spec.title}: ADB, (10)")
    take_measurement(builder, spec)
    take_parameters(builder, spec, "lumped", "plant", "synthesised")
    mass, det, _ = define_dynamics(builder, spec, dynamics)
    scaled = constraint.jacobian * mass.adjugate() * dynamics.input_matrix
    units, single = LawUnits(spec), scaled.rows == 1
    adb = scaled[0] / det if single else scaled.det() / det**scaled.rows
    text = "input gain of the constraint, (10)" if single else "determinant of ADB, (10)"
    builder.give("adb", adb, units.adb if single else units.adb_det, text)
    return builder.build()


def _design_blocks(spec: ModelSpec, dynamics: Dynamics, zeros: ZeroDynamics) -> tuple[Block, ...]:
    """Blocks that judge a parameter set: they are evaluated when one is read, never emitted."""
    return tuple(
        block
        for block in (
            _lumping(spec),
            _setpoint(spec),
            _minors(spec, dynamics),
            _rest_force(spec, dynamics),
            _polynomial(spec, zeros),
            _synthesis(spec, zeros),
            _conditions(spec),
        )
        if block is not None
    )


def _lumping(spec: ModelSpec) -> Block | None:
    if not spec.lumping:
        return None
    builder = BlockBuilder("lumping", f"{spec.title}: lumped parameters")
    take_parameters(builder, spec, "physical")
    declared = {symbol_of(p): p for p in spec.parameters}
    for symbol, combination in spec.lumping:
        parameter = declared[symbol]
        builder.give(symbol.name, combination, parameter.unit, parameter.description, "parameter")
    return builder.build()


def _setpoint(spec: ModelSpec) -> Block:
    builder = BlockBuilder("setpoint", f"{spec.title}: setpoint")
    take_parameters(builder, spec, "lumped", "plant", "gain")
    for c, value in zip(spec.coordinates, spec.constraint.setpoint, strict=True):
        builder.give(c.name, value, c.unit, f"setpoint of {c.name}")
    return builder.build()


def _minors(spec: ModelSpec, dynamics: Dynamics) -> Block:
    builder = BlockBuilder("mass_minors", f"{spec.title}: leading principal minors of M")
    take_measurement(builder, spec)
    take_parameters(builder, spec, "lumped", "plant")
    for k in range(1, len(spec.coordinates) + 1):
        builder.give(f"minor{k}", dynamics.mass_matrix[:k, :k].det(), "", f"minor of order {k}")
    return builder.build()


def _rest_force(spec: ModelSpec, dynamics: Dynamics) -> Block:
    """Gravity at the setpoint that no actuator reaches: zero where the setpoint can be held."""
    builder = BlockBuilder("rest_force", f"{spec.title}: unactuated gravity at the setpoint")
    take_parameters(builder, spec, "lumped", "plant", "gain")
    at_rest = dict(zip(spec.positions, spec.constraint.setpoint, strict=True))
    b = dynamics.input_matrix
    left = (sp.eye(b.rows) - b * (b.T * b).inv() * b.T) * dynamics.gravity
    for i, entry in enumerate(left.subs(at_rest)):
        builder.give(
            f"rest_force{i + 1}", entry, force_unit(spec.coordinates[i].unit), f"row {i + 1}"
        )
    return builder.build()


def _polynomial(spec: ModelSpec, zeros: ZeroDynamics) -> Block:
    builder = BlockBuilder("zero_polynomial", f"{spec.title}: zero dynamics at the setpoint")
    take_parameters(builder, spec, "lumped", "plant", "synthesised", "gain", "uncertainty")
    degree = len(zeros.coefficients) - 1
    for k, coefficient in enumerate(zeros.coefficients):
        builder.give(f"a{degree - k}", coefficient, "", f"coefficient of p^{degree - k}")
    return builder.build()


def _synthesis(spec: ModelSpec, zeros: ZeroDynamics) -> Block | None:
    if not zeros.gains:
        return None
    builder = BlockBuilder("gain_synthesis", f"{spec.title}: gains from zero-dynamics poles")
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
    builder = BlockBuilder("stability", f"{spec.title}: closed-form stability conditions")
    take_parameters(builder, spec, "lumped", "plant", "synthesised", "gain")
    for k, condition in enumerate(spec.stability):
        builder.give(f"margin{k + 1}", condition.margin, "", condition.text)
    return builder.build()
