"""The smallest point at which two forms disagree: few, simple, exact values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import combinations, product

import sympy as sp
from pfaffian.derive.audit.row import Counterexample

_POSITIVE = (sp.S.One, sp.Integer(2), sp.Rational(1, 2), sp.Integer(3))
_REAL = (sp.S.Zero, sp.S.One, -sp.S.One, sp.Integer(2))
#: How many symbols may leave their simplest value.
_DEPTH = 3

Admissible = Callable[[Mapping[sp.Symbol, sp.Expr]], bool]


def _values(symbol: sp.Symbol) -> tuple[sp.Expr, ...]:
    return _POSITIVE if symbol.is_positive else _REAL


def _points(
    symbols: list[sp.Symbol], fixed: Mapping[sp.Symbol, sp.Expr]
) -> Iterator[dict[sp.Symbol, sp.Expr]]:
    """Yield points by the number of symbols that leave their simplest value."""
    base = {s: fixed.get(s, _values(s)[0]) for s in symbols}
    free = [s for s in symbols if s not in fixed]
    for depth in range(_DEPTH + 1):
        for moved in combinations(free, depth):
            for values in product(*(_values(s)[1:] for s in moved)):
                yield base | dict(zip(moved, values, strict=True))


def smallest_counterexample(
    printed: sp.Expr,
    derived: sp.Expr,
    fixed: Mapping[sp.Symbol, sp.Expr] | None = None,
    meaning: str = "the printed and the derived form",
    violates: Callable[[sp.Expr, sp.Expr], bool] | None = None,
) -> Counterexample | None:
    """Return the first point at which `printed` and `derived` disagree, or None.

    Points are tried from the simplest on. `fixed` values are kept; `violates` replaces "differ"
    where the claim is an inequality.
    """
    symbols = sorted(printed.free_symbols | derived.free_symbols, key=lambda s: s.name)
    for point in _points(symbols, fixed or {}):
        found = Counterexample(tuple(point.items()), printed, derived, meaning)
        if found.disagrees() and (violates is None or violates(*found.values())):
            return found
    return None
