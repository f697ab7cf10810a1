"""The nearest point of ADB = 0 in all coordinates at once, with a bound that no zero is nearer."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.evaluate_arrays import evaluate_at
from pfaffian.derive.ir.extrema import restricted
from pfaffian.derive.ir.intervals import enclose
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.program import Program
from scipy.optimize import brentq, minimize

Array = NDArray[np.float64]

#: The search covers the ball of half a turn (3.14 in any other unit) about the setpoint.
REACH = math.pi
_RAY_STEPS = 720
_MOST_RAYS, _MOST_POLISHED = 4096, 32
#: Relative gap between the distance found and the bound at which the proof ends.
_GAP = {1: 1e-6, 2: 1e-4}
_WIDE_GAP = 1e-2
_BATCH, _MOST_BOXES, _MOST_PASSES, _MOST_RESTARTS = 4096, 1 << 16, 400, 20


@dataclass(frozen=True)
class SingularPoint:
    """The nearest point found with ADB = 0: its `distance` and `offset` from the setpoint by name.

    The distance is the Euclidean one of the offsets in the coordinates' own units, infinite where
    no zero was found; `unit` is empty where the units differ. No zero is nearer than `least`,
    which is rigorous: intervals exclude zero from ADB on all of that ball.
    """

    distance: float
    least: float
    offset: dict[str, float]
    unit: str


def nearest_singular_point(model: LoweredModel, values: Mapping[str, float]) -> SingularPoint:
    """Return the point of ADB = 0 (of det ADB for several actuators) nearest to the setpoint.

    It is looked for in all coordinates that ADB depends on, within `REACH`.
    """
    program = restricted(model.program("input_gain"), ["adb"])
    setpoint = evaluate(model.program("setpoint"), values)
    still = {f"d{c.name}": 0.0 for c in model.coordinates}
    taken = {s.name for s in program.inputs}
    moved = [c for c in model.coordinates if c.name in taken]
    units = {c.unit for c in moved}
    found, least = nearest_zero(
        program, {**values, **still}, {c.name: setpoint[c.name] for c in moved}
    )
    distance = math.hypot(*found.values()) if found else math.inf
    return SingularPoint(distance, least, found, units.pop() if len(units) == 1 else "")


def nearest_zero(
    program: Program, fixed: Mapping[str, float], centre: Mapping[str, float]
) -> tuple[dict[str, float], float]:
    """Return the offset from `centre` to the nearest zero of `program`'s one output, and a bound.

    The offset is empty where no change of sign was found within `REACH`; the bound is the radius
    of a ball around `centre` without any zero.
    """
    names, at = list(centre), np.array(list(centre.values()))
    output = program.outputs[0].name

    def value(offsets: Array) -> Array:
        """Return the output at offsets (N, d)."""
        moved = {n: at[k] + offsets[:, k] for k, n in enumerate(names)}
        found = evaluate_at(program, {**fixed, **moved})[output]
        return np.broadcast_to(np.asarray(found, float), (len(offsets),))

    here = float(value(np.zeros((1, len(names))))[0])
    if here == 0.0:
        return dict.fromkeys(names, 0.0), 0.0
    if not (names and math.isfinite(here)):
        return {}, 0.0 if names else math.inf
    positive = here > 0.0
    offset = _found(value, _rays(len(names)), REACH, positive)
    for _ in range(_MOST_RESTARTS):
        radius = math.inf if offset is None else float(np.linalg.norm(offset))
        least, beyond = _excluded(program, fixed, names, at, min(radius, REACH), positive)
        if beyond is None:
            break
        nearer = _found(value, [beyond / _length(beyond)], _length(beyond), positive)
        if nearer is None:
            break
        offset = nearer
    named = {} if offset is None else dict(zip(names, map(float, offset), strict=True))
    return named, min(least, radius)


def _found(
    value: Callable[[Array], Array], rays: list[Array], reach: float, positive: bool
) -> Array | None:
    """Return the nearest zero found: first ones on `rays`, then along the surface from there."""
    crossings = (_crossing(value, ray, reach, positive) for ray in rays)
    best = sorted((u for u in crossings if u is not None), key=_length)
    if len(rays[0]) > 1:
        slid = (_slid(value, u, positive) for u in best[:_MOST_POLISHED])
        best += [u for u in slid if u is not None]
    return min(best, key=_length, default=None)


def _length(offset: Array) -> float:
    return float(np.linalg.norm(offset))


def _crossing(
    value: Callable[[Array], Array], ray: Array, reach: float, positive: bool
) -> Array | None:
    """Return the first change of sign seen along `ray`, or nothing."""
    way = np.linspace(0.0, reach, _RAY_STEPS + 1)
    crossed = (value(way[:, None] * ray) > 0.0) != positive
    if not crossed.any():
        return None
    k = int(np.argmax(crossed))
    low, high = float(way[k - 1]), float(way[k])
    return np.asarray(brentq(lambda t: value((t * ray)[None, :])[0], low, high, xtol=1e-14) * ray)


def _rays(d: int) -> list[Array]:
    """Return unit vectors (d,): the axes first, then all corners of {-1, 0, 1}^d."""
    corners = itertools.islice(itertools.product((0.0, 1.0, -1.0), repeat=d), 1, _MOST_RAYS)
    rays = [np.array(c) / math.hypot(*c) for c in corners]
    return sorted(rays, key=lambda u: int(np.count_nonzero(u)))


def _slid(value: Callable[[Array], Array], start: Array, positive: bool) -> Array | None:
    """Minimise the distance along the surface from `start`; the end is a zero on its own ray."""
    size = abs(float(value(np.zeros((1, len(start))))[0]))
    constraint = {"type": "eq", "fun": lambda u: float(value(np.asarray(u)[None, :])[0]) / size}
    found: Any = minimize(
        lambda u: float(u @ u), start, method="SLSQP", constraints=[constraint], tol=1e-14
    )
    radius = _length(found.x)
    if not 0.0 < radius <= REACH:
        return None
    return _crossing(value, found.x / radius, min(1.001 * radius, REACH), positive)


def _excluded(
    program: Program,
    fixed: Mapping[str, float],
    names: list[str],
    at: Array,
    radius: float,
    positive: bool,
) -> tuple[float, Array | None]:
    """Return a radius, at most `radius`, within which intervals exclude every zero.

    Boxes that may hold a zero are halved, the nearest first; the bound is their least distance.
    Where all of a box has the other sign the search ends: its middle is returned as well, a zero
    lies before it.
    """
    goal = radius * (1.0 - _GAP.get(len(names), _WIDE_GAP))
    known = {n: (np.asarray(v), np.asarray(v)) for n, v in fixed.items()}
    low, high = -radius * np.ones((1, len(at))), radius * np.ones((1, len(at)))
    slack = 1e-15 * (np.abs(at) + radius)  # what rounding takes from at + offset
    for _ in range(_MOST_PASSES):
        ends = (at + low - slack, at + high + slack)
        box = {n: (ends[0][:, k], ends[1][:, k]) for k, n in enumerate(names)}
        below, above = enclose(program, {**known, **box})[program.outputs[0].name]
        near = np.linalg.norm(np.maximum(0.0, np.maximum(low, -high)), axis=1)
        middle = (low + high) / 2.0
        turned = np.broadcast_to((above < 0.0) if positive else (below > 0.0), near.shape)
        turned = turned & (np.linalg.norm(middle, axis=1) < goal)
        if turned.any():
            return 0.0, np.asarray(middle[int(np.argmax(turned))])
        kept = np.broadcast_to((below <= 0.0) & (above >= 0.0), near.shape) & (near < goal)
        low, high, near = low[kept], high[kept], near[kept]
        if not len(near) or len(near) > _MOST_BOXES:
            break
        low, high = _refined(low, high, near)
    return float(near.min(initial=goal)) * (1.0 - 1e-12), None


def _refined(low: Array, high: Array, near: Array) -> tuple[Array, Array]:
    """Return the boxes (N, d) with the nearest of them halved."""
    order = np.argsort(near, kind="stable")
    first, rest = order[:_BATCH], order[_BATCH:]
    halves = _halved(low[first], high[first])
    return np.vstack([halves[0], low[rest]]), np.vstack([halves[1], high[rest]])


def _halved(low: Array, high: Array) -> tuple[Array, Array]:
    """Halve boxes (N, d) across their widest sides."""
    rows = np.arange(len(low))
    side = np.argmax(high - low, axis=1)
    middle = (low[rows, side] + high[rows, side]) / 2.0
    left, right = high.copy(), low.copy()
    left[rows, side] = right[rows, side] = middle
    return np.vstack([low, right]), np.vstack([left, high])
