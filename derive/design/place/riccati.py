"""The servo-constraint from a Riccati equation: the rows B^T P and their gains."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pfaffian.derive.design.place.linear_plant import residual_rows, state_space
from pfaffian.derive.design.place.row_space import MET, fitted_gains, row_gap
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.toml import shown
from scipy.linalg import LinAlgError, eigh, solve_continuous_are

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RiccatiRow:
    """The rows B^T P (m, 2n) of x = (q - q_d, q'), with P (2n, 2n), diag Q (2n), R, and the gains.

    On s = B^T P x = 0 the linearised plant has d/dt x^T P x = -x^T Q x: P is a Lyapunov function
    of the zero dynamics. `gap` is the sine of the largest angle between the row spaces of B^T P
    and of the residual with these gains, states in units of 1/sqrt(P_ii); `lyapunov_rate` the
    largest d/dt x^T P x over x^T P x on s = 0 of that residual, in 1/s: negative proves it stable.
    """

    weights: tuple[float, ...]
    effort: float
    rows: tuple[tuple[float, ...], ...]
    matrix: tuple[tuple[float, ...], ...]
    gains: dict[str, float]
    gap: float
    lyapunov_rate: float

    @property
    def row(self) -> tuple[float, ...]:
        """Return the first row, the only one with one actuator."""
        return self.rows[0]

    def as_json(self) -> dict[str, Any]:
        """Return what `pfaffian design --json` shows of it."""
        return {
            "P": self.matrix,
            "Q": self.weights,
            "R": self.effort,
            "row": self.row if len(self.rows) == 1 else self.rows,
            "row_gap": self.gap,
            "lyapunov_rate": self.lyapunov_rate,
        }


def read_weights(model: LoweredModel, text: str, where: str) -> tuple[tuple[float, ...], float]:
    """Return diag Q and R from "Q1,..,Q2n[,R]" (R = 1); raise `InputError` naming `where`."""
    order = 2 * len(model.coordinates)
    remedy = f"give {order} positive weights of (q, q'), and R after them if it is not 1"
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{where}: {shown(text)} is no list of weights", remedy=remedy) from None
    if len(numbers) not in (order, order + 1):
        raise InputError(f"{where}: {len(numbers)} weights for {order} states", remedy=remedy)
    for number in numbers:
        if not (math.isfinite(number) and number > 0.0):
            raise InputError(f"{where}: {number:g} is not a positive weight", remedy=remedy)
    return tuple(numbers[:order]), numbers[order] if len(numbers) > order else 1.0


def riccati_row(
    model: LoweredModel,
    values: Mapping[str, float],
    weights: tuple[float, ...],
    effort: float,
    where: str,
) -> RiccatiRow:
    """Solve the Riccati equation at the setpoint and match its rows to the model's residual.

    Raises `InputError` naming `where` for a residual whose gains do not meet the rows, a plant
    that cannot be stabilised, and gains out of their bounds.
    """
    if len(model.actuators) == 1 and not model.has_program("row_gains"):
        raise InputError(
            f"{where}: the residual of model {model.name} does not meet every row of errors and "
            f"rates with its gains",
            remedy="place poles instead (--poles)",
        )
    a, b = state_space(model, values)
    p = solve_riccati(a, b, weights, effort)
    if p is None:
        raise InputError(
            f"{where}: the Riccati equation has no stabilising solution at the setpoint",
            remedy="choose weights closer to each other, or check that the plant is controllable",
        )
    rows, scale = b.T @ p, 1.0 / np.sqrt(np.diag(p))
    if len(rows) == 1:
        gains = _single_gains(model, values, rows[0])
    else:
        gains = _several_gains(model, values, rows, scale, where)
    for parameter in model.parameters:
        if parameter.name in gains:
            parameter.check(gains[parameter.name], where)
    own = residual_rows(model, {**values, **gains})
    return RiccatiRow(
        weights,
        effort,
        _as_tuples(rows),
        _as_tuples(p),
        gains,
        row_gap(own * scale, rows * scale),
        lyapunov_rate(a, b, p, own),
    )


def _as_tuples(matrix: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in line) for line in matrix)


def _single_gains(model: LoweredModel, values: Mapping[str, float], row: Array) -> dict[str, float]:
    half = range(1, len(model.coordinates) + 1)
    names = [*(f"row_position_{i}" for i in half), *(f"row_rate_{i}" for i in half)]
    named = dict(zip(names, map(float, row), strict=True))
    return evaluate(model.program("row_gains"), {**values, **named})


def _several_gains(
    model: LoweredModel, values: Mapping[str, float], rows: Array, scale: Array, where: str
) -> dict[str, float]:
    """Fit the gains to the row space of `rows`; raise `InputError` with the gap that is left."""
    names = tuple(p.name for p in model.parameters if p.group == "synthesised")
    gains, gap = fitted_gains(model, values, names, rows, scale)
    if not gap < MET:
        raise InputError(
            f"{where}: the residual of model {model.name} does not meet the {len(rows)} rows B^T P "
            f"with its gains {', '.join(names)}: the nearest row space found is {gap:.2g} away "
            f"(sine of the largest angle, states in units of 1/sqrt(P_ii))",
            remedy="place poles instead (--poles), or give the residual more gains",
        )
    return gains


def lyapunov_rate(a: Array, b: Array, p: Array, rows: Array) -> float:
    """Return the largest d/dt x^T P x over x^T P x on s = S x = 0, with S = `rows` (m, 2n), in 1/s.

    There tau holds s' = 0: x' = (A - B (S B)^-1 S A) x. It is the largest eigenvalue of the
    derivative restricted to s = 0, in the metric of P: negative proves the zero dynamics stable.
    """
    try:
        sliding = a - b @ np.linalg.solve(rows @ b, rows @ a)
        null = np.linalg.svd(rows)[2][len(rows) :].T
        rate = null.T @ (p @ sliding + sliding.T @ p) @ null
        found = eigh((rate + rate.T) / 2.0, null.T @ p @ null, eigvals_only=True)
    except (LinAlgError, ValueError):
        return math.inf
    return float(found[-1])


def solve_riccati(a: Array, b: Array, weights: tuple[float, ...], effort: float) -> Array | None:
    """Return the positive definite P of the Riccati equation, or nothing if none is found.

    Q = diag(weights) (2n,), R = effort times the identity (m, m).
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of overflow in the balancing: no solution either
            found: Any = solve_continuous_are(
                a, b, np.diag(weights), effort * np.identity(b.shape[1])
            )
    except (LinAlgError, ValueError, Warning):
        return None
    p: Array = (found + found.T) / 2.0
    return p if np.all(np.isfinite(p)) and np.linalg.eigvalsh(p)[0] > 0.0 else None
