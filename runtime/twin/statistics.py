"""Figures of every rig, kept up to date during a flight: no trajectory is stored for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.twin.angles import turns, wrapped
from pfaffian.runtime.twin.settings import TwinScenario
from pfaffian.runtime.twin.unit import BALANCE, Command

#: Largest error [SI] at which a rig counts as captured, where the scenario names none.
DEFAULT_TOLERANCE = 0.2
#: MAE2 looks at the last two seconds.
_LAST_SECONDS = 2.0


@dataclass(frozen=True)
class Statistics:
    """Figures of N rigs, SI units; errors of angles are within half a turn.

    `balance_time` (N,) is when mode 2 came to stay, `capture_time` when mode 2 and every error
    within its tolerance came to stay; both NaN where that never happened. `iae` (N, n) is the
    integral of |q - q_d| by the trapezoidal rule over the sampling instants, `mae` its maximum and
    `mae2` that of the last two seconds. `peak_torque` (N, m) is the largest |torque| commanded,
    `violations` (N,) counts periods with a torque beyond the controller's limit or no number,
    `saturated` (N,) is the share of periods with a torque at its limit. `fault_periods` counts
    periods with a fault, `first_fault` is the first one; `periods` (N,) those flown. `lost` (N,) is
    1 where the plant flew off beyond 1e6 and was stopped.
    """

    balance_time: Array
    capture_time: Array
    iae: Array
    mae: Array
    mae2: Array
    peak_torque: Array
    violations: Array
    saturated: Array
    fault_periods: Array
    first_fault: Array
    periods: Array
    last_mode: Array
    lost: Array

    @property
    def captured(self) -> Array:
        """Return which rigs ended captured, bool (N,)."""
        return np.asarray(np.isfinite(self.capture_time) & (self.lost == 0))


class Observer:
    """Gathers the statistics of a flight turn by turn."""

    def __init__(self, scenario: TwinScenario) -> None:
        """Prepare for the first turn."""
        manifest, count = scenario.base.folder.manifest, scenario.rigs
        self._n = len(manifest.coordinates)
        self._goal = np.array([scenario.base.setpoint[c] for c in manifest.coordinates])
        self._turn = turns(manifest)
        self._tolerance = np.array(
            [scenario.tolerance.get(c, DEFAULT_TOLERANCE) for c in manifest.coordinates]
        )
        self._limit = np.array([scenario.base.controller[n] for n in manifest.limits])
        last = (scenario.base.steps - 1) * scenario.base.sample_time
        self._late = last - _LAST_SECONDS
        self._made = _empty(count, self._n, len(manifest.actuators))
        self._error = np.zeros((count, self._n))
        self._time = np.zeros(count)

    def take(self, time: Array, live: Array | None, truth: Array, command: Command) -> None:
        """Take one turn at `time` (N,) into account, of the rigs in `live` (None: of all)."""
        part: Any = slice(None) if live is None else np.flatnonzero(live)
        now = time[part]
        error = np.abs(wrapped(truth[part, : self._n] - self._goal, self._turn))
        self._take_errors(part, now, error)
        mode = command.mode[part]
        near = _every(error <= self._tolerance)
        self._take_modes(part, now, np.asarray(mode == BALANCE), near)
        self._take_torque(part, command.torque[part])
        made, fault = self._made, command.fault[part]
        made["first_fault"][part] = np.where(
            made["first_fault"][part] == 0, fault, made["first_fault"][part]
        )
        made["fault_periods"][part] += fault != 0
        made["last_mode"][part] = mode
        made["periods"][part] += 1

    def _take_errors(self, part: Any, now: Array, error: Array) -> None:
        made = self._made
        passed = 0.5 * (now - self._time[part])
        made["iae"][part] += (error + self._error[part]) * passed[:, None]
        made["mae"][part] = np.maximum(made["mae"][part], error)
        late = now >= self._late
        if late.any():
            made["mae2"][part] = np.maximum(made["mae2"][part], np.where(late[:, None], error, 0))
        self._error[part], self._time[part] = error, now

    def _take_modes(self, part: Any, now: Array, balanced: Array, near: Array) -> None:
        for name, holds in (("balance_time", balanced), ("capture_time", balanced & near)):
            since = self._made[name][part]
            since = np.where(np.isnan(since), now, since)
            self._made[name][part] = np.where(holds, since, np.nan)

    def _take_torque(self, part: Any, torque: Array) -> None:
        made, size = self._made, np.abs(torque)
        made["peak_torque"][part] = np.fmax(made["peak_torque"][part], size)
        made["violations"][part] += ~_every(size <= self._limit)
        made["saturated"][part] += ~_every(~(size >= self._limit))

    def statistics(self, lost: Array) -> Statistics:
        """Return the figures of the turns so far."""
        made = dict(self._made)
        made["saturated"] = made["saturated"] / np.maximum(made["periods"], 1)
        return Statistics(lost=lost.copy(), **made)


def _every(holds: Array) -> Array:
    """Return whether each row of `holds` (N, n) is all true: for few columns faster than all(1)."""
    return np.asarray(reduce(np.logical_and, holds.T))


def _empty(count: int, n: int, m: int) -> dict[str, Array]:
    counts = ("violations", "saturated", "fault_periods", "periods")
    return {
        **{k: np.full(count, np.nan) for k in ("balance_time", "capture_time")},
        **{k: np.zeros((count, n)) for k in ("iae", "mae", "mae2")},
        "peak_torque": np.zeros((count, m)),
        **{k: np.zeros(count, np.int64) for k in counts},
        **{k: np.zeros(count, np.uint32) for k in ("first_fault", "last_mode")},
    }


def summary(statistics: Statistics, coordinates: tuple[str, ...]) -> Mapping[str, float]:
    """Return the worst figures over all rigs, by the names that a flight of one rig has."""
    figures: dict[str, float] = {}
    for k, name in enumerate(coordinates):
        for figure in ("iae", "mae", "mae2"):
            figures[f"{figure}_{name}"] = float(getattr(statistics, figure)[:, k].max())
    figures["peak_torque"] = float(statistics.peak_torque.max())
    return figures
