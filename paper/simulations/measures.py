"""The numbers of a run: the paper's IAE, MAE and MAE2, and what its figures 10-12 accumulate."""

from __future__ import annotations

import numpy as np
from pfaffian.paper.simulations.fly import Run
from pfaffian.runtime.base.arrays import Array

LAST_SECONDS = 2.0


def measures(run: Run) -> dict[str, float]:
    """Return IAE [rad s], MAE, MAE2 [rad] of both angles, and what beta and the torque come to.

    `beta_end` is the largest |beta| of the last two seconds [rad/s], `beta_sum` its integral
    [rad], `effort` the integral of tau^2 [N^2 m^2 s], `gain_square` the least (ADB)^2. Of a run
    that ended early the figures cover what there is; MAE2 and `beta_end` are then NaN.
    """
    time, error = run.time, np.abs(run.errors())
    late = time >= run.case.duration - LAST_SECONDS
    whole = not run.ended
    found: dict[str, float] = {}
    for k, name in enumerate(("q1", "q2")):
        found[f"iae_{name}"] = float(np.trapezoid(error[:, k], time))
        found[f"mae_{name}"] = float(error[:, k].max())
        found[f"mae2_{name}"] = float(error[late, k].max()) if whole else float("nan")
    beta, tau = np.abs(run.signals["beta"]), run.signals["tau"]
    found["beta_max"] = float(beta.max())
    found["beta_end"] = float(beta[late].max()) if whole else float("nan")
    found["beta_sum"] = float(np.trapezoid(beta, time))
    found["effort"] = float(np.trapezoid(tau**2, time))
    found["peak_torque"] = float(np.abs(tau).max())
    found["gain_square"] = float((run.signals["adb"] ** 2).min())
    return found


def accumulated(time: Array, values: Array) -> Array:
    """Return the integral (N,) of `values` up to each of the times, by the trapezoidal rule."""
    areas = np.diff(time) * (values[1:] + values[:-1]) / 2.0
    return np.concatenate([[0.0], np.cumsum(areas)])
