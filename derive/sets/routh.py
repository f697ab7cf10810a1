"""Stability of the zero dynamics in numbers: Routh's array, and the closed-form margins of a set.

Nothing here needs SymPy or NumPy: a parameter set is judged in plain floats.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.names import DAMPED, FRICTIONLESS

#: A root this small beside the largest is a zero within the rounding of the coefficients.
_ROUNDING = 2.0**-48


@dataclass(frozen=True)
class HurwitzMargin:
    """A closed-form condition as a person reads it, and its value: it holds where that is > 0."""

    condition: str
    margin: float


def routh_column(coefficients: Sequence[float]) -> tuple[float, ...]:
    """Return the first column of Routh's array of a polynomial, highest power first.

    The polynomial is divided by its leading coefficient, so that the column starts with 1 and its
    entry k is in 1/s^k. It ends with its first zero, below which the array is not defined. All
    roots lie left of the imaginary axis if and only if the column is complete and positive; a
    complete one changes sign once for each root on the right. A polynomial of no degree of its
    own (leading coefficient 0, or a number that is not finite) has the column (NaN,).
    """
    if not coefficients or coefficients[0] == 0.0 or not all(map(math.isfinite, coefficients)):
        return (math.nan,)
    above = [c / coefficients[0] for c in coefficients[0::2]]
    below = [c / coefficients[0] for c in coefficients[1::2]]
    column = [above[0]]
    while below:
        column.append(below[0])
        if below[0] == 0.0:
            break
        ratio = above[0] / below[0]
        padded = [*below[1:], *[0.0] * (len(above) - len(below))]
        above, below = below, [a - ratio * b for a, b in zip(above[1:], padded, strict=True)]
    return tuple(column)


def without_origin(coefficients: Sequence[float], most: int) -> tuple[float, ...]:
    """Return a polynomial with at most `most` zeros at the origin divided out.

    A last coefficient counts as zero where it is no more than rounding leaves of it, beside a_n R^n
    with the size R of the largest root, as the other coefficients bound it.
    """
    left = tuple(coefficients)
    for _ in range(most):
        n = len(left) - 1
        if n < 1 or not all(map(math.isfinite, left)):
            break
        sizes = [abs(c / left[0]) ** (1.0 / k) for k, c in enumerate(left[:-1]) if k and left[0]]
        if abs(left[-1]) > _ROUNDING * abs(left[0]) * max(sizes, default=0.0) ** n:
            break
        left = left[:-1]
    return left


def is_stable_column(column: Sequence[float]) -> bool:
    """Return whether all entries of a column of `routh_column` are positive."""
    return all(entry > 0.0 for entry in column)  # NaN is not, and nor is a zero that ends it


def hurwitz_margins(model: LoweredModel, values: Mapping[str, float]) -> tuple[HurwitzMargin, ...]:
    """Return the closed-form Hurwitz conditions of `model` with their margins at `values`.

    They are those of the plant without friction unless `values` have some. There are none above
    degree 4. A margin is NaN where it divides by zero.
    """
    known = {p.name: p.default for p in model.parameters if p.default is not None} | dict(values)
    rubs = any(known.get(p.name, 0.0) for p in model.parameters if p.group == "uncertainty")
    name = DAMPED if rubs and model.has_program(DAMPED) else FRICTIONLESS
    if not model.has_program(name):
        return ()
    return _margins(model, name, known)


def worded_margins(model: LoweredModel, values: Mapping[str, float]) -> tuple[HurwitzMargin, ...]:
    """Return the stability conditions that the specification of `model` words itself, if any."""
    return _margins(model, "stability", values) if model.has_program("stability") else ()


def _margins(
    model: LoweredModel, name: str, values: Mapping[str, float]
) -> tuple[HurwitzMargin, ...]:
    program = model.program(name)
    margins = evaluate(program, values).values()
    return tuple(
        HurwitzMargin(signal.description, margin)
        for signal, margin in zip(program.outputs, margins, strict=True)
    )


def _off(margin: float) -> str:
    if math.isnan(margin):
        return "undefined"
    return "it is zero" if margin == 0.0 else f"off by {-margin:.4g}"


def violated_margins(margins: Sequence[HurwitzMargin]) -> list[str]:
    """Return the conditions that do not hold, and by how much."""
    return [f"{m.condition} ({_off(m.margin)})" for m in margins if not m.margin > 0.0]


def violated_rows(coefficients: Sequence[float]) -> list[str]:
    """Return the first entry of Routh's column that is not positive: what any degree can say."""
    column, degree = routh_column(coefficients), len(coefficients) - 1
    if math.isnan(column[0]):
        return [f"a{degree} is {coefficients[0]:.4g}, so that p^{degree} is missing"]
    return [
        f"row {k} of Routh's column > 0 ({_off(entry)})"
        for k, entry in enumerate(column)
        if not entry > 0.0
    ][:1]
