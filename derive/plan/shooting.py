"""Direct multiple shooting: one nonlinear program a grid, solved by IPOPT.

Unknown are the states at the nodes, the torque at the nodes (linear in between) and, where it is
free, the end time. Runge-Kutta steps of order 4 lead from node to node.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pfaffian.derive.plan.problem import Problem

Array = NDArray[np.float64]
#: The program keeps this far inside the speed limits, relative to them: it sees them at its
#: Runge-Kutta steps only, and the check sees everything.
_SPEED_MARGIN = 1e-3


@dataclass(frozen=True)
class Grid:
    """How finely a problem is solved: intervals, Runge-Kutta steps in each, IPOPT's tolerance."""

    intervals: int
    steps: int
    tolerance: float
    iterations: int


@dataclass(frozen=True)
class Trajectory:
    """Times (N+1,), states (N+1, 2n) and torques (N+1, m) at the nodes, with the cost."""

    times: Array
    states: Array
    torques: Array
    cost: float
    iterations: int

    @property
    def end_time(self) -> float:
        """Return the time of the last node in s."""
        return float(self.times[-1])


@dataclass(frozen=True)
class Guess:
    """Where IPOPT starts: states (N+1, 2n), torques (N+1, m) and the end time."""

    states: Array
    torques: Array
    end_time: float


def random_guess(problem: Problem, intervals: int, seed: int, number: int) -> Guess:
    """Return start `number` of `seed`: a straight line with random swings, the first without.

    The swings are sums of sine waves that vanish at both ends; of them the one with k half
    waves has an amplitude of 2/k rad (or m) on average.
    """
    rng = np.random.default_rng([seed, number])
    n, m = problem.order, len(problem.actuators)
    share = np.linspace(0.0, 1.0, intervals + 1)[:, None]
    start, goal = np.array(problem.start), np.array(problem.goal)
    least, most = problem.end_time
    end = least * (most / least) ** float(rng.uniform())
    waves = np.arange(1, 6)
    sines = np.sin(math.pi * share * waves)
    slopes = math.pi * waves * np.cos(math.pi * share * waves)
    size = 0.0 if number == 0 else 2.0
    swing = size * rng.standard_normal((len(waves), n)) / waves[:, None]
    push = (0.3 if number else 0.0) * rng.standard_normal((len(waves), m))
    q = start[:n] + share * (goal - start)[:n] + sines @ swing
    rates = ((goal - start)[:n] + slopes @ swing) / end
    torques = np.clip(sines @ push, -0.9, 0.9) * np.array(problem.torque_limits)
    return Guess(np.hstack([q, rates]), torques, end)


def resampled(found: Trajectory, intervals: int, end_time: float) -> Guess:
    """Return `found` on another grid and stretched to `end_time`, linearly between its nodes."""
    share = found.times / found.end_time
    at = np.linspace(0.0, 1.0, intervals + 1)

    def onto(values: Array) -> Array:
        return np.column_stack([np.interp(at, share, column) for column in values.T])

    states = onto(found.states)
    states[:, states.shape[1] // 2 :] *= found.end_time / end_time
    return Guess(states, onto(found.torques), end_time)


class Shooting:
    """The nonlinear program of a problem on one grid, built once and solved from many starts."""

    def __init__(self, problem: Problem, rates: Any, grid: Grid, end_time: float | None) -> None:
        """Build it; a given `end_time` is kept, else it is free within the problem's bounds."""
        self.problem, self.grid = problem, grid
        self._bounds = (end_time, end_time) if end_time else problem.end_time
        self._limited = [i for i, v in enumerate(problem.speed_limits) if math.isfinite(v)]
        self._build(rates)

    def _build(self, rates: Any) -> None:
        import casadi as ca

        n2, m, count = 2 * self.problem.order, len(self.problem.actuators), self.grid.intervals
        x, v = ca.MX.sym("x", n2, count + 1), ca.MX.sym("v", m, count + 1)
        end = ca.MX.sym("end")
        h = end / count
        interval = self._interval(rates).map(count)
        reached, inner = interval(x[:, :-1], v[:, :-1], v[:, 1:], ca.repmat(h, 1, count))
        gaps = ca.vec(reached - x[:, 1:])
        constraints = ca.vertcat(gaps, ca.vec(inner))
        self._fast = int(inner.numel())
        unknown = ca.vertcat(ca.vec(x), ca.vec(v), end)
        options: dict[str, Any] = {
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "linear_solver": "mumps",
                "tol": self.grid.tolerance,
                "constr_viol_tol": self.grid.tolerance,
                "max_iter": self.grid.iterations,
                "mu_strategy": "adaptive",
                "bound_relax_factor": 0.0,
            },
        }
        nlp = {"x": unknown, "f": self._cost(x, v, end, h), "g": constraints}
        self._solver = ca.nlpsol("plan", "ipopt", nlp, options)

    def _interval(self, rates: Any) -> Any:
        """Return (x, v0, v1, h) -> (x at the end, limited speeds after each inner step)."""
        import casadi as ca

        n2, m, steps = 2 * self.problem.order, len(self.problem.actuators), self.grid.steps
        limits = ca.DM(list(self.problem.torque_limits))
        x0, v0, v1 = ca.SX.sym("x", n2), ca.SX.sym("v0", m), ca.SX.sym("v1", m)
        h = ca.SX.sym("h")
        step, x, inner = h / steps, x0, []

        def slope(state: Any, share: float) -> Any:
            return rates(state, limits * (v0 + share * (v1 - v0)))

        for k in range(steps):
            a, b, c = k / steps, (k + 0.5) / steps, (k + 1) / steps
            k1 = slope(x, a)
            k2 = slope(x + step / 2 * k1, b)
            k3 = slope(x + step / 2 * k2, b)
            k4 = slope(x + step * k3, c)
            x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            if k < steps - 1:
                inner += [x[self.problem.order + i] for i in self._limited]
        return ca.Function("interval", [x0, v0, v1, h], [x, ca.vertcat(ca.SX(0, 1), *inner)])

    def _cost(self, x: Any, v: Any, end: Any, h: Any) -> Any:
        """Return the cost: exact for the linear torque, by the trapezoidal rule for the speed."""
        import casadi as ca

        weights, n = self.problem.weights, self.problem.order
        a, b = v[:, :-1], v[:, 1:]
        effort = h / 3 * ca.sum1(ca.vec(a * a + a * b + b * b))
        smoothness = ca.sumsqr(b - a) / h
        squares = ca.sum1(x[n:, :] ** 2)
        speed = h * (ca.sum2(squares) - squares[0] / 2 - squares[-1] / 2)
        return (
            weights.effort * effort
            + weights.smoothness * smoothness
            + weights.speed * speed
            + weights.time * end
        )

    def solve(self, guess: Guess) -> Trajectory | None:
        """Return the solution IPOPT finds from `guess`, or nothing where it finds none."""
        problem, count = self.problem, self.grid.intervals
        n, m = problem.order, len(problem.actuators)
        limits = np.array(problem.torque_limits)
        low, high = self._unknown_bounds()
        first = np.concatenate([
            guess.states.ravel(), (guess.torques / limits).ravel(), [guess.end_time]
        ])  # fmt: skip
        fast = np.tile(self._speeds()[self._limited], self._fast // max(len(self._limited), 1))
        gaps = np.zeros(2 * n * count)
        answer = self._solver(
            x0=np.clip(first, low, high),
            lbx=low,
            ubx=high,
            lbg=np.concatenate([gaps, -fast]),
            ubg=np.concatenate([gaps, fast]),
        )
        stats = self._solver.stats()
        if not stats["success"]:
            return None
        flat = np.array(answer["x"]).ravel()
        states = flat[: 2 * n * (count + 1)].reshape(count + 1, 2 * n)
        torques = flat[2 * n * (count + 1) : -1].reshape(count + 1, m) * limits
        times = np.linspace(0.0, float(flat[-1]), count + 1)
        return Trajectory(times, states, torques, float(answer["f"]), int(stats["iter_count"]))

    def _speeds(self) -> Array:
        return np.array(self.problem.speed_limits) * (1.0 - _SPEED_MARGIN)

    def _unknown_bounds(self) -> tuple[Array, Array]:
        """Return the bounds of the unknowns: rest at both ends, limits in between."""
        problem, count = self.problem, self.grid.intervals
        limits = np.array(problem.torque_limits)
        state = np.concatenate([np.full(problem.order, math.inf), self._speeds()])
        high_x = np.tile(state, (count + 1, 1))
        low_x = -high_x
        low_x[0] = high_x[0] = problem.start
        low_x[-1] = high_x[-1] = problem.goal
        high_v = np.ones((count + 1, len(limits)))
        low_v = -high_v
        low_v[0] = high_v[0] = np.array(problem.start_torque) / limits
        low_v[-1] = high_v[-1] = np.array(problem.goal_torque) / limits
        return (
            np.concatenate([low_x.ravel(), low_v.ravel(), [self._bounds[0]]]),
            np.concatenate([high_x.ravel(), high_v.ravel(), [self._bounds[1]]]),
        )
