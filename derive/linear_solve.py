"""Solving with the mass matrix: an L D L^T factorisation written out as named definitions.

Two rows of a small matrix are better served by the adjugate, which needs one division; from four
coordinates on the factorisation is shorter, and its values are the ones that have to be rounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.block import BlockBuilder


@dataclass(frozen=True)
class Factors:
    """M = L D L^T: `lower` (n, n) unit lower triangular, `inverse_pivots` 1/d (n,)."""

    lower: sp.Matrix
    inverse_pivots: tuple[sp.Symbol, ...]


def define_factors(builder: BlockBuilder, mass: sp.Matrix) -> Factors:
    """Define the factors of the symmetric positive definite `mass`, from the last row upwards.

    A chain's last link is the lightest: eliminating it first keeps the numbers of the others small.
    """
    n = mass.rows
    lower = sp.eye(n).as_mutable()
    inverse: list[sp.Symbol | None] = [None] * n
    scaled = sp.zeros(n, n)  # d_j l_ij, needed twice
    for j in reversed(range(n)):
        pivot = mass[j, j] - sum(scaled[k, j] * lower[k, j] for k in range(j + 1, n))
        name = builder.define(f"pivot{j + 1}", pivot, "pivot of the mass matrix")
        inverse[j] = builder.define(f"inverse_pivot{j + 1}", 1 / name, "")
        for i in range(j):
            entry = mass[i, j] - sum(scaled[k, i] * lower[k, j] for k in range(j + 1, n))
            scaled[j, i] = builder.define(f"r{j + 1}{i + 1}", entry, "row of D L^T")
            lower[j, i] = builder.define(f"l{j + 1}{i + 1}", scaled[j, i] * inverse[j], "row of L")
    return Factors(sp.ImmutableDenseMatrix(lower), tuple(s for s in inverse if s is not None))


def define_solution(
    builder: BlockBuilder, factors: Factors, right: Sequence[sp.Expr], base: str
) -> tuple[sp.Expr, ...]:
    """Define x with M x = `right` and return it (n,)."""
    n = len(right)
    reduced: list[sp.Expr] = list(right)
    for j in reversed(range(n)):
        value = right[j] - sum(factors.lower[k, j] * reduced[k] for k in range(j + 1, n))
        reduced[j] = builder.define(f"{base}_reduced{j + 1}", value, "")
    found: list[sp.Expr] = [sp.S.Zero] * n
    for i in range(n):
        value = reduced[i] * factors.inverse_pivots[i] - sum(
            factors.lower[i, j] * found[j] for j in range(i)
        )
        found[i] = builder.define(f"{base}{i + 1}", value, "")
    return tuple(found)
