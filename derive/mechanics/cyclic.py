"""Cyclic coordinates that the servo-constraint does not see, and their zeros at the origin.

Where M, V, B, F and the constraint do not change along a direction v that no motion turns, a motion
along v is one of the zero dynamics: nothing drives it back, and nothing drives it away. The column
of the pencil along v is (M v p^2 + D v p, S1 v p), so that p divides the characteristic polynomial,
and p^2 does without friction where s does not see the rate along v either. These zeros are exact:
they belong to the plant, whatever its parameters and gains. The rest of the polynomial decides.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.ir.names import CONSERVED, CYCLIC
from pfaffian.derive.mechanics.constraint import Constraint
from pfaffian.derive.mechanics.dynamics import Dynamics
from pfaffian.derive.spec.model_spec import TIME, ModelSpec
from pfaffian.derive.symbolic.block import Block, BlockBuilder


@dataclass(frozen=True)
class CyclicDirection:
    """A direction v (n,) along which neither plant nor constraint changes.

    `zeros` is the most zeros at the origin it accounts for: 2, or 1 where s sees the rate along v.
    `name` is that of the coordinate, or of the sum it is; entries may hold parameters (gears).
    """

    name: str
    entries: tuple[sp.Expr, ...]
    zeros: int

    @property
    def text(self) -> str:
        """Return what that means to who asks for something."""
        if self.zeros == 1:
            return (
                f"{self.name} is cyclic, and s contains its rate alone: the rate can be asked for, "
                "the position stays where it comes to be"
            )
        return (
            f"{self.name} is cyclic, and s does not contain it: it goes on at the rate it has, "
            "which is no instability; to ask for its rate or position put them into a constraint"
        )


def cyclic_directions(
    spec: ModelSpec, dynamics: Dynamics, constraint: Constraint
) -> tuple[CyclicDirection, ...]:
    """Return independent cyclic directions: coordinates first, then pairs, then any others."""
    given = spec.constraint
    own = [*dynamics.input_matrix, *dynamics.uncertain_force, *constraint.residual, *given.drift]
    rates = [*constraint.residual, *given.drift]
    return tuple(
        CyclicDirection(name, v, 2 if _constant(rates, spec.velocities, v) else 1)
        for name, v in _directions(spec, [*_energies(dynamics), *own])
    )


def conserved_momenta(spec: ModelSpec, dynamics: Dynamics) -> tuple[str, ...]:
    """Return the directions along which the energies do not change and no actuator acts.

    The momentum along such a direction is conserved but for friction.
    """
    return tuple(
        name
        for name, v in _directions(spec, _energies(dynamics))
        if all(x == 0 for x in (sp.Matrix([v]) * dynamics.input_matrix))
    )


def _energies(dynamics: Dynamics) -> list[sp.Expr]:
    return [dynamics.potential_energy, *dynamics.mass_matrix]


def _directions(spec: ModelSpec, whole: Sequence[sp.Expr]) -> list[tuple[str, tuple[sp.Expr, ...]]]:
    """Return independent directions, with their names, along which nothing of `whole` changes."""
    n, names = len(spec.coordinates), [c.name for c in spec.coordinates]
    unit = [tuple(sp.Integer(k == i) for k in range(n)) for i in range(n)]
    found = [(names[i], v) for i, v in enumerate(unit) if _constant(whole, spec.positions, v)]
    left = [i for i in range(n) if not any(v[i] for _, v in found)]
    for (i, j), sign in itertools.product(itertools.combinations(left, 2), (1, -1)):
        v = tuple(sp.Integer(1 if k == i else sign if k == j else 0) for k in range(n))
        known = [d for _, d in found]
        if sp.Matrix([*known, v]).rank() > len(known) and _constant(whole, spec.positions, v):
            found.append((f"{names[i]} {'+' if sign > 0 else '-'} {names[j]}", v))
    for v in _null_space(spec, whole) if len(found) < n else []:
        known = [d for _, d in found]
        if sp.Matrix([*known, v]).rank() > len(known) and _constant(whole, spec.positions, v):
            shares = zip(v, spec.positions, strict=True)
            found.append((str(sp.Add(*(x * q for x, q in shares))), v))
    return found


def _null_space(spec: ModelSpec, whole: Sequence[sp.Expr]) -> list[tuple[sp.Expr, ...]]:
    """Return the directions that what is in front of each function of the motion leaves over.

    The slopes of `whole` are sums of products of a factor of parameters and one of the motion;
    what these factors, as far as expansion tells, all give zero for is a direction.
    """
    moving = [*spec.positions, *spec.velocities, *(c.acceleration for c in spec.coordinates), TIME]
    rows: dict[tuple[int, sp.Expr], list[sp.Expr]] = {}
    for number, expression in enumerate(whole):
        for i, q in enumerate(spec.positions):
            for term in sp.Add.make_args(sp.expand(expression.diff(q), trig=True)):
                factor, motion = term.as_independent(*moving, as_Add=False)
                row = rows.setdefault((number, motion), [sp.S.Zero] * len(spec.positions))
                row[i] += factor
    kept = [row for row in rows.values() if any(x != 0 for x in row)]
    found = sp.Matrix(kept).nullspace(simplify=True) if kept else []
    return [tuple(sp.factor(x) for x in _whole(v)) for v in found]


def _whole(v: sp.Matrix) -> sp.Matrix:
    """Return `v` times the denominators of its entries."""
    below = sp.S.One
    for x in v:
        below = sp.lcm(below, sp.denom(sp.together(x)))
    return v.applyfunc(lambda x: sp.cancel(x * below))


def _constant(
    expressions: Sequence[sp.Expr], symbols: Sequence[sp.Symbol], v: Sequence[sp.Expr]
) -> bool:
    """Return whether no expression changes along `v`, as far as expansion tells."""
    moved = [(s, x) for s, x in zip(symbols, v, strict=True) if x]
    for expression in expressions:
        present = [(s, x) for s, x in moved if s in expression.free_symbols]
        if len(present) == 1 and len(moved) == 1:
            return False
        slope = sp.Add(*(x * expression.diff(s) for s, x in present))
        if slope != 0 and sp.expand(slope, trig=True) != 0:
            return False
    return True


def trailing_zeros(coefficients: Sequence[sp.Expr]) -> int:
    """Return how many coefficients at the end, highest power first, are zero; never all."""
    count = 0
    while count < len(coefficients) - 1 and coefficients[len(coefficients) - 1 - count] == 0:
        count += 1
    return count


def cyclic_blocks(
    spec: ModelSpec, dynamics: Dynamics, directions: Sequence[CyclicDirection], at_origin: int
) -> tuple[Block, ...]:
    """Return the zeros at the origin by direction, and the conserved momenta, where there are."""
    blocks = []
    if at_origin:
        builder = BlockBuilder(CYCLIC, f"{spec.title}: zeros at the origin", spec.own)
        left = at_origin
        for k, direction in enumerate(directions):
            own = min(direction.zeros, left)
            left -= own
            builder.give(f"cyclic{k + 1}", sp.Integer(own), "", direction.text)
        blocks.append(builder.build())
    momenta = conserved_momenta(spec, dynamics)
    if momenta:
        builder = BlockBuilder(CONSERVED, f"{spec.title}: conserved momenta", spec.own)
        for k, name in enumerate(momenta):
            text = f"the momentum along {name} is conserved, as no actuator changes it"
            builder.give(f"conserved{k + 1}", sp.S.One, "", text)
        blocks.append(builder.build())
    return tuple(blocks)
