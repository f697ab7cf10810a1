"""The row of s that gives the zero dynamics wanted poles, for one actuator and any plant.

With x' = A x + b tau and s = r x, the zeros of s are the roots of r adj(p I - A) b, which is linear
in r: the coefficients of the wanted polynomial determine r. The numbers are few, and their errors
grow fast with the order, so they are solved for exactly, as fractions: the result is the same on
every machine, and needs no library.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction

Rows = list[list[Fraction]]


def row_for_polynomial(
    linearisation: Mapping[str, float], order: int, wanted: Sequence[float]
) -> list[float] | None:
    """Return r (2n,) of s = r (q - q_d, q') with zeros at the roots of `wanted`, or nothing.

    `linearisation` holds the entries of M, D, K and B by the names of the block `linearisation`,
    `order` is n, `wanted` the monic polynomial (2n,), highest coefficient first. There is no row
    where the plant is not controllable at the setpoint.
    """

    def matrix(name: str, columns: int) -> Rows:
        return [
            [Fraction(linearisation[f"{name}_{i + 1}_{j + 1}"]) for j in range(columns)]
            for i in range(order)
        ]

    mass = matrix("mass", order)
    parts = [matrix("stiffness", order), matrix("damping", order), matrix("input", 1)]
    right = [[*k, *d, *b] for k, d, b in zip(*parts, strict=True)]
    solved = _solve(mass, right)
    if solved is None:
        return None
    size = 2 * order
    plant = [[Fraction(int(j == i + order)) for j in range(size)] for i in range(order)]
    plant += [[-x for x in row[:size]] for row in solved]
    vector = [Fraction(0)] * order + [row[size] for row in solved]
    found = _output_row(plant, vector, [Fraction(c) for c in wanted])
    return [float(x) for x in found] if found else None


def _output_row(
    plant: Rows, vector: list[Fraction], wanted: list[Fraction]
) -> list[Fraction] | None:
    """Return r with r adj(p I - A) b = `wanted`, by Faddeev and LeVerrier's recursion."""
    size = len(vector)
    column, columns = vector, [vector]
    adjugate = [[Fraction(int(i == j)) for j in range(size)] for i in range(size)]
    for k in range(1, size):
        product = _multiplied(plant, adjugate)
        trace = -sum((product[i][i] for i in range(size)), Fraction(0)) / k
        adjugate = [
            [x + trace if i == j else x for j, x in enumerate(row)] for i, row in enumerate(product)
        ]
        column = [_dot(row, vector) for row in adjugate]
        columns.append(column)
    found = _solve(columns, [[c] for c in wanted])
    return [row[0] for row in found] if found else None


def _multiplied(left: Rows, right: Rows) -> Rows:
    turned = list(zip(*right, strict=True))
    return [[_dot(row, column) for column in turned] for row in left]


def _dot(left: Sequence[Fraction], right: Sequence[Fraction]) -> Fraction:
    return sum((a * b for a, b in zip(left, right, strict=True)), Fraction(0))


def _solve(matrix: Rows, right: Rows) -> Rows | None:
    """Return X with `matrix` X = `right`, or nothing where `matrix` is singular."""
    size = len(matrix)
    rows = [[*m, *r] for m, r in zip(matrix, right, strict=True)]
    for k in range(size):
        pivot = next((i for i in range(k, size) if rows[i][k] != 0), None)
        if pivot is None:
            return None
        rows[k], rows[pivot] = rows[pivot], rows[k]
        lead = rows[k][k]
        rows[k] = [x / lead for x in rows[k]]
        for i in range(size):
            if i != k and rows[i][k] != 0:
                factor = rows[i][k]
                rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[size:] for row in rows]
