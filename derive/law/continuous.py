"""The adaptive robust constraint-following law as printed, (15)-(23)."""

from __future__ import annotations

from collections.abc import Iterable

import sympy as sp
from pfaffian.derive.law.terms import LawUnits, define_shared, give_parts, norm
from pfaffian.derive.mechanics.block_terms import real, take_measurement, take_parameters
from pfaffian.derive.mechanics.constraint import Constraint
from pfaffian.derive.mechanics.dynamics import Dynamics
from pfaffian.derive.spec.model_spec import ModelSpec
from pfaffian.derive.symbolic.block import Block, BlockBuilder


def continuous_law(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> Block:
    """Return the law (15)-(23) as printed: torque and the rates of its own states.

    The two integrals of (6) enter as the one integral of `drift`, which is their weighted sum.
    """
    law, units, m = spec.law, LawUnits(spec), len(spec.actuators)
    builder = BlockBuilder(
        "continuous", f"{spec.title}: continuous control law, (15)-(23)", spec.own
    )
    take_measurement(builder, spec)
    initial = [
        builder.take(real(n), u, "s at engagement", "state")
        for n, u in zip(spec.own.numbered("residual_initial"), units.residuals, strict=True)
    ]
    integral = [
        builder.take(real(n), u, "integral of drift since engagement, (6)", "state")
        for n, u in zip(spec.own.numbered("drift_integral"), units.residuals, strict=True)
    ]
    bound = builder.take(spec.own_symbol("bound_estimate"), units.force, "ahat, (15)", "state")
    take_parameters(builder, spec, "lumped", "plant", "synthesised", "gain")
    shared = define_shared(builder, spec, dynamics, constraint)
    beta = tuple(
        builder.define(n, s - s0 + z, "(21)", u)
        for n, s, s0, z, u in zip(
            spec.own.numbered("beta"), shared.s, initial, integral, units.residuals, strict=True
        )
    )
    nominal = shared.adb.adjugate() * sp.Matrix(shared.demand) / shared.adb_det
    scaled_value = shared.adb.T * sp.Matrix(beta)

    def define(
        base: str, values: Iterable[sp.Expr], text: str, unit: tuple[str, ...]
    ) -> tuple[sp.Symbol, ...]:
        return tuple(
            builder.define(n, v, text, u)
            for n, v, u in zip(spec.own.of_actuators(base), values, unit, strict=True)
        )

    p1 = define("p1", nominal, "(17)", units.forces)
    scaled = define("bhat", scaled_value, "(20)", (units.scaled,) * m)
    p2 = define("p2", [-law.kappa * x for x in scaled], "(18)", units.forces)
    effort = builder.define("effort", bound * shared.regressor, "ahat Pi", units.force)
    mu = define("mu", [x * effort for x in scaled], "(22)", ("",) * m)
    gamma = sp.Max(norm(mu), law.epsilon)
    p3 = define("p3", [-x * effort / gamma for x in mu], "(19), (23)", units.forces)
    for actuator, *parts in zip(spec.actuators, p1, p2, p3, strict=True):
        builder.give(actuator.name, sp.Add(*parts), actuator.unit, "torque, (16)")
    give_parts(builder, spec, shared, beta, (p1, p2, p3))
    for n, rate, u in zip(
        spec.own.numbered("drift_integral"), shared.drift, units.drifts, strict=True
    ):
        builder.give(spec.own(f"{n}_rate"), rate, u, "rate of the integral")
    builder.give(
        spec.own(f"{bound.name}_rate"),
        law.adaptation_rate * shared.regressor * norm(scaled) - law.leakage_rate * bound,
        f"{units.force}/s",
        "rate of ahat, (15)",
    )
    return builder.build()
