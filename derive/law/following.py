"""The sampled law along a reference: the row of its constraint varies with the time.

The constraint is s = R1(t) (q' - qr') + R0(t) (q - qr) with s' + drift(s) = 0, hence A = R1 and
b = -drift + R1 qr'' - R1' e' - R0' e - R0 e' with e = q - qr. Everything else is the sampled law.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import sympy as sp
from pfaffian.derive.law.sampled import LEAST_SQUARE, complete_law
from pfaffian.derive.law.terms import LawUnits, Shared, define_shared
from pfaffian.derive.mechanics.constraint import Constraint
from pfaffian.derive.mechanics.dynamics import Dynamics
from pfaffian.derive.spec.model_spec import TIME, Matrix, ModelSpec
from pfaffian.derive.symbolic.block import Block, BlockBuilder
from pfaffian.derive.symbolic.units import unit_product

GROUP = "reference"


def following_law(spec: ModelSpec, dynamics: Dynamics) -> Block | None:
    """Return one period of the sampled law along a reference, in the group `reference`.

    There is none where the drift depends on more than s and parameters: it then belongs to the
    residual it was given with.
    """
    own = {*spec.positions, *spec.velocities, TIME}
    if any(d.free_symbols & own for d in spec.constraint.drift):
        return None
    builder = BlockBuilder(
        "follow", f"{spec.title}: sampled control law along a reference", spec.own
    )
    names = iter(spec.own.reference([c.name for c in spec.coordinates]))
    positions, rates, accelerations = _take_motion(builder, spec, names)
    r0, r1, r0_rate, r1_rate = _take_rows(builder, spec, names)

    def define() -> Shared:
        errors = Matrix([q - r for q, r in zip(spec.positions, positions, strict=True)])
        pairs = zip(spec.coordinates, spec.velocities, rates, strict=True)
        named = [
            builder.define(f"e{i + 1}", e, "error, (4)", c.unit)
            for i, (e, c) in enumerate(zip(errors, spec.coordinates, strict=True))
        ]
        moving = [
            builder.define(f"de{i + 1}", dq - r, "rate of the error", f"{c.unit}/s")
            for i, (c, dq, r) in enumerate(pairs)
        ]
        e, de, motion = Matrix(named), Matrix(moving), Matrix(accelerations)
        residual = r1 * de + r0 * e
        free = r1_rate * de + r0_rate * e + r0 * de - r1 * motion
        given = dict(zip(spec.constraint.residual_symbols, residual, strict=True))
        drift = spec.constraint.drift.xreplace(given)
        constraint = Constraint(
            jacobian=r1,
            acceleration=Matrix(-free - sp.Matrix(drift)),
            residual=Matrix(residual),
            drift=Matrix(drift),
            free_motion=Matrix(free),
        )
        along = replace(spec, constraint=replace(spec.constraint, errors=errors))
        return define_shared(builder, along, dynamics, constraint, LEAST_SQUARE, moving)

    return complete_law(builder, spec, define)


_Symbols = tuple[sp.Symbol, ...]


def _take_motion(
    builder: BlockBuilder, spec: ModelSpec, names: Iterator[str]
) -> tuple[_Symbols, _Symbols, _Symbols]:
    """Declare qr, qr' and qr'', each (n,), under the next `names`."""
    found = []
    kinds = (("", "reference of"), ("/s", "rate of the reference of"))
    for per, text in (*kinds, ("/s^2", "acceleration of the reference of")):
        found.append(
            tuple(
                builder.take(
                    sp.Symbol(next(names), real=True),
                    f"{c.unit}{per}",
                    f"{text} {c.name}",
                    GROUP,
                )
                for c in spec.coordinates
            )
        )
    return found[0], found[1], found[2]


def _take_rows(
    builder: BlockBuilder, spec: ModelSpec, names: Iterator[str]
) -> tuple[sp.Matrix, ...]:
    """Declare R0, R1, R0' and R1', each (m, n), under the next `names`."""
    units, m = LawUnits(spec).residuals, len(spec.actuators)
    found = []
    for power in (0, -1):
        for prefix, seconds in (("", 0), ("d", 1)):
            entries = [
                builder.take(
                    sp.Symbol(next(names), real=True),
                    unit_product((units[r], 1), (c.unit, -1), ("s", seconds + power)),
                    f"{'rate of the ' if power else ''}weight of the error of {prefix}{c.name} in "
                    f"the constraint",
                    GROUP,
                )
                for r in range(m)
                for c in spec.coordinates
            ]
            found.append(Matrix(m, len(spec.coordinates), entries))
    return tuple(found)
