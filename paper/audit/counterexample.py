"""The smallest point at which two forms disagree: few, simple, exact values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import combinations, islice, product

import sympy as sp
from pfaffian.paper.audit.row import Counterexample
from sympy.core.function import AppliedUndef

_POSITIVE = (sp.S.One, sp.Integer(2), sp.Rational(1, 2), sp.Integer(3))
_REAL = (sp.S.Zero, sp.S.One, -sp.S.One, sp.Integer(2))
#: How many symbols may leave their simplest value.
_DEPTH = 3
#: Values of which none is zero, and how many points are tried at most.
_DENSE = (sp.S.One, sp.Integer(2), sp.Integer(3), sp.Rational(1, 2), sp.Integer(5))
_MOST_POINTS = 400

Admissible = Callable[[Mapping[sp.Symbol, sp.Expr]], bool]


def _values(symbol: sp.Symbol) -> tuple[sp.Expr, ...]:
    return _POSITIVE if symbol.is_positive else _REAL


def _points(
    symbols: list[sp.Symbol], fixed: Mapping[sp.Symbol, sp.Expr]
) -> Iterator[dict[sp.Symbol, sp.Expr]]:
    """Yield points by the number of symbols that leave their simplest value; after the first of
    them some at which none is zero, for products of many.
    """
    base = {s: fixed.get(s, _values(s)[0]) for s in symbols}
    free = [s for s in symbols if s not in fixed]
    for depth in range(_DEPTH + 1):
        if depth == 2:
            for shift in range(len(_DENSE)):
                dense = {s: _DENSE[(k + shift) % len(_DENSE)] for k, s in enumerate(free)}
                yield base | dense
        for moved in combinations(free, depth):
            for values in product(*(_values(s)[1:] for s in moved)):
                yield base | dict(zip(moved, values, strict=True))


def _free_of_functions(*expressions: sp.Expr) -> list[sp.Expr]:
    """Return the expressions with a symbol for each integral or other undefined function."""
    found = sorted(set().union(*(e.atoms(AppliedUndef) for e in expressions)), key=str)
    names = {f: sp.Symbol(f"{f.func}_{k}", real=True) for k, f in enumerate(found, 1)}
    return [e.xreplace(names) for e in expressions]


def smallest_counterexample(
    printed: sp.Expr,
    derived: sp.Expr,
    fixed: Mapping[sp.Symbol, sp.Expr] | None = None,
    meaning: str = "the printed and the derived form",
    violates: Callable[[sp.Expr, sp.Expr], bool] | None = None,
) -> Counterexample | None:
    """Return the first point at which `printed` and `derived` disagree, or None.

    Points are tried from the simplest on, `_MOST_POINTS` at most. `fixed` values are kept;
    `violates` replaces "differ" where the claim is an inequality.
    """
    printed, derived = _free_of_functions(printed, derived)
    symbols = sorted(printed.free_symbols | derived.free_symbols, key=lambda s: s.name)
    for point in islice(_points(symbols, fixed or {}), _MOST_POINTS):
        found = Counterexample(tuple(point.items()), printed, derived, meaning)
        if found.disagrees() and (violates is None or violates(*found.values())):
            return found
    return None
