"""Zero dynamics of a plant known within intervals: the worst pole of a box, and friction limits."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.parameter import Parameter
from pfaffian.derive.sets.gains import is_hurwitz, roots_of, zero_polynomial
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import parse_quantity
from pfaffian.runtime.base.toml import suggestion
from scipy.optimize import differential_evolution, minimize

_MOST_INTERVALS = 8
_GRID_POINTS = 1500
_GENERATIONS = 40
#: Stands for an unbounded abscissa in the searches, which need finite costs.
_UNBOUNDED = 1e12
_GROUPS = ("physical", "lumped", "plant", "uncertainty")
#: Friction limits are looked for over this many decades below a parameter's upper bound.
#: Largest damping tried where friction has no bound, in the plant's own.
_MOST_DAMPING = 1e6
_DECADES, _STEPS_PER_DECADE = 12, 20


Point = tuple[float, ...]


@dataclass(frozen=True)
class Interval:
    """Closed bounds of one parameter in its SI unit."""

    name: str
    lower: float
    upper: float


@dataclass(frozen=True)
class WorstCase:
    """The slowest zero-dynamics pole found in a box, where it is, and the nominal one.

    `margin` is its distance from the imaginary axis in 1/s, negative where some plant in the box
    is unstable and minus infinity where ADB at the setpoint changes sign within the box.
    """

    box: tuple[Interval, ...]
    stable: bool
    margin: float
    nominal_margin: float
    poles: tuple[complex, ...]
    at: dict[str, float]


def read_number(text: str, parameter: Parameter, where: str) -> float:
    """Return a value given as an SI number or with a unit; raise `InputError` naming `where`."""
    try:
        number = float(text)
    except ValueError:
        return parse_quantity(text.strip(), parameter.unit, where)
    if not math.isfinite(number):
        raise InputError(f"{where}: {number} is not finite", remedy="give a finite number")
    return number


def read_friction(model: LoweredModel, text: str, where: str) -> dict[str, float]:
    """Return what "joint2_viscous=0.001,..." gives the plant; raise `InputError` otherwise."""
    declared = {p.name: p for p in model.parameters if p.group == "uncertainty"}
    found: dict[str, float] = {}
    for name, value in _assignments(text, list(declared), where):
        parameter = declared[name]
        found[name] = parameter.check(read_number(value, parameter, f"{where} {name}"), where)
    return found


def read_box(
    model: LoweredModel, values: Mapping[str, float], text: str, where: str
) -> tuple[Interval, ...]:
    """Return the intervals in "theta3=5%,joint2_viscous=0:0.002" about `values`.

    Raises `InputError` naming `where` for an unknown parameter, an empty interval, one out of
    the parameter's bounds, and intervals of both forms of the plant.
    """
    declared = {p.name: p for p in model.parameters if p.group in _GROUPS and p.name in values}
    box: list[Interval] = []
    for name, value in _assignments(text, list(declared), where):
        box.append(_interval(declared[name], values[name], value, f"{where} {name}"))
    lumped = [i.name for i in box if declared[i.name].group == "lumped"]
    if lumped and any(declared[i.name].group == "physical" for i in box):
        raise InputError(
            f"{where}: {lumped[0]} follows from the physical parameters given with it",
            remedy="give intervals of one form: all physical or all lumped parameters",
        )
    if len(box) > _MOST_INTERVALS:
        raise InputError(f"{where}: {len(box)} intervals", remedy=f"give at most {_MOST_INTERVALS}")
    return tuple(box)


def _assignments(text: str, known: list[str], where: str) -> list[tuple[str, str]]:
    pairs: list[tuple[str, str]] = []
    for part in text.split(","):
        name, equals, value = (p.strip() for p in part.partition("="))
        if not equals or not value:
            raise InputError(f"{where}: {part!r} is no NAME=VALUE", remedy=suggestion(name, known))
        if name not in known:
            raise InputError(f"{where}: unknown parameter {name}", remedy=suggestion(name, known))
        if name in dict(pairs):
            raise InputError(f"{where}: {name} is given twice", remedy="give it once")
        pairs.append((name, value))
    return pairs


def _interval(parameter: Parameter, nominal: float, text: str, where: str) -> Interval:
    remedy = "give LOWER:UPPER, or a percentage of the set's value such as 5%"
    if text.endswith("%"):
        try:
            part = abs(nominal) * float(text[:-1]) / 100.0
        except ValueError:
            raise InputError(f"{where}: {text!r} is no percentage", remedy=remedy) from None
        lower, upper = nominal - part, nominal + part
        if not part > 0.0:
            raise InputError(f"{where}: {text} of {nominal:g} is no interval", remedy=remedy)
    else:
        ends = text.split(":")
        if len(ends) != 2:
            raise InputError(f"{where}: {text!r} is no interval", remedy=remedy)
        lower, upper = (read_number(end, parameter, where) for end in ends)
    if not lower < upper:
        raise InputError(f"{where}: {lower:g} is not below {upper:g}", remedy=remedy)
    return Interval(parameter.name, parameter.check(lower, where), parameter.check(upper, where))


def worst_case(
    model: LoweredModel, values: Mapping[str, float], box: tuple[Interval, ...]
) -> WorstCase:
    """Search `box` for the plant with the slowest or least stable zero dynamics.

    The spectral abscissa is not smooth, and neither convex nor concave in the parameters: corners,
    a grid, differential evolution with a fixed seed and a local search from the best point. What
    is found is a lower bound of the true worst case, attained at `at`; it is no proof.
    """
    names = [i.name for i in box]
    abscissa = _abscissa(model, values, names)
    corners = itertools.product(*((i.lower, i.upper) for i in box))
    points: list[Point] = [*corners, *_grid(box)]
    best = _searched(abscissa, box, max(points, key=abscissa))
    worst, at = abscissa(best), dict(zip(names, best, strict=True))
    polynomial = zero_polynomial(model, moved(model, values, at))
    return WorstCase(
        box=box,
        stable=worst < 0.0 and is_hurwitz(polynomial),
        margin=-worst,
        nominal_margin=-max(p.real for p in roots_of(zero_polynomial(model, values))),
        poles=roots_of(polynomial),
        at=at,
    )


def _searched(abscissa: Callable[[Point], float], box: tuple[Interval, ...], best: Point) -> Point:
    """Return the worst point that a global and then a local search find, no better than `best`.

    Both work in the unit cube, so that they know nothing of units.
    """
    cube = [(0.0, 1.0)] * len(box)

    def point(unit: Any) -> Point:
        inside = (min(max(float(u), 0.0), 1.0) for u in unit)
        return tuple(
            min(i.lower + (i.upper - i.lower) * u, i.upper)
            for i, u in zip(box, inside, strict=True)
        )

    def cost(unit: Any) -> float:
        return -min(abscissa(point(unit)), _UNBOUNDED)

    evolved = differential_evolution(
        cost, cube, seed=0, maxiter=_GENERATIONS, popsize=10, polish=False, tol=1e-10
    )
    best = max(best, point(evolved.x), key=abscissa)
    start = [(x - i.lower) / (i.upper - i.lower) for x, i in zip(best, box, strict=True)]
    local = minimize(cost, start, method="Nelder-Mead", bounds=cube, options={"xatol": 1e-10})
    return max(best, point(local.x), key=abscissa)


def moved(
    model: LoweredModel, values: Mapping[str, float], at: Mapping[str, float]
) -> dict[str, float]:
    """Return `values` with those in `at`; lumped ones follow where a physical one moves."""
    changed = {**values, **at}
    physical = {p.name for p in model.parameters if p.group == "physical"}
    if physical & set(at):
        changed |= evaluate(model.program("lumping"), changed)
    return changed


def _abscissa(
    model: LoweredModel, values: Mapping[str, float], names: list[str]
) -> Callable[[Point], float]:
    """Return the largest real part of the poles at a point of the box.

    It is infinite where the leading coefficient has not its nominal sign: on the way there a pole
    has passed through infinity.
    """
    nominal = zero_polynomial(model, values)[0]

    def abscissa(point: Point) -> float:
        at = dict(zip(names, point, strict=True))
        polynomial = zero_polynomial(model, moved(model, values, at))
        if not polynomial[0] * nominal > 0.0:
            return math.inf
        return max(p.real for p in roots_of(polynomial))

    return abscissa


def _grid(box: tuple[Interval, ...]) -> list[Point]:
    """Return a grid over the box, or its centre where a grid would have too many points."""
    count = max(3, int(_GRID_POINTS ** (1.0 / len(box))))
    if count ** len(box) > 3 * _GRID_POINTS:
        return [tuple((i.lower + i.upper) / 2.0 for i in box)]
    axes = [[i.lower + (i.upper - i.lower) * k / (count - 1) for k in range(count)] for i in box]
    return list(itertools.product(*axes))


def friction_limits(model: LoweredModel, values: Mapping[str, float]) -> dict[str, float]:
    """Return by name the largest value of each uncertain parameter that keeps the poles stable.

    Each is raised alone from its value in `values`; the limit is where the least entry of Routh's
    first column passes zero. Parameters that never destabilise are left out, as are all of them
    where the zero dynamics are unstable already.
    """
    taken = {s.name for s in model.program("zero_polynomial").inputs}
    limits: dict[str, float] = {}
    if not is_hurwitz(zero_polynomial(model, values)):
        return limits
    for parameter in model.parameters:
        if parameter.group == "uncertainty" and parameter.name in taken:
            limit = _limit(model, values, parameter)
            if limit is not None:
                limits[parameter.name] = limit
    return limits


def _own_damping(model: LoweredModel, values: Mapping[str, float]) -> float:
    """Return the largest inertia times the rate of the fastest pole."""
    known = {p.name: p.default for p in model.parameters if p.default is not None} | dict(values)
    linear = evaluate(model.program("linearisation"), known)
    mass = max(abs(v) for n, v in linear.items() if n.startswith("mass_"))
    rate = max((abs(p) for p in roots_of(zero_polynomial(model, values))), default=1.0)
    return mass * (rate or 1.0)


def _limit(model: LoweredModel, values: Mapping[str, float], parameter: Parameter) -> float | None:
    start = values.get(parameter.name, parameter.default or 0.0)

    def stable(added: float) -> bool:
        return is_hurwitz(zero_polynomial(model, {**values, parameter.name: start + added}))

    room = parameter.upper - start
    if not math.isfinite(room):  # what a friction of the plant's own scale is, far exceeded
        room = _MOST_DAMPING * _own_damping(model, values)
    below = 0.0
    for k in range(_DECADES * _STEPS_PER_DECADE + 1):
        above = room * 10.0 ** (k / _STEPS_PER_DECADE - _DECADES)
        if not stable(above):
            break
        below = above
    else:
        return None
    while (middle := (below + above) / 2.0) not in (below, above):
        below, above = (middle, above) if stable(middle) else (below, middle)
    return start + below
