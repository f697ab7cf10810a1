"""Where a mass matrix is positive definite: on a grid within the declared bounds.

A matrix that is indefinite belongs to no rigid mechanism. One that loses rank at single points
belongs to coordinates with a singularity, such as the two angles of a spherical pendulum.
"""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Iterator, Mapping

from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.names import MASS_MATRIX

#: Points of the grid, over all coordinates M depends on, and of one coordinate.
_MOST_POINTS, _MOST_STEPS = 24**3, 24
#: Points of a coordinate that is no angle, as shares of its bound.
_SHARES = (0.0, 1e-3, 0.01, 0.1, 0.5, 1.0)
#: A pivot of M scaled to a unit diagonal that counts as zero: far above rounding.
_NOTHING = 1e-11


class Definiteness(enum.Enum):
    """What a symmetric matrix is: positive definite, semidefinite, or not even that."""

    POSITIVE = "positive definite"
    SEMI = "positive semidefinite"
    NONE = "indefinite"


def definiteness(model: LoweredModel, values: Mapping[str, float]) -> Definiteness:
    """Return what M is at the coordinates and parameters in `values`."""
    if all(m > 0.0 for m in evaluate(model.program("mass_minors"), values).values()):
        return Definiteness.POSITIVE
    entries = iter(evaluate(model.program(MASS_MATRIX), values).values())
    n = len(model.coordinates)
    mass = [[0.0] * n for _ in range(n)]
    for i in range(n):
        for j in range(i, n):
            mass[i][j] = mass[j][i] = next(entries)
    return definiteness_of(mass)


def definiteness_of(mass: list[list[float]]) -> Definiteness:
    """Return what the symmetric `mass` (n, n) is, by elimination with a unit diagonal."""
    n, left, found = len(mass), [row[:] for row in mass], Definiteness.POSITIVE
    scales = [math.sqrt(abs(mass[i][i])) or 1.0 for i in range(n)]
    left = [[left[i][j] / scales[i] / scales[j] for j in range(n)] for i in range(n)]
    if not all(math.isfinite(x) for row in left for x in row):
        return Definiteness.NONE
    open_ = list(range(n))
    while open_:
        k = max(open_, key=lambda i: left[i][i])
        open_.remove(k)
        pivot = left[k][k]
        if pivot <= _NOTHING:  # the largest that is left: all others are no larger
            rest = [abs(left[i][j]) for i in (*open_, k) for j in (*open_, k)]
            return Definiteness.SEMI if max(rest) <= _NOTHING else Definiteness.NONE
        for i in open_:
            for j in open_:
                left[i][j] -= left[i][k] * left[k][j] / pivot
    return found


def points_within_bounds(
    model: LoweredModel, setpoint: Mapping[str, float]
) -> Iterator[dict[str, float]]:
    """Yield the setpoint and a grid of the coordinates that M depends on, within their bounds.

    Of an angle one turn is enough: elsewhere M is the same.
    """
    program = model.program(MASS_MATRIX)
    names = [s.name for s in program.inputs if s.group == "input"]
    coordinates = {c.name: c for c in model.coordinates}
    yield {n: setpoint[n] for n in names}
    steps = min(_MOST_STEPS, max(4, round(_MOST_POINTS ** (1.0 / max(len(names), 1)))))
    axes = []
    for name in names:
        bound = coordinates[name].bound
        if coordinates[name].unit in ("rad", "deg", ""):
            half = min(bound, math.pi)
            axes.append([half * (2 * k - steps) / steps for k in range(steps + 1)])
        else:
            shares = _SHARES if steps > 2 * len(_SHARES) else (0.0, 0.1, 1.0)
            axes.append([s * share * bound for share in shares for s in (-1.0, 1.0)])
    for point in itertools.product(*axes):
        yield dict(zip(names, point, strict=True))


def worded(model: LoweredModel, at: Mapping[str, float]) -> str:
    """Return the coordinates `at`, with their units, as a person reads them."""
    units = {c.name: c.unit for c in model.coordinates}
    return ", ".join(f"{n} = {v:.4g} {units[n]}".rstrip() for n, v in at.items()) or "any place"
