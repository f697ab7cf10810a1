"""Many closed-loop flights at once: one scenario, perturbed plants, starts and controllers.

Every flight has the bits that `fly` gives it alone, whatever flies beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.batch import BatchModel, Columns
from pfaffian.runtime.flight.scenario import Scenario

#: Flights that advance together: their arrays stay in the cache.
_TOGETHER = 1024


@dataclass(frozen=True)
class Flights:
    """N recorded flights of K periods.

    `time` has shape (K,), seconds, the start of each period; `signals` holds (K, N) by name, and
    `status` (K, N) is int32.
    """

    scenario: Scenario
    time: Array
    signals: Mapping[str, Array]
    status: Array


def fly_many(
    scenario: Scenario,
    batch: BatchModel,
    *,
    plant: Mapping[str, Array] | None = None,
    initial: Mapping[str, Array] | None = None,
    controller: Mapping[str, Array] | None = None,
    signals: Sequence[str] | None = None,
) -> Flights:
    """Fly N copies of `scenario`, in SI units.

    `plant`, `initial` and `controller` give values of shape (N,) by name for what differs from the
    scenario, `signals` the members of input, output and state to record: by default coordinates
    and torques. The sample time is the scenario's for all. Raises `InputError` for an unknown name
    and for arrays that differ in length.
    """
    changes = {
        "plant_params": dict(plant or {}),
        "plant_state": dict(initial or {}),
        "params": dict(controller or {}),
    }
    count = _count(batch, changes)
    manifest = scenario.folder.manifest
    names = tuple(signals) if signals is not None else (*manifest.coordinates, *manifest.actuators)
    known = {n: role for role in ("state", "output", "input") for n in _members(batch, role)}
    for name in names:
        if name not in known:
            raise InputError(
                f"no signal {name} to record", remedy=f"one of: {', '.join(sorted(known))}"
            )
    logs = {n: np.empty((scenario.steps, count)) for n in names}
    status = np.empty((scenario.steps, count), np.int32)
    for first in range(0, count, _TOGETHER):
        part = slice(first, min(first + _TOGETHER, count))
        given = {r: {n: a[part] for n, a in of.items()} for r, of in changes.items()}
        _fly_part(
            scenario,
            batch,
            given,
            {n: (known[n], log[:, part]) for n, log in logs.items()},
            status[:, part],
        )
    time = np.arange(scenario.steps) * scenario.sample_time
    return Flights(scenario, time, logs, status)


def _members(batch: BatchModel, role: str) -> tuple[str, ...]:
    return batch.folder.manifest.structures[role].names()


def _count(batch: BatchModel, changes: Mapping[str, dict[str, Array]]) -> int:
    """Return N, having made arrays of float64 of all changes."""
    lengths = set()
    for role, of in changes.items():
        for name, values in of.items():
            if name not in _members(batch, role) or name == "sample_time":
                what = "cannot differ" if name == "sample_time" else f"is no member of {role}"
                raise InputError(f"{name} {what}", remedy=f"one of: {_members(batch, role)}")
            of[name] = np.ascontiguousarray(values, np.float64)
            lengths.add(of[name].shape)
    if len(lengths) != 1 or len(next(iter(lengths))) != 1:
        raise InputError(
            f"the values that differ have the shapes {sorted(lengths)}",
            remedy="give at least one array, all of one shape (N,)",
        )
    return int(next(iter(lengths))[0])


def _fly_part(
    scenario: Scenario,
    batch: BatchModel,
    changes: Mapping[str, Mapping[str, Array]],
    logs: Mapping[str, tuple[str, Array]],
    status_log: Array,
) -> None:
    """Fly what fits into the cache; `logs` are (K, N) by name, with the role that has the name."""
    n = status_log.shape[1]
    base = {"params": scenario.controller, "plant_params": scenario.plant}
    params, plant_params, plant_state = (
        _filled(batch.columns(role, n), base.get(role, scenario.initial), changes[role])
        for role in ("params", "plant_params", "plant_state")
    )
    # What is measured is the plant's state, and what is applied the controller's output.
    shared = {name: plant_state[name] for name in plant_state.names()}
    roles = {
        "input": batch.columns("input", n, **shared),
        "output": batch.columns("output", n),
        "state": batch.columns("state", n),
    }
    actuators = _members(batch, "plant_input")
    applied = batch.columns("plant_input", n, **{a: roles["output"][a] for a in actuators})
    status = np.zeros(n, np.int32)
    step = np.full(n, scenario.sample_time / scenario.plant_substeps)
    recorded = [(roles[role][name], log) for name, (role, log) in logs.items()]
    batch.init(roles["state"], params, status)
    for k in range(scenario.steps):
        if "time" in roles["input"].names():
            roles["input"]["time"][:] = k * scenario.sample_time
        batch.step(roles["state"], params, roles["input"], roles["output"], status)
        for column, log in recorded:
            log[k] = column
        status_log[k] = status
        batch.plant_step(plant_state, plant_params, applied, step, scenario.plant_substeps)


def _filled(columns: Columns, common: Mapping[str, float], own: Mapping[str, Array]) -> Columns:
    for name in columns.names():
        columns[name][:] = own[name] if name in own else common[name]
    return columns
