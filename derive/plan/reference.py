"""A plan between its nodes: cubic through values and slopes, the torque linear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Curve:
    """A cubic Hermite curve: values (N+1, ...) and slopes (N+1, ...) at times (N+1,).

    Before the first and after the last node it keeps the value there.
    """

    times: Array
    values: Array
    slopes: Array

    def __call__(self, time: float) -> Array:
        """Return the value at `time`."""
        k, h, u = self._where(time)
        a, b = self.values[k], self.values[k + 1]
        c, d = h * self.slopes[k], h * self.slopes[k + 1]
        square, cube = u * u, u * u * u
        found: Array = (
            (2.0 * cube - 3.0 * square + 1.0) * a
            + (cube - 2.0 * square + u) * c
            + (3.0 * square - 2.0 * cube) * b
            + (cube - square) * d
        )
        return found

    def slope(self, time: float) -> Array:
        """Return the derivative at `time`, 0 outside."""
        if not self.times[0] <= time <= self.times[-1]:
            return np.zeros_like(self.values[0])
        k, h, u = self._where(time)
        rise = (self.values[k + 1] - self.values[k]) / h
        a, b = self.slopes[k], self.slopes[k + 1]
        found: Array = (
            6.0 * u * (1.0 - u) * rise + (1.0 + u * (3.0 * u - 4.0)) * a + u * (3.0 * u - 2.0) * b
        )
        return found

    def _where(self, time: float) -> tuple[int, float, float]:
        last = len(self.times) - 2
        k = min(max(int(np.searchsorted(self.times, time, side="right")) - 1, 0), last)
        h = float(self.times[k + 1] - self.times[k])
        return k, h, min(max((time - float(self.times[k])) / h, 0.0), 1.0)


def torque_at(times: Array, torques: Array, time: float) -> Array:
    """Return the torque (m,) at `time`: linear between the nodes, held outside."""
    return np.array([np.interp(time, times, column) for column in torques.T])
