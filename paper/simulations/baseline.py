"""The paper's baseline: the linear quadratic regulator of section 5.1, Q = I, R = 1."""

from __future__ import annotations

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.code.generated_model import GeneratedModel, fill_records
from scipy.linalg import solve_continuous_are

_STEP = 1e-5


def linear_plant(host: GeneratedModel, set_name: str) -> tuple[Array, Array]:
    """Return A (4, 4) and B (4, 1) of x' = A x + B tau at the upright, x = (e, q').

    By central differences of the generated accelerations; friction is left out, as in the paper.
    """
    values = host.folder.parameters(set_name)
    params = fill_records(host.records("plant_params"), values)
    state, applied, rate = (host.records(r) for r in ("plant_state", "plant_input", "plant_rate"))
    channels = ("q1", "q2", "dq1", "dq2", "tau")
    goal = np.array([values["q1d"], values["q2d"], 0.0, 0.0, 0.0])

    def accelerations(point: Array) -> Array:
        for name, value in zip(channels, point, strict=True):
            (applied if name == "tau" else state)[name] = value
        host.acceleration(params, state, applied, rate)
        return np.array([rate["ddq1"][0], rate["ddq2"][0]])

    shifts = _STEP * np.eye(5)
    columns = [(accelerations(goal + h) - accelerations(goal - h)) / (2 * _STEP) for h in shifts]
    lower = np.array(columns).T
    a = np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), lower[:, :4]])
    return a, np.vstack([np.zeros((2, 1)), lower[:, 4:]])


def lqr_gain(
    host: GeneratedModel, set_name: str = "sim", effort: float = 1.0, rates: float = 1.0
) -> tuple[float, ...]:
    """Return K (4,) of tau = -K (e, q') in N m per rad and per rad/s, for R = `effort` [1/(N m)^2]
    and Q = diag(1, 1, `rates`, `rates`); the paper has Q = I and R = 1."""
    a, b = linear_plant(host, set_name)
    p = solve_continuous_are(a, b, np.diag([1.0, 1.0, rates, rates]), effort * np.eye(1))
    # Rounded so that no difference in a linear algebra library changes what is flown.
    return tuple(round(float(k), 6) for k in (b.T @ p)[0] / effort)


def slowest_rate(host: GeneratedModel, gain: tuple[float, ...], set_name: str) -> float:
    """Return the largest real part of the poles of A - B K [1/s]."""
    a, b = linear_plant(host, set_name)
    return float(np.linalg.eigvals(a - b @ np.array([gain])).real.max())
