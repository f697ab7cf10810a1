"""The sampled law: the continuous one discretised implicitly, what the target runs.

Held for a period T, the law as printed diverges as soon as T kappa (ADB)^2 exceeds 2; the implicit
one never does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.law.terms import LawUnits, Shared, define_shared, give_parts, norm
from pfaffian.derive.mechanics.block_terms import real, take_measurement, take_parameters
from pfaffian.derive.mechanics.constraint import Constraint
from pfaffian.derive.mechanics.dynamics import Dynamics
from pfaffian.derive.spec.model_spec import ModelSpec
from pfaffian.derive.symbolic.block import Block, BlockBuilder
from pfaffian.derive.symbolic.functions import side
from pfaffian.derive.symbolic.units import unit_product
from sympy.codegen.cfunctions import expm1

#: Keeps the direction of bhat defined where bhat is zero; far below any value that matters.
_NO_LENGTH = sp.Rational(1, 2**500)
#: Keeps |e| and |e'| in Pi from 0 by 2^-60: their roots then need no special cases, and Pi a
#: derivative everywhere. It is less than the rounding of Pi >= 2.
LEAST_SQUARE = sp.Rational(1, 2**120)


@dataclass(frozen=True)
class _State:
    """Symbols of the controller's memory: offsets and drifts (m,), engaged, ahat, prepared.

    `previous` are the torques last commanded, (m,) with slew limits and none without.
    """

    engaged: sp.Symbol
    offsets: tuple[sp.Symbol, ...]
    drifts: tuple[sp.Symbol, ...]
    bound: sp.Symbol
    decay: sp.Symbol
    step: sp.Symbol
    previous: tuple[sp.Symbol, ...]


@dataclass(frozen=True)
class _Torque:
    """p1, p2, p3 and their sum (m,), and |bhat| after the period."""

    parts: tuple[tuple[sp.Symbol, ...], ...]
    total: tuple[sp.Symbol, ...]
    scaled_next: sp.Expr


def prepared_values(spec: ModelSpec) -> Block:
    """Return the values that depend on parameters alone: the exact leakage over one period."""
    law, units = spec.law, LawUnits(spec)
    builder = BlockBuilder(
        "prepare", f"{spec.title}: values computed once from the parameters", spec.own
    )
    take_parameters(builder, spec, "gain", "target")
    exponent = builder.define("exponent", -law.leakage_rate * law.sample_time, "-k2 T")
    builder.give(spec.own("leakage_decay"), sp.exp(exponent), "", "e^(-k2 T)", "prepared")
    builder.give(
        spec.own("adaptation_step"),
        -law.adaptation_rate * expm1(exponent) / law.leakage_rate,
        unit_product(
            *(
                (p.unit, 1)
                for p in spec.parameters
                if p.name in (law.adaptation_rate.name, law.sample_time.name)
            )
        ),
        "k1 (1 - e^(-k2 T))/k2",
        "prepared",
    )
    builder.give(
        spec.own("bound_estimate"), law.initial_bound, units.force, "ahat at the start", "state"
    )
    return builder.build()


def sampled_law(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> Block:
    """Return one period of the sampled law.

    beta advances by backward Euler under p2 + p3. With N = (ADB)^T ADB, x = bhat at the end of the
    period solves x + T N (kappa x + rho x/max(|x|, eps/rho)) = bhat, rho = ahat Pi. With one
    actuator the left side is the smaller of two straight lines in |x|, hence a closed form. With
    more, N is replaced by its trace: x then keeps the direction of bhat, the same closed form
    holds, and beta still contracts, since no eigenvalue of N exceeds the trace. The leakage law is
    solved exactly with x held, so that sampled and continuous law share their equilibria.
    """
    builder = BlockBuilder("step", f"{spec.title}: sampled control law, one period", spec.own)
    return complete_law(
        builder, spec, lambda: define_shared(builder, spec, dynamics, constraint, LEAST_SQUARE)
    )


def complete_law(builder: BlockBuilder, spec: ModelSpec, define: Callable[[], Shared]) -> Block:
    """Return one period of the law for what `define` defines of a constraint, in `builder`.

    Measurement, state and parameters are declared before `define` is called.
    """
    units = LawUnits(spec)
    take_measurement(builder, spec)
    state = _take_state(builder, spec, units)
    take_parameters(builder, spec, "lumped", "plant", "synthesised", "gain", "target")
    shared = define()
    moved = tuple(
        builder.define(
            name,
            sp.Piecewise(
                (offset + spec.law.sample_time * (before + drift) / 2, state.engaged > 0),
                (-s, True),
            ),
            "captured at engagement, then the trapezoidal integral of drift, (6)",
            unit,
        )
        for name, offset, before, drift, s, unit in zip(
            spec.own.numbered("offset"),
            state.offsets,
            state.drifts,
            shared.drift,
            shared.s,
            units.residuals,
            strict=True,
        )
    )
    beta = tuple(
        builder.define(name, s + z, "(21)", unit)
        for name, s, z, unit in zip(
            spec.own.numbered("beta"), shared.s, moved, units.residuals, strict=True
        )
    )
    torque = _define_torque(builder, spec, units, shared, beta, state.bound)
    commands, saturated = _limit_torque(builder, spec, torque.total, state.previous)
    _give_output(builder, spec, shared, beta, torque, commands, saturated)
    _give_state(builder, spec, state, shared, moved, torque, commands, saturated)
    return builder.build()


def _take_state(builder: BlockBuilder, spec: ModelSpec, units: LawUnits) -> _State:
    take = builder.take
    return _State(
        take(spec.own_symbol("engaged"), "", "1 once the law has been engaged", "state"),
        tuple(
            take(real(n), u, "beta - s, (21)", "state")
            for n, u in zip(spec.own.numbered("constraint_offset"), units.residuals, strict=True)
        ),
        tuple(
            take(real(n), u, "drift one period ago", "state")
            for n, u in zip(spec.own.numbered("drift_previous"), units.drifts, strict=True)
        ),
        take(spec.own_symbol("bound_estimate"), units.force, "ahat, (15)", "state"),
        take(spec.own_symbol("leakage_decay"), "", "e^(-k2 T)", "prepared"),
        take(spec.own_symbol("adaptation_step"), "", "k1 (1 - e^(-k2 T))/k2", "prepared"),
        tuple(
            take(real(spec.own.previous(a.name)), a.unit, f"{a.name} last commanded", "state")
            for a, _ in zip(spec.actuators, spec.law.slews, strict=bool(spec.law.slews))
        ),
    )


def _define_torque(
    builder: BlockBuilder,
    spec: ModelSpec,
    units: LawUnits,
    shared: Shared,
    beta: tuple[sp.Symbol, ...],
    bound: sp.Symbol,
) -> _Torque:
    """Define p1 with the singularity guard, and p2, p3 by backward Euler on beta."""
    define, law, m = builder.define, spec.law, len(spec.actuators)
    threshold = law.singular_threshold
    inverse = define(
        "adb_inverse",
        shared.adb_det / sp.Max(shared.adb_det**2, threshold**2),
        "1/ADB, and 0 where ADB = 0" if m == 1 else "1/det ADB, and 0 where det ADB = 0",
        unit_product((units.adb_det, -1)),
    )
    nominal = shared.adb.adjugate() * sp.Matrix(shared.demand)
    p1 = tuple(
        define(n, inverse * v, "(17)", u)
        for n, v, u in zip(spec.own.of_actuators("p1"), nominal, units.forces, strict=True)
    )
    scaled_value = shared.adb.T * sp.Matrix(beta)
    scaled = tuple(
        define(n, v, "(20)", units.scaled)
        for n, v in zip(spec.own.of_actuators("bhat"), scaled_value, strict=True)
    )
    effort = define("effort", bound * shared.regressor, "ahat Pi", units.force)
    square = sum(entry**2 for entry in shared.adb)
    rate = define("rate", law.sample_time * square, "T (ADB)^2" if m == 1 else "T tr(ADB^T ADB)")
    layer = define("layer", effort**2 / law.epsilon, "slope of p3 in bhat inside its layer, (23)")
    solve = _one_actuator if m == 1 else _several_actuators
    p2, p3, after = solve(builder, spec, units, scaled, effort, rate, layer)
    total = tuple(
        define(n, sp.Add(*parts), "(16)", u)
        for n, u, *parts in zip(
            spec.own.of_actuators("torque"), units.forces, p1, p2, p3, strict=True
        )
    )
    return _Torque((p1, p2, p3), total, after)


_Solved = tuple[tuple[sp.Symbol, ...], tuple[sp.Symbol, ...], sp.Expr]


def _one_actuator(
    builder: BlockBuilder,
    spec: ModelSpec,
    units: LawUnits,
    scaled: tuple[sp.Symbol, ...],
    effort: sp.Symbol,
    rate: sp.Symbol,
    layer: sp.Symbol,
) -> _Solved:
    """Solve the implicit step exactly: inside the layer of p3 unless that asks for more than rho.

    Each form is computed where it is used, so that no digits are lost inside the layer.
    """
    define, law, bhat = builder.define, spec.law, scaled[0]
    inside = define(
        "bhat_inside",
        bhat / (1 + rate * (law.kappa + layer)),
        "bhat after the period, inside the layer",
        units.scaled,
    )
    pull = define("p3_inside", layer * inside, "-p3 inside the layer", units.force)
    push = define(
        "p3_outside",
        side(bhat) * effort,
        "-p3 outside the layer",
        units.force,
    )
    outside = define(
        "bhat_outside",
        (bhat - rate * push) / (1 + rate * law.kappa),
        "bhat after the period, outside the layer",
        units.scaled,
    )
    beyond = sp.Abs(pull) > effort
    after = define(
        "bhat_next",
        sp.Piecewise((outside, beyond), (inside, True)),
        "bhat after the period",
        units.scaled,
    )
    p2 = define("p2", -law.kappa * after, "(18)", units.force)
    p3 = define("p3", -sp.Piecewise((push, beyond), (pull, True)), "(19), (23)", units.force)
    return (p2,), (p3,), sp.Abs(after)


def _several_actuators(
    builder: BlockBuilder,
    spec: ModelSpec,
    units: LawUnits,
    scaled: tuple[sp.Symbol, ...],
    effort: sp.Symbol,
    rate: sp.Symbol,
    layer: sp.Symbol,
) -> _Solved:
    """Solve the step along bhat: its length by the closed form, its direction kept."""
    define, law = builder.define, spec.law
    length = define(spec.own("bhat_length"), norm(scaled), "|bhat|", units.scaled)
    inside = define(
        "shrink_inside", 1 / (1 + rate * (law.kappa + layer)), "|x|/|bhat| in the layer"
    )
    guarded = define(
        spec.own("bhat_length_guarded"),
        sp.Max(length, _NO_LENGTH),
        "|bhat|, never zero",
        units.scaled,
    )
    outside = define(
        "shrink_outside",
        (1 - rate * effort / guarded) / (1 + rate * law.kappa),
        "|x|/|bhat| outside the layer",
    )
    shrink = define("shrink", sp.Max(inside, outside), "|x|/|bhat|")
    pull = define("pull", sp.Min(layer * inside, effort / guarded), "|p3|/|bhat|")
    p2 = tuple(
        define(n, -law.kappa * shrink * x, "(18)", u)
        for n, x, u in zip(spec.own.of_actuators("p2"), scaled, units.forces, strict=True)
    )
    p3 = tuple(
        define(n, -pull * x, "(19), (23)", u)
        for n, x, u in zip(spec.own.of_actuators("p3"), scaled, units.forces, strict=True)
    )
    return p2, p3, shrink * length


def _limit_torque(
    builder: BlockBuilder,
    spec: ModelSpec,
    torques: tuple[sp.Symbol, ...],
    previous: tuple[sp.Symbol, ...],
) -> tuple[tuple[sp.Symbol, ...], sp.Basic]:
    """Define what is commanded, (m,), and return it with the condition that a limit binds.

    The slew limit comes first and the torque limit last, so that the command is within the latter
    whatever the previous torque is; where that is no number, the slew limit asks for nothing.
    """
    law, define = spec.law, builder.define
    slews = law.slews or (None,) * len(torques)
    befores = previous or (None,) * len(torques)
    names = zip(
        spec.own.of_actuators("torque_least"),
        spec.own.of_actuators("torque_most"),
        spec.own.of_actuators("torque_slewed"),
        spec.own.of_actuators("command"),
        (a.unit for a in spec.actuators),
        strict=True,
    )
    commands: list[sp.Symbol] = []
    binding: list[sp.Basic] = []
    for (least, most, slewed, command, unit), torque, limit, slew, before in zip(
        names, torques, law.limits, slews, befores, strict=True
    ):
        near = torque
        if slew is not None:
            reach = law.sample_time * slew
            low = define(least, before - reach, "least torque that the slew limit allows", unit)
            high = define(most, before + reach, "largest torque that the slew limit allows", unit)
            choice = sp.Piecewise((low, torque < low), (high, torque > high), (torque, True))
            near = define(slewed, choice, "torque within the slew limit", unit)
            binding += [torque < low, torque > high]
        over = sp.Abs(near) > limit
        binding.append(over)
        value = sp.Piecewise((side(near) * limit, over), (near, True))
        commands.append(define(command, value, "saturated torque", unit))
    return tuple(commands), sp.Or(*binding) if len(binding) > 1 else binding[0]


def _give_output(
    builder: BlockBuilder,
    spec: ModelSpec,
    shared: Shared,
    beta: tuple[sp.Symbol, ...],
    torque: _Torque,
    commands: tuple[sp.Symbol, ...],
    saturated: sp.Basic,
) -> None:
    """Let the commands, the parts of the torque and the flags leave."""
    for actuator, command in zip(spec.actuators, commands, strict=True):
        within = "within its limits" if spec.law.slews else "within its limit"
        builder.give(actuator.name, command, actuator.unit, f"torque, (16), {within}")
    give_parts(builder, spec, shared, beta, torque.parts)
    builder.give(
        spec.own("saturated"),
        sp.Piecewise((1, saturated), (0, True)),
        "",
        "torque at its limit",
        "flag",
    )
    near = shared.adb_det**2 < spec.law.singular_threshold**2
    builder.give(
        spec.own("near_singular"),
        sp.Piecewise((1, near), (0, True)),
        "",
        "|ADB| below its least",
        "flag",
    )


def _give_state(
    builder: BlockBuilder,
    spec: ModelSpec,
    state: _State,
    shared: Shared,
    moved: tuple[sp.Symbol, ...],
    torque: _Torque,
    commands: tuple[sp.Symbol, ...],
    saturated: sp.Basic,
) -> None:
    """Let the next state leave. While the torque saturates, integral and adaptation would wind up:
    both are held.
    """
    units = LawUnits(spec)
    for name, before, after, unit in zip(
        spec.own.numbered("constraint_offset"), state.offsets, moved, units.residuals, strict=True
    ):
        held = sp.Piecewise((before, sp.And(saturated, state.engaged > 0)), (after, True))
        builder.give(name, held, unit, "beta - s", "next_state")
    for name, drift, unit in zip(
        spec.own.numbered("drift_previous"), shared.drift, units.drifts, strict=True
    ):
        builder.give(name, drift, unit, "drift of this period", "next_state")
    grown = state.decay * state.bound + state.step * shared.regressor * torque.scaled_next
    builder.give(
        spec.own("bound_estimate"),
        sp.Piecewise((state.bound, saturated), (grown, True)),
        units.force,
        "ahat, (15)",
        "next_state",
    )
    for before, command, a in zip(
        state.previous, commands, spec.actuators, strict=bool(state.previous)
    ):
        builder.give(before.name, command, a.unit, f"{a.name} commanded", "next_state")
