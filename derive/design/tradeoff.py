"""Decay rate of the zero dynamics against the distance to ADB = 0, as a curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pfaffian.derive.design.assess import assess, with_values
from pfaffian.derive.design.place.poles import gains_for_poles
from pfaffian.derive.design.place.riccati import riccati_row
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.sets.gains import zero_order
from pfaffian.derive.sets.parameter_set import ParameterSet
from pfaffian.runtime.base.errors import InputError

_POINTS = 25
_FASTEST, _SLOWEST = 20.0, 0.5
_LEAST_FACTOR, _LARGEST_FACTOR = 1e-3, 1e3


@dataclass(frozen=True)
class TradeoffPoint:
    """One design of a family: `knob` is the multiple pole in 1/s, or the factor on the
    rates' weights in Q.

    `decay_rate` is that of the slowest zero-dynamics pole in 1/s.
    """

    family: str
    knob: float
    decay_rate: float
    singular_distance_rad: float
    singular_unit: str
    gains: dict[str, float]


def tradeoff_curve(
    model: LoweredModel, parameters: ParameterSet, weights: tuple[float, ...], effort: float
) -> tuple[TradeoffPoint, ...]:
    """Return both families: all poles at -p for p in 0.5 to 20 1/s, and Riccati rows.

    The latter keep the weights of the positions and scale those of the rates by 1e-3 to 1e3:
    scaling all of Q only moves the row towards its limit of cheap control. Designs that do not
    exist or whose gains are out of bounds are left out.
    """
    values = parameters.as_dict()
    order = zero_order(model)
    half = len(model.coordinates)
    points: list[TradeoffPoint] = []
    for rate in _spaced(_SLOWEST, _FASTEST):
        try:
            gains = gains_for_poles(model, values, (complex(-rate),) * order, "curve")
        except InputError:
            continue
        points.append(_point(model, parameters, "poles", -rate, gains, rate))
    for factor in _spaced(_LEAST_FACTOR, _LARGEST_FACTOR):
        try:
            scaled = weights[:half] + tuple(w * factor for w in weights[half:])
            gains = riccati_row(model, values, scaled, effort, "curve").gains
        except InputError:
            continue
        points.append(_point(model, parameters, "riccati", factor, gains, None))
    return tuple(points)


def _spaced(first: float, last: float) -> list[float]:
    """Return values from `first` to `last`, both exact, in equal ratios."""
    ratio = (last / first) ** (1.0 / (_POINTS - 1))
    return [first * ratio**k for k in range(_POINTS - 1)] + [last]


def _point(
    model: LoweredModel,
    parameters: ParameterSet,
    family: str,
    knob: float,
    gains: Mapping[str, float],
    rate: float | None,
) -> TradeoffPoint:
    """`rate` replaces the computed one where it is known: roots of a multiple pole scatter."""
    design = assess(model, with_values(parameters, gains), nearest=False)
    decay = design.decay_rate if rate is None else rate
    distance, unit = design.singular_distance_rad, design.singular_unit
    return TradeoffPoint(family, knob, decay, distance, unit, dict(gains))
