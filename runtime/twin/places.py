"""Where a force from outside enters a plant: at the shaft of a motor, or as a load on a joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.toml import suggestion
from pfaffian.runtime.code.generated_model import GeneratedModel, fill_records
from pfaffian.runtime.twin.settings import TwinScenario

_TINY = 1e-9


@dataclass(frozen=True)
class Place:
    """A member of the plant's input (`is_load` false), or a parameter that loads a joint."""

    is_load: bool
    index: int

    @property
    def entry(self) -> tuple[int, int]:
        """Return the two numbers as C takes them."""
        return int(self.is_load), self.index


def place_of(scenario: TwinScenario, model: GeneratedModel, joint: str, what: str) -> Place:
    """Return where a force on `joint` enters: its motor's torque, or else its load.

    Raises `InputError` where there is neither.
    """
    names = scenario.coordinates
    if joint not in names:
        raise InputError(
            f"{scenario.base.name}: {what}: no joint {joint}",
            remedy=suggestion(joint, list(names)),
        )
    shaft = _motor_of(scenario, model, names.index(joint))
    if shaft is not None:
        return shaft
    known = model.records("plant_params").dtype.names or ()
    for name in (f"{joint}_load", f"joint{names.index(joint) + 1}_load"):
        if name in known:
            return Place(True, known.index(name))
    raise InputError(
        f"{scenario.base.name}: {what}: model {model.folder.manifest.model} has neither a motor "
        f"nor a load on {joint}",
        remedy=f"act on another joint, or add {joint}_load to the model's disturbances",
    )


def _motor_of(scenario: TwinScenario, model: GeneratedModel, joint: int) -> Place | None:
    """Return the actuator whose torque acts on `joint` alone, with factor one.

    M^-1 B e_a is compared with M^-1 e_j, both out of the plant: M from its kinetic energy.
    """
    mass = _mass_matrix(scenario, model)
    for index in range(len(scenario.actuators)):
        column = mass @ response(scenario, model, Place(False, index))
        unit = np.eye(len(mass))[joint]
        if np.abs(column - unit).max() < _TINY:
            return Place(False, index)
    return None


def response(scenario: TwinScenario, model: GeneratedModel, place: Place) -> Array:
    """Return the accelerations (n,) that a unit force at `place` adds, at the nominal start."""
    params, state = _nominal(scenario, model)
    rate, pushed = model.records("plant_rate"), model.records("plant_rate")
    applied = model.records("plant_input")
    model.acceleration(params, state, applied, rate)
    record, step = (params, -1.0) if place.is_load else (applied, 1.0)
    record[(record.dtype.names or ())[place.index]] += step
    model.acceleration(params, state, applied, pushed)
    return np.asarray(pushed.view(np.float64) - rate.view(np.float64))


def _nominal(scenario: TwinScenario, model: GeneratedModel) -> tuple[Array, Array]:
    """Return records of the nominal plant, at rest where the flight starts."""
    start = scenario.base.initial
    still = {n: v if n in scenario.coordinates else 0.0 for n, v in start.items()}
    params = fill_records(model.records("plant_params"), dict(scenario.base.plant))
    return params, fill_records(model.records("plant_state"), still)


def _mass_matrix(scenario: TwinScenario, model: GeneratedModel) -> Array:
    """Return M (n, n) at the nominal start, out of the plant's kinetic energy."""
    names = scenario.coordinates
    fast = 2.0**20  # so that T is not lost beside V
    params, state = _nominal(scenario, model)
    energy = np.zeros(1)

    def kinetic(*moving: str) -> float:
        values = []
        for speed in (fast, 0.0):
            for name in names:
                state[f"d{name}"] = speed * moving.count(name)
            model.energy(params, state, energy)
            values.append(float(energy[0]))
        return (values[0] - values[1]) / fast**2

    return np.array([[kinetic(a, b) - kinetic(a) - kinetic(b) for a in names] for b in names])
