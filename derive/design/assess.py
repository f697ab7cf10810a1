"""What a parameter set amounts to: zero-dynamics poles, input gain, the way to ADB = 0."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from pfaffian.derive.design.nearest import SingularPoint, nearest_singular_point
from pfaffian.derive.design.place.linear_plant import input_gains
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.sets.gains import gain_names, is_hurwitz, roots_of, zero_polynomial
from pfaffian.derive.sets.parameter_set import (
    ParameterSet,
    cyclic_notes,
    resolve_set,
    violated_bounds,
)
from pfaffian.derive.sets.raw_set import RawSet
from pfaffian.derive.sets.routh import HurwitzMargin, hurwitz_margins, routh_column
from scipy.optimize import brentq

_SCAN_STEPS = 720


@dataclass(frozen=True)
class Design:
    """Figures of one parameter set; `singular_distance_rad` is infinite where ADB keeps its sign.

    It is an offset of `singular_coordinate` alone, in that coordinate's own unit: `singular_unit`.
    `nearest_singular_point` is over all coordinates at once, and absent where it was not asked.
    `input_gain` is ADB at the setpoint, `contraction` kappa (ADB)^2 there in 1/s, the rate at which
    p2 shrinks beta; for several actuators they are the determinant of ADB and the rate of its
    least singular value. `sampled_contraction` is the rate times the sample time: the printed law,
    held for a period, needs it below 2. `routh_column` is the first column of Routh's array, and
    `hurwitz` has the derived conditions with their margins: all are positive if and only if the
    zero dynamics are stable. Where they are not, `violated` names the conditions that do not hold.
    `cyclic` says of each cyclic coordinate that s does not see what can be asked for; its zeros at
    the origin are not among the poles.
    """

    gains: dict[str, float]
    zero_dynamics_poles: tuple[complex, ...]
    stable: bool
    routh_column: tuple[float, ...]
    hurwitz: tuple[HurwitzMargin, ...]
    violated: tuple[str, ...]
    input_gain: float
    singular_distance_rad: float
    singular_coordinate: str
    singular_unit: str
    contraction: float
    sampled_contraction: float
    cyclic: tuple[str, ...] = ()
    nearest_singular_point: SingularPoint | None = None

    @property
    def decay_rate(self) -> float:
        """Return the decay rate of the slowest zero-dynamics pole in 1/s; negative if unstable."""
        return -max((p.real for p in self.zero_dynamics_poles), default=-math.inf)


def assess(model: LoweredModel, parameters: ParameterSet, *, nearest: bool = True) -> Design:
    """Return the figures of `parameters`, with the `nearest` point of ADB = 0 unless not wanted."""
    values = parameters.as_dict()
    polynomial = zero_polynomial(model, values)
    stable = is_hurwitz(polynomial)
    distance, coordinate = singular_distance(model, values)
    gain = setpoint_gain(model, values)
    least = abs(gain) if len(model.actuators) == 1 else float(input_gains(model, values)[-1])
    contraction = values.get("kappa", 0.0) * least**2
    return Design(
        gains={name: values[name] for name in gain_names(model)},
        zero_dynamics_poles=roots_of(polynomial),
        stable=stable,
        routh_column=routh_column(polynomial),
        hurwitz=hurwitz_margins(model, values),
        violated=() if stable else tuple(violated_bounds(model, values)),
        input_gain=gain,
        singular_distance_rad=distance,
        singular_coordinate=coordinate,
        singular_unit=next((c.unit for c in model.coordinates if c.name == coordinate), ""),
        contraction=contraction,
        sampled_contraction=values.get("sample_time", 0.0) * contraction,
        cyclic=cyclic_notes(model),
        nearest_singular_point=nearest_singular_point(model, values) if nearest else None,
    )


def base_set(model: LoweredModel, raw: RawSet, chooses_gains: bool) -> ParameterSet:
    """Complete `raw` without judging its stability.

    Where the design `chooses_gains` the set need not have any: those it has not are NaN, and its
    wanted poles are dropped.
    """
    if chooses_gains:
        missing = {n: math.nan for n in gain_names(model) if n not in raw.values}
        raw = replace(raw, values={**raw.values, **missing}, poles=())
    return resolve_set(model, raw, judge=False)


def with_values(parameters: ParameterSet, changed: Mapping[str, float]) -> ParameterSet:
    """Return `parameters` with the values in `changed`."""
    values = tuple((name, changed.get(name, value)) for name, value in parameters.values)
    return replace(parameters, values=values)


def setpoint_gain(model: LoweredModel, values: Mapping[str, float]) -> float:
    """Return ADB at the setpoint; its determinant for several actuators."""
    return _gain_along(model, values, model.coordinates[0].name)(0.0)


def _gain_along(
    model: LoweredModel, values: Mapping[str, float], coordinate: str
) -> Callable[[float], float]:
    """Return ADB as a function of the offset of one coordinate from the setpoint."""
    program = model.program("input_gain")
    setpoint = evaluate(model.program("setpoint"), values)
    rest = {f"d{c.name}": 0.0 for c in model.coordinates}
    at = {**values, **rest, **setpoint}

    def gain(offset: float) -> float:
        return evaluate(program, {**at, coordinate: at[coordinate] + offset})["adb"]

    return gain


def singular_distance(model: LoweredModel, values: Mapping[str, float]) -> tuple[float, str]:
    """Return the least offset of one coordinate from the setpoint at which ADB = 0, and which.

    Coordinates are scanned one at a time over half a turn to either side, those ADB depends on.
    """
    nearest, name = math.inf, ""
    moved = {s.name for s in model.program("input_gain").inputs}
    for coordinate in (c for c in model.coordinates if c.name in moved):
        gain = _gain_along(model, values, coordinate.name)
        for side in (1.0, -1.0):
            root = _first_zero(gain, side)
            if root < nearest:
                nearest, name = root, coordinate.name
    return nearest, name


def _first_zero(gain: Callable[[float], float], side: float) -> float:
    """Return the least |offset| on one `side` at which `gain` changes sign, or infinity."""
    positive = gain(0.0) > 0.0
    step = side * math.pi / _SCAN_STEPS
    for k in range(1, _SCAN_STEPS + 1):
        if (gain(k * step) > 0.0) != positive:
            return abs(float(brentq(gain, (k - 1) * step, k * step, xtol=1e-12)))
    return math.inf
