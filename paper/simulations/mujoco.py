"""Section 5.1 in MuJoCo, an engine that shares no code with this project, under the generated C."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import MissingToolError
from pfaffian.runtime.code.compiled import compiled_model
from pfaffian.runtime.code.generated_model import GeneratedModel
from pfaffian.runtime.flight.closed_loop import Trajectory, fly
from pfaffian.runtime.flight.metrics import tracking_metrics
from pfaffian.runtime.flight.scenario import Scenario, read_scenario

#: Steps of the engine's Runge-Kutta integrator in one period of the controller.
_SUBSTEPS = 10


@dataclass(frozen=True)
class Agreement:
    """One flight twice, on the generated plant and in the engine, under the same controller.

    `largest` is the greatest difference of an angle [rad], `torque` that of the torque [N m];
    `ours` and `theirs` are IAE and MAE2 of both flights.
    """

    scenario: str
    steps: int
    largest: float
    torque: float
    ours: Mapping[str, float]
    theirs: Mapping[str, float]


def pendubot_mjcf(values: Mapping[str, float], timestep: float) -> str:
    """Return the Pendubot as MuJoCo's XML from its masses, lengths and inertias, SI units.

    Hinges about -y turn x towards z, so that q1 counts from the horizontal, upwards.
    """
    v = values
    spin1, spin2 = (" ".join([f"{v[n]!r}"] * 3) for n in ("I1", "I2"))
    hinge = 'type="hinge" axis="0 -1 0"'
    return f"""<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 {-v["g"]!r}" timestep="{timestep!r}" integrator="RK4"/>
  <worldbody><body>
    <joint name="q1" {hinge}/>
    <inertial pos="{v["lc1"]!r} 0 0" mass="{v["m1"]!r}" diaginertia="{spin1}"/>
    <body pos="{v["l1"]!r} 0 0">
      <joint name="q2" {hinge}/>
      <inertial pos="{v["lc2"]!r} 0 0" mass="{v["m2"]!r}" diaginertia="{spin2}"/>
    </body>
  </body></worldbody>
  <actuator><motor joint="q1"/></actuator>
</mujoco>"""


def fly_in_engine(scenario: Scenario) -> tuple[Array, Array]:
    """Return angles (N, 2) and torque (N,) of `scenario` flown in MuJoCo.

    Raises `MissingToolError` where it is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise MissingToolError(
            f"the Python package mujoco is missing ({error})",
            remedy="install it: pip install 'pfaffian[dev]' (or pip install mujoco)",
        ) from error
    values = scenario.folder.parameters(scenario.set_name)
    step = scenario.sample_time / _SUBSTEPS
    engine: Any = mujoco.MjModel.from_xml_string(pendubot_mjcf(values, step))
    data: Any = mujoco.MjData(engine)
    data.qpos[:] = [scenario.initial[n] for n in ("q1", "q2")]
    data.qvel[:] = [scenario.initial[n] for n in ("dq1", "dq2")]
    data.qfrc_applied[0] = -scenario.plant["joint1_load"]  # F stands on the left of (1)
    model = compiled_model(scenario.folder.manifest.model)
    controller = model.Controller(model.Params(**scenario.controller))
    angles, torques = np.empty((scenario.steps, 2)), np.empty(scenario.steps)
    for k in range(scenario.steps):
        angles[k] = data.qpos
        torques[k] = controller.step(*data.qpos, *data.qvel)
        data.ctrl[0] = torques[k]
        for _ in range(_SUBSTEPS):
            mujoco.mj_step(engine, data)
    return angles, torques


def agreement(name: str, host: GeneratedModel, steps: int | None = None) -> Agreement:
    """Fly the scenario called `name` on both plants, for `steps` periods if not the whole."""
    scenario = read_scenario(name)
    scenario = replace(scenario, steps=steps or scenario.steps)
    ours = fly(scenario, host, host, "host")
    angles, torques = fly_in_engine(scenario)
    theirs = _as_trajectory(ours, angles, torques)
    found = np.stack([ours.measured[n] for n in ("q1", "q2")], 1)
    return Agreement(
        name,
        scenario.steps,
        float(np.abs(found - angles).max()),
        float(np.abs(ours.output["tau"] - torques).max()),
        tracking_metrics(ours),
        tracking_metrics(theirs),
    )


def _as_trajectory(like: Trajectory, angles: Array, torques: Array) -> Trajectory:
    """Return a flight with these angles and torques, for its tracking figures."""
    measured, output = like.measured.copy(), like.output.copy()
    measured["q1"], measured["q2"], output["tau"] = angles[:, 0], angles[:, 1], torques
    return replace(like, measured=measured, output=output)
