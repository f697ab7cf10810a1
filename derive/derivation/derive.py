"""The derivation stage: a model specification in, everything symbolic about it out."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.derivation.decomposition import Decomposition, decompose, input_gain_expression
from pfaffian.derive.derivation.plant_blocks import (
    acceleration_block,
    energy_block,
    input_gain_block,
)
from pfaffian.derive.derivation.set_blocks import design_blocks
from pfaffian.derive.law.continuous import continuous_law
from pfaffian.derive.law.following import following_law
from pfaffian.derive.law.sampled import prepared_values, sampled_law
from pfaffian.derive.law.swing_up import check_swing_up, swing_up_blocks, swing_up_identities
from pfaffian.derive.mechanics.constraint import Constraint, check_input_gain, servo_constraint
from pfaffian.derive.mechanics.dynamics import Dynamics
from pfaffian.derive.mechanics.hurwitz import HurwitzConditions, hurwitz_blocks, hurwitz_conditions
from pfaffian.derive.mechanics.identities import Identity, prove_identities
from pfaffian.derive.mechanics.lagrange import lagrangian_dynamics
from pfaffian.derive.mechanics.linearisation import linearisation_blocks
from pfaffian.derive.mechanics.zero_dynamics import ZeroDynamics, zero_dynamics
from pfaffian.derive.spec.check_dimensions import check_dimensions
from pfaffian.derive.spec.model_spec import ModelSpec
from pfaffian.derive.symbolic.block import Block


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
        input_gain=input_gain_expression(spec, dynamics, constraint),
        decomposition=decompose(spec, dynamics, constraint),
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
            acceleration_block(spec, dynamics),
            energy_block(spec, dynamics),
            input_gain_block(spec, dynamics, constraint),
            *design_blocks(spec, dynamics, constraint, zeros),
            *hurwitz_blocks(spec, zeros, hurwitz),
            *linearisation_blocks(spec, dynamics, constraint),
            *swing_up_blocks(spec, dynamics),
        ),
    )
