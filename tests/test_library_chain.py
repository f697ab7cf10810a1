"""The chain of links: physics from elsewhere, gains that are what they claim, code and flight.

MuJoCo measures each joint from the link below, the model each link from the upright; belts and
rotors turn with the joint, which is what MuJoCo calls its armature.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from pfaffian.derive.derivation.derive import derive
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.mechanics.chain import chain, forward_dynamics
from pfaffian.derive.models.chain.spec import chain_model
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
from pfaffian.derive.sets.gains import zero_polynomial
from pfaffian.derive.spec.check import check_spec
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.verify.compare import verify
from pfaffian.derive.verify.oracle import Oracle
from pfaffian.derive.verify.subjects import CompiledUnderTest, PythonUnderTest
from pfaffian.runtime.code.generated_model import (
    fill_records,
    host_model,
    open_generated,
    ppc750_model,
)
from pfaffian.runtime.flight.closed_loop import differing_bits, fly
from pfaffian.runtime.flight.metrics import status_counts
from pfaffian.runtime.flight.scenario import read_scenario
from scipy.linalg import solve_continuous_are

COUNT = 300


class Physics:
    """A chain as MuJoCo sees it, from the model's parameters; motors in all joints but the first.

    Angles and torques are the model's: from the upright, and on link k + 1 against link k.
    """

    def __init__(self, values: dict[str, float], links: int) -> None:
        bodies = ""
        for k in reversed(range(1, links + 1)):
            inertia = values[f"inertia{k}"]
            below = f"0 0 {values[f'length{k - 1}']}" if k > 1 else "0 0 0"
            armature = values[f"belt{k - 1}"] if k > 1 else 0.0
            bodies = f"""
            <body pos="{below}">
              <joint name="r{k}" type="hinge" axis="0 -1 0" armature="{armature}"/>
              <inertial pos="0 0 {values[f"centre{k}"]}" mass="{values[f"mass{k}"]}"
                        diaginertia="{inertia} {inertia} {inertia}"/>
              {bodies}
            </body>"""
        motors = "".join(f'<motor joint="r{k}"/>' for k in range(2, links + 1))
        self.model = mujoco.MjModel.from_xml_string(
            f'<mujoco><compiler angle="radian"/><option gravity="0 0 -{values["g"]}"/>'
            f"<worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>"
        )
        self.data = mujoco.MjData(self.model)

    def accelerations(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Return q'' (n,) of the angles from the upright."""
        self.data.qpos[:], self.data.qvel[:] = np.diff(q, prepend=0.0), np.diff(dq, prepend=0.0)
        self.data.ctrl[:] = torque
        mujoco.mj_forward(self.model, self.data)
        return np.cumsum(self.data.qacc)


@pytest.fixture(scope="module")
def folder():
    return open_generated("chain")


@pytest.fixture(scope="module")
def host(folder):
    return host_model(folder)


@pytest.fixture(scope="module")
def values(folder):
    return folder.parameters("triple")


@pytest.fixture(scope="module")
def source():
    found = find_model("chain")
    model = lowered_model(found)
    return derivation_of(found), model, [s.as_dict() for s in library_sets(model, found)]


def _random(links: int, count: int = COUNT) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(7)
    angles = rng.uniform(-np.pi, np.pi, (count, links))
    rates = rng.normal(0.0, 3.0, (count, links))
    return angles, rates, rng.normal(0.0, 20.0, (count, links - 1))


def _states(host, q: np.ndarray, dq: np.ndarray):
    state = host.records("plant_state", len(q))
    for k in range(q.shape[1]):
        state[f"q{k + 1}"], state[f"dq{k + 1}"] = q[:, k], dq[:, k]
    return state


def test_every_identity_is_proved(source):
    assert len(source[0].identities) >= 6
    assert [i.name for i in source[0].identities if not i.proved] == []


def test_accelerations_agree_with_mujoco(host, values):
    q, dq, torque = _random(3)
    physics = Physics(values, 3)
    theirs = np.array([physics.accelerations(*r) for r in zip(q, dq, torque, strict=True)])
    applied, rate = host.records("plant_input", COUNT), host.records("plant_rate", COUNT)
    applied["tau1"], applied["tau2"] = torque.T
    params = fill_records(host.records("plant_params", COUNT), values)
    host.acceleration(params, _states(host, q, dq), applied, rate)
    ours = np.column_stack([rate[f"ddq{k}"] for k in (1, 2, 3)])
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-11 * np.abs(theirs).max())


def test_friction_acts_between_the_links(host, values):
    """Each hinge takes the power damping times its relative rate squared, whatever the state."""
    q, dq, torque = _random(3)
    damping = {"damping1": 0.3, "damping2": 0.7, "damping3": 1.1}
    applied = host.records("plant_input", COUNT)
    applied["tau1"], applied["tau2"] = torque.T
    rates = []
    for changes in ({}, damping):
        params = fill_records(host.records("plant_params", COUNT), values | changes)
        rate = host.records("plant_rate", COUNT)
        host.acceleration(params, _states(host, q, dq), applied, rate)
        rates.append(np.column_stack([rate[f"ddq{k}"] for k in (1, 2, 3)]))
    lost = np.empty(COUNT)
    for k, angles in enumerate(q):
        mass = _mass_matrix(values, angles)
        lost[k] = dq[k] @ mass @ (rates[0][k] - rates[1][k])
    relative = np.diff(dq, prepend=0.0, axis=1)
    np.testing.assert_allclose(lost, relative**2 @ list(damping.values()), rtol=1e-9, atol=1e-9)


def _mass_matrix(values: dict[str, float], q: np.ndarray) -> np.ndarray:
    """Return M (3, 3) of the angles from the upright, out of MuJoCo's for relative ones."""
    physics = Physics(values, 3)
    physics.accelerations(q, np.zeros(3), np.zeros(2))
    theirs = np.zeros((3, 3))
    mujoco.mj_fullM(physics.model, physics.data, theirs)
    relative = np.eye(3) - np.eye(3, k=-1)
    return relative.T @ theirs @ relative


def test_energy_is_kept_in_two_seconds_of_free_motion(host, values):
    state = _states(host, np.array([[0.7, 0.4, -0.9]]), np.array([[1.0, -2.0, 3.0]]))
    params = fill_records(host.records("plant_params"), values)
    weightless = fill_records(host.records("plant_params"), values | {"g": 0.0})
    applied, step, energy = host.records("plant_input"), np.array([1e-4]), np.zeros(1)
    host.energy(params, state, energy)
    before, moving = energy[0], 0.0
    for _ in range(20):
        host.plant_step(state, params, applied, step, 1000)
        host.energy(weightless, state, energy)
        moving = max(moving, energy[0])
    host.energy(params, state, energy)
    assert moving > 0.0
    assert abs(energy[0] - before) < 1e-8 * moving


def _verified(folder, source, host, target, target_samples):
    subjects = [PythonUnderTest(folder), CompiledUnderTest(host, "c-host")]
    found = verify(*source, subjects, target, samples=300, target_samples=target_samples)
    assert found.passed, found.worst_scaled_ulp
    return found


def test_generated_code_is_verified_on_the_host(folder, source, host):
    found = _verified(folder, source, host, None, 0)
    assert {r.language for r in found.functions} == {"python", "c-host"}


@pytest.mark.target
def test_the_target_has_the_same_bits(folder, source, host):
    target = CompiledUnderTest(ppc750_model(folder), "c-ppc750")
    found = _verified(folder, source, host, target, 300)
    assert found.target_samples == 300
    assert found.target_mismatches == 0


@pytest.fixture(scope="module")
def flight(host):
    return fly(read_scenario("chain-balance"), host, host, "host")


def test_the_lean_is_caught(flight, values):
    """With zeros from -2.5 1/s on, one percent of the lean is left after five seconds."""
    for k in (1, 2, 3):
        lean = np.abs(flight.measured[f"q{k}"])
        assert lean[0] == 0.05
        assert lean[-500:].max() < 0.01 * lean[0]
    for k in (1, 2):
        assert np.abs(flight.output[f"tau{k}"]).max() <= values[f"tau{k}_limit"]
    assert np.isfinite(flight.energy).all()
    assert set(status_counts(flight)) == {"OK"}


@pytest.mark.target
def test_a_thousand_steps_on_the_target_have_the_host_s_bits(folder, host):
    scenario = replace(read_scenario("chain-balance"), steps=1000)
    there = fly(scenario, ppc750_model(folder), host, "pil-unicorn")
    assert differing_bits(fly(scenario, host, host, "host"), there) == 0


def _state_space(values: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return (A, B) of MuJoCo's frictionless plant at the upright, x = (q, q')."""
    physics = Physics(values, 3)
    a, b, still = np.zeros((6, 6)), np.zeros((6, 2)), np.zeros(3)
    a[:3, 3:] = np.eye(3)
    for k, e in enumerate(1e-5 * np.eye(3)):
        up, down = (physics.accelerations(s * e, still, np.zeros(2)) for s in (1, -1))
        a[3:, k] = (up - down) / 2e-5
    for k, e in enumerate(np.eye(2)):
        b[3:, k] = physics.accelerations(still, still, e)
    return a, b


def test_the_gains_are_the_riccati_rows_they_are_said_to_be(values):
    a, b = _state_space(values)
    p = solve_continuous_are(a, b, np.diag([1.0, 1.0, 1.0, 0.1, 0.1, 0.1]), 1e-4 * np.eye(2))
    rows = np.linalg.solve(b.T @ p @ b, b.T @ p)  # scaled so that ADB = R b is the identity
    for k, row in enumerate(rows, 1):
        theirs = [values[f"{kind}{k}{j}"] for kind in ("rate", "weight") for j in (1, 2, 3)]
        np.testing.assert_allclose(theirs, row, rtol=2e-5)


def test_adb_is_one_at_the_setpoint(folder, values):
    module = folder.python_module()
    params = module.Params(**{n: values[n] for n in folder.manifest.structures["params"].names()})
    upright = module.Input(**dict.fromkeys(folder.manifest.structures["input"].names(), 0.0))
    assert float(module.input_gain(params, upright)) == pytest.approx(
        1.0, abs=1e-4
    )  # six digits a gain


def test_mujoco_s_plant_under_the_constraints_has_the_zeros_of_the_polynomial(source, values):
    a, b = _state_space(values)
    rows = np.array(
        [
            [values[f"{kind}{k}{j}"] for kind in ("rate", "weight") for j in (1, 2, 3)]
            for k in (1, 2)
        ]
    )
    held = a - b @ np.linalg.solve(rows @ b, rows @ a)
    within = np.linalg.svd(rows)[2][2:].T
    theirs = np.linalg.eigvals(within.T @ held @ within)
    ours = np.roots(zero_polynomial(source[1], values))
    assert (ours.real < 0.0).all()
    np.testing.assert_allclose(np.sort_complex(theirs), np.sort_complex(ours), rtol=1e-5)


@pytest.mark.parametrize("links", [2, 4])
def test_chains_of_other_lengths_derive_and_move_as_mujoco_s(links):
    spec = chain_model(links)
    check_spec(spec)
    derivation = derive(spec)
    assert [i.name for i in derivation.identities if not i.proved] == []
    block = derivation.block("acceleration")
    oracle = Oracle(block)
    rng = np.random.default_rng(links)
    values = {p.name: float(rng.uniform(0.2, 2.0)) for p in spec.parameters}
    values |= {p.name: 0.0 for p in spec.parameters if p.group == "uncertainty"}
    physics = Physics(values, links)
    for q, dq, torque in zip(*_random(links, 20), strict=True):
        at = {f"q{k + 1}": x for k, x in enumerate(q)}
        at |= {f"dq{k + 1}": x for k, x in enumerate(dq)}
        at |= {f"tau{k + 1}": x for k, x in enumerate(torque)}
        known = values | at
        ours, _ = oracle({s.name: float(known[s.name]) for s in block.inputs})
        theirs = physics.accelerations(q, dq, torque)
        np.testing.assert_allclose([float(x) for x in ours], theirs, rtol=1e-8, atol=1e-9)


def test_without_belts_it_is_the_chain_of_the_benchmark(source, values):
    """The benchmark measures from the horizontal, drives the base too, and has no belts."""
    block = forward_dynamics(chain(3))
    oracle, model = Oracle(block), source[1]
    plant = dict(values) | {"belt1": 0.0, "belt2": 0.0, "damping1": 0.0}
    plant |= {"damping2": 0.0, "damping3": 0.0}
    theirs = {"m": "mass", "len": "length", "c": "centre", "J": "inertia"}
    for q, dq, torque in zip(*_random(3, 20), strict=True):
        at = {f"q{k + 1}": x for k, x in enumerate(q)}
        at |= {f"dq{k + 1}": x for k, x in enumerate(dq)}
        ours = evaluate(
            model.program("acceleration"), plant | at | {"tau1": torque[0], "tau2": torque[1]}
        )
        named = at | {f"q{k + 1}": x + np.pi / 2 for k, x in enumerate(q)}
        named |= {"tau1": 0.0, "tau2": torque[0], "tau3": torque[1], "g": values["g"]}
        named |= {
            f"{short}{k}": values.get(f"{long}{k}", 0.0)
            for short, long in theirs.items()
            for k in (1, 2, 3)
        }
        found, _ = oracle({s.name: float(named[s.name]) for s in block.inputs})
        np.testing.assert_allclose(
            list(ours.values()), [float(x) for x in found], rtol=1e-9, atol=1e-9
        )


def test_the_committed_generation_has_not_drifted(run):
    checked = run("generate", "chain", "--check")
    assert checked.code == 0, checked.out + checked.err
