"""The chain's forward dynamics by other tools, lowered in the same way, for the benchmark.

Each peer gives M and the right-hand side of M q'' = f in its own form. The solution is CasADi's
`ldl` with `cse` for all of them, so that what differs is the derivation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import sympy as sp
from pfaffian.derive.ir.program import Program
from pfaffian.derive.lower.to_casadi import ToCasadi
from pfaffian.derive.lower.to_program import lower, lower_graph
from pfaffian.derive.mechanics.chain import Chain, chain, forward_dynamics
from pfaffian.derive.optimise.passes import optimised


def ours(links: int) -> Program:
    """Derive and lower with this package."""
    return optimised(lower(forward_dynamics(chain(links))))


def casadi_alone(links: int) -> Program:
    """Build the energies as a CasADi graph and let it differentiate them."""
    plant = chain(links)
    inputs = _inputs(plant)
    convert = ToCasadi(inputs)
    q, dq, tau = (ca.vertcat(*(inputs[s] for s in g)) for g in (plant.angles, plant.rates,
                                                                 plant.torques))  # fmt: skip
    kinetic, potential = _energies(plant, inputs, convert)
    momentum = ca.gradient(kinetic, dq)
    mass = ca.jacobian(momentum, dq)
    right = _joint_torques(tau) - ca.jtimes(momentum, q, dq) + ca.gradient(kinetic - potential, q)
    return _solved("casadi", inputs, mass, right)


def lagranges_method(links: int) -> Program:
    """Derive with SymPy's LagrangesMethod."""
    from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols

    plant = chain(links)
    moving, back = _moving(plant, dynamicsymbols)
    energy = (plant.kinetic_energy - plant.potential_energy).subs(moving)
    method = LagrangesMethod(energy, [moving[q] for q in plant.angles])
    method.form_lagranges_equations()
    mass, force = method.mass_matrix.subs(back), method.forcing.subs(back)
    return _from_sympy("lagranges_method", plant, mass, force)


def kanes_method(links: int) -> Program:
    """Derive with SymPy's KanesMethod, one frame a link."""
    from sympy.physics.mechanics import (
        KanesMethod,
        Point,
        ReferenceFrame,
        RigidBody,
        dynamicsymbols,
        inertia,
    )

    plant = chain(links)
    moving, _ = _moving(plant, dynamicsymbols)
    t = dynamicsymbols._t
    u = dynamicsymbols(f"u1:{links + 1}")
    ground = ReferenceFrame("N")
    joint = Point("O")
    joint.set_vel(ground, 0)
    bodies, loads, kinematic = [], [], []
    for k, q in enumerate(plant.angles):
        frame = ground.orientnew(f"F{k}", "Axis", [moving[q], ground.z])
        frame.set_ang_vel(ground, u[k] * ground.z)
        kinematic.append(moving[q].diff(t) - u[k])
        centre = joint.locatenew(f"C{k}", plant.centres[k] * frame.x)
        centre.v2pt_theory(joint, ground, frame)
        tensor = inertia(frame, 0, 0, plant.inertias[k])
        bodies.append(RigidBody(f"B{k}", centre, frame, plant.masses[k], (tensor, centre)))
        loads.append((centre, -plant.masses[k] * plant.gravity * ground.y))
        following = joint.locatenew(f"J{k}", plant.lengths[k] * frame.x)
        following.v2pt_theory(joint, ground, frame)
        joint = following
    method = KanesMethod(ground, [moving[q] for q in plant.angles], u, kd_eqs=kinematic)
    method.kanes_equations(bodies, loads)
    back = dict(zip(u, plant.rates, strict=True)) | {moving[q]: q for q in plant.angles}
    return _from_sympy(
        "kanes_method", plant, method.mass_matrix.subs(back), method.forcing.subs(back)
    )


PEERS: dict[str, Callable[[int], Program]] = {
    "ours": ours,
    "casadi": casadi_alone,
    "kanes_method": kanes_method,
    "lagranges_method": lagranges_method,
}


def _inputs(plant: Chain) -> dict[sp.Symbol, Any]:
    symbols = (*plant.angles, *plant.rates, *plant.torques, *plant.parameters)
    return {s: ca.SX.sym(s.name) for s in symbols}


def _moving(plant: Chain, dynamic: Callable[[str], Any]) -> tuple[dict[Any, Any], list[Any]]:
    """Return the substitution to functions of time, and the way back (rates first)."""
    t = dynamic._t  # type: ignore[attr-defined]
    functions = {q: dynamic(f"f{q.name}") for q in plant.angles}
    rates = {r: functions[q].diff(t) for q, r in zip(plant.angles, plant.rates, strict=True)}
    back = [(f, r) for r, f in rates.items()] + [(f, q) for q, f in functions.items()]
    return functions | rates, back


def _joint_torques(tau: Any) -> Any:
    """Return tau_i - tau_(i+1): what the motors do on angles measured from the horizontal."""
    return tau - ca.vertcat(tau[1:], 0)


def _energies(plant: Chain, inputs: dict[sp.Symbol, Any], convert: ToCasadi) -> tuple[Any, Any]:
    """Return T and V as graphs that share the positions of the joints, as a person writes them."""
    joint, speed = ca.SX.zeros(2), ca.SX.zeros(2)
    kinetic, potential = ca.SX(0), ca.SX(0)
    for k, (q, r) in enumerate(zip(plant.angles, plant.rates, strict=True)):
        along = ca.vertcat(convert(sp.cos(q)), convert(sp.sin(q)))
        across = ca.vertcat(-along[1], along[0]) * inputs[r]
        mass, length, centre, inertia, g = (
            inputs[s] for s in (plant.masses[k], plant.lengths[k], plant.centres[k],
                                plant.inertias[k], plant.gravity)
        )  # fmt: skip
        velocity = speed + centre * across
        kinetic += mass * ca.sumsqr(velocity) / 2 + inertia * inputs[r] ** 2 / 2
        potential += mass * g * (joint + centre * along)[1]
        joint, speed = joint + length * along, speed + length * across
    return kinetic, potential


def _from_sympy(name: str, plant: Chain, mass: sp.Matrix, force: sp.Matrix) -> Program:
    inputs = _inputs(plant)
    convert = ToCasadi(inputs)
    n = len(plant.angles)
    m = ca.vertcat(*(ca.horzcat(*(convert(mass[i, j]) for j in range(n))) for i in range(n)))
    tau = ca.vertcat(*(inputs[s] for s in plant.torques))
    right = ca.vertcat(*(convert(f) for f in force)) + _joint_torques(tau)
    return _solved(name, inputs, m, right)


def _solved(name: str, inputs: dict[sp.Symbol, Any], mass: Any, right: Any) -> Program:
    d, lt, p = ca.ldl(mass)
    found = ca.ldl_solve(right, d, lt, p)
    names = tuple(f"ddq{k + 1}" for k in range(found.numel()))
    return lower_graph(name, {s.name: v for s, v in inputs.items()}, names, ca.vertsplit(found))
