"""TORA, overhead crane and two-wheeled robot against sources that share no code with this project.

Accelerations come from MuJoCo, whose models are written here from the plants' drawings and the
parameters of the generated manifest, and from equations of motion written out by hand. The poles
of the zero dynamics come from a linearisation of the generated plant by finite differences.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import REPOSITORY
from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.generation import generate
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
from pfaffian.derive.sets.gains import polynomial_of
from pfaffian.derive.sets.raw_set import read_set
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.verify.compare import LIMIT_ULP, verify
from pfaffian.derive.verify.subjects import CompiledUnderTest, PythonUnderTest
from pfaffian.derive.writer import drift
from pfaffian.runtime.code.generated_model import fill_records, host_model, open_generated
from pfaffian.runtime.flight.closed_loop import fly
from pfaffian.runtime.flight.metrics import status_counts, tracking_metrics
from pfaffian.runtime.flight.scenario import read_scenario

Values = dict[str, float]
Array = np.ndarray[Any, Any]

TORA = """
<mujoco>
  <compiler angle="radian" inertiafromgeom="false"/>
  <option gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="x" type="slide" axis="1 0 0" stiffness="{stiffness}"/>
      <inertial pos="0 0 0" mass="{cart_mass}" diaginertia="1 1 1"/>
      <body>
        <joint name="theta" type="hinge" axis="0 0 1"/>
        <inertial pos="0 -{eccentricity} 0" mass="{arm_mass}"
                  diaginertia="{arm_inertia} {arm_inertia} {arm_inertia}"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="theta"/></actuator>
</mujoco>
"""
#: The load is a point: MuJoCo wants an inertia, and takes one far below the rounding of m l^2.
CRANE = """
<mujoco>
  <compiler angle="radian" inertiafromgeom="false"/>
  <option gravity="0 0 -{g}"/>
  <worldbody>
    <body>
      <joint name="x" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="{trolley_mass}" diaginertia="1 1 1"/>
      <body>
        <joint name="theta" type="hinge" axis="0 -1 0"/>
        <inertial pos="0 0 -{rope_length}" mass="{load_mass}" diaginertia="1e-14 1e-14 1e-14"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="x"/></actuator>
</mujoco>
"""
#: The axle slides at X = R phi, so that rolling needs no constraint: the wheels' inertia is an
#: armature of that joint, the rotors' one of a tendon whose length is phi - psi, on which the
#: motors pull.
TWO_WHEELED = """
<mujoco>
  <compiler angle="radian" inertiafromgeom="false"/>
  <option gravity="0 0 -{g}"/>
  <worldbody>
    <body>
      <joint name="phi" type="slide" axis="1 0 0" armature="{wheel_armature}"/>
      <inertial pos="0 0 0" mass="{wheels}" diaginertia="1 1 1"/>
      <body>
        <joint name="psi" type="hinge" axis="0 1 0"/>
        <inertial pos="0 0 {height}" mass="{body_mass}"
                  diaginertia="{body_inertia} {body_inertia} {body_inertia}"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="motor" armature="{rotor_armature}">
      <joint joint="phi" coef="{per_radius}"/>
      <joint joint="psi" coef="-1"/>
    </fixed>
  </tendon>
  <actuator><motor tendon="motor"/></actuator>
</mujoco>
"""


def tora_by_hand(p: Values, q: Array, dq: Array, u: float) -> tuple[Array, Array]:
    """Return M and the forces of Bupp, Bernstein and Coppola's equations of motion."""
    coupling = p["arm_mass"] * p["eccentricity"]
    total = p["arm_mass"] + p["cart_mass"]
    inertia = p["arm_inertia"] + coupling * p["eccentricity"]
    mass = [[total, coupling * np.cos(q[1])], [coupling * np.cos(q[1]), inertia]]
    force = [coupling * dq[1] ** 2 * np.sin(q[1]) - p["stiffness"] * q[0], u]
    return np.array(mass), np.array(force)


def crane_by_hand(p: Values, q: Array, dq: Array, u: float) -> tuple[Array, Array]:
    """Return M and the forces of the crane with a hanging point load."""
    m, length = p["load_mass"], p["rope_length"]
    off = m * length * np.cos(q[1])
    mass = [[p["trolley_mass"] + m, off], [off, m * length**2]]
    force = [
        u + m * length * dq[1] ** 2 * np.sin(q[1]),
        -m * p["g"] * length * np.sin(q[1]),
    ]
    return np.array(mass), np.array(force)


def two_wheeled_by_hand(p: Values, q: Array, dq: Array, u: float) -> tuple[Array, Array]:
    """Return M and the forces of Yamamoto's equations in the plane, for a torque u."""
    m, radius, body, height = p["wheel_mass"], p["radius"], p["body_mass"], p["height"]
    rotors = 2.0 * p["gear"] ** 2 * p["rotor_inertia"]
    off = body * height * radius * np.cos(q[1]) - rotors
    mass = [
        [(2.0 * m + body) * radius**2 + 2.0 * p["wheel_inertia"] + rotors, off],
        [off, body * height**2 + p["body_inertia"] + rotors],
    ]
    force = [
        u + body * height * radius * dq[1] ** 2 * np.sin(q[1]),
        -u + body * p["g"] * height * np.sin(q[1]),
    ]
    return np.array(mass), np.array(force)


def _of_two_wheeled(p: Values) -> Values:
    return {
        "wheels": 2.0 * p["wheel_mass"],
        "wheel_armature": 2.0 * p["wheel_inertia"] / p["radius"] ** 2,
        "rotor_armature": 2.0 * p["gear"] ** 2 * p["rotor_inertia"],
        "per_radius": 1.0 / p["radius"],
    }


@dataclass(frozen=True)
class Case:
    """A model, its MuJoCo twin, and how the first joint of that reads in our coordinate."""

    set_name: str
    scenario: str
    xml: str
    by_hand: Callable[[Values, Array, Array, float], tuple[Array, Array]]
    more: Callable[[Values], Values]
    metres: Callable[[Values], float]
    #: Sizes of position, rates and force at the random states.
    sizes: tuple[float, float, float, float]
    #: What the last two seconds of the scenario must be within, by coordinate.
    within: tuple[float, float]


def _nothing(_: Values) -> Values:
    return {}


def _one(_: Values) -> float:
    return 1.0


CASES = {
    "tora": Case(
        "benchmark",
        "tora-damping",
        TORA,
        tora_by_hand,
        _nothing,
        _one,
        (0.1, 0.5, 10.0, 0.1),
        (1e-5, 1e-3),
    ),
    "crane": Case(
        "inteco",
        "crane-transport",
        CRANE,
        crane_by_hand,
        _nothing,
        _one,
        (0.5, 1.0, 5.0, 5.0),
        (1e-6, 1e-6),
    ),
    "two_wheeled": Case(
        "nxtway",
        "two-wheeled-balance",
        TWO_WHEELED,
        two_wheeled_by_hand,
        _of_two_wheeled,
        lambda p: p["radius"],
        (3.0, 5.0, 5.0, 0.1),
        (1e-3, 1e-4),
    ),
}


class Plant:
    """The generated C plant of one case, driven from arrays."""

    def __init__(self, name: str) -> None:
        self.case = CASES[name]
        self.folder = open_generated(name)
        self.values = self.folder.parameters(self.case.set_name)
        self.names = self.folder.manifest.coordinates
        self.host = host_model(self.folder)
        self.params = fill_records(self.host.records("plant_params"), self.values)

    def state(self, q: Array, dq: Array) -> Any:
        """Return a state record."""
        motion = dict(zip(self.names, q, strict=True))
        motion |= {f"d{n}": v for n, v in zip(self.names, dq, strict=True)}
        return fill_records(self.host.records("plant_state"), motion)

    def acceleration(self, q: Array, dq: Array, u: float) -> Array:
        """Return q'' of the generated C."""
        rate = self.host.records("plant_rate")
        applied = fill_records(self.host.records("plant_input"), {"u": u})
        self.host.acceleration(self.params, self.state(q, dq), applied, rate)
        return np.array([rate[f"dd{n}"][0] for n in self.names])

    def energy(self, state: Any) -> float:
        """Return T + V of the generated C."""
        energy = np.zeros(1)
        self.host.energy(self.params, state, energy)
        return float(energy[0])


@pytest.fixture(scope="module", params=list(CASES))
def name(request):
    return request.param


@pytest.fixture(scope="module")
def plant(name):
    return Plant(name)


def _random_states(case: Case, count: int) -> list[tuple[Array, Array, float]]:
    rng = np.random.default_rng(11)
    near, slow, fast, force = case.sizes
    return [
        (
            np.array([rng.normal(0.0, near), rng.uniform(-np.pi, np.pi)]),
            np.array([rng.normal(0.0, slow), rng.normal(0.0, fast)]),
            rng.normal(0.0, force),
        )
        for _ in range(count)
    ]


def test_all_identities_are_proved(name):
    identities = derivation_of(find_model(name)).identities
    assert len(identities) >= 6
    assert [i.name for i in identities if not i.proved] == []


def test_accelerations_agree_with_mujoco(plant):
    case, values = plant.case, plant.values
    exact = {k: repr(v) for k, v in (values | case.more(values)).items()}
    model = mujoco.MjModel.from_xml_string(case.xml.format(**exact))
    data = mujoco.MjData(model)
    scale = np.array([case.metres(values), 1.0])
    for q, dq, u in _random_states(case, 300):
        data.qpos[:], data.qvel[:], data.ctrl[0] = q * scale, dq * scale, u
        mujoco.mj_forward(model, data)
        theirs = data.qacc / scale
        size = np.abs(theirs).max()
        np.testing.assert_allclose(
            plant.acceleration(q, dq, u), theirs, rtol=1e-8, atol=1e-10 * size
        )


def test_accelerations_agree_with_the_equations_written_by_hand(plant):
    for q, dq, u in _random_states(plant.case, 300):
        mass, force = plant.case.by_hand(plant.values, q, dq, u)
        theirs = np.linalg.solve(mass, force)
        size = np.abs(theirs).max()
        np.testing.assert_allclose(
            plant.acceleration(q, dq, u), theirs, rtol=1e-10, atol=1e-12 * size
        )


def test_the_tora_has_the_coupling_that_the_benchmark_prints():
    p = open_generated("tora").parameters("benchmark")
    inertia = p["arm_inertia"] + p["arm_mass"] * p["eccentricity"] ** 2
    total = p["arm_mass"] + p["cart_mass"]
    coupling = p["arm_mass"] * p["eccentricity"] / np.sqrt(inertia * total)
    assert coupling == pytest.approx(0.200, abs=5e-4)


def test_energy_is_kept_in_two_seconds_of_free_motion(plant):
    state = plant.state(np.array([0.05, 1.0]), np.array([0.1, 2.0]))
    before, scale = plant.energy(state), 0.0
    applied, step = plant.host.records("plant_input"), np.array([1e-4])
    for _ in range(10):
        plant.host.plant_step(state, plant.params, applied, step, 2_000)
        scale = max(scale, abs(plant.energy(state) - before))
    assert scale < 1e-9 * abs(before)
    assert abs(state[plant.names[1]][0] - 1.0) > 0.1, "nothing moved"


def _numeric_zero_polynomial(plant: Plant) -> Array:
    """Linearise q'' by central differences, hold s' = 0, and take out the root that s itself is."""
    at = np.array([plant.values[f"{n}d"] for n in plant.names])
    still, h = np.zeros(2), 1e-5

    def rates(x: Array, u: float) -> Array:
        return np.concatenate([x[2:], plant.acceleration(at + x[:2], x[2:], u)])

    a = np.zeros((4, 4))
    for k in range(4):
        e = np.zeros(4)
        e[k] = h
        a[:, k] = (rates(e, 0.0) - rates(-e, 0.0)) / (2.0 * h)
    zero = np.concatenate([still, still])
    b = (rates(zero, h) - rates(zero, -h)) / (2.0 * h)
    first, last = plant.names
    weight = plant.values[f"weight_{first}"]
    r = [plant.values[f"rate_{n}"] for n in (first, last)]
    s = np.array([weight * r[0], r[1], weight, 1.0])
    held = a - np.outer(b, s @ a) / (s @ b)
    return np.poly(held)


def test_the_zero_dynamics_have_the_wanted_poles(plant, name):
    source = find_model(name)
    model = lowered_model(source)
    raw = read_set(source.set_path(plant.case.set_name), model.parameters, source.sets())
    wanted = np.array([*polynomial_of(raw.poles), 0.0])
    found = _numeric_zero_polynomial(plant)
    size = np.abs(raw.poles).max() ** np.arange(5)
    np.testing.assert_allclose(found / size, wanted / size, atol=1e-6)


def test_the_generated_code_verifies(plant, name):
    source = find_model(name)
    model = lowered_model(source)
    sets = [s.as_dict() for s in library_sets(model, source)]
    subjects = [PythonUnderTest(plant.folder), CompiledUnderTest(plant.host, "c-host")]
    found = verify(derivation_of(source), model, sets, subjects, None, 300, 0)
    assert found.passed
    assert found.worst_scaled_ulp <= LIMIT_ULP


def test_the_scenario_converges_with_the_law_in_charge(plant):
    scenario = read_scenario(plant.case.scenario)
    trajectory = fly(scenario, plant.host, plant.host, "host")
    figures, status = tracking_metrics(trajectory), status_counts(trajectory)
    for coordinate, bound in zip(plant.names, plant.case.within, strict=True):
        assert figures[f"mae2_{coordinate}"] < bound
    assert figures["peak_torque"] <= plant.values["torque_limit"]
    assert status["OK"] > 0.99 * scenario.steps


def test_what_is_committed_is_what_is_generated_now(name):
    source = find_model(name)
    model = lowered_model(source)
    now = generate(Emission(model, library_sets(model, source)))
    assert drift(now, REPOSITORY / "generated" / name) == ""
