"""What a parameter set amounts to: zero-dynamics poles, input gain, the way to ADB = 0."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from pfaffian.derive.lowered import LoweredModel
from pfaffian.derive.parameter_set import ParameterSet, is_hurwitz, roots_of, zero_polynomial
from pfaffian.derive.program import evaluate
from scipy.optimize import brentq

_SCAN_STEPS = 720


@dataclass(frozen=True)
class Design:
    """Figures of one parameter set; `singular_distance_rad` is infinite where ADB keeps its sign.

    `contraction` is kappa (ADB)^2 at the setpoint in 1/s, the rate at which p2 shrinks beta.
    """

    gains: dict[str, float]
    zero_dynamics_poles: tuple[complex, ...]
    stable: bool
    input_gain: float
    singular_distance_rad: float
    singular_coordinate: str
    contraction: float


def assess(model: LoweredModel, parameters: ParameterSet) -> Design:
    """Return the figures of `parameters`."""
    values = parameters.as_dict()
    polynomial = zero_polynomial(model, values)
    distance, coordinate = singular_distance(model, values)
    gain = _gain_along(model, values, model.coordinates[0].name)(0.0)
    return Design(
        gains={p.name: values[p.name] for p in model.parameters if p.group == "synthesised"},
        zero_dynamics_poles=roots_of(polynomial),
        stable=is_hurwitz(polynomial),
        input_gain=gain,
        singular_distance_rad=distance,
        singular_coordinate=coordinate,
        contraction=values.get("kappa", 0.0) * gain**2,
    )


def _gain_along(
    model: LoweredModel, values: dict[str, float], coordinate: str
) -> Callable[[float], float]:
    """Return ADB as a function of the offset of one coordinate from the setpoint."""
    program = model.program("input_gain")
    setpoint = evaluate(model.program("setpoint"), values)
    rest = {f"d{c.name}": 0.0 for c in model.coordinates}

    def gain(offset: float) -> float:
        at = {**values, **rest, **setpoint}
        at[coordinate] += offset
        return evaluate(program, at)["adb"]

    return gain


def singular_distance(model: LoweredModel, values: dict[str, float]) -> tuple[float, str]:
    """Return the least offset of one coordinate from the setpoint at which ADB = 0, and which."""
    nearest, name = math.inf, ""
    for coordinate in model.coordinates:
        gain = _gain_along(model, values, coordinate.name)
        for side in (1.0, -1.0):
            before = gain(0.0)
            for k in range(1, _SCAN_STEPS + 1):
                offset = side * math.pi * k / _SCAN_STEPS
                here = gain(offset)
                if (here > 0.0) != (before > 0.0):
                    root = brentq(gain, offset - side * math.pi / _SCAN_STEPS, offset, xtol=1e-12)
                    if abs(root) < nearest:
                        nearest, name = abs(root), coordinate.name
                    break
    return nearest, name
