"""The oracle: a symbolic block evaluated with 200 bits, through MPFR.

It shares nothing with lowering and emission: it walks the block's own SymPy expressions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import gmpy2
import numpy as np
import sympy as sp
from pfaffian.derive.symbolic.block import Block
from pfaffian.derive.symbolic.numeric import function_of
from sympy.core.relational import Relational

#: 200 bits are 60 decimal digits; 50 are promised, ten are for the oracle's own rounding.
PRECISION_BITS = 200
#: A comparison decided by less than this, relative, may fall the other way in double precision.
TIE = 2.0**-40

_FUNCTIONS: dict[str, Any] = {
    "mpf": gmpy2.mpfr,
    "sin": gmpy2.sin,
    "cos": gmpy2.cos,
    "atan": gmpy2.atan,
    "tanh": gmpy2.tanh,
    "exp": gmpy2.exp,
    "expm1": gmpy2.expm1,
    "log": gmpy2.log,
    "tan": gmpy2.tan,
    "cot": gmpy2.cot,
    "sec": gmpy2.sec,
    "csc": gmpy2.csc,
    "asin": gmpy2.asin,
    "acos": gmpy2.acos,
    "acot": lambda x: gmpy2.atan(1 / x),
    "atan2": gmpy2.atan2,
    "sinh": gmpy2.sinh,
    "cosh": gmpy2.cosh,
    "coth": gmpy2.coth,
    "sech": gmpy2.sech,
    "csch": gmpy2.csch,
    "Heaviside": lambda x, at_zero=0.5: 0 if x < 0 else 1 if x > 0 else at_zero,
    "DiracDelta": lambda *_: 0,
    "sqrt": gmpy2.sqrt,
    "sign": gmpy2.sign,
    "side": lambda x: -1 if x < 0 else 1,
    "Abs": abs,
    "Max": max,
    "Min": min,
    "max": max,
    "min": min,
}


_Compiled = tuple[str, Callable[..., Any], tuple[str, ...]]


class Oracle:
    """Evaluates one block at 200 bits."""

    def __init__(self, block: Block, tie: float = TIE) -> None:
        """Prepare a function a definition, in order; `tie` is for comparisons too close to call."""
        self.block = block
        with gmpy2.context(precision=PRECISION_BITS):
            namespace = {**_FUNCTIONS, "pi": gmpy2.const_pi()}
        self._steps = [_compiled(d.symbol, d.expression, namespace) for d in block.definitions]
        self._choices = [
            _Choice(choice, namespace, set(block.symbols), tie)
            for d in block.definitions
            for choice in sorted(d.expression.atoms(sp.Piecewise), key=sp.default_sort_key)
        ]

    def __call__(self, values: Mapping[str, float]) -> tuple[list[Any], bool]:
        """Return the outputs at `values`, and whether every comparison was clearly decided."""
        with gmpy2.context(precision=PRECISION_BITS):
            known: dict[str, Any] = {name: gmpy2.mpfr(v) for name, v in values.items()}
            for name, function, needs in self._steps:
                known[name] = function(*(known[n] for n in needs))
            outputs = [known[symbol.name] for symbol in self.block.results]
            return outputs, all(choice.is_clear(known) for choice in self._choices)


class _Choice:
    """One Piecewise: is it clear which branch is taken, or does it not matter?"""

    def __init__(
        self,
        choice: sp.Piecewise,
        namespace: Mapping[str, Any],
        inputs: set[sp.Symbol],
        tie: float,
    ) -> None:
        self._tie = tie
        conditions = [c for _, c in choice.args]
        relations = sorted(
            set().union(*(c.atoms(Relational) for c in conditions)), key=sp.default_sort_key
        )
        self._sides = [
            _compiled(None, side, namespace)
            for relation in relations
            if not relation.free_symbols <= inputs
            for side in (relation.lhs, relation.rhs)
        ]
        self._branches = [_compiled(None, e, namespace) for e, _ in choice.args]

    def is_clear(self, known: Mapping[str, Any]) -> bool:
        """Return whether every comparison is decided, or all branches give the same value."""
        sides = _values(self._sides, known)
        if all(self._apart(a, b) for a, b in zip(sides[0::2], sides[1::2], strict=True)):
            return True
        first, *others = _values(self._branches, known)
        return not any(self._apart(first, other) for other in others)

    def _apart(self, a: Any, b: Any) -> bool:
        return bool(abs(a - b) > self._tie * max(abs(a), abs(b)))


def _values(functions: list[_Compiled], known: Mapping[str, Any]) -> list[Any]:
    return [function(*(known[n] for n in needs)) for _, function, needs in functions]


def _compiled(
    symbol: sp.Symbol | None, expression: sp.Basic, namespace: Mapping[str, Any]
) -> _Compiled:
    needs = sorted(expression.free_symbols, key=lambda s: s.name)
    function = function_of(needs, expression, [dict(namespace), "mpmath"])
    return (symbol.name if symbol else "", function, tuple(s.name for s in needs))


def absolute_error(computed: np.ndarray[Any, Any], exact: list[Any]) -> np.ndarray[Any, Any]:
    """Return |computed - exact|, shape (N,); infinite where `computed` is not finite."""
    errors = np.empty(len(exact))
    with gmpy2.context(precision=PRECISION_BITS):
        for k, (value, reference) in enumerate(zip(computed.tolist(), exact, strict=True)):
            error = float(abs(reference - value)) if math.isfinite(value) else math.inf
            # An oracle without an answer (0/0 in the formulas) must not pass for agreement.
            errors[k] = math.inf if math.isnan(error) else error
    return errors
