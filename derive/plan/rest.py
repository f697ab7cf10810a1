"""Where a plant rests by itself: the start of a swing-up, the torque that holds, its period."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray
from pfaffian.derive.plan.plant import NumericPlant
from pfaffian.derive.spec.model_spec import ModelSpec
from pfaffian.runtime.base.errors import InputError
from scipy.linalg import eigh

Array = NDArray[np.float64]
#: Points of the search grid a turn of each angle the potential energy depends on.
_A_TURN = 8


def hanging_rest(
    spec: ModelSpec, plant: NumericPlant, goal: tuple[float, ...]
) -> tuple[float, ...] | None:
    """Return the resting equilibrium q (n,) with least potential energy, near `goal`.

    Angles are searched over the turn from `goal` - pi; what V does not depend on stays at `goal`.
    Returns nothing where V has no such minimum, or depends on no coordinate.
    """
    symbols = [*spec.positions]
    moving = [i for i, c in enumerate(spec.coordinates) if _depends(spec, symbols[i].name)]
    turns = [
        [goal[i] + math.pi * (2.0 * k / _A_TURN - 1.0) for k in range(_A_TURN)]
        if spec.coordinates[i].unit == "rad"
        else [goal[i]]
        for i in moving
    ]

    def full(part: Array) -> Array:
        q = np.array(goal)
        q[moving] = part
        return q

    grid = [np.array(point) for point in itertools.product(*turns)]
    lowest = min(grid, key=lambda point: plant.potential(full(point)))
    if not moving:
        return None
    q = _polished(plant, full(lowest), moving)
    if q is None:
        return None
    return tuple(float(v) if abs(v) > 1e-15 else 0.0 for v in q)


def _depends(spec: ModelSpec, name: str) -> bool:
    return name in {s.name for s in spec.potential_energy.free_symbols}


def _polished(plant: NumericPlant, q: Array, moving: list[int]) -> Array | None:
    """Return the zero of G next to `q` by Newton's method, or nothing unless V is least there."""
    first = q.copy()
    for _ in range(50):
        slope = plant.stiffness(q)[np.ix_(moving, moving)]
        if not np.all(np.isfinite(slope)) or np.linalg.eigvalsh(slope)[0] <= 0.0:
            return None
        move = np.linalg.solve(slope, plant.gravity(q)[moving])
        q[moving] -= move
        if not np.max(np.abs(q - first)) < math.pi:
            return None
        if np.max(np.abs(move)) < 1e-15 * (1.0 + np.max(np.abs(q))):
            break
    return q if np.max(np.abs(move)) < 1e-10 else None


def held_torque(
    spec: ModelSpec, plant: NumericPlant, q: tuple[float, ...], limits: tuple[float, ...], what: str
) -> tuple[float, ...] | None:
    """Return the torque (m,) that holds `q` at rest, or nothing where none does.

    Raises `InputError` naming `what` is to be held where that takes more than the `limits`.
    """
    at = np.array(q)
    _, bias, inputs = plant.matrices(at, np.zeros(plant.n))
    torque, *_ = np.linalg.lstsq(inputs, bias, rcond=None)
    left = np.abs(inputs @ torque - bias)
    scale = max(np.max(np.abs(plant.gravity(at + shift))) for shift in (0.0, 1.0, 2.0))
    if np.max(left) > 1e-9 * max(scale, 1e-300):
        return None
    for actuator, value, limit in zip(spec.actuators, torque, limits, strict=True):
        if abs(value) > limit:
            raise InputError(
                f"model {spec.name}: {actuator.name} = {value:.4g} {actuator.unit} holds the "
                f"{what}, beyond the limit of {limit:g} {actuator.unit}",
                remedy="raise --torque-limit",
            )
    return tuple(float(v) if abs(v) > 1e-12 * scale else 0.0 for v in torque)


def slowest_period(plant: NumericPlant, q: tuple[float, ...]) -> float:
    """Return the period in s of the slowest oscillation about `q`; 2 s where nothing swings."""
    at = np.array(q)
    mass = plant.matrices(at, np.zeros(plant.n))[0]
    slope = plant.stiffness(at)
    squares = eigh((slope + slope.T) / 2.0, mass, eigvals_only=True)
    swinging = [s for s in squares if s > 1e-6 * np.max(np.abs(squares))]
    return 2.0 * math.pi / math.sqrt(min(swinging)) if swinging else 2.0
