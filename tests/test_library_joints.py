"""Plants of the library with two joints: physics from elsewhere, verified code, closed loops.

MuJoCo models and published equations take their numbers from the parameter set that was generated,
so a parameter that is misunderstood, not one that is mistyped, is what these tests would show.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
from pfaffian.derive.sets.raw_set import read_set
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.verify.compare import LIMIT_ULP, verify
from pfaffian.derive.verify.subjects import CompiledUnderTest, PythonUnderTest
from pfaffian.runtime.code.generated_model import (
    fill_records,
    host_model,
    open_generated,
    ppc750_model,
)
from pfaffian.runtime.flight.closed_loop import differing_bits, fly
from pfaffian.runtime.flight.metrics import status_counts, tracking_metrics
from pfaffian.runtime.flight.scenario import read_scenario

#: Stands for an inertia that cannot matter: of a body that does not turn about that axis.
_NEVER = "1"


def _cart_pole(p: SimpleNamespace) -> str:
    """A hinge about +y turns z towards x: theta from the upright, to the right."""
    return f"""
    <body>
      <joint name="x" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="{p.cart_mass}" diaginertia="{_NEVER} {_NEVER} {_NEVER}"/>
      <body>
        <joint name="theta" type="hinge" axis="0 1 0"/>
        <inertial pos="0 0 {p.half_length}" mass="{p.pole_mass}"
                  diaginertia="{_NEVER} {p.pole_inertia} {_NEVER}"/>
      </body>
    </body>"""


def _acrobot(p: SimpleNamespace) -> str:
    """Hinges about -y turn x towards z: q1 from the horizontal, upwards."""
    return f"""
    <body>
      <joint name="q1" type="hinge" axis="0 -1 0"/>
      <inertial pos="{p.lc1} 0 0" mass="{p.m1}" diaginertia="{p.I1} {p.I1} {p.I1}"/>
      <body pos="{p.l1} 0 0">
        <joint name="q2" type="hinge" axis="0 -1 0"/>
        <inertial pos="{p.lc2} 0 0" mass="{p.m2}" diaginertia="{p.I2} {p.I2} {p.I2}"/>
      </body>
    </body>"""


def _furuta(p: SimpleNamespace) -> str:
    """The arm along x turns about z; a hinge about -x turns the upright towards +y, onwards.

    The slender pendulum has no inertia about its own axis; MuJoCo takes no less than 1e-15.
    """
    return f"""
    <body>
      <joint name="theta" type="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{_NEVER} {_NEVER} {p.arm_inertia}"/>
      <body pos="{p.arm_length} 0 0">
        <joint name="alpha" type="hinge" axis="-1 0 0"/>
        <inertial pos="0 0 {p.half_length}" mass="{p.pendulum_mass}"
                  diaginertia="{p.pendulum_inertia} {p.pendulum_inertia} 2e-15"/>
      </body>
    </body>"""


def _reaction_wheel(p: SimpleNamespace) -> str:
    return f"""
    <body>
      <joint name="theta" type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 {p.pendulum_centre}" mass="{p.pendulum_mass}"
                diaginertia="{_NEVER} {p.pendulum_inertia} {_NEVER}"/>
      <body pos="0 0 {p.wheel_centre}">
        <joint name="phi" type="hinge" axis="0 1 0"/>
        <inertial pos="0 0 0" mass="{p.wheel_mass}"
                  diaginertia="{_NEVER} {p.wheel_inertia} {_NEVER}"/>
      </body>
    </body>"""


Motion = tuple[np.ndarray, np.ndarray]


def _barto(p: SimpleNamespace, q: Motion, dq: Motion, u: np.ndarray) -> Motion:
    """Barto, Sutton and Anderson 1983, appendix: uniform pole, without friction."""
    (_, theta), (_, rate), m, length = q, dq, p.pole_mass, p.half_length
    total, sin, cos = p.cart_mass + m, np.sin(theta), np.cos(theta)
    push = (-u - m * length * rate**2 * sin) / total
    angular = (p.g * sin + cos * push) / (length * (4 / 3 - m * cos**2 / total))
    return (u + m * length * (rate**2 * sin - angular * cos)) / total, angular


def _spong(p: SimpleNamespace, q: Motion, dq: Motion, u: np.ndarray) -> Motion:
    """Spong 1995: d11 q1'' + d12 q2'' + h1 + phi1 = 0, d12 q1'' + d22 q2'' + h2 + phi2 = tau."""
    coupling = p.m2 * p.l1 * p.lc2
    d22 = p.m2 * p.lc2**2 + p.I2
    d12 = d22 + coupling * np.cos(q[1])
    d11 = p.m1 * p.lc1**2 + p.m2 * p.l1**2 + p.I1 + d22 + 2 * coupling * np.cos(q[1])
    h1 = -coupling * np.sin(q[1]) * (dq[1] ** 2 + 2 * dq[1] * dq[0])
    h2 = coupling * np.sin(q[1]) * dq[0] ** 2
    phi2 = p.m2 * p.lc2 * p.g * np.cos(q[0] + q[1])
    phi1 = (p.m1 * p.lc1 + p.m2 * p.l1) * p.g * np.cos(q[0]) + phi2
    return _solve(d11, d12, d22, -h1 - phi1, u - h2 - phi2)


def _cazzolato(p: SimpleNamespace, q: Motion, dq: Motion, u: np.ndarray) -> Motion:
    """Cazzolato and Prime 2011, slender pendulum; their theta2 hangs down and runs backwards."""
    hanging, rate, arm = np.pi - q[1], -dq[1], dq[0]
    j2 = p.pendulum_inertia + p.pendulum_mass * p.half_length**2
    j0 = p.arm_inertia + p.pendulum_mass * p.arm_length**2
    coupling = p.pendulum_mass * p.arm_length * p.half_length
    sin, double = np.sin(hanging), np.sin(2 * hanging)
    first = u + coupling * sin * rate**2 - arm * rate * double * j2
    weight = p.g * p.pendulum_mass * p.half_length * sin
    second = arm**2 * double * j2 / 2 - weight
    theta, back = _solve(j0 + j2 * sin**2, coupling * np.cos(hanging), j2, first, second)
    return theta, -back


def _wheel(p: SimpleNamespace, q: Motion, _: Motion, u: np.ndarray) -> Motion:
    """Spong, Corke and Lozano 2001 in relative angles: the torque turns the pendulum back."""
    moment = p.pendulum_mass * p.pendulum_centre + p.wheel_mass * p.wheel_centre
    inertia = p.pendulum_mass * p.pendulum_centre**2 + p.wheel_mass * p.wheel_centre**2
    theta = (moment * p.g * np.sin(q[0]) - u) / (inertia + p.pendulum_inertia)
    return theta, u / p.wheel_inertia - theta


def _solve(d11, d12, d22, first, second) -> Motion:
    det = d11 * d22 - d12**2
    return (d22 * first - d12 * second) / det, (d11 * second - d12 * first) / det


@dataclass(frozen=True)
class Plant:
    """A model, its set and scenario; torques and rates of usual size; physics from elsewhere."""

    model: str
    set_name: str
    scenario: str
    torque: float
    rates: tuple[float, float]
    bodies: Callable[[SimpleNamespace], str]
    published: Callable[[SimpleNamespace, Motion, Motion, np.ndarray], Motion]


PLANTS = (
    Plant("cart_pole", "barto", "cart-pole-balance", 5.0, (2.0, 5.0), _cart_pole, _barto),
    Plant("acrobot", "spong", "acrobot-balance", 10.0, (3.0, 5.0), _acrobot, _spong),
    Plant("furuta", "qube", "furuta-balance", 0.02, (10.0, 10.0), _furuta, _cazzolato),
    Plant(
        "reaction_wheel",
        "kit",
        "reaction-wheel-balance",
        0.02,
        (5.0, 200.0),
        _reaction_wheel,
        _wheel,
    ),
)


class Rig:
    """One plant as generated C on the host, and as MuJoCo sees it."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.folder = open_generated(plant.model)
        self.values = self.folder.parameters(plant.set_name)
        self.names = self.folder.manifest.coordinates
        self.actuator = self.folder.manifest.actuators[0]
        self.host = host_model(self.folder)
        self.p = SimpleNamespace(**self.values)
        driven = {"cart_pole": "x", "acrobot": "q2", "furuta": "theta", "reaction_wheel": "phi"}
        self.mj = mujoco.MjModel.from_xml_string(
            f'<mujoco><compiler angle="radian"/><option gravity="0 0 -{self.p.g}"/>'
            f"<worldbody>{plant.bodies(self.p)}</worldbody>"
            f'<actuator><motor joint="{driven[plant.model]}"/></actuator></mujoco>'
        )
        self.data = mujoco.MjData(self.mj)

    def params(self, count: int = 1, **changes: float):
        return fill_records(self.host.records("plant_params", count), self.values | changes)

    def states(self, q: np.ndarray, dq: np.ndarray):
        """Return plant states from q and q' (N, 2)."""
        state = self.host.records("plant_state", len(q))
        for k, name in enumerate(self.names):
            state[name], state[f"d{name}"] = q[:, k], dq[:, k]
        return state

    def accelerations(self, q: np.ndarray, dq: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return q'' (N, 2) of the generated C."""
        applied, rate = (self.host.records(r, len(q)) for r in ("plant_input", "plant_rate"))
        applied[self.actuator] = u
        self.host.acceleration(self.params(len(q)), self.states(q, dq), applied, rate)
        return np.column_stack([rate[f"dd{n}"] for n in self.names])

    def mujoco_acceleration(self, q: np.ndarray, dq: np.ndarray, u: float) -> np.ndarray:
        self.data.qpos[:], self.data.qvel[:], self.data.ctrl[0] = q, dq, u
        mujoco.mj_forward(self.mj, self.data)
        return self.data.qacc.copy()

    def random(self, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rng = np.random.default_rng(7)
        q = rng.uniform(-np.pi, np.pi, (count, 2))
        dq = rng.normal(0.0, 1.0, (count, 2)) * self.plant.rates
        return q, dq, rng.normal(0.0, self.plant.torque, count)

    def energy(self, state, **changes: float) -> np.ndarray:
        energy = np.zeros(len(state))
        self.host.energy(self.params(len(state), **changes), state, energy)
        return energy


@pytest.fixture(scope="module", params=PLANTS, ids=lambda plant: plant.model)
def rig(request) -> Rig:
    return Rig(request.param)


@pytest.fixture(scope="module")
def source(rig):
    folder = find_model(rig.plant.model)
    model = lowered_model(folder)
    return derivation_of(folder), model, [s.as_dict() for s in library_sets(model, folder)]


def test_every_identity_is_proved(source):
    assert len(source[0].identities) >= 6
    assert [i.name for i in source[0].identities if not i.proved] == []


def test_accelerations_agree_with_mujoco(rig):
    q, dq, u = rig.random(300)
    theirs = np.array([rig.mujoco_acceleration(*row) for row in zip(q, dq, u, strict=True)])
    scale = np.abs(theirs).max(axis=0)
    np.testing.assert_allclose(rig.accelerations(q, dq, u) / scale, theirs / scale, 1e-8, 1e-11)


def test_accelerations_agree_with_the_published_equations(rig):
    q, dq, u = rig.random(300)
    theirs = np.column_stack(rig.plant.published(rig.p, tuple(q.T), tuple(dq.T), u))
    scale = np.abs(theirs).max(axis=0)
    np.testing.assert_allclose(rig.accelerations(q, dq, u) / scale, theirs / scale, 1e-11, 1e-13)


def test_the_mass_matrix_is_mujoco_s(rig):
    """Without gravity the energy is T, of which M is the polarisation."""
    theirs = np.zeros((2, 2))
    for angle in rig.random(20)[0]:
        rig.mujoco_acceleration(angle, np.zeros(2), 0.0)
        mujoco.mj_fullM(rig.mj, rig.data, theirs)
        rates = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
        first, second, both = rig.energy(rig.states(np.tile(angle, (3, 1)), rates), g=0.0)
        off = both - first - second
        ours = np.array([[2 * first, off], [off, 2 * second]])
        np.testing.assert_allclose(ours, theirs, 1e-9, 1e-12 * np.abs(theirs).max())


def test_energy_is_kept_in_two_seconds_of_free_motion(rig):
    state = rig.states(np.array([[0.7, 0.4]]), 0.3 * np.array([rig.plant.rates]))
    applied, step = rig.host.records("plant_input"), np.array([1e-4])
    before, moving = rig.energy(state)[0], 0.0
    for _ in range(20):
        rig.host.plant_step(state, rig.params(), applied, step, 1000)
        moving = max(moving, rig.energy(state, g=0.0)[0])
    assert moving > 0.0
    assert abs(rig.energy(state)[0] - before) < 1e-8 * moving


def _verified(rig, source, target, target_samples):
    subjects = [PythonUnderTest(rig.folder), CompiledUnderTest(rig.host, "c-host")]
    found = verify(*source, subjects, target, samples=300, target_samples=target_samples)
    assert found.passed
    assert found.worst_scaled_ulp <= LIMIT_ULP
    return found


def test_generated_code_is_verified_on_the_host(rig, source):
    found = _verified(rig, source, None, 0)
    assert {r.language for r in found.functions} == {"python", "c-host"}


@pytest.mark.target
def test_the_target_has_the_same_bits(rig, source):
    target = CompiledUnderTest(ppc750_model(rig.folder), "c-ppc750")
    found = _verified(rig, source, target, 300)
    assert found.target_samples == 300
    assert found.target_mismatches == 0


@pytest.fixture(scope="module")
def flight(rig):
    return fly(read_scenario(rig.plant.scenario), rig.host, rig.host, "host")


def test_the_balance_scenario_converges(rig, flight):
    figures = tracking_metrics(flight)
    for name in rig.names:
        assert figures[f"mae2_{name}"] < 1e-5
        assert figures[f"mae_{name}"] > 0.04  # it did start away from the setpoint
    for records in (flight.measured, flight.output, flight.state):
        for name in records.dtype.names:
            assert np.isfinite(records[name]).all()
    assert figures["peak_torque"] <= rig.values["torque_limit"]
    counts = status_counts(flight)
    assert set(counts) <= {"OK", "SATURATED"}
    assert counts["OK"] > 0.98 * len(flight.time)


@pytest.mark.target
@pytest.mark.parametrize("rig", PLANTS[2:3], ids=lambda plant: plant.model, indirect=True)
def test_two_thousand_steps_on_the_target_have_the_host_s_bits(rig):
    scenario = replace(read_scenario(rig.plant.scenario), steps=2000)
    there = fly(scenario, ppc750_model(rig.folder), rig.host, "pil-unicorn")
    here = fly(scenario, rig.host, rig.host, "host")
    assert differing_bits(here, there) == 0
    assert here.sha256() == there.sha256()


def test_the_committed_generation_has_not_drifted(rig, run):
    checked = run("generate", rig.plant.model, "--check")
    assert checked.code == 0, checked.out + checked.err


def _slope(function: Callable[[float], np.ndarray], step: float) -> np.ndarray:
    """Return the derivative at 0 by five points, the error of order step^4."""
    near = function(step) - function(-step)
    far = function(2 * step) - function(-2 * step)
    return (8 * near - far) / (12 * step)


def _zeros(rig: Rig, setpoint: Mapping[str, float]) -> np.ndarray:
    """Return the poles of MuJoCo's plant, linearised at the setpoint, with s = 0 imposed."""
    still = np.array([setpoint[n] for n in rig.names])
    a, b = np.zeros((4, 4)), np.zeros(4)
    a[:2, 2:] = np.eye(2)
    for k, unit in enumerate(np.eye(2)):
        a[2:, k] = _slope(lambda h, e=unit: rig.mujoco_acceleration(still + h * e, 0 * e, 0), 1e-3)
        a[2:, 2 + k] = _slope(lambda h, e=unit: rig.mujoco_acceleration(still, h * e, 0), 1e-3)
    b[2:] = _slope(lambda h: rig.mujoco_acceleration(still, np.zeros(2), h), rig.plant.torque)
    weights = np.array([rig.values.get(f"weight_{n}", 1.0) for n in rig.names])
    rates = np.array([rig.values[f"rate_{n}"] for n in rig.names])
    row = np.concatenate([weights * rates, weights])
    held = a - np.outer(b, row @ a) / (row @ b)  # the torque that keeps s' = 0
    within = np.linalg.svd(row[None, :])[2][1:].T  # a basis of s = 0
    return np.linalg.eigvals(within.T @ held @ within)


def test_mujoco_s_plant_under_the_constraint_has_the_wanted_poles(rig, source):
    folder = find_model(rig.plant.model)
    raw = read_set(folder.set_path(rig.plant.set_name), source[1].parameters, folder.sets())
    setpoint = {n: rig.values[f"{n}d"] for n in rig.names}
    found, wanted = _zeros(rig, setpoint), np.array(raw.poles)
    assert (found.real < 0.0).all()
    np.testing.assert_allclose(np.poly(found), np.poly(wanted).real, rtol=1e-7)
    np.testing.assert_allclose(np.sort_complex(found.real), np.sort_complex(wanted.real), rtol=1e-3)
    np.testing.assert_allclose(found.imag, 0.0, atol=1e-3 * np.abs(wanted).max())
