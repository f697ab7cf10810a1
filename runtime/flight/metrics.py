"""Tracking figures of a flight, as the paper defines them in section 5.1."""

from __future__ import annotations

import numpy as np
from pfaffian.runtime.flight.closed_loop import Trajectory

#: MAE2 looks at the last two seconds.
_LAST_SECONDS = 2.0


def tracking_metrics(trajectory: Trajectory) -> dict[str, float]:
    """Return IAE [rad s], MAE and MAE2 [rad] by coordinate, and the peak torque [N m].

    IAE is the integral of |q - q_d| by the trapezoidal rule, MAE its maximum, MAE2 the maximum
    over the last two seconds.
    """
    time = trajectory.time
    last = time >= time[-1] - _LAST_SECONDS
    figures: dict[str, float] = {}
    for name, error in trajectory.errors().items():
        absolute = np.abs(error)
        figures[f"iae_{name}"] = float(np.trapezoid(absolute, time))
        figures[f"mae_{name}"] = float(absolute.max())
        figures[f"mae2_{name}"] = float(absolute[last].max())
    torques = [np.abs(trajectory.output[a]) for a in trajectory.scenario.folder.manifest.actuators]
    figures["peak_torque"] = float(np.max(torques))
    return figures


def status_counts(trajectory: Trajectory) -> dict[str, int]:
    """Return how many periods ended with each status that occurred, by name."""
    names = trajectory.scenario.folder.manifest.status
    values, counts = np.unique(trajectory.status, return_counts=True)
    return {names[int(v)]: int(c) for v, c in zip(values, counts, strict=True)}
