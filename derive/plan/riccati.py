"""The row of the servo-constraint along a plan: B^T P of the differential Riccati equation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pfaffian.derive.design.place.riccati import solve_riccati
from pfaffian.derive.plan.problem import Problem
from pfaffian.derive.plan.reference import Curve, torque_at
from pfaffian.derive.plan.shooting import Trajectory
from pfaffian.runtime.base.errors import CheckError, InputError
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RowPath:
    """Rows B^T P (N+1, m, 2n) of (q - q_ref, q' - q_ref') at the nodes, and their rates.

    P solves -P' = A^T P + P A - P B R^-1 B^T P + Q backwards from the algebraic solution at the
    goal; Q = diag(`weights`), R = `effort` over the squared torque limits. `matrices` are P
    (N+1, 2n, 2n). `lyapunov_rate` is the largest d/dt x^T P x over x^T P x on s = 0 at any node,
    in 1/s, negative where P proves the linearised error dynamics on s = 0 stable;
    `input_gain` the least eigenvalue of B^T P B over its value at the goal: how far ADB stays
    from 0.
    """

    weights: tuple[float, ...]
    effort: float
    rows: Array
    rates: Array
    matrices: Array
    lyapunov_rate: float
    input_gain: float


class Linearised:
    """A (2n, 2n), B (2n, m) along a trajectory, and B', by CasADi's differentiation."""

    def __init__(self, rates: Any, n2: int, m: int) -> None:
        """Differentiate the function `rates` of (x, tau)."""
        import casadi as ca

        x, tau, dx = ca.SX.sym("x", n2), ca.SX.sym("tau", m), ca.SX.sym("dx", n2)
        slope = rates(x, tau)
        b = ca.jacobian(slope, tau)
        moved = ca.reshape(ca.jtimes(ca.vec(b), x, dx), n2, m)
        self._function = ca.Function("linear", [x, tau, dx], [ca.jacobian(slope, x), b, moved])
        self._rates = rates

    def __call__(self, x: Array, tau: Array) -> tuple[Array, Array, Array]:
        """Return A, B and B' where the plant moves through `x` under `tau`."""
        a, b, moved = (np.array(v) for v in self._function(x, tau, self.rates(x, tau)))
        return a, b, moved

    def rates(self, x: Array, tau: Array) -> Array:
        """Return x' (2n,)."""
        found: Array = np.array(self._rates(x, tau)).ravel()
        return found


def riccati_path(
    problem: Problem,
    rates: Any,
    plan: Trajectory,
    weights: tuple[float, ...],
    effort: float,
) -> RowPath:
    """Integrate the Riccati equation along `plan`.

    Raises `InputError` where the linearisation at the goal has no stabilising solution, and
    `CheckError` where P does not stay positive definite.
    """
    n2, m = 2 * problem.order, len(problem.actuators)
    linear = Linearised(rates, n2, m)
    scale = np.diag(problem.torque_limits)
    a, b, _ = linear(np.array(problem.goal), np.array(problem.goal_torque))
    last = solve_riccati(a, b @ scale, weights, effort)
    if last is None:
        raise InputError(
            f"model {problem.model}: the Riccati equation has no stabilising solution at the goal",
            remedy="choose other --riccati weights, or check that the plant is controllable there",
        )
    matrices = _backwards(plan, linear, scale, weights, effort, last)
    if not all(np.linalg.eigvalsh(p)[0] > 0.0 for p in matrices):
        raise CheckError(
            f"model {problem.model}: P does not stay positive definite along the plan",
            remedy="choose --riccati weights closer to each other",
        )
    rows, slopes, lyapunov, gains = [], [], [], []
    for x, tau, p in zip(plan.states, plan.torques, matrices, strict=True):
        a, b, moved = linear(x, tau)
        dp = _slope(p, a, b @ scale, weights, effort)
        rows.append(b.T @ p)
        slopes.append(moved.T @ p + b.T @ dp)
        lyapunov.append(_lyapunov_rate(a, b, p, dp, rows[-1], slopes[-1]))
        gains.append(float(np.linalg.eigvalsh(rows[-1] @ b)[0]))
    return RowPath(
        weights,
        effort,
        np.array(rows),
        np.array(slopes),
        matrices,
        max(lyapunov),
        min(gains) / gains[-1],
    )


def _slope(p: Array, a: Array, b: Array, weights: tuple[float, ...], effort: float) -> Array:
    """Return P' of the differential Riccati equation."""
    pb = p @ b
    found: Array = pb @ pb.T / effort - a.T @ p - p @ a - np.diag(weights)
    return found


def _backwards(
    plan: Trajectory,
    linear: Linearised,
    scale: Array,
    weights: tuple[float, ...],
    effort: float,
    last: Array,
) -> Array:
    """Return P (N+1, 2n, 2n) at the nodes, `last` at the end."""
    n2 = len(weights)
    pairs = zip(plan.states, plan.torques, strict=True)
    slopes = np.array([linear.rates(x, tau) for x, tau in pairs])
    curve = Curve(plan.times, plan.states, slopes)

    def rate(time: float, flat: Array) -> Array:
        p = flat.reshape(n2, n2)
        a, b, _ = linear(curve(time), torque_at(plan.times, plan.torques, time))
        return _slope((p + p.T) / 2.0, a, b @ scale, weights, effort).ravel()

    matrices = [last]
    for k in range(len(plan.times) - 1, 0, -1):
        span = (float(plan.times[k]), float(plan.times[k - 1]))
        size = float(np.max(np.abs(matrices[-1])))
        found = solve_ivp(
            rate, span, matrices[-1].ravel(), method="DOP853", rtol=1e-9, atol=1e-11 * size
        )
        p = found.y[:, -1].reshape(n2, n2)
        matrices.append((p + p.T) / 2.0)
    return np.array(matrices[::-1])


def _lyapunov_rate(a: Array, b: Array, p: Array, dp: Array, rows: Array, slopes: Array) -> float:
    """Return the largest V'/V of V = x^T P x on s = S x = 0, where tau holds s' = 0."""
    sliding = a - b @ np.linalg.solve(rows @ b, rows @ a + slopes)
    null = np.linalg.svd(rows)[2][len(rows) :].T
    rate = null.T @ (dp + p @ sliding + sliding.T @ p) @ null
    found = eigh((rate + rate.T) / 2.0, null.T @ p @ null, eigvals_only=True)
    return float(found[-1])
