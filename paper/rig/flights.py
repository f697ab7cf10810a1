"""Flights of section 6: cases of a campaign on the twin, recorded, and what they come to."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.twin.angles import turns, wrapped
from pfaffian.runtime.twin.files.campaign import Campaign, Case, read_campaign
from pfaffian.runtime.twin.flight import fly_twin
from pfaffian.runtime.twin.recording import Flight, Wanted, entered_at
from pfaffian.runtime.twin.rig import plant_model
from pfaffian.runtime.twin.settings import TwinScenario
from pfaffian.runtime.twin.units.registry import CONTROLLERS

LAWS, RIGS, GRID = "section-6-laws", "section-6-rigs", "section-6-grid"
#: Errors count from a flight's last entry into BALANCE, for so long [s].
WINDOW = 10.0
LAST_SECONDS = 2.0
PLAN_PHASE = 2


@dataclass(frozen=True)
class Measures:
    """Figures of one flight after capture; q1 and q2 in that order, SI units.

    `entered` is when BALANCE came to stay, NaN if never; all else is NaN then. `iae` is over
    `WINDOW` seconds from there, `mae2` the largest error of the flight's last two seconds,
    `effort` the integral of tau^2 over the window.
    """

    entered: float
    iae: tuple[float, float]
    mae2: tuple[float, float]
    effort: float

    @property
    def caught(self) -> bool:
        """Return whether BALANCE came to stay."""
        return bool(np.isfinite(self.entered))


@dataclass(frozen=True)
class Swing:
    """A swing-up: `upright` [s] is when BALANCE came to stay; `peak` torque [N m] until there,
    `work` the positive work of the motor [J], `energy` the integral of |tau q1'| [J], and
    `following` the largest distance of both angles from the plan [rad], NaN without one."""

    upright: float
    peak: float
    work: float
    energy: float
    following: tuple[float, float]
    rms: tuple[float, float]


def case_of(campaign: Campaign, **points: str) -> Case:
    """Return the case of `campaign` at these points of its axes."""
    for case in campaign.cases:
        if all(case.points[axis] == point for axis, point in points.items()):
            return case
    raise CheckError(f"{campaign.name}: no case {points}", remedy="see the campaign's axes")


def fly_recorded(
    scenario: TwinScenario, machine: str = "host", signals: tuple[str, ...] = ()
) -> Flight:
    """Fly a scenario of one rig and keep its signals, or those named."""
    model = plant_model(scenario.base.folder)
    unit = CONTROLLERS[scenario.controller](scenario, model, machine)
    return fly_twin(scenario, unit, Wanted(signals=signals), model=model)


def fly_measured(scenario: TwinScenario) -> tuple[Measures, str, int]:
    """Fly a scenario of one rig; return its measures, the digest and the first fault."""
    flight = fly_recorded(scenario, signals=("mode", *scenario.coordinates, *scenario.actuators))
    return measured(flight), flight.sha256(), int(flight.statistics.first_fault[0])


def fly_each(
    scenarios: Iterable[TwinScenario], jobs: int, update: Callable[[int, int], None]
) -> list[tuple[Measures, str, int]]:
    """Fly each of `scenarios`, `jobs` at a time, in order."""
    wanted, found = list(scenarios), []
    if jobs == 1:
        for scenario in wanted:
            found.append(fly_measured(scenario))
            update(len(found), len(wanted))
        return found
    with ProcessPoolExecutor(jobs) as pool:
        for one in pool.map(fly_measured, wanted):
            found.append(one)
            update(len(found), len(wanted))
    return found


def scenarios_of(name: str, change: Callable[[TwinScenario], TwinScenario] = lambda s: s) -> Any:
    """Return [(points, scenario)] of every case of the campaign called `name`."""
    campaign = read_campaign(name)
    return [(dict(c.points), change(campaign.scenario(c))) for c in campaign.cases]


def errors_of(flight: Flight) -> Array:
    """Return the errors (K, 2) of a flight of one rig, within half a turn."""
    of = flight.scenario
    goal = np.array([of.base.setpoint[c] for c in of.coordinates])
    angles = np.stack([flight.signals[c][:, 0] for c in of.coordinates], 1)
    return np.asarray(wrapped(angles - goal, turns(of.base.folder.manifest)))


def measured(flight: Flight) -> Measures:
    """Return what a flight of one rig comes to after capture."""
    time, error = flight.time[:, 0], np.abs(errors_of(flight))
    tau = flight.signals[flight.scenario.actuators[0]][:, 0]
    first, nothing = entered_at(flight), (float("nan"), float("nan"))
    if first < 0:
        return Measures(float("nan"), nothing, nothing, float("nan"))
    part = slice(first, first + round(WINDOW / flight.scenario.base.sample_time) + 1)
    late = time >= time[-1] - LAST_SECONDS
    iae = np.trapezoid(error[part], time[part], axis=0)
    mae2 = error[late].max(axis=0)
    return Measures(
        float(time[first]),
        (float(iae[0]), float(iae[1])),
        (float(mae2[0]), float(mae2[1])),
        float(np.trapezoid(tau[part] ** 2, time[part])),
    )


def swing_of(flight: Flight) -> Swing:
    """Return what the swing-up of a flight of one rig took."""
    first = entered_at(flight)
    end = len(flight.time) if first < 0 else first + 1
    time = flight.time[:end, 0]
    tau = flight.signals[flight.scenario.actuators[0]][:end, 0]
    rate = flight.signals[f"d{flight.scenario.coordinates[0]}"][:end, 0]
    power = tau * rate
    most, rms = following(flight)
    return Swing(
        float(time[-1]) if first >= 0 else float("nan"),
        float(np.abs(tau).max()),
        float(np.trapezoid(np.maximum(power, 0.0), time)),
        float(np.trapezoid(np.abs(power), time)),
        most,
        rms,
    )


def following(flight: Flight) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the largest and the root mean square distance of both angles from the plan [rad]."""
    of = flight.scenario
    on = np.flatnonzero(flight.signals["phase"][:, 0] == PLAN_PHASE)
    if not len(on):
        return (float("nan"),) * 2, (float("nan"),) * 2
    model = plant_model(of.base.folder)
    reference = model.records("reference", len(on))
    model.plan_at(of.base.set_name, flight.time[on, 0] - flight.time[on[0], 0], reference)
    wanted = np.stack([reference[f"{c}_ref"] for c in of.coordinates], 1)
    angles = np.stack([flight.signals[c][on, 0] for c in of.coordinates], 1)
    off = np.abs(wrapped(angles - wanted, turns(of.base.folder.manifest)))
    most, rms = off.max(axis=0), np.sqrt((off**2).mean(axis=0))
    return (float(most[0]), float(most[1])), (float(rms[0]), float(rms[1]))


def with_control(scenario: TwinScenario, **members: float) -> TwinScenario:
    """Return `scenario` with these members of the complete controller."""
    return replace(scenario, control={**scenario.control, **members})


def shortened(steps: int, rigs: int) -> Callable[[TwinScenario], TwinScenario]:
    """Return what limits a scenario to `steps` periods and `rigs` rigs: for quick forms."""
    return partial(_limited, steps, rigs)


def _limited(steps: int, rigs: int, scenario: TwinScenario) -> TwinScenario:
    base = replace(scenario.base, steps=min(steps, scenario.base.steps))
    return replace(scenario, base=base, rigs=min(rigs, scenario.rigs))
