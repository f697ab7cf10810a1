"""Operating regions: a box of coordinates and rates, over which the assumptions are checked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.toml import suggestion

#: Beyond this, in rad or rad/s, no region and no start means anything.
_FARTHEST = 1000.0
_FORM = "write q1=1:2,q2=0.6,rate=8: LOW:HIGH, or a half-width about the setpoint; rad and rad/s"


@dataclass(frozen=True)
class Region:
    """A box: the ends of each coordinate (rad) and each rate (rad/s) by name."""

    box: Mapping[str, tuple[float, float]]

    def contains(self, points: Mapping[str, Array]) -> Array:
        """Return whether each point lies within, bool of shape (N,)."""
        inside = [(points[n] >= a) & (points[n] <= b) for n, (a, b) in self.box.items()]
        return np.asarray(np.logical_and.reduce(np.broadcast_arrays(*inside)))

    def text(self) -> str:
        """Return the box as a person reads it."""
        return ", ".join(f"{n} in [{a:.4g}, {b:.4g}]" for n, (a, b) in self.box.items())


def region_around(points: Mapping[str, Array], margin: float) -> Region:
    """Return the least box around `points`, each side moved out by `margin` of its length."""
    box = {}
    for name, values in points.items():
        low, high = float(np.min(values)), float(np.max(values))
        extra = margin * max(high - low, 1e-3)
        box[name] = (low - extra, high + extra)
    return Region(box)


def parse_region(
    text: str, coordinates: Sequence[str], setpoint: Mapping[str, float]
) -> dict[str, tuple[float, float]]:
    """Return the sides of a region that `text` names, by coordinate or rate.

    `text` is such as `q1=1:2,q2=0.6,rate=8`: ends, or a half-width about the setpoint (zero for
    a rate); `rate` stands for every rate. Raises `InputError` where it is malformed.
    """
    rates = [f"d{n}" for n in coordinates]
    known = [*coordinates, *rates, "rate"]
    box = {}
    for part in text.split(","):
        key, _, value = (p.strip() for p in part.partition("="))
        if key not in known:
            raise InputError(f"--region: unknown coordinate {key!r}", remedy=suggestion(key, known))
        for name in rates if key == "rate" else [key]:
            box[name] = _side(value, setpoint.get(name, 0.0), f"--region: {key}")
    return box


def _side(text: str, centre: float, where: str) -> tuple[float, float]:
    first, colon, second = text.partition(":")
    try:
        numbers = [float(first), float(second)] if colon else [float(first)]
    except ValueError as error:
        raise InputError(f"{where}: {text!r} is no number and no LOW:HIGH", remedy=_FORM) from error
    if not all(abs(n) <= _FARTHEST for n in numbers):
        raise InputError(f"{where}: {text!r} is not within {_FARTHEST:g}", remedy=_FORM)
    low, high = numbers if colon else (centre - numbers[0], centre + numbers[0])
    if not low <= high:
        raise InputError(f"{where}: {low:g} to {high:g} is empty", remedy=_FORM)
    return low, high


def parse_point(text: str, known: Mapping[str, float]) -> dict[str, float]:
    """Return `known` with the values that `text`, such as `q1=1,dq1=0.5`, names replaced.

    Raises `InputError` for an unknown name or no number.
    """
    point = dict(known)
    for part in text.split(","):
        key, _, value = (p.strip() for p in part.partition("="))
        if key not in point:
            raise InputError(f"--initial: unknown {key!r}", remedy=suggestion(key, list(point)))
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not abs(number) <= _FARTHEST:
            raise InputError(
                f"--initial: {key}: {value!r} is no number within {_FARTHEST:g}",
                remedy="write q1=1,q2=0.5,dq1=1,dq2=0 in rad and rad/s",
            )
        point[key] = number
    return point
