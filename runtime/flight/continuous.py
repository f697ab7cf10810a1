"""The plant under the continuous law as printed, flown by an implicit solver.

The sampled law is what a target runs; the theorem of the source speaks of this one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.code.generated_model import GeneratedModel, fill_records
from pfaffian.runtime.flight.scenario import Scenario
from scipy.integrate import solve_ivp

_RELATIVE = 1e-8
#: What the integration resolves of each state, in its SI unit.
ABSOLUTE = 1e-10
_MOST_EVALUATIONS = 1_000_000


@dataclass(frozen=True)
class ContinuousFlight:
    """A solution of the continuous closed loop at N times, all in SI units.

    `time` (N,); `position`, `rate` and `acceleration` (N, n) of q, q' and q''; `drift_integral`
    and `drift` (N,) of (6); `bound` and `bound_rate` (N,) are ahat and its rate, (15); `beta`
    (N,) of (21); `adb` (N,) of (10), its determinant for several actuators; `torque` (N,). With
    m > 1 actuators `drift_integral`, `drift`, `beta` and `torque` have the shape (N, m). `ended`
    says why the flight is shorter than the scenario, and is empty where it is not.
    """

    scenario: Scenario
    time: Array
    position: Array
    rate: Array
    acceleration: Array
    drift_integral: Array
    drift: Array
    bound: Array
    bound_rate: Array
    beta: Array
    adb: Array
    torque: Array
    ended: str = ""

    @property
    def beta_size(self) -> Array:
        """Return |beta|, shape (N,)."""
        return np.abs(self.beta) if self.beta.ndim == 1 else np.linalg.norm(self.beta, axis=1)


class ContinuousLoop:
    """The right-hand side of the closed loop; the state is (q, q', integrals of drift, ahat)."""

    def __init__(self, scenario: Scenario, host: GeneratedModel) -> None:
        """Engage the law at the scenario's start: s there is what beta is counted from."""
        self.host, self.scenario, self.evaluations = host, scenario, 0
        manifest = scenario.folder.manifest
        self.names, self.own, self.numbered = manifest.coordinates, manifest.own, manifest.numbered
        self.channels = [*self.names, *(f"d{n}" for n in self.names)]
        self._params = fill_records(host.records("params"), dict(scenario.controller))
        self._plant = fill_records(host.records("plant_params"), dict(scenario.plant))
        self._state = host.records("continuous_state")
        self._measured, self._motion = host.records("input"), host.records("plant_state")
        self.output = host.records("continuous_output")
        self._applied, self.acceleration = host.records("plant_input"), host.records("plant_rate")
        self.actuators = tuple(self._applied.dtype.names or ())
        self._integrals, self._bound = self.numbered("drift_integral"), self.own("bound_estimate")
        motion = [scenario.initial[c] for c in self.channels]
        still = [0.0] * len(self.actuators)
        self.start = np.array([*motion, *still, scenario.controller["bound_initial"]])
        self.engage(self.start)

    def engage(self, y: Array, time: float = 0.0) -> None:
        """Engage the law anew in the state `y`: beta is counted from s there."""
        self.observe(y, time)
        for s0, s in zip(self.numbered("residual_initial"), self.numbered("s"), strict=True):
            self._state[s0] = self.output[s]

    def observe(self, y: Array, time: float = 0.0) -> None:
        """Evaluate the law in the state `y`, at `time` in seconds."""
        if "time" in (self._measured.dtype.names or ()):
            self._measured["time"] = time
        for name, value in zip(self.channels, y, strict=False):
            self._measured[name] = self._motion[name] = value
        for name, value in zip(self._integrals, y[len(self.channels) :], strict=False):
            self._state[name] = value
        self._state[self._bound] = y[-1]
        self.host.continuous(self._state, self._params, self._measured, self.output)

    def __call__(self, time: float, y: Array) -> Array:
        """Return the rate of `y`."""
        self.evaluations += 1
        if self.evaluations > _MOST_EVALUATIONS:
            raise CheckError(
                f"{self.scenario.name}: the continuous law needed over {_MOST_EVALUATIONS} "
                f"evaluations",
                remedy="shorten the duration, or widen the layer epsilon",
            )
        self.observe(y, time)
        for name in self.actuators:
            self._applied[name] = self.output[name]
        self.host.acceleration(self._plant, self._motion, self._applied, self.acceleration)
        n = len(self.names)
        rate = np.empty_like(y)
        rate[:n] = y[n : 2 * n]
        rate[n : 2 * n] = [self.acceleration[f"dd{c}"][0] for c in self.names]
        rate[2 * n : -1] = [self.output[self.own(f"{i}_rate")][0] for i in self._integrals]
        rate[-1] = self.output[self.own(f"{self._bound}_rate")][0]
        return rate

    def clearance(self, time: float, y: Array) -> float:
        """Return |ADB| less the singular threshold: the flight ends where it vanishes."""
        self.observe(y, time)
        return float(
            abs(self.output[self.own("adb")][0]) - self.scenario.controller["singular_threshold"]
        )


def fly_continuous(scenario: Scenario, host: GeneratedModel) -> ContinuousFlight:
    """Fly `scenario` under (15)-(23) as printed, without torque limit, sampled every period.

    The flight ends early where |ADB| falls to the singular threshold or the solver gives up;
    `ended` says so. Raises `CheckError` where it would take too many evaluations.
    """
    loop = ContinuousLoop(scenario, host)
    times = np.arange(scenario.steps + 1) * scenario.sample_time
    found = solve_ivp(
        loop,
        (0.0, times[-1]),
        loop.start,
        "LSODA",
        times,
        events=_singular_event(loop),
        rtol=_RELATIVE,
        atol=ABSOLUTE,
    )
    ended = "" if found.status == 0 else f"after {found.t[-1]:.4g} s: {found.message}"
    if found.status == 1:
        ended = f"|ADB| fell to singular_threshold at {found.t_events[0][0]:.4g} s"
    loop.evaluations = 0
    return record(loop, found.t, found.y.T, ended)


def _singular_event(loop: ContinuousLoop) -> Any:
    """Return the event of `loop` as a function, which may carry the attribute `terminal`."""

    def event(time: float, y: Array) -> float:
        return loop.clearance(time, y)

    event.terminal = True  # type: ignore[attr-defined]
    return event


def record(loop: ContinuousLoop, times: Array, states: Array, ended: str = "") -> ContinuousFlight:
    """Return all signals of `loop` in `states`, shape (N, 2 n + m + 1), at `times` (N,)."""
    n, m = len(loop.names), len(loop.actuators)
    beta = loop.numbered("beta")
    signals = np.empty((len(times), 2 * m + 1))
    rates = np.empty_like(states)
    for k, y in enumerate(states):
        rates[k] = loop(times[k], y)
        signals[k] = [loop.output[s][0] for s in (*beta, *loop.actuators, loop.own("adb"))]

    def columns(of: Array) -> Array:
        return of[:, 0] if m == 1 else of

    return ContinuousFlight(
        scenario=loop.scenario,
        time=times,
        position=states[:, :n],
        rate=states[:, n : 2 * n],
        acceleration=rates[:, n : 2 * n],
        drift_integral=columns(states[:, 2 * n : -1]),
        drift=columns(rates[:, 2 * n : -1]),
        bound=states[:, -1],
        bound_rate=rates[:, -1],
        beta=columns(signals[:, :m]),
        adb=signals[:, -1],
        torque=columns(signals[:, m : 2 * m]),
        ended=ended,
    )
