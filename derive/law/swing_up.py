"""The energy swing-up law of Fantoni, Lozano and Spong (2000), for one actuator on one coordinate.

With M the mass matrix, h = C q' + G and q_a the coordinate acted on, N = (adj M)_aa and
W = -(adj M)_a h make det M q_a'' = N tau + W. For E~ = E - V(goal), q_a~ = q_a - goal_a the torque

    tau = [-kD W - det M (kV q_a' + kP q_a~)] / (kD N + kE E~ det M)

lets V_L = kE E~^2/2 + kD q_a'^2/2 + kP q_a~^2/2 fall at the rate kV q_a'^2. Its denominator is
positive in every state if and only if kD/kE > (V(goal) - V(q)) det M/N for all q, as E >= V(q).
"""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.ir.names import ANGLE_GROUP, SWING_UP_LIMIT, SWING_UP_PROGRAM
from pfaffian.derive.mechanics.block_terms import (
    define_dynamics,
    define_trigonometry,
    take_measurement,
    take_parameters,
)
from pfaffian.derive.mechanics.dynamics import SMALL, Dynamics
from pfaffian.derive.mechanics.identities import Identity
from pfaffian.derive.mechanics.mass_solver import MassSolver, determinant
from pfaffian.derive.spec.model_spec import Coordinate, ModelSpec, SwingUp
from pfaffian.derive.symbolic.block import Block, BlockBuilder
from pfaffian.derive.symbolic.functions import side
from pfaffian.derive.symbolic.normal_form import is_zero, trigonometric_sum, zero_matrix
from pfaffian.derive.symbolic.units import dimension_of, unit_product
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import unit_registry


@dataclass(frozen=True)
class _Row:
    """The row of the acted coordinate: det q_a'' = reach tau + drive, and the unit of det/reach.

    Beyond `SMALL` coordinates everything is divided by det M, and det is 1.
    """

    det: sp.Expr
    reach: sp.Expr
    drive: sp.Expr
    unit: str


def check_swing_up(spec: ModelSpec) -> None:
    """Raise `InputError` unless the law of `spec`, if any, has one actuator on one coordinate.

    The gains must have units that make V_L a sum of like terms, and kV q_a'^2 its rate.
    """
    if spec.swing_up is None:
        return
    b = spec.input_matrix
    ones = [b[i, 0] for i in range(b.rows) if b[i, 0] != 0]
    if b.cols != 1 or ones != [sp.S.One]:
        raise InputError(
            f"model {spec.name}: the energy swing-up law needs one actuator that acts on one "
            f"coordinate, but the input matrix is {b.tolist()}",
            remedy="leave the swing-up out, or take coordinates of which the actuator drives one",
            about="swing_up",
        )
    _check_units(spec, spec.swing_up)


def _check_units(spec: ModelSpec, gains: SwingUp) -> None:
    units = {p.name: p.unit for p in spec.parameters}
    acted = acted_coordinate(spec)
    energy, time = spec.own_symbol("E"), spec.own_symbol("t")
    units |= {acted.name: acted.unit, acted.velocity.name: f"{acted.unit}/s"}
    units |= {energy.name: "J", time.name: "s"}
    terms = (
        (gains.energy, gains.energy * energy**2),
        (gains.rate, gains.rate * acted.velocity**2),
        (gains.position, gains.position * acted.position**2),
        (gains.damping, gains.damping * acted.velocity**2 * time),
    )
    number = unit_registry().Quantity(1, "").dimensionality
    for gain, term in terms:
        where = f"model {spec.name}: swing-up gain {gain.name}"
        have = dimension_of(term, units, where)
        if have != number:
            raise InputError(
                f"{where} has the unit {units[gain.name]!r}: its term {term} of V_L has dimension "
                f"{have}, and V_L is a number",
                remedy="mend the unit: kP 1/q^2, kD s^2/q^2, kE 1/J^2, kV s/q^2 with q that of "
                f"{acted.name}",
                about=gain.name,
            )


def acted_coordinate(spec: ModelSpec) -> Coordinate:
    """Return the coordinate that the actuator acts on."""
    return spec.coordinates[_acted(spec)]


def _acted(spec: ModelSpec) -> int:
    return next(i for i in range(spec.input_matrix.rows) if spec.input_matrix[i, 0] != 0)


def swing_up_blocks(spec: ModelSpec, dynamics: Dynamics) -> tuple[Block, ...]:
    """Return the law, and what bounds kD/kE from below; nothing where the model has no law."""
    if spec.swing_up is None:
        return ()
    return (_law(spec, spec.swing_up, dynamics), _limit(spec, dynamics))


def _law(spec: ModelSpec, gains: SwingUp, dynamics: Dynamics) -> Block:
    """The torque within its limit; 0 where the denominator is not positive, which is flagged."""
    builder = BlockBuilder("swing_up", f"{spec.title}: energy swing-up law", spec.own)
    take_measurement(builder, spec)
    take_parameters(builder, spec, "lumped", "plant", "gain", "swing_up", "target")
    mass, solver, bias = define_dynamics(builder, spec, dynamics)
    define, actuator, acted = builder.define, spec.actuators[0], acted_coordinate(spec)
    missing = _define_energy_error(builder, spec, dynamics, mass)
    row = _define_row(builder, spec, mass, solver, bias)
    away = define(
        "away",
        acted.position - spec.constraint.setpoint[_acted(spec)],
        f"{acted.name} from its setpoint",
        acted.unit,
    )
    unit = unit_product(("s", 2), (acted.unit, -2), (row.unit, 1))
    denominator = define(
        "denominator",
        gains.rate * row.reach + gains.energy * missing * row.det,
        "kD N + kE E~ det M",
        unit,
    )
    push = gains.damping * acted.velocity + gains.position * away
    torque = define(
        "torque",
        (-gains.rate * row.drive - row.det * push) / denominator,
        "[-kD W - det M (kV q_a' + kP q_a~)]/denominator",
        actuator.unit,
    )
    _give_torque(builder, spec, torque, denominator)
    builder.give(
        spec.own("energy_error"), missing, "J", "energy missing to the setpoint at rest, negated"
    )
    builder.give(
        spec.own("denominator"), denominator, unit, "denominator of the law, positive by design"
    )
    return builder.build()


def _give_torque(
    builder: BlockBuilder, spec: ModelSpec, torque: sp.Symbol, denominator: sp.Symbol
) -> None:
    """Let the torque within its limit and the flags leave."""
    limit, unit = spec.law.limits[0], spec.actuators[0].unit
    beyond, regular = sp.Abs(torque) > limit, denominator > 0
    limited = builder.define(
        "limited_torque",
        sp.Piecewise((side(torque) * limit, beyond), (torque, True)),
        "within the limit",
        unit,
    )
    command = builder.define(
        "command", sp.Piecewise((limited, regular), (0, True)), "0 where the law has no sense", unit
    )
    builder.give(spec.actuators[0].name, command, unit, "torque, within its limit")
    builder.give(
        spec.own("saturated"),
        sp.Piecewise((1, sp.And(beyond, regular)), (0, True)),
        "",
        "torque at its limit",
        "flag",
    )
    builder.give(
        spec.own("near_singular"),
        sp.Piecewise((0, regular), (1, True)),
        "",
        "denominator not positive",
        "flag",
    )


def _define_energy_error(
    builder: BlockBuilder, spec: ModelSpec, dynamics: Dynamics, mass: sp.Matrix
) -> sp.Symbol:
    """Define E~ = T + V - V(goal)."""
    rates = sp.Matrix(spec.velocities)
    kinetic = builder.define("kinetic", (rates.T * mass * rates)[0] / 2, "q'^T M q'/2", "J")
    values = []
    for name, value, text in (
        ("potential", dynamics.potential_form, "V"),
        ("potential_goal", _at_goal(spec, dynamics.potential_form), "V at the setpoint"),
    ):
        named = define_trigonometry(builder, [value])
        values.append(builder.define(name, value.xreplace(named), text, "J"))
    return builder.define("energy_error", kinetic + values[0] - values[1], "E~", "J")


def _at_goal(spec: ModelSpec, potential: sp.Expr) -> sp.Expr:
    goal = dict(zip(spec.positions, spec.constraint.setpoint, strict=True))
    return potential.subs(goal, simultaneous=True)


def _define_row(
    builder: BlockBuilder, spec: ModelSpec, mass: sp.Matrix, solver: MassSolver, bias: sp.Matrix
) -> _Row:
    n, a = len(spec.coordinates), _acted(spec)
    units = [c.unit for c in spec.coordinates]
    if n > SMALL:
        unit = sp.eye(n)[a, :]
        row = sp.Matrix([solver.define_row(unit, "inverse", "entry of M^-1", [""] * n)])
        det, inertia = sp.S.One, unit_product((units[a], 2), ("J*s^2", -1))
    else:
        row = mass.adjugate()[a, :]
        det = solver.determinant
        others = [u for k, u in enumerate(units) if k != a]
        inertia = unit_product(*(f for u in others for f in (("J*s^2", 1), (u, -2))))
    acceleration = unit_product((spec.actuators[0].unit, 1), (inertia, 1))
    drive = builder.define("drive", -(row * bias)[0], "W: det M q_a'' without torque", acceleration)
    return _Row(det, row[0, a], drive, inertia)


def _limit(spec: ModelSpec, dynamics: Dynamics) -> Block:
    """What kD/kE must exceed for all q that remain: (V(goal) - V) det M/N.

    A coordinate that only turns the whole plant in the field, on which M does not depend, is taken
    where V is least: that is known in closed form.
    """
    builder = BlockBuilder(SWING_UP_PROGRAM, f"{spec.title}: what kD/kE must exceed", spec.own)
    left = _repeating(spec, dynamics)
    for c in spec.coordinates:
        builder.take(c.position, c.unit, c.description, ANGLE_GROUP if c in left else "input")
    take_parameters(builder, spec, "lumped", "plant", "gain")
    least = least_potential(spec, dynamics)
    drop = _at_goal(spec, dynamics.potential_energy) - least
    mass, a = dynamics.mass_matrix, _acted(spec)
    named = define_trigonometry(builder, [drop, *mass])
    potential = builder.define("drop", drop.xreplace(named), "V(goal) - V(q), at most", "J")
    det = determinant(dynamics, spec.positions).xreplace(named) if mass.rows <= SMALL else sp.S.One
    solver = MassSolver(builder, mass.xreplace(named), det)
    acted = acted_coordinate(spec)
    unit = unit_product(("s", 2), ("J", 2), (acted.unit, -2))
    if mass.rows > SMALL:
        row = solver.define_row(sp.eye(mass.rows)[a, :], "inverse", "", [""] * mass.rows)
        ratio = 1 / row[a]
    else:
        ratio = solver.determinant / mass.adjugate()[a, a].xreplace(named)
    builder.give(SWING_UP_LIMIT, potential * ratio, unit, "kD/kE must exceed it")
    return builder.build()


def _repeating(spec: ModelSpec, dynamics: Dynamics) -> list[Coordinate]:
    """Return the coordinates that M and V contain only in sines and cosines of whole multiples."""
    used = (dynamics.potential_energy, *dynamics.mass_matrix)
    functions = sorted(
        set().union(*(e.atoms(sp.sin, sp.cos) for e in used)), key=sp.default_sort_key
    )
    hidden = {f: sp.Dummy() for f in functions}
    outside = set().union(*(e.xreplace(hidden).free_symbols for e in used))
    return [
        c
        for c in spec.coordinates
        if c.position not in outside
        and all(f.args[0].diff(c.position).is_Integer for f in functions)
    ]


def least_potential(spec: ModelSpec, dynamics: Dynamics) -> sp.Expr:
    """Return V, at its least over one angle that M does not depend on where there is such a one.

    In it V = X cos + Y sin + Z, which is least at Z - sqrt(X^2 + Y^2).
    """
    potential = dynamics.potential_energy
    for c in spec.coordinates:
        angle = c.position
        if not potential.has(angle) or dynamics.mass_matrix.has(angle):
            continue
        expanded = sp.expand(sp.expand_trig(potential))
        x, y = (expanded.coeff(f) for f in (sp.cos(angle), sp.sin(angle)))
        rest = expanded - sp.expand(x * sp.cos(angle) + y * sp.sin(angle))
        if not sp.Matrix([x, y, rest]).has(angle):
            return trigonometric_sum(rest) - sp.sqrt(trigonometric_sum(x**2 + y**2))
    return potential


def swing_up_identities(spec: ModelSpec, dynamics: Dynamics) -> tuple[Identity, ...]:
    """Prove det M q_a'' = N tau + W, and V_L' = -kV q_a'^2 under the law.

    Nothing is known about det M, N, W and E~ but E' = q'^T M q'' + q'^T M' q'/2 + G^T q' and the
    first identity; so as symbols they make the proof of the second shorter, and as good.
    """
    if spec.swing_up is None:
        return ()
    gains, a = spec.swing_up, _acted(spec)
    mass, size = dynamics.mass_matrix, len(spec.coordinates)
    row = mass.adjugate()[a, :] if size <= SMALL else None
    proved = []
    if row is not None:
        unit = mass.det() * sp.eye(size)[a, :]
        proved.append(
            Identity(
                "the actuator's row of M q'' = B tau - C q' - G",
                "\\det M\\,\\ddot q_a = N\\tau + W",
                zero_matrix(row * mass - unit),
            )
        )
    det, reach, drive, error, away, tau = sp.symbols(
        "det N W E_error away tau", real=True, cls=sp.Dummy
    )
    rate = spec.velocities[a]
    acceleration = (reach * tau + drive) / det
    energy_rate = _power(spec, dynamics, tau)
    fall = (
        gains.energy * error * energy_rate
        + gains.rate * rate * acceleration
        + gains.position * away * rate
    )
    law = (-gains.rate * drive - det * (gains.damping * rate + gains.position * away)) / (
        gains.rate * reach + gains.energy * error * det
    )
    proved.append(
        Identity(
            "under the swing-up law V_L falls at the rate kV q_a'^2",
            "\\dot V_L = -k_V\\,\\dot q_a^2",
            is_zero(fall.subs(tau, law) + gains.damping * rate**2),
        )
    )
    return tuple(proved)


def _power(spec: ModelSpec, dynamics: Dynamics, tau: sp.Symbol) -> sp.Expr:
    """Return E' along M q'' = B tau - C q' - G, from M, C and G; expanded, so that terms cancel."""
    q, dq = sp.Matrix(spec.positions), sp.Matrix(spec.velocities)
    mass = dynamics.mass_matrix
    mass_rate = sum(
        (mass.diff(qi) * vi for qi, vi in zip(q, dq, strict=True)), sp.zeros(*mass.shape)
    )
    forces = dynamics.input_matrix * tau - dynamics.coriolis_matrix * dq - dynamics.gravity
    power = dq.T * forces + dq.T * mass_rate * dq / 2 + dynamics.gravity.T * dq
    return trigonometric_sum(power[0])
