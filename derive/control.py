"""The adaptive robust constraint-following law, continuous (15)-(23) and sampled.

Both laws share the nominal part p1 and differ in how beta, p2, p3 and the adaptation advance. The
sampled law is the continuous one discretised implicitly: held for a period T, the law as printed
diverges as soon as T kappa (ADB)^2 exceeds 2, the implicit one never does.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.block import Block, BlockBuilder
from pfaffian.derive.constraint import Constraint
from pfaffian.derive.dimensions import force_unit, unit_product
from pfaffian.derive.lagrange import Dynamics
from pfaffian.derive.spec import ModelSpec, RobustLaw, symbol_of
from pfaffian.runtime.errors import InputError
from sympy.codegen.cfunctions import expm1


@dataclass(frozen=True)
class _Shared:
    """Symbols of the values that both laws compute in the same way."""

    s: sp.Symbol
    drift: sp.Symbol
    adb: sp.Symbol
    demand: sp.Symbol
    regressor: sp.Symbol


class _LawUnits:
    """Units of the law's signals, from those of the residual and the actuator."""

    def __init__(self, spec: ModelSpec) -> None:
        self.force = spec.actuators[0].unit
        self.residual = spec.constraint.residual_unit
        self.adb = unit_product((self.residual, 1), ("s", -1), (self.force, -1))
        self.drift = unit_product((self.residual, 1), ("s", -1))
        self.scaled = unit_product((self.adb, 1), (self.residual, 1))


def real(name: str) -> sp.Symbol:
    """Return a real symbol."""
    return sp.Symbol(name, real=True)


def take_measurement(builder: BlockBuilder, spec: ModelSpec) -> None:
    """Declare q and q' as inputs."""
    for c in spec.coordinates:
        builder.take(c.position, c.unit, c.description, "input")
    for c in spec.coordinates:
        builder.take(c.velocity, f"{c.unit}/s", f"rate of {c.name}", "input")


def take_parameters(builder: BlockBuilder, spec: ModelSpec, *groups: str) -> None:
    """Declare the parameters of `groups` as inputs."""
    for p in spec.parameters_in(*groups):
        builder.take(symbol_of(p), p.unit, p.description, "parameter")


def define_trigonometry(
    builder: BlockBuilder, expressions: Iterable[sp.Basic]
) -> dict[sp.Basic, sp.Symbol]:
    """Define every sine and cosine in `expressions`, and their arguments where those are sums.

    Returns the mapping to substitute. Named values are rounded once and used often.
    """
    found = sorted(
        set().union(*(e.atoms(sp.sin, sp.cos) for e in expressions)), key=sp.default_sort_key
    )
    known: dict[sp.Basic, sp.Symbol] = {}
    for function in found:
        argument = function.args[0]
        if argument not in known and not argument.is_Symbol:
            words = "_plus_".join(sorted(s.name for s in argument.free_symbols))
            plain = argument == sum(argument.free_symbols)
            name = words if plain else f"angle{len(known) + 1}"
            known[argument] = builder.define(name, argument, "angle", "rad")
        angle = known.get(argument, argument)
        known[function] = builder.define(
            f"{function.func.__name__}_{angle.name}", function.func(angle), ""
        )
    return known


def define_dynamics(
    builder: BlockBuilder, spec: ModelSpec, dynamics: Dynamics
) -> tuple[sp.Matrix, sp.Symbol, sp.Matrix]:
    """Define M, det M and the bias h = C q' + G; return (M, det M, h) in the names defined."""
    n = len(spec.coordinates)
    units = [c.unit for c in spec.coordinates]
    raw = dynamics.coriolis_matrix * sp.Matrix(spec.velocities) + dynamics.gravity
    named = define_trigonometry(builder, [*dynamics.mass_matrix, *raw])
    mass = sp.zeros(n, n)
    for i in range(n):
        for j in range(i, n):
            mass[i, j] = mass[j, i] = builder.define(
                f"m{i + 1}{j + 1}",
                dynamics.mass_matrix[i, j].xreplace(named),
                "mass matrix, (1)",
                unit_product(("J*s^2", 1), (units[i], -1), (units[j], -1)),
            )
    # Expanded in the parameters: the products of entries cancel most of each other's digits.
    expanded = sp.expand(dynamics.mass_matrix.det()).xreplace(named)
    det = builder.define("det_m", expanded, "determinant of the mass matrix")
    names = [
        builder.define(
            f"bias{i + 1}", raw[i].xreplace(named), "row of C q' + G, (1)", force_unit(units[i])
        )
        for i in range(n)
    ]
    return mass, det, sp.Matrix(names)


def _define_shared(
    builder: BlockBuilder, spec: ModelSpec, dynamics: Dynamics, constraint: Constraint
) -> _Shared:
    """Define s, drift, ADB, the demand b + AD(C q' + G) and the regressor Pi of (47)."""
    units = _LawUnits(spec)
    error_symbols = [
        builder.define(f"e{i + 1}", e, "error, (4)", spec.coordinates[i].unit)
        for i, e in enumerate(spec.constraint.errors)
    ]
    named = dict(zip(spec.constraint.errors, error_symbols, strict=True))
    s = builder.define("s", constraint.residual[0].xreplace(named), "(3)", units.residual)
    drift = builder.define(
        "drift",
        spec.constraint.drift[0].subs(spec.constraint.residual_symbols[0], s),
        "sigma s + (2 eta/pi) arctan s, (2)",
        units.drift,
    )
    mass, det, bias = define_dynamics(builder, spec, dynamics)
    row = constraint.jacobian * mass.adjugate() / det
    ad = sp.Matrix(
        [
            [
                builder.define(f"ad{i + 1}", row[i], "entry of A D, D = M^-1", units.adb)
                for i in range(len(spec.coordinates))
            ]
        ]
    )
    adb = builder.define("adb", (ad * dynamics.input_matrix)[0], "(10)", units.adb)
    free_motion = (
        constraint.residual.jacobian(sp.Matrix(spec.positions)) * sp.Matrix(spec.velocities)
    )[0]
    b = builder.define("b", -free_motion - drift, "right-hand side of A q'' = b, (7)", units.drift)
    demand = builder.define("demand", b + (ad * bias)[0], "b + A D (C q' + G)", units.drift)
    # Pi adds unlike units where the coordinates have different ones, as (47) does in any case.
    kinds = {c.unit for c in spec.coordinates}
    motion = kinds.pop() if len(kinds) == 1 else ""
    speed = builder.define(
        "speed", sp.sqrt(sum(v**2 for v in spec.velocities)), "|e'|", motion and f"{motion}/s"
    )
    distance = builder.define("distance", sp.sqrt(sum(e**2 for e in error_symbols)), "|e|", motion)
    regressor = builder.define("regressor", (speed + 1) ** 2 + (distance + 1) ** 2, "Pi, (47)")
    return _Shared(s, drift, adb, demand, regressor)


def _require_single_input(spec: ModelSpec) -> None:
    if len(spec.actuators) != 1:
        raise InputError(
            f"model {spec.name}: the control law is derived for one actuator, "
            f"this plant has {len(spec.actuators)}",
            remedy="give a plant with one actuator and one servo-constraint",
        )


def continuous_law(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> Block:
    """Return the law (15)-(23) as printed: torque and the rates of its own states.

    The two integrals of (6) enter as the one integral of `drift`, which is their weighted sum.
    """
    _require_single_input(spec)
    law, units = spec.law, _LawUnits(spec)
    builder = BlockBuilder("continuous", f"{spec.title}: continuous control law, (15)-(23)")
    take_measurement(builder, spec)
    initial = builder.take(real("residual_initial"), units.residual, "s at engagement", "state")
    integral = builder.take(
        real("drift_integral"), units.residual, "integral of drift since engagement, (6)", "state"
    )
    bound = builder.take(real("bound_estimate"), units.force, "ahat, (15)", "state")
    take_parameters(builder, spec, "lumped", "plant", "synthesised", "gain")
    shared = _define_shared(builder, spec, dynamics, constraint)
    beta = builder.define("beta", shared.s - initial + integral, "(21)", units.residual)
    p1 = builder.define("p1", shared.demand / shared.adb, "(17)", units.force)
    scaled = builder.define("bhat", shared.adb * beta, "(20)", units.scaled)
    p2 = builder.define("p2", -law.kappa * scaled, "(18)", units.force)
    effort = builder.define("effort", bound * shared.regressor, "ahat Pi", units.force)
    mu = builder.define("mu", scaled * effort, "(22)")
    p3 = builder.define(
        "p3", -mu * effort / sp.Max(sp.Abs(mu), law.epsilon), "(19), (23)", units.force
    )
    builder.give(spec.actuators[0].name, p1 + p2 + p3, units.force, "torque, (16)")
    for symbol, unit, text in (
        (p1, units.force, "nominal part, (17)"),
        (p2, units.force, "initial deviation part, (18)"),
        (p3, units.force, "robust part, (19)"),
        (shared.s, units.residual, "residual s, (3)"),
        (beta, units.residual, "constraint-following error, (21)"),
        (shared.adb, units.adb, "input gain of the constraint, (10)"),
    ):
        builder.give(symbol.name, symbol, unit, text)
    builder.give("drift_integral_rate", shared.drift, units.drift, "rate of the integral")
    builder.give(
        "bound_estimate_rate",
        law.adaptation_rate * shared.regressor * sp.Abs(scaled) - law.leakage_rate * bound,
        f"{units.force}/s",
        "rate of ahat, (15)",
    )
    return builder.build()


def prepared_values(spec: ModelSpec) -> Block:
    """Return the values that depend on parameters alone: the exact leakage over one period."""
    law, units = spec.law, _LawUnits(spec)
    builder = BlockBuilder("prepare", f"{spec.title}: values computed once from the parameters")
    take_parameters(builder, spec, "gain", "target")
    exponent = builder.define("exponent", -law.leakage_rate * law.sample_time, "-k2 T")
    builder.give("leakage_decay", sp.exp(exponent), "", "e^(-k2 T)", "prepared")
    builder.give(
        "adaptation_step",
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
    builder.give("bound_estimate", law.initial_bound, units.force, "ahat at the start", "state")
    return builder.build()


def sampled_law(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> Block:
    """Return one period of the sampled law: what the target runs.

    beta advances by backward Euler under p2 + p3, so x = bhat at the end of the period solves
    x + T (ADB)^2 (kappa x + rho sat(rho x / eps)) = bhat with rho = ahat Pi; the left side is the
    smaller of two straight lines in |x|, hence the closed form below. The leakage law is solved
    exactly with x held, so that the sampled and the continuous law share their equilibria.
    """
    _require_single_input(spec)
    law, units = spec.law, _LawUnits(spec)
    builder = BlockBuilder("step", f"{spec.title}: sampled control law, one period")
    take_measurement(builder, spec)
    take = builder.take
    engaged = take(real("engaged"), "", "1 once the law has been engaged", "state")
    offset = take(real("constraint_offset"), units.residual, "beta - s, (21)", "state")
    drift_before = take(real("drift_previous"), units.drift, "drift one period ago", "state")
    bound = take(real("bound_estimate"), units.force, "ahat, (15)", "state")
    decay = take(real("leakage_decay"), "", "e^(-k2 T)", "prepared")
    step = take(real("adaptation_step"), "", "k1 (1 - e^(-k2 T))/k2", "prepared")
    take_parameters(builder, spec, "lumped", "plant", "synthesised", "gain", "target")
    shared = _define_shared(builder, spec, dynamics, constraint)
    define = builder.define
    moved = define(
        "offset",
        sp.Piecewise(
            (offset + law.sample_time * (drift_before + shared.drift) / 2, engaged > 0),
            (-shared.s, True),
        ),
        "captured at engagement, then the trapezoidal integral of drift, (6)",
        units.residual,
    )
    beta = define("beta", shared.s + moved, "(21)", units.residual)
    torque = _define_torque(builder, law, units, shared, beta, bound)
    command = define(
        "command",
        sp.Min(sp.Max(torque.total, -law.torque_limit), law.torque_limit),
        "saturated torque",
        units.force,
    )
    saturated = sp.Abs(torque.total) > law.torque_limit
    builder.give(spec.actuators[0].name, command, units.force, "torque, (16), within its limit")
    for symbol, unit, text in (
        (torque.p1, units.force, "nominal part, (17)"),
        (torque.p2, units.force, "initial deviation part, (18)"),
        (torque.p3, units.force, "robust part, (19)"),
        (shared.s, units.residual, "residual s, (3)"),
        (beta, units.residual, "constraint-following error, (21)"),
        (shared.adb, units.adb, "input gain of the constraint, (10)"),
    ):
        builder.give(symbol.name, symbol, unit, text)
    builder.give(
        "saturated", sp.Piecewise((1, saturated), (0, True)), "", "torque at its limit", "flag"
    )
    builder.give(
        "near_singular",
        sp.Piecewise((1, sp.Abs(shared.adb) < law.singular_threshold), (0, True)),
        "",
        "|ADB| below its least",
        "flag",
    )
    # While the torque saturates, the integral and the adaptation would wind up: both are held.
    builder.give(
        "constraint_offset",
        sp.Piecewise((offset, sp.And(saturated, engaged > 0)), (moved, True)),
        units.residual,
        "beta - s",
        "next_state",
    )
    builder.give("drift_previous", shared.drift, units.drift, "drift of this period", "next_state")
    builder.give(
        "bound_estimate",
        sp.Piecewise(
            (bound, saturated),
            (decay * bound + step * shared.regressor * sp.Abs(torque.scaled_next), True),
        ),
        units.force,
        "ahat, (15)",
        "next_state",
    )
    return builder.build()


@dataclass(frozen=True)
class _Torque:
    p1: sp.Symbol
    p2: sp.Symbol
    p3: sp.Symbol
    total: sp.Symbol
    scaled_next: sp.Symbol


def _define_torque(
    builder: BlockBuilder,
    law: RobustLaw,
    units: _LawUnits,
    shared: _Shared,
    beta: sp.Symbol,
    bound: sp.Symbol,
) -> _Torque:
    """Define p1 with the singularity guard, and p2, p3 by backward Euler on beta."""
    define = builder.define
    kappa, epsilon = law.kappa, law.epsilon
    threshold = law.singular_threshold
    inverse = define(
        "adb_inverse",
        shared.adb / sp.Max(shared.adb**2, threshold**2),
        "1/ADB, and 0 where ADB = 0",
        unit_product((units.adb, -1)),
    )
    p1 = define("p1", inverse * shared.demand, "(17)", units.force)
    scaled = define("bhat", shared.adb * beta, "(20)", units.scaled)
    effort = define("effort", bound * shared.regressor, "ahat Pi", units.force)
    rate = define("rate", law.sample_time * shared.adb**2, "T (ADB)^2")
    layer = define("layer", effort**2 / epsilon, "slope of p3 in bhat inside its layer, (23)")
    inside = define(
        "bhat_inside",
        scaled / (1 + rate * (kappa + layer)),
        "bhat after the period, inside the layer",
        units.scaled,
    )
    outside = define(
        "bhat_outside",
        (sp.Abs(scaled) - rate * effort) / (1 + rate * kappa),
        "|bhat| after the period, outside the layer",
        units.scaled,
    )
    after = define(
        "bhat_next",
        sp.sign(scaled) * sp.Max(sp.Abs(inside), outside),
        "bhat after the period",
        units.scaled,
    )
    p2 = define("p2", -kappa * after, "(18)", units.force)
    p3 = define("p3", -sp.Min(sp.Max(layer * inside, -effort), effort), "(19), (23)", units.force)
    total = define("torque", p1 + p2 + p3, "(16)", units.force)
    return _Torque(p1, p2, p3, total, after)
