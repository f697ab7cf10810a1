"""Gains that place the zero dynamics of a plant with several actuators.

One polynomial does not determine the rows of several constraints, and the model's residual need
not be able to meet every row. The regular form gives rows that place the poles; the gains are
fitted to their row space, and where that is not met the coefficients of the zero polynomial are
matched, from that fit, from a Riccati solution, from the set's own gains and from ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pfaffian.derive.design.place.linear_plant import state_space
from pfaffian.derive.design.place.regular_form import placed_rows
from pfaffian.derive.design.place.riccati import solve_riccati
from pfaffian.derive.design.place.row_space import MET, bounds_of, descend, fitted_gains, starts_for
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.sets.gains import gain_names
from pfaffian.runtime.base.errors import InputError

Array = NDArray[np.float64]
#: From complete values to the scaled mismatch of the coefficients with those of given poles.
Mismatch = Callable[[Mapping[str, float], tuple[complex, ...]], list[float]]

#: Poles nearer to each other than this share of the largest are approached from apart.
_CROWDED = 0.05
#: How far apart they are on the way, in units of each pole; gains are extrapolated to zero.
_WAY = (0.4, 0.36, 0.32, 0.28, 0.24, 0.2, 0.16, 0.12)
#: Largest mismatch of a coefficient on the way: beyond it the start leads nowhere.
_ON_THE_WAY = 1e-9


@dataclass(frozen=True)
class Placement:
    """Gains that place poles, and how they were found.

    `by` is `closed form`, `row space` or `coefficients`. For several actuators `row_gap` is how
    far the residual's row space is from that of the regular form (the sine of the largest angle
    in SI units), and `spread` how far that had to move a repeated pole, relative.
    """

    gains: dict[str, float]
    by: str
    row_gap: float | None = None
    spread: float = 0.0


def place_several(
    model: LoweredModel,
    values: Mapping[str, float],
    poles: tuple[complex, ...],
    mismatch: Mismatch,
    tolerance: float,
    where: str,
) -> Placement:
    """Return the gains that place the zero dynamics at `poles`, whatever the number of actuators.

    `mismatch` is to be below `tolerance` in every entry. Raises `InputError` naming `where` where
    no start gets there.
    """
    names = gain_names(model)
    a, b = state_space(model, values)
    placed = placed_rows(a, b, poles)
    fitted: dict[str, float] = {}
    gap: float | None = None
    if placed:
        fitted, gap = fitted_gains(model, values, names, placed.rows, np.ones(len(a)), 2)
        if gap < MET and _largest(mismatch({**values, **fitted}, poles)) < tolerance:
            return Placement(fitted, "row space", gap, placed.spread)
    worst = math.inf
    for start in _starts(model, values, names, fitted):
        found = _matched(model, values, poles, mismatch, start)
        worst = min(worst, off := _largest(mismatch({**values, **found}, poles)))
        if off < tolerance:
            return Placement(found, "coefficients", gap, placed.spread if placed else 0.0)
    near = f", and miss the rows of the regular form by {gap:.2g}" if gap is not None else ""
    raise InputError(
        f"{where}: no gains {', '.join(names)} within their bounds place the zero dynamics there; "
        f"the best start is off by {worst:.2g} of a coefficient{near}",
        remedy="choose other poles: constraints that do not couple need real poles or whole pairs "
        "each, so give at least one real pole for every constraint of odd order",
    )


def _largest(mismatch: list[float]) -> float:
    """Return the largest entry in size; infinite where one is not a number."""
    found = max(abs(x) for x in mismatch)
    return found if all(math.isfinite(x) for x in mismatch) else math.inf


def _starts(
    model: LoweredModel,
    values: Mapping[str, float],
    names: tuple[str, ...],
    fitted: dict[str, float],
) -> Iterator[Array]:
    """Return the starts: the fit to the regular form, to a Riccati solution, own gains, ones."""
    if fitted:
        yield np.array([fitted[n] for n in names])
    a, b = state_space(model, values)
    p = solve_riccati(a, b, (1.0,) * len(a), 1.0)
    if p is not None:
        gains, _ = fitted_gains(model, values, names, b.T @ p, np.ones(len(a)), 2)
        yield np.array([gains[n] for n in names])
    yield from starts_for(names, values)


def _matched(
    model: LoweredModel,
    values: Mapping[str, float],
    poles: tuple[complex, ...],
    mismatch: Mismatch,
    start: Array,
) -> dict[str, float]:
    """Return the gains nearest to `poles` that a least-squares search finds from `start`.

    Where poles crowd, the coefficients hardly tell the gains apart and the search stalls. The
    gains depend smoothly on the poles all the same: they are found for poles apart, and
    extrapolated to the ones that are wanted.
    """
    names = gain_names(model)

    way: list[Array] = []
    for k, distance in enumerate(_WAY if _crowded(poles) else ()):
        first = _extrapolated(_WAY[:k], way, distance) if way else start
        wanted = _apart(poles, distance)
        way.append(_search(model, values, wanted, mismatch, names, first))
        given = dict(zip(names, map(float, way[-1]), strict=True))
        if _largest(mismatch({**values, **given}, wanted)) > _ON_THE_WAY:
            start, way = way[-1], []
            break
    if way:
        start = _extrapolated(_WAY, way, 0.0)
    found = _search(model, values, poles, mismatch, names, start)
    return dict(zip(names, map(float, found), strict=True))


def _search(
    model: LoweredModel,
    values: Mapping[str, float],
    poles: tuple[complex, ...],
    mismatch: Mismatch,
    names: tuple[str, ...],
    start: Array,
) -> Array:
    def off(gains: Array) -> Array:
        given = dict(zip(names, map(float, gains), strict=True))
        return np.array(mismatch({**values, **given}, poles))

    return descend(off, start, bounds_of(model, names))


def _crowded(poles: tuple[complex, ...]) -> bool:
    least = min(
        (abs(p - r) for i, p in enumerate(poles) for r in poles[:i]),
        default=math.inf,
    )
    return least < _CROWDED * max(abs(p) for p in poles)


def _apart(poles: tuple[complex, ...], distance: float) -> tuple[complex, ...]:
    """Return `poles` times factors from 1 - distance to 1 + distance, slow to fast; pairs stay."""
    upper = sorted(
        (complex(p) for p in poles if p.imag >= 0.0), key=lambda p: (abs(p), -p.real, p.imag)
    )
    last = max(len(upper) - 1, 1)
    moved = [p * (1.0 + distance * (2.0 * k / last - 1.0)) for k, p in enumerate(upper)]
    return tuple(moved + [p.conjugate() for p in moved if p.imag > 0.0])


def _extrapolated(at: tuple[float, ...], values: list[Array], wanted: float) -> Array:
    """Return the polynomial through (at, values) at `wanted`, by Neville's scheme."""
    table = list(values)
    for step in range(1, len(at)):
        table = [
            ((at[k + step] - wanted) * table[k] - (at[k] - wanted) * table[k + 1])
            / (at[k + step] - at[k])
            for k in range(len(table) - 1)
        ]
    return table[0]
