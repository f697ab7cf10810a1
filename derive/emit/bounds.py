"""Bounds that emitted code checks of its inputs."""

from __future__ import annotations

import math
import sys

from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.names import TIME_NAME
from pfaffian.derive.ir.ranges import Range

#: Largest |time| in seconds taken as a measurement of a time-varying constraint: thirty years.
TIME_BOUND = 1e9


def finite_bound(value: float) -> float:
    """Return a bound as a literal can hold it: what is unbounded must still be finite."""
    return math.copysign(sys.float_info.max, value) if math.isinf(value) else value


def measured_bounds(model: LoweredModel) -> list[tuple[str, float]]:
    """Return each measurement of a period with the largest magnitude that is taken for one."""
    rows = []
    for c in model.coordinates:
        rows += [(c.name, c.bound), (f"d{c.name}", c.rate_bound)]
    if any(s.name == TIME_NAME for s in model.program("step").inputs):
        rows.append((TIME_NAME, TIME_BOUND))
    return [(name, finite_bound(bound)) for name, bound in rows]


def input_bounds(model: LoweredModel) -> dict[str, Range]:
    """Return what the checks before the step, and those of `init`, leave of its inputs."""
    bounds = {p.name: (p.lower, p.upper) for p in model.parameters}
    return bounds | {name: (-b, b) for name, b in measured_bounds(model)}
