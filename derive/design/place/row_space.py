"""Rows of the residual for several actuators: wanted up to a left factor, met by the gains.

s = S x and s = L S x with any invertible L (m, m) vanish together and have the same zero dynamics.
So only the row space of S (m, 2n) matters: the gains of the model's residual are fitted to it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray
from pfaffian.derive.design.place.linear_plant import residual_rows
from pfaffian.derive.ir.lowered import LoweredModel
from scipy.optimize import least_squares

Array = NDArray[np.float64]

#: A row space is met where no direction of it is off by more than this sine.
MET = 1e-9
_MOST_EVALUATIONS = 100
_MOST_SIGNS = 16


def row_gap(own: Array, wanted: Array) -> float:
    """Return the sine of the largest angle between the row spaces of two (m, 2n) matrices.

    It is 1 where either has not full rank.
    """
    first, second = _basis(own), _basis(wanted)
    if first is None or second is None:
        return 1.0
    left = first - first @ second.T @ second
    return min(float(np.linalg.norm(left, 2)), 1.0)


def _basis(rows: Array) -> Array | None:
    """Return an orthonormal basis (m, 2n) of the row space, or nothing below full rank."""
    if not np.all(np.isfinite(rows)):
        return None
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    _, sizes, basis = np.linalg.svd(rows / np.where(lengths > 0.0, lengths, 1.0))
    full = bool(sizes[-1] > 1e-12 * sizes[0])
    return np.asarray(basis[: len(rows)]) if full else None


def bounds_of(model: LoweredModel, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Return the lower and upper bounds (k,) of the gains called `names`."""
    declared = {p.name: p for p in model.parameters}
    lower = np.array([declared[n].lower for n in names])
    return lower, np.array([declared[n].upper for n in names])


def starts_for(names: tuple[str, ...], values: Mapping[str, float]) -> Iterator[Array]:
    """Return the gains in `values` where they are complete, then ones of every sign."""
    own = np.array([values.get(n, math.nan) for n in names])
    if np.all(np.isfinite(own)):
        yield own
    signs = itertools.product((1.0, -1.0), repeat=len(names))
    yield from (np.array(point) for point in itertools.islice(signs, _MOST_SIGNS))


def descend(mismatch: Callable[[Array], Array], start: Array, bounds: tuple[Array, Array]) -> Array:
    """Return where least squares of `mismatch` end from `start` (k,) within `bounds`, (k,) each."""
    lower, upper = bounds
    found = least_squares(
        lambda gains: np.nan_to_num(mismatch(gains), nan=1e6, posinf=1e6, neginf=-1e6),
        np.clip(start, np.nextafter(lower, upper), np.nextafter(upper, lower)),
        bounds=bounds,
        x_scale="jac",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
        max_nfev=_MOST_EVALUATIONS,
    )
    return np.asarray(found.x)


def fitted_gains(
    model: LoweredModel,
    values: Mapping[str, float],
    names: tuple[str, ...],
    wanted: Array,
    scale: Array,
    most_starts: int = _MOST_SIGNS + 1,
) -> tuple[dict[str, float], float]:
    """Return the gains `names` whose residual comes nearest to the row space of `wanted` (m, 2n).

    Returned beside them is the gap of `row_gap` with the states measured in units of `scale`
    (2n,). The rows are asked to vanish on the null space of `wanted` by least squares, from
    several starts; the first that meets it is taken, else the nearest. They keep their own length:
    made unit, they could come near any direction by growing without bound.
    """
    null = np.linalg.svd(wanted * scale)[2][len(wanted) :].T

    def rows(gains: Array) -> Array:
        given = dict(zip(names, map(float, gains), strict=True))
        return np.asarray(residual_rows(model, {**values, **given}) * scale)

    def mismatch(gains: Array) -> Array:
        return np.asarray((rows(gains) @ null).ravel())

    best, least = np.ones(len(names)), math.inf
    for start in itertools.islice(starts_for(names, values), most_starts):
        found = descend(mismatch, start, bounds_of(model, names))
        gap = row_gap(rows(found), wanted * scale)
        if gap < least:
            best, least = found, gap
        if least < MET:
            break
    return dict(zip(names, map(float, best), strict=True)), least
