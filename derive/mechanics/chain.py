"""The planar chain of n links: the plant on which the derivation's growth is measured.

Each link's angle is measured from the horizontal, so that its velocity does not depend on the
links below it: M_ij = a_ij cos(q_i - q_j), and the bias holds one sine and one square a pair.
"""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.mechanics.block_terms import define_trigonometry
from pfaffian.derive.mechanics.lagrange import mass_matrix, velocity_forces
from pfaffian.derive.mechanics.mass_solver import define_factors, define_solution
from pfaffian.derive.symbolic.block import Block, BlockBuilder
from pfaffian.derive.symbolic.normal_form import trigonometric_sum
from pfaffian.runtime.base.errors import InputError

MAX_LINKS = 12


@dataclass(frozen=True)
class Chain:
    """Symbols and energies of a chain: q, q' (n,), torques on the joints (n,), parameters, T, V."""

    angles: tuple[sp.Symbol, ...]
    rates: tuple[sp.Symbol, ...]
    torques: tuple[sp.Symbol, ...]
    masses: tuple[sp.Symbol, ...]
    lengths: tuple[sp.Symbol, ...]
    centres: tuple[sp.Symbol, ...]
    inertias: tuple[sp.Symbol, ...]
    gravity: sp.Symbol
    kinetic_energy: sp.Expr
    potential_energy: sp.Expr

    @property
    def parameters(self) -> tuple[sp.Symbol, ...]:
        """Return every parameter, in the order in which functions take them."""
        return (*self.masses, *self.lengths, *self.centres, *self.inertias, self.gravity)


def chain(links: int) -> Chain:
    """Return the chain of `links` links, by the positions of its centres of mass."""
    if not 1 <= links <= MAX_LINKS:
        raise InputError(
            f"a chain of {links} links is out of range", remedy=f"give 1 to {MAX_LINKS} links"
        )

    def symbols(letter: str, *, positive: bool = True) -> tuple[sp.Symbol, ...]:
        names = [f"{letter}{k + 1}" for k in range(links)]
        return tuple(sp.Symbol(n, positive=True) if positive else sp.Symbol(n, real=True)
                     for n in names)  # fmt: skip

    q, dq = symbols("q", positive=False), symbols("dq", positive=False)
    mass, length, centre, inertia = (symbols(s) for s in ("m", "len", "c", "J"))
    g = sp.Symbol("g", positive=True)
    joint = sp.zeros(2, 1)
    speed = sp.zeros(2, 1)
    kinetic, potential = sp.S.Zero, sp.S.Zero
    for k in range(links):
        along = sp.Matrix([sp.cos(q[k]), sp.sin(q[k])])
        across = sp.Matrix([-sp.sin(q[k]), sp.cos(q[k])]) * dq[k]
        velocity = speed + centre[k] * across
        kinetic += mass[k] * velocity.dot(velocity) / 2 + inertia[k] * dq[k] ** 2 / 2
        potential += mass[k] * g * (joint + centre[k] * along)[1]
        joint, speed = joint + length[k] * along, speed + length[k] * across
    return Chain(
        q, dq, symbols("tau", positive=False), mass, length, centre, inertia, g, kinetic, potential
    )


def forward_dynamics(plant: Chain) -> Block:
    """Return q'' of `plant`, derived from its energies: M by its coefficients, C q' without C.

    M is factored instead of inverted.
    """
    n = len(plant.angles)
    builder = BlockBuilder("acceleration", f"chain of {n} links: forward dynamics")
    for group, symbols in (
        ("input", (*plant.angles, *plant.rates)),
        ("torque", plant.torques),
        ("parameter", plant.parameters),
    ):
        for symbol in symbols:
            builder.take(symbol, "", "", group)
    mass = mass_matrix(trigonometric_sum(plant.kinetic_energy), plant.rates, f"chain of {n} links")
    gravity = [plant.potential_energy.diff(q) for q in plant.angles]
    moving = velocity_forces(mass, plant.angles, plant.rates)
    named = define_trigonometry(builder, [*mass, *moving, *gravity])
    defined = sp.zeros(n, n)
    for i in range(n):
        for j in range(i, n):
            entry = builder.define(f"m{i + 1}{j + 1}", mass[i, j].xreplace(named), "mass matrix")
            defined[i, j] = defined[j, i] = entry
    forces = []
    for i in range(n):
        after = plant.torques[i + 1] if i + 1 < n else sp.S.Zero
        applied = plant.torques[i] - after - moving[i] - gravity[i]
        forces.append(builder.define(f"force{i + 1}", applied.xreplace(named), "applied force"))
    factors = define_factors(builder, defined)
    for i, value in enumerate(define_solution(builder, factors, forces, "solved")):
        builder.give(f"ddq{i + 1}", value, "rad/s^2", f"acceleration of q{i + 1}")
    return builder.build()
