"""Following a plan: the law with the Riccati row, sampled, beside the torque played back.

With e = q - q_ref, the servo-constraint is s = r1 e' + r0 e, its rows those of the plan. The law is
p1 + p2 of the paper with A(t) = r1: tau = (ADB)^-1 (b + AD (C q' + G + F)) - kappa bhat/(1 + T
kappa |ADB|^2), b = r1 q_ref'' - (r1' + r0) e' - r0' e - sigma s.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pfaffian.derive.derivation.derive import Derivation
from pfaffian.derive.plan.planner import Plan
from pfaffian.derive.plan.plant import NumericPlant, numeric_plant
from pfaffian.derive.plan.reference import Curve, torque_at
from pfaffian.runtime.base.errors import InputError

Array = NDArray[np.float64]
#: What counts as standing at the goal: the largest error over the last quarter of the hold.
_STANDING = 0.1
#: Longest Runge-Kutta step of the simulated plant, in s.
_STEP = 1e-3


@dataclass(frozen=True)
class FollowOptions:
    """The law's rates in 1/s, how long the goal is held in s, and how far the plant is off.

    `sigma` is the decay of s, `rate` that of beta (kappa |ADB|^2 at the goal). Each of `draws`
    draws of `seed` moves every parameter by up to `spread` of itself and every coordinate at the
    start by up to `spread` of its way to the goal (of 1 where it has none), uniformly.
    """

    sigma: float = 20.0
    rate: float = 20.0
    hold: float = 2.0
    spread: float = 0.05
    draws: int = 5
    seed: int = 0

    def __post_init__(self) -> None:
        """Raise `InputError` for a number of draws out of bounds."""
        if not 0 <= self.draws <= 1000:
            raise InputError(f"--draws: {self.draws}", remedy="give 0 to 1000")


@dataclass(frozen=True)
class Run:
    """One run: largest |e| (n,) along the plan, |e| at its end, energy used in J, peak torque.

    `standing` says whether the goal is held at the end of the hold; `saturated` is the share of
    samples at a torque limit. Energy is counted up to the end of the plan.
    """

    error: tuple[float, ...]
    end_error: float
    energy_used: float
    peak_torque: float
    saturated: float
    standing: bool


@dataclass(frozen=True)
class Following:
    """Runs of one case under the law and under the torque played back."""

    case: str
    law: tuple[Run, ...]
    playback: tuple[Run, ...]


class FollowingLaw:
    """The sampled law along a plan; it knows the nominal plant only."""

    def __init__(self, plan: Plan, plant: NumericPlant, options: FollowOptions) -> None:
        """Start before the first period."""
        path, row = plan.trajectory, plan.row
        self._plan, self._plant, self._options = plan, plant, options
        self._n, self._period = plant.n, plan.problem.sample_time
        slopes = np.hstack([path.states[:, plant.n :], plan.accelerations])
        self._state = Curve(path.times, path.states, slopes)
        self._row = Curve(path.times, row.rows, row.rates)
        gain = self._gain(row.rows[-1], path.states[-1])
        self._kappa = options.rate / float(np.sum(gain**2))
        self._offset: Array | None = None
        self._limits = np.array(plan.problem.available_limits)

    def reference(self, time: float) -> tuple[Array, Array]:
        """Return (q, q') and (q', q'') of the plan at `time`."""
        return self._state(time), self._state.slope(time)

    def __call__(self, time: float, state: Array) -> Array:
        """Return the torque (m,) of the period that begins at `time`, within the limits."""
        n, sigma = self._n, self._options.sigma
        wanted, moving = self.reference(time)
        row, slope = self._row(time), self._row.slope(time)
        error = state - wanted
        s = row @ error
        if self._offset is None:
            self._offset = -s
        mass, bias, inputs = self._plant.matrices(state[:n], state[n:])
        ad = np.linalg.solve(mass.T, row[:, n:].T).T
        gain = ad @ inputs
        b = row[:, n:] @ moving[n:] - slope @ error - row[:, :n] @ error[n:] - sigma * s
        demand = np.linalg.solve(gain, b + ad @ bias)
        scaled = gain.T @ (s + self._offset)
        shrink = 1.0 + self._period * self._kappa * float(np.sum(gain**2))
        torque = demand - self._kappa * scaled / shrink
        limited: Array = np.clip(torque, -self._limits, self._limits)
        if np.array_equal(limited, torque):  # held while the torque is at its limit
            self._offset = self._offset + self._period * sigma * s
        return limited

    def _gain(self, row: Array, state: Array) -> Array:
        n = self._n
        mass, _, inputs = self._plant.matrices(state[:n], state[n:])
        gain: Array = row[:, n:] @ np.linalg.solve(mass, inputs)
        return gain


def follow_plan(
    derivation: Derivation, plan: Plan, options: FollowOptions
) -> tuple[Following, ...]:
    """Fly `plan` with the law and by playback: as planned, from other starts, on other plants."""
    values = dict(plan.problem.parameters)
    # What the acceleration does not depend on, the setpoint does: the plan knows its goal itself.
    known = _with_defaults(derivation, values)
    nominal = numeric_plant(derivation, known)
    rng = np.random.default_rng(options.seed)
    starts = [_moved_start(plan, options.spread, rng) for _ in range(options.draws)]
    changes = [_moved(values, options.spread, rng) for _ in range(options.draws)]
    plants = [numeric_plant(derivation, {**known, **c}) for c in changes]
    own = np.array(plan.problem.start)
    share = f"{100.0 * options.spread:g} %"
    cases = (
        ("as planned", [(nominal, own)]),
        (f"start off by {share}", [(nominal, x) for x in starts]),
        (f"parameters off by {share}", [(p, own) for p in plants]),
        ("both", list(zip(plants, starts, strict=True))),
    )
    return tuple(_fly(case, plan, nominal, flights, options) for case, flights in cases if flights)


def _with_defaults(derivation: Derivation, values: Mapping[str, float]) -> dict[str, float]:
    """Return `values` with anything for the other parameters: no run depends on those."""
    return {p.name: p.default or 0.0 for p in derivation.spec.parameters} | dict(values)


def _moved(
    values: Mapping[str, float], spread: float, rng: np.random.Generator
) -> dict[str, float]:
    return {name: v * (1.0 + spread * float(rng.uniform(-1.0, 1.0))) for name, v in values.items()}


def _moved_start(plan: Plan, spread: float, rng: np.random.Generator) -> Array:
    n = plan.problem.order
    start, goal = np.array(plan.problem.start), np.array(plan.problem.goal)
    way = np.abs(goal - start)[:n]
    way[way == 0.0] = 1.0
    start[:n] += spread * way * rng.uniform(-1.0, 1.0, n)
    return start


def _fly(
    case: str,
    plan: Plan,
    nominal: NumericPlant,
    flights: list[tuple[NumericPlant, Array]],
    options: FollowOptions,
) -> Following:
    path, period = plan.trajectory, plan.problem.sample_time

    def playback(time: float, state: Array) -> Array:
        return torque_at(path.times, path.torques, time + period / 2.0)

    return Following(
        case,
        tuple(_run(plan, p, x, FollowingLaw(plan, nominal, options), options) for p, x in flights),
        tuple(_run(plan, p, x, playback, options) for p, x in flights),
    )


def _run(
    plan: Plan,
    plant: NumericPlant,
    start: Array,
    law: Callable[[float, Array], Array],
    options: FollowOptions,
) -> Run:
    """Fly the plan and hold the goal; a run that leaves for infinity ends there."""
    problem, path = plan.problem, plan.trajectory
    n, period, limits = plant.n, problem.sample_time, np.array(problem.available_limits)
    slopes = np.hstack([path.states[:, n:], plan.accelerations])
    reference = Curve(path.times, path.states, slopes)
    steps, planned = (round(t / period) for t in (path.end_time + options.hold, path.end_time))
    state, used, peak, saturated = start.copy(), 0.0, 0.0, 0
    errors = [np.abs(state - path.states[0])]
    for k in range(steps):
        torque = law(k * period, state)
        peak, saturated = (
            max(peak, float(np.max(np.abs(torque)))),
            saturated + bool(np.any(np.abs(torque) >= limits)),
        )
        before, state = state, _advanced(plant, state, torque, period)
        if not np.all(np.abs(state) < 1e6):
            state = np.full_like(state, np.inf)
            errors += [state] * (steps - k)
            break
        if k < planned:
            powers = [np.sum(np.abs(plant.power(x, torque))) for x in (before, state)]
            used += float(sum(powers)) / 2.0 * period
        errors.append(np.abs(state - reference((k + 1) * period)))
    track = np.array(errors)[:, :n]
    last = track[-max(1, round(options.hold / period / 4.0)) :]
    return Run(
        error=tuple(map(float, np.max(track[: planned + 1], axis=0))),
        end_error=float(np.max(track[planned])),
        energy_used=used,
        peak_torque=peak,
        saturated=saturated / steps,
        standing=bool(np.max(last) < _STANDING),
    )


def _advanced(plant: NumericPlant, state: Array, torque: Array, period: float) -> Array:
    """Return the state a period later under a held torque (Runge-Kutta of order 4)."""
    count = max(1, round(period / _STEP))
    h = period / count
    for _ in range(count):
        k1 = plant.quick_rates(state, torque)
        k2 = plant.quick_rates(state + h / 2.0 * k1, torque)
        k3 = plant.quick_rates(state + h / 2.0 * k2, torque)
        k4 = plant.quick_rates(state + h * k3, torque)
        state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return state
