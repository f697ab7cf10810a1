"""A plan against the ODE: another integrator, another evaluation of the plant, every limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pfaffian.derive.plan.plant import NumericPlant
from pfaffian.derive.plan.problem import Problem
from pfaffian.derive.plan.reference import torque_at
from pfaffian.derive.plan.shooting import Trajectory
from pfaffian.runtime.base.errors import CheckError
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]
#: Largest defect of an interval, in the coordinates' units and those per second.
DEFECT_TOLERANCE = 1e-7
#: How far the ends may lie from the start and the goal.
_END_TOLERANCE = 1e-9
#: Parts of each interval at which limits and power are looked at.
_PARTS = 16


@dataclass(frozen=True)
class PlanCheck:
    """What the independent integration (DOP853, 1e-12) of the plan shows.

    `defect` is the largest miss of a next node when the ODE is integrated from the one before,
    `drift` where the goal is missed when it is integrated through from the start. `energy_used` is
    the integral of sum |tau_i (B^T q')_i|, `work` that without the absolute value, in J, and
    `energy_change` T + V at the end less that at the start. Peaks are (m,) and (n,), over `_PARTS`
    points an interval.
    """

    defect: float
    defect_time: float
    drift: float
    energy_used: float
    work: float
    energy_change: float
    peak_torque: tuple[float, ...]
    peak_speed: tuple[float, ...]
    violations: tuple[str, ...]

    def demand(self, where: str) -> None:
        """Raise `CheckError` naming `where` and everything that does not hold."""
        if self.violations:
            raise CheckError(
                f"{where}: {'; '.join(self.violations)}",
                remedy="plan again with more nodes (--nodes), more starts (--seeds) or a longer "
                "--end-time",
            )


def check_plan(plant: NumericPlant, problem: Problem, plan: Trajectory) -> PlanCheck:
    """Integrate the ODE along `plan` and compare; the outcome names what does not hold."""
    n = problem.order
    defects, used, work, speeds = [], 0.0, 0.0, np.zeros(n)
    for k in range(len(plan.times) - 1):
        reached, inner, powers = _interval(plant, plan, k)
        defects.append(float(np.max(np.abs(reached - plan.states[k + 1]))))
        h = float(plan.times[k + 1] - plan.times[k])
        used += _simpson(np.abs(powers).sum(axis=1), h)
        work += _simpson(powers.sum(axis=1), h)
        speeds = np.maximum(speeds, np.max(np.abs(inner[:, n:]), axis=0))
    worst = int(np.argmax(defects)) if np.all(np.isfinite(defects)) else 0
    torques = np.max(np.abs(plan.torques), axis=0)
    found = PlanCheck(
        defect=defects[worst],
        defect_time=float(plan.times[worst + 1]),
        drift=_drift(plant, problem, plan),
        energy_used=used,
        work=work,
        energy_change=_energy(plant, plan.states[-1]) - _energy(plant, plan.states[0]),
        peak_torque=tuple(map(float, torques)),
        peak_speed=tuple(map(float, speeds)),
        violations=(),
    )
    return PlanCheck(**{**vars(found), "violations": _violations(problem, plan, found)})


def _interval(plant: NumericPlant, plan: Trajectory, k: int) -> tuple[Array, Array, Array]:
    """Return the state after interval k, and states and powers at `_PARTS` + 1 points of it."""
    begin, end = float(plan.times[k]), float(plan.times[k + 1])
    at = np.linspace(begin, end, _PARTS + 1)
    at[-1] = end
    states = _integrate(plant, plan, plan.states[k], begin, end, at)
    powers = [
        plant.power(x, torque_at(plan.times, plan.torques, float(t)))
        for t, x in zip(at, states, strict=True)
    ]
    return states[-1], states, np.array(powers)


def _integrate(
    plant: NumericPlant, plan: Trajectory, state: Array, begin: float, end: float, at: Array
) -> Array:
    found = solve_ivp(
        lambda t, x: plant.rates(x, torque_at(plan.times, plan.torques, t)),
        (begin, end),
        state,
        method="DOP853",
        t_eval=at,
        rtol=1e-12,
        atol=1e-13,
    )
    if not found.success:
        return np.full((len(at), len(state)), np.inf)
    states: Array = found.y.T
    return states


def _drift(plant: NumericPlant, problem: Problem, plan: Trajectory) -> float:
    """Return the largest miss of the goal after integration from node to node without a reset."""
    state = np.array(problem.start)
    for k in range(len(plan.times) - 1):
        begin, end = float(plan.times[k]), float(plan.times[k + 1])
        state = _integrate(plant, plan, state, begin, end, np.array([end]))[-1]
        if not np.all(np.isfinite(state)):
            return float("inf")
    return float(np.max(np.abs(state - np.array(problem.goal))))


def _energy(plant: NumericPlant, state: Array) -> float:
    return plant.kinetic(state) + plant.potential(state[: plant.n])


def _simpson(values: Array, length: float) -> float:
    weights = np.ones(_PARTS + 1)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    return float(weights @ values) * length / (3.0 * _PARTS)


def _violations(problem: Problem, plan: Trajectory, found: PlanCheck) -> tuple[str, ...]:
    """Return what does not hold, worded."""
    said = []
    if not found.defect <= DEFECT_TOLERANCE:
        said.append(
            f"the ODE misses the node at {found.defect_time:.4g} s by {found.defect:.3g}, "
            f"more than {DEFECT_TOLERANCE:g}"
        )
    for what, state, wanted in (
        ("starts", plan.states[0], problem.start),
        ("ends", plan.states[-1], problem.goal),
    ):
        gap = float(np.max(np.abs(state - np.array(wanted))))
        if not gap <= _END_TOLERANCE:
            said.append(f"it {what} {gap:.3g} away from where it should")
    most = problem.end_time[1]
    if plan.end_time > most * (1.0 + 1e-12):
        said.append(f"it takes {plan.end_time:g} s, more than {most:g} s")
    limits = zip(problem.actuators, found.peak_torque, problem.torque_limits, strict=True)
    said += [
        f"{name} reaches {peak:.6g} {unit}, beyond {limit:g} {unit}"
        for (name, unit), peak, limit in limits
        if not peak <= limit
    ]
    speeds = zip(problem.coordinates, found.peak_speed, problem.speed_limits, strict=True)
    said += [
        f"d{name} reaches {peak:.6g} {unit}/s, beyond {limit:g} {unit}/s"
        for (name, unit), peak, limit in speeds
        if not peak <= limit
    ]
    return tuple(said)
