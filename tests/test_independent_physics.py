"""The generated plant against MuJoCo, an engine that shares no code with this project."""

import mujoco
import numpy as np
import pytest
from pfaffian.runtime.code.generated_model import fill_records, host_model, open_generated

L1, LC1, LC2, M1, M2, I1, I2, G = 0.15, 0.09, 0.08, 0.09, 0.73, 0.0073, 0.0001, 9.8
#: Hinges about -y turn x towards z, so that q1 is measured from the horizontal, upwards.
PENDUBOT = f"""
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 -{G}" timestep="0.0005" integrator="RK4"/>
  <worldbody>
    <body>
      <joint name="q1" type="hinge" axis="0 -1 0"/>
      <inertial pos="{LC1} 0 0" mass="{M1}" diaginertia="{I1} {I1} {I1}"/>
      <body pos="{L1} 0 0">
        <joint name="q2" type="hinge" axis="0 -1 0"/>
        <inertial pos="{LC2} 0 0" mass="{M2}" diaginertia="{I2} {I2} {I2}"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="q1"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def engine():
    model = mujoco.MjModel.from_xml_string(PENDUBOT)
    return model, mujoco.MjData(model)


@pytest.fixture(scope="module")
def plant():
    folder = open_generated("pendubot")
    model = host_model(folder)
    params = fill_records(model.records("plant_params"), folder.parameters("sim"))
    return model, params


def test_accelerations_agree_at_random_states(engine, plant):
    model, data = engine
    generated, params = plant
    rng = np.random.default_rng(3)
    state, applied, rate = (
        generated.records(r) for r in ("plant_state", "plant_input", "plant_rate")
    )
    for _ in range(500):
        data.qpos[:] = rng.uniform(-np.pi, np.pi, 2)
        data.qvel[:] = rng.normal(0.0, 5.0, 2)
        data.ctrl[0] = rng.normal(0.0, 3.0)
        mujoco.mj_forward(model, data)
        state["q1"], state["q2"] = data.qpos
        state["dq1"], state["dq2"] = data.qvel
        applied["tau"] = data.ctrl[0]
        generated.acceleration(params, state, applied, rate)
        ours = np.array([rate["ddq1"][0], rate["ddq2"][0]])
        np.testing.assert_allclose(ours, data.qacc, rtol=1e-9, atol=1e-9)


def test_a_second_of_free_motion_agrees(engine, plant):
    model, data = engine
    generated, params = plant
    mujoco.mj_resetData(model, data)
    data.qpos[:] = (1.0, 0.5)
    state = generated.records("plant_state")
    state["q1"], state["q2"] = 1.0, 0.5
    applied, step = generated.records("plant_input"), np.array([0.0005])
    for _ in range(2000):
        mujoco.mj_step(model, data)
        generated.plant_step(state, params, applied, step, 1)
    ours = np.array([state[n][0] for n in ("q1", "q2", "dq1", "dq2")])
    np.testing.assert_allclose(ours, [*data.qpos, *data.qvel], rtol=1e-6, atol=1e-7)


def test_energy_is_kept_without_torque_and_friction(plant):
    generated, params = plant
    state = generated.records("plant_state")
    state["q1"], state["q2"] = 1.0, 0.5
    applied, step = generated.records("plant_input"), np.array([0.0001])
    before, after = np.zeros(1), np.zeros(1)
    generated.energy(params, state, before)
    generated.plant_step(state, params, applied, step, 20_000)
    generated.energy(params, state, after)
    assert abs(after[0] - before[0]) < 1e-9 * abs(before[0])
