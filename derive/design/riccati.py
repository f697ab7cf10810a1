"""The servo-constraint from a Riccati equation: the row B^T P and its gains."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pfaffian.derive.lowered import LoweredModel
from pfaffian.derive.program import evaluate
from pfaffian.runtime.documents import shown
from pfaffian.runtime.errors import InputError
from scipy.linalg import LinAlgError, solve_continuous_are

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RiccatiRow:
    """The row B^T P of x = (q - q_d, q'), with P (2n, 2n), diag Q (2n), R, and the gains it gives.

    On s = B^T P x = 0 the linearised plant has d/dt x^T P x = -x^T Q x: P is a Lyapunov function
    of the zero dynamics.
    """

    weights: tuple[float, ...]
    effort: float
    row: tuple[float, ...]
    matrix: tuple[tuple[float, ...], ...]
    gains: dict[str, float]


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


def state_space(model: LoweredModel, values: Mapping[str, float]) -> tuple[Array, Array]:
    """Return A (2n, 2n), B (2n, m) of x' = A x + B tau at the setpoint, x = (q - q_d, q')."""
    matrix = _matrices(model, values)
    n, m = len(model.coordinates), len(model.actuators)
    inverse = np.linalg.inv(matrix("mass", n, n))
    lower = np.hstack([-inverse @ matrix("stiffness", n, n), -inverse @ matrix("damping", n, n)])
    above = np.hstack([np.zeros((n, n)), np.eye(n)])
    b = np.vstack([np.zeros((n, m)), inverse @ matrix("input", n, m)])
    return np.vstack([above, lower]), b


def input_gains(model: LoweredModel, values: Mapping[str, float]) -> Array:
    """Return the singular values (m,) of ADB at the setpoint, largest first."""
    matrix = _matrices(model, values)
    n, m = len(model.coordinates), len(model.actuators)
    inverse = np.linalg.inv(matrix("mass", n, n))
    return np.linalg.svd(matrix("rate_row", m, n) @ inverse @ matrix("input", n, m))[1]


def _matrices(model: LoweredModel, values: Mapping[str, float]) -> Callable[[str, int, int], Array]:
    """Return a function from name and shape to a matrix of the linearisation."""
    defaults = {p.name: p.default for p in model.parameters if p.default is not None}
    entries = evaluate(model.program("linearisation"), {**defaults, **values})

    def matrix(name: str, rows: int, columns: int) -> Array:
        return np.array(
            [[entries[f"{name}_{i + 1}_{j + 1}"] for j in range(columns)] for i in range(rows)]
        )

    return matrix


def riccati_row(
    model: LoweredModel,
    values: Mapping[str, float],
    weights: tuple[float, ...],
    effort: float,
    where: str,
) -> RiccatiRow:
    """Solve the Riccati equation at the setpoint and match its row to the model's residual.

    Raises `InputError` naming `where` for several actuators, a residual with fewer gains than a
    row has directions, a plant that cannot be stabilised, and gains out of their bounds.
    """
    if not model.has_program("row_gains"):
        raise InputError(
            f"{where}: the residual of model {model.name} does not meet every row of errors and "
            f"rates with its gains, or there are several actuators",
            remedy="place poles instead (--poles)",
        )
    a, b = state_space(model, values)
    p = _solution(a, b, weights, effort)
    if p is None:
        raise InputError(
            f"{where}: the Riccati equation has no stabilising solution at the setpoint",
            remedy="choose weights closer to each other, or check that the plant is controllable",
        )
    row = tuple(float(r) for r in (b.T @ p)[0])
    half = range(1, len(model.coordinates) + 1)
    names = [*(f"row_position_{i}" for i in half), *(f"row_rate_{i}" for i in half)]
    named = dict(zip(names, row, strict=True))
    gains = evaluate(model.program("row_gains"), {**values, **named})
    for parameter in model.parameters:
        if parameter.name in gains:
            parameter.check(gains[parameter.name], where)
    matrix = tuple(tuple(float(v) for v in line) for line in p)
    return RiccatiRow(weights, effort, row, matrix, gains)


def _solution(a: Array, b: Array, weights: tuple[float, ...], effort: float) -> Array | None:
    """Return the positive definite P of the Riccati equation, or nothing if none is found."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of overflow in the balancing: no solution either
            found: Any = solve_continuous_are(a, b, np.diag(weights), np.array([[effort]]))
    except (LinAlgError, ValueError, Warning):
        return None
    p: Array = (found + found.T) / 2.0
    return p if np.all(np.isfinite(p)) and np.linalg.eigvalsh(p)[0] > 0.0 else None
