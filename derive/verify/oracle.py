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
from pfaffian.derive.block import Block
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
    "sqrt": gmpy2.sqrt,
    "sign": gmpy2.sign,
    "Abs": abs,
    "Max": max,
    "Min": min,
    "max": max,
    "min": min,
}


class Oracle:
    """Evaluates one block at 200 bits."""

    def __init__(self, block: Block) -> None:
        """Prepare a function a definition, in order."""
        self.block = block
        with gmpy2.context(precision=PRECISION_BITS):
            namespace = {**_FUNCTIONS, "pi": gmpy2.const_pi()}
        inputs = set(block.symbols)
        self._steps = [_compiled(d.symbol, d.expression, namespace) for d in block.definitions]
        self._relations = [
            _compiled(None, side, namespace)
            for d in block.definitions
            for relation in sorted(d.expression.atoms(Relational), key=sp.default_sort_key)
            if not relation.free_symbols <= inputs
            for side in (relation.lhs, relation.rhs)
        ]

    def __call__(self, values: Mapping[str, float]) -> tuple[list[Any], bool]:
        """Return the outputs at `values`, and whether every comparison was clearly decided."""
        with gmpy2.context(precision=PRECISION_BITS):
            known: dict[str, Any] = {name: gmpy2.mpfr(v) for name, v in values.items()}
            for name, function, needs in self._steps:
                known[name] = function(*(known[n] for n in needs))
            outputs = [known[symbol.name] for symbol in self.block.results]
            sides = [function(*(known[n] for n in needs)) for _, function, needs in self._relations]
            clear = all(
                abs(a - b) > TIE * max(abs(a), abs(b))
                for a, b in zip(sides[0::2], sides[1::2], strict=True)
            )
            return outputs, clear


def _compiled(
    symbol: sp.Symbol | None, expression: sp.Basic, namespace: Mapping[str, Any]
) -> tuple[str, Callable[..., Any], tuple[str, ...]]:
    needs = sorted(expression.free_symbols, key=lambda s: s.name)
    function = sp.lambdify(needs, expression, modules=[dict(namespace), "mpmath"])
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
