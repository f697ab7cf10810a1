"""Closed-loop flight: the controller on one machine, the plant on another."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pfaffian.runtime.code.generated_model import GeneratedModel, fill_records
from pfaffian.runtime.flight.scenario import Scenario

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Trajectory:
    """A recorded flight of N periods.

    `time` has shape (N,), seconds, the start of each period. `measured` and `output` are
    structured arrays (N,) of what entered and left the controller, `state` of what it remembered
    after the period, `status` int32 (N,), `energy` (N,) the plant's T + V in joule.
    """

    scenario: Scenario
    mode: str
    time: np.ndarray[Any, Any]
    measured: np.ndarray[Any, Any]
    output: np.ndarray[Any, Any]
    state: np.ndarray[Any, Any]
    status: np.ndarray[Any, Any]
    energy: np.ndarray[Any, Any]

    def sha256(self) -> str:
        """Return the digest of the raw IEEE bytes, little-endian, of every recorded signal."""
        total = hashlib.sha256()
        for records in (self.measured, self.output, self.state):
            for name in records.dtype.names or ():
                column = records[name]
                total.update(column.astype(column.dtype.newbyteorder("<")).tobytes())
        total.update(self.status.astype("<i4").tobytes())
        return total.hexdigest()

    def errors(self) -> dict[str, np.ndarray[Any, Any]]:
        """Return q - q_d (N,) by coordinate."""
        return {q: self.measured[q].astype(float) - qd for q, qd in self.scenario.setpoint.items()}


def fly(
    scenario: Scenario,
    controller: GeneratedModel,
    plant: GeneratedModel,
    mode: str,
    progress: Progress | None = None,
) -> Trajectory:
    """Fly `scenario`: measure, step the controller, hold its torque, advance the plant."""
    n = scenario.steps
    log = {role: controller.records(role, n) for role in ("input", "output", "state")}
    status_log, energy_log = np.zeros(n, np.int32), np.zeros(n)
    params = fill_records(controller.records("params"), dict(scenario.controller))
    state, measured = controller.records("state"), controller.records("input")
    output, status = controller.records("output"), np.zeros(1, np.int32)
    plant_params = fill_records(plant.records("plant_params"), dict(scenario.plant))
    plant_state = fill_records(plant.records("plant_state"), dict(scenario.initial))
    applied, energy = plant.records("plant_input"), plant.reals([0.0])
    timed = "time" in (measured.dtype.names or ())
    step = plant.reals([scenario.sample_time / scenario.plant_substeps])
    controller.init(state, params, status)
    for k in range(n):
        for name in plant_state.dtype.names or ():
            measured[name] = plant_state[name]
        if timed:
            measured["time"] = k * scenario.sample_time
        controller.step(state, params, measured, output, status)
        plant.energy(plant_params, plant_state, energy)
        log["input"][k], log["output"][k], log["state"][k] = measured[0], output[0], state[0]
        status_log[k], energy_log[k] = status[0], energy[0]
        for name in applied.dtype.names or ():
            applied[name] = output[name]
        plant.plant_step(plant_state, plant_params, applied, step, scenario.plant_substeps)
        if progress and (k + 1) % 100 == 0:
            progress(k + 1, n)
    time = np.arange(n) * scenario.sample_time
    return Trajectory(
        scenario, mode, time, log["input"], log["output"], log["state"], status_log, energy_log
    )


def differing_bits(one: Trajectory, other: Trajectory) -> int:
    """Return how many bits of all recorded signals differ between two flights of equal length."""
    total = int(np.count_nonzero(one.status != other.status)) * 32
    for mine, theirs in (
        (one.measured, other.measured),
        (one.output, other.output),
        (one.state, other.state),
    ):
        for name in mine.dtype.names or ():
            width = f"u{mine[name].dtype.itemsize}"
            changed = np.ascontiguousarray(mine[name]).view(width) ^ np.ascontiguousarray(
                theirs[name]
            ).view(width)
            total += int(np.bitwise_count(changed).sum())
    return total
