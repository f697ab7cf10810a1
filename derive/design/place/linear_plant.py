"""The plant linearised at the setpoint in numbers: A, B, and the rows of the residual."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.lowered import LoweredModel

Array = NDArray[np.float64]


def state_space(model: LoweredModel, values: Mapping[str, float]) -> tuple[Array, Array]:
    """Return A (2n, 2n), B (2n, m) of x' = A x + B tau at the setpoint, x = (q - q_d, q')."""
    matrix = _matrices(model, values)
    n, m = len(model.coordinates), len(model.actuators)
    inverse = np.linalg.inv(matrix("mass", n, n))
    lower = np.hstack([-inverse @ matrix("stiffness", n, n), -inverse @ matrix("damping", n, n)])
    above = np.hstack([np.zeros((n, n)), np.eye(n)])
    b = np.vstack([np.zeros((n, m)), inverse @ matrix("input", n, m)])
    return np.vstack([above, lower]), b


def residual_rows(model: LoweredModel, values: Mapping[str, float]) -> Array:
    """Return S (m, 2n) of s = S x at the setpoint, x = (q - q_d, q')."""
    matrix = _matrices(model, values)
    n, m = len(model.coordinates), len(model.actuators)
    return np.hstack([matrix("position_row", m, n), matrix("rate_row", m, n)])


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
