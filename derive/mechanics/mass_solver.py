"""Solving with the mass matrix, written out as named definitions.

A matrix of two rows is best served by the adjugate, which needs one division; a larger one by a
factorisation M = L^T D L: it is shorter, and its values are the ones that have to be rounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import sympy as sp
from pfaffian.derive.mechanics.dynamics import SMALL
from pfaffian.derive.symbolic.block import BlockBuilder
from pfaffian.derive.symbolic.forms import splits_up

if TYPE_CHECKING:
    from pfaffian.derive.mechanics.dynamics import Dynamics


@dataclass(frozen=True)
class Factors:
    """M = L^T D L: `lower` (n, n) unit lower triangular, `inverse_pivots` 1/d (n,)."""

    lower: sp.Matrix
    inverse_pivots: tuple[sp.Symbol, ...]


def define_factors(builder: BlockBuilder, mass: sp.Matrix) -> Factors:
    """Define the factors of the symmetric positive definite `mass`, from the last row upwards.

    A chain's last link is the lightest: eliminating it first keeps the numbers of the others small.
    """
    n = mass.rows
    lower = sp.eye(n).as_mutable()
    inverse: list[sp.Symbol | None] = [None] * n
    scaled = sp.zeros(n, n)  # d_j l_ji, needed twice
    for j in reversed(range(n)):
        pivot = mass[j, j] - sum(scaled[k, j] * lower[k, j] for k in range(j + 1, n))
        name = builder.define(f"pivot{j + 1}", pivot, "pivot of the mass matrix")
        inverse[j] = builder.define(f"inverse_pivot{j + 1}", 1 / name, "")
        for i in range(j):
            entry = mass[i, j] - sum(scaled[k, i] * lower[k, j] for k in range(j + 1, n))
            if entry == 0:
                continue
            scaled[j, i] = builder.define(f"r{j + 1}{i + 1}", entry, "row of D L")
            lower[j, i] = builder.define(f"l{j + 1}{i + 1}", scaled[j, i] * inverse[j], "row of L")
    return Factors(sp.ImmutableDenseMatrix(lower), tuple(s for s in inverse if s is not None))


def define_solution(
    builder: BlockBuilder,
    factors: Factors,
    right: Sequence[sp.Expr],
    base: str,
    text: str = "",
    units: Sequence[str] = (),
) -> tuple[sp.Expr, ...]:
    """Define x with M x = `right` and return it (n,), described by `text` and `units`."""
    n = len(right)
    reduced: list[sp.Expr] = list(right)
    for j in reversed(range(n)):
        value = right[j] - sum(factors.lower[k, j] * reduced[k] for k in range(j + 1, n))
        plain = value == 0 or value.is_Symbol or value.is_Number
        reduced[j] = value if plain else builder.define(f"{base}_reduced{j + 1}", value, "")
    found: list[sp.Expr] = [sp.S.Zero] * n
    for i in range(n):
        value = reduced[i] * factors.inverse_pivots[i] - sum(
            factors.lower[i, j] * found[j] for j in range(i)
        )
        unit = units[i] if units else ""
        found[i] = builder.define(f"{base}{i + 1}", value, text, unit)
    return tuple(found)


def determinant(dynamics: Dynamics, positions: Sequence[sp.Symbol]) -> sp.Expr:
    """Return det M, expanded in the parameters where its entries are sums of plain products.

    The products of the entries would cancel most of each other's digits. With roots and quotients
    of what moves it is the squares within an entry that would, multiplied out.
    """
    mass = dynamics.mass_matrix
    plain = all(splits_up(entry, positions) for entry in mass)
    return sp.expand(mass.det()) if plain else mass.det()


class MassSolver:
    """Solves with M in one block: by the adjugate up to `SMALL` coordinates, else by factors.

    What it needs besides M, the determinant or the factors, is defined when it is first used.
    """

    def __init__(self, builder: BlockBuilder, mass: sp.Matrix, determinant: sp.Expr) -> None:
        """Take M, and up to `SMALL` coordinates det M, in the names defined."""
        self._builder, self._mass, self._determinant = builder, mass, determinant

    @cached_property
    def determinant(self) -> sp.Symbol:
        """Define det M."""
        return self._builder.define("det_m", self._determinant, "determinant of the mass matrix")

    @cached_property
    def _factors(self) -> Factors:
        return define_factors(self._builder, self._mass)

    def define_row(
        self, row: sp.Matrix, base: str, text: str, units: Sequence[str], of_several: bool = False
    ) -> list[sp.Expr]:
        """Define `row` D (n,) with D = M^-1, for a row (1, n).

        Of `of_several` rows the products are named as well: what rounding does to them differs from
        row to row, and in the determinant of the rows that is all that is left of M's entries.
        """
        right = row.T
        if of_several and self._mass.rows <= SMALL:
            return self._defined_by_products(right, base, text, units)
        return list(self._solved(right, base, text, units))

    def _defined_by_products(
        self, right: sp.Matrix, base: str, text: str, units: Sequence[str]
    ) -> list[sp.Expr]:
        adjugate, found = self._mass.adjugate(), []
        for i in range(right.rows):
            first, *others = [p for p in adjugate[i, :].multiply_elementwise(right.T) if p] or [0]
            named = [self._builder.define(f"{base}{i + 1}_part", p, "") for p in others]
            value = sp.Add(first, *named) / self.determinant
            found.append(self._builder.define(f"{base}{i + 1}", value, text, units[i]))
        return found

    def define_solution(
        self, right: sp.Matrix, base: str, text: str, units: Sequence[str]
    ) -> list[sp.Expr]:
        """Define D `right` (n,)."""
        return list(self._solved(right, base, text, units))

    def _solved(
        self, right: sp.Matrix, base: str, text: str, units: Sequence[str]
    ) -> Sequence[sp.Expr]:
        if self._mass.rows > SMALL:
            return define_solution(self._builder, self._factors, list(right), base, text, units)
        values = self._mass.adjugate() * right / self.determinant
        return [
            self._builder.define(f"{base}{i + 1}", value, text, units[i])
            for i, value in enumerate(values)
        ]
