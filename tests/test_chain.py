"""The n-link chain: derived from its energies, equal to the plain Lagrangian, and lean."""

import json
import math

import pytest
import sympy as sp
from pfaffian.benchmarks.chain_peers import PEERS
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.lower.to_program import lower
from pfaffian.derive.mechanics.chain import chain, forward_dynamics
from pfaffian.derive.mechanics.lagrange import christoffel_matrix, mass_matrix, velocity_forces
from pfaffian.derive.symbolic.normal_form import is_zero, trigonometric_sum, zero_matrix
from pfaffian.runtime.base.errors import InputError


@pytest.mark.parametrize("links", [1, 2, 3])
def test_it_is_the_plain_lagrangian(links):
    """d/dt dL/dq' - dL/dq, differentiated without any of the shortcuts, gives the same forces."""
    plant = chain(links)
    q, dq = list(plant.angles), list(plant.rates)
    lagrangian = plant.kinetic_energy - plant.potential_energy
    plain_mass = sp.hessian(plant.kinetic_energy, dq)
    momentum = [lagrangian.diff(r) for r in dq]
    plain = sp.Matrix(
        [
            sum(momentum[i].diff(q[k]) * dq[k] for k in range(links)) - lagrangian.diff(q[i])
            for i in range(links)
        ]
    )
    mass = mass_matrix(trigonometric_sum(plant.kinetic_energy), dq, "chain")
    ours = velocity_forces(mass, q, dq) + sp.Matrix([plant.potential_energy]).jacobian(q).T
    assert zero_matrix(mass - plain_mass)
    assert zero_matrix(ours - plain)


def test_velocity_forces_are_c_times_the_rates():
    plant = chain(3)
    q, dq = sp.Matrix(plant.angles), sp.Matrix(plant.rates)
    mass = mass_matrix(trigonometric_sum(plant.kinetic_energy), list(dq), "chain")
    difference = velocity_forces(mass, list(q), list(dq)) - christoffel_matrix(mass, q, dq) * dq
    assert zero_matrix(difference)


@pytest.mark.parametrize("links", [2, 3, 5])
def test_every_tool_of_the_benchmark_gives_the_same_accelerations(links):
    values: dict[str, float] = {}
    for k in range(1, links + 1):
        values |= {f"q{k}": 0.3 * k, f"dq{k}": 1.0 - 0.4 * k, f"tau{k}": 0.1 * k, f"m{k}": 1.0 / k}
        values |= {f"len{k}": 0.5 + 0.1 * k, f"c{k}": 0.2 + 0.03 * k, f"J{k}": 0.02 * k}
    values["g"] = 9.8
    ours = evaluate(PEERS["ours"](links), values)
    for tool in ("casadi", "kanes_method", "lagranges_method"):
        theirs = evaluate(PEERS[tool](links), values)
        for name, value in ours.items():
            assert theirs[name] == pytest.approx(value, rel=1e-10), (tool, name)


def test_operations_grow_no_faster_than_the_power_2_3_and_stay_below_casadi():
    counts = {n: sum(lower(forward_dynamics(chain(n))).op_count().values()) for n in (4, 8)}
    assert math.log2(counts[8] / counts[4]) <= 2.3
    casadi = sum(PEERS["casadi"](4).op_count().values())
    assert counts[4] < casadi


def test_a_kinetic_energy_that_is_no_quadratic_form_is_refused():
    x, v = sp.symbols("x v", real=True)
    for energy in (v**3, v**2 + v, v**2 + x, sp.sin(v)):
        with pytest.raises(InputError, match="quadratic"):
            mass_matrix(energy, [v], "somewhere")
    assert is_zero(mass_matrix(x * v**2 / 2, [v], "somewhere")[0] - x)


@pytest.mark.parametrize("links", [0, 13])
def test_a_chain_out_of_range_is_refused(links):
    with pytest.raises(InputError, match="out of range"):
        chain(links)


@pytest.mark.target
def test_benchmark_prints_its_rows_and_ours_takes_the_fewest_instructions(run):
    done = run("bench", "chain", "--links", "3", "--json")
    assert done.code == 0
    rows = json.loads(done.out)["rows"]
    assert {r["tool"] for r in rows} == set(PEERS)
    by_tool = {r["tool"]: r["ppc750_instructions"] for r in rows}
    assert by_tool["ours"] == min(by_tool.values())
    assert all(set(r) == {"n", "tool", "derive_s", "ops", "ppc750_instructions"} for r in rows)
