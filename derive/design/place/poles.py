"""Gains from wanted zero-dynamics poles: in closed form where there is one, else numerically."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from pfaffian.derive.design.place.placement import Placement, place_several
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.sets.gains import (
    gain_names,
    places_poles,
    polynomial_of,
    synthesise_gains,
    zero_order,
    zero_polynomial,
)
from pfaffian.derive.sets.raw_set import parse_poles
from pfaffian.runtime.base.errors import InputError
from scipy.optimize import least_squares

#: Largest mismatch of a coefficient, relative to that of poles all at the largest radius.
_TOLERANCE = 1e-10
#: Magnitudes of poles in 1/s whose powers still compare.
_LEAST_RADIUS, _LARGEST_RADIUS = 1e-6, 1e6
_START_LEVELS = (1.0, 3.0, 0.3, 10.0)
_MOST_STARTS = 64


def read_poles(text: str, where: str) -> tuple[complex, ...]:
    """Return the poles in `text`, such as "-6,-4+2j,-4-2j"; raise `InputError` naming `where`."""
    return parse_poles([part.strip() for part in text.split(",")], where)


def gains_for_poles(
    model: LoweredModel, values: Mapping[str, float], poles: tuple[complex, ...], where: str
) -> dict[str, float]:
    """Return the gains of `placement_for_poles`."""
    return placement_for_poles(model, values, poles, where).gains


def placement_for_poles(
    model: LoweredModel, values: Mapping[str, float], poles: tuple[complex, ...], where: str
) -> Placement:
    """Return the gains that place the zero dynamics of the plant with these `values` at `poles`.

    The closed form holds for the plant without friction; with friction, and for a model without
    a closed form, coefficients are matched numerically; for several actuators `place_several`
    does it. Raises `InputError` naming `where` for a wrong number of poles, where no gains are
    found, and for gains out of their bounds.
    """
    order = zero_order(model)
    if len(poles) != order:
        raise InputError(
            f"{where}: {len(poles)} poles for zero dynamics of order {order}",
            remedy=f"give {order} poles",
        )
    wild = [p for p in poles if not _LEAST_RADIUS <= abs(p) <= _LARGEST_RADIUS]
    if wild:
        raise InputError(
            f"{where}: {wild[0]:g} is no pole of a mechanism",
            remedy=f"give magnitudes from {_LEAST_RADIUS:g} to {_LARGEST_RADIUS:g} 1/s",
        )
    found = _placed(model, values, poles, where)
    for parameter in model.parameters:
        if parameter.name in found.gains:
            parameter.check(found.gains[parameter.name], where)
    return found


def _placed(
    model: LoweredModel, values: Mapping[str, float], poles: tuple[complex, ...], where: str
) -> Placement:
    if len(model.actuators) > 1 and gain_names(model):
        off = partial(_mismatch, model)
        return place_several(model, values, poles, off, _TOLERANCE, where)
    gains: dict[str, float] = {}
    if places_poles(model):
        gains = synthesise_gains(model, values, poles, where)
    if gains and _holds(model, {**values, **gains}, poles):
        return Placement(gains, "closed form")
    return Placement(numeric_gains(model, {**values, **gains}, poles, where), "coefficients")


def numeric_gains(
    model: LoweredModel, values: Mapping[str, float], poles: tuple[complex, ...], where: str
) -> dict[str, float]:
    """Match the coefficients of the zero polynomial by least squares, from several starts.

    The gains in `values` are the first start. Raises `InputError` where no start converges.
    """
    names = gain_names(model)
    declared = {p.name: p for p in model.parameters}
    lower = np.array([declared[n].lower for n in names])
    upper = np.array([declared[n].upper for n in names])

    def mismatch(gains: Any) -> Any:
        found = _mismatch(
            model, {**values, **dict(zip(names, map(float, gains), strict=True))}, poles
        )
        return np.nan_to_num(np.array(found), nan=1e6, posinf=1e6, neginf=-1e6)

    worst = math.inf
    for start in _starts(names, values):
        inside = np.clip(start, np.nextafter(lower, upper), np.nextafter(upper, lower))
        found = least_squares(
            mismatch,
            inside,
            bounds=(lower, upper),
            x_scale="jac",
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        worst = min(worst, float(np.max(np.abs(found.fun))))
        if worst < _TOLERANCE:
            return dict(zip(names, map(float, found.x), strict=True))
    raise InputError(
        f"{where}: no gains {', '.join(names)} within their bounds place the zero dynamics there; "
        f"the best start is off by {worst:.2g} of a coefficient",
        remedy="choose other poles: slower ones, or fewer digits apart from those of the set",
    )


def _mismatch(
    model: LoweredModel, values: Mapping[str, float], poles: tuple[complex, ...]
) -> list[float]:
    """Return have - wanted of the monic coefficients, each over radius^k for its degree."""
    have = zero_polynomial(model, values)
    wanted = polynomial_of(poles)
    radius = max(abs(p) for p in poles)
    if len(have) != len(wanted):  # friction gives a cyclic coordinate a pole of its own
        return [math.inf] * len(poles)
    lead = have[0] or math.nan
    pairs = zip(have[1:], wanted[1:], strict=True)
    return [(h / lead - w) / radius ** (k + 1) for k, (h, w) in enumerate(pairs)]


def _holds(model: LoweredModel, values: Mapping[str, float], poles: tuple[complex, ...]) -> bool:
    return all(abs(m) < _TOLERANCE for m in _mismatch(model, values, poles))


def _starts(names: tuple[str, ...], values: Mapping[str, float]) -> Iterator[Any]:
    own = np.array([values.get(n, math.nan) for n in names])
    if np.all(np.isfinite(own)):
        yield own
    grid = itertools.product(_START_LEVELS, repeat=len(names))
    yield from (np.array(point) for point in itertools.islice(grid, _MOST_STARTS))
