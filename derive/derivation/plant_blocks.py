"""Blocks that describe the plant: acceleration, energy, input gain."""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.ir.names import MASS_MATRIX
from pfaffian.derive.law.terms import LawUnits
from pfaffian.derive.mechanics.block_terms import (
    define_dynamics,
    define_trigonometry,
    take_measurement,
    take_parameters,
)
from pfaffian.derive.mechanics.constraint import Constraint
from pfaffian.derive.mechanics.dynamics import Dynamics
from pfaffian.derive.spec.model_spec import ModelSpec
from pfaffian.derive.symbolic.block import Block, BlockBuilder
from pfaffian.derive.symbolic.forms import grouped
from pfaffian.derive.symbolic.units import force_unit


def acceleration_block(spec: ModelSpec, dynamics: Dynamics) -> Block:
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


def energy_block(spec: ModelSpec, dynamics: Dynamics) -> Block:
    """Give T + V in joules, with T and V as named definitions."""
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


def input_gain_block(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> Block:
    """Give ADB of (10), or its determinant for several actuators."""
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


def mass_matrix_block(spec: ModelSpec, dynamics: Dynamics) -> Block:
    """Give the upper triangle of M, row by row: what is judged where its minors vanish."""
    builder = BlockBuilder(MASS_MATRIX, f"{spec.title}: M")
    take_measurement(builder, spec)
    take_parameters(builder, spec, "lumped", "plant")
    n, mass = len(spec.coordinates), dynamics.mass_matrix
    for i, j in ((r, c) for r in range(n) for c in range(r, n)):
        value = grouped(mass[i, j], spec.positions)
        builder.give(f"m_{i + 1}_{j + 1}", value, "", f"M, row {i + 1}, column {j + 1}")
    return builder.build()
