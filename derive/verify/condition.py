"""Condition of a block: how far rounding moves each output, whoever computes it.

For an output y two scales are given. The *input* scale is sum_i |x_i dy/dx_i| over the inputs:
the componentwise condition number times |y|. The *named* scale adds the values the derivation
names (bias1, det_m, ...) and those of its functions (tanh(f v), ...), each of which has to be
rounded to a double once before it is used. An error of a few units in the last place of the named
scale is as good as the formulas allow. The derivatives come from SymPy, chained over the
definitions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp
from pfaffian.derive.symbolic.block import Block
from pfaffian.derive.symbolic.functions import side
from pfaffian.derive.symbolic.numeric import function_of
from pfaffian.runtime.base.arrays import Array
from sympy.core.relational import Relational

#: Functions whose values are rounded once, whoever computes them.
_ROUNDED = (
    sp.sin,
    sp.cos,
    sp.tan,
    sp.atan,
    sp.tanh,
    sp.exp,
    sp.log,
    sp.asin,
    sp.acos,
    sp.sinh,
    sp.cosh,
    sp.atan2,
)
#: The derivative of a sign is zero wherever it exists; no sample sits on the jump itself.
NUMPY = [
    {"DiracDelta": np.zeros_like, "side": lambda x: np.where(np.less(x, 0.0), -1.0, 1.0)},
    "numpy",
]


@dataclass(frozen=True)
class _Step:
    name: str
    needs: tuple[str, ...]
    value: Callable[..., Any]
    partials: tuple[Callable[..., Any], ...]


class Condition:
    """Evaluates the condition scale of every output of one block, vectorised over samples."""

    def __init__(self, block: Block) -> None:
        """Differentiate each definition once, by each symbol it contains."""
        self.block = block
        definitions = _with_functions_named(block)
        self._steps = [_step(s, e) for s, e in definitions]
        # Of |x| at 0 the slope: 0 where x is 0 exactly, as of s - s; 1 where rounding may move it.
        self._moving = [_step(s, e, side) for s, e in definitions]
        powers = set().union(*(d.expression.atoms(sp.Pow) for d in block.definitions))
        self._divisors = {p.base.name for p in powers if p.base.is_Symbol and p.exp.is_negative}
        inputs = set(block.symbols)
        relations = set().union(*(d.expression.atoms(Relational) for d in block.definitions))
        self._differences = [
            _step(sp.Dummy(), relation.lhs - relation.rhs, side)
            for relation in sorted(relations, key=sp.default_sort_key)
            if not relation.free_symbols <= inputs
        ]

    def __call__(self, values: Mapping[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return the named and the input scale of each output by name, shape (N,)."""
        count = len(next(iter(values.values())))
        known, local = self._evaluated(values)
        named: dict[str, Array] = {}
        by_input: dict[str, Array] = {}
        inputs = {symbol.name for symbol in self.block.symbols}
        with np.errstate(all="ignore"):
            for signal, symbol in zip(self.block.outputs, self.block.results, strict=True):
                weights = self._weights(symbol.name, known, local)
                by_input[signal.name] = _total(
                    [w for n, w in weights.items() if n in inputs], count
                )
                named[signal.name] = _total(list(weights.values()), count)
        return named, by_input

    def without_a_digit(self, values: Mapping[str, Array], unit: float) -> Array:
        """Return the samples with a named value that is not zero but below its scale times `unit`.

        Rounding alone may then give that value the other sign: shape (N,).
        """
        known, local = self._evaluated(values)
        lost = np.zeros(len(next(iter(values.values()))), bool)
        with np.errstate(all="ignore"):
            for k, step in enumerate(self._steps):
                weights = self._weights(step.name, known, local[: k + 1])
                size = np.abs(known[step.name])
                lost |= (size != 0.0) & (size < unit * _total(list(weights.values()), len(lost)))
        return lost

    def vanishing(self, values: Mapping[str, Array], unit: float) -> Array:
        """Return the samples with a divisor that cancels below its scale times `unit`, (N,).

        Zero is such a value where the terms that make it are not.
        """
        known, local = self._evaluated(values)
        found = np.zeros(len(next(iter(values.values()))), bool)
        with np.errstate(all="ignore"):
            for k, step in enumerate(self._steps):
                if step.name not in self._divisors:
                    continue
                weights = self._weights(step.name, known, local[: k + 1])
                scale = _total(list(weights.values()), len(found))
                found |= (scale > 0.0) & ~(np.abs(known[step.name]) > unit * scale)
        return found

    def close_calls(self, values: Mapping[str, Array], unit: float) -> Array:
        """Return the samples with a comparison nearer than its sides' scale times `unit`: (N,).

        Rounding alone may decide it, as of a torque that large terms cancel down to its limit.
        """
        known, local = self._evaluated(values, self._moving)
        count = len(next(iter(values.values())))
        close = np.zeros(count, bool)
        with np.errstate(all="ignore"):
            for difference in self._differences:
                arguments = [known[n] for n in difference.needs]
                reach = np.zeros(count)
                for name, partial in zip(difference.needs, difference.partials, strict=True):
                    weights = self._weights(name, known, local)
                    reach = reach + np.abs(partial(*arguments)) * _total([*weights.values()], count)
                close |= np.abs(difference.value(*arguments)) <= unit * reach
        return close

    def _evaluated(
        self, values: Mapping[str, Array], steps: list[_Step] | None = None
    ) -> tuple[dict[str, Array], list[list[Array]]]:
        """Return every value by name, and the partial derivatives of each definition."""
        count = len(next(iter(values.values())))
        known: dict[str, Array] = dict(values)
        local: list[list[Array]] = []
        with np.errstate(all="ignore"):
            for step in self._steps if steps is None else steps:
                arguments = [known[n] for n in step.needs]
                known[step.name] = _full(step.value(*arguments), count)
                local.append([_full(p(*arguments), count) for p in step.partials])
        return known, local

    def _weights(
        self, name: str, known: Mapping[str, Array], local: list[list[Array]]
    ) -> dict[str, Array]:
        """Return |v dy/dv| for y called `name`, of the definitions that `local` is about, by v."""
        moves = self._gradient(name, local)
        return {n: np.nan_to_num(np.abs(known[n] * m), posinf=0.0) for n, m in moves.items()}

    def _gradient(self, output: str, local: list[list[Array]]) -> dict[str, Array]:
        """Return the derivative of `output` by every value that moves it (reverse chain rule)."""
        gradient: dict[str, Array] = {output: np.ones(1)}
        for step, partials in zip(
            reversed(self._steps[: len(local)]), reversed(local), strict=True
        ):
            if step.name not in gradient:
                continue
            for need, partial in zip(step.needs, partials, strict=True):
                # What does not move the output must not spoil it where its own slope is infinite.
                share = np.where(gradient[step.name] == 0.0, 0.0, gradient[step.name] * partial)
                gradient[need] = gradient[need] + share if need in gradient else share
        return gradient


def _total(parts: list[Array], count: int) -> Array:
    return np.broadcast_to(np.sum(parts, axis=0), (count,)) if parts else np.zeros(count)


def _full(value: Any, count: int) -> Array:
    return np.broadcast_to(np.asarray(value, dtype=float), (count,))


def _with_functions_named(block: Block) -> list[tuple[sp.Symbol, sp.Expr]]:
    """Return the definitions in order, each function of them defined before it is used."""
    named: dict[sp.Expr, sp.Symbol] = {}
    definitions: list[tuple[sp.Symbol, sp.Expr]] = []
    for d in block.definitions:
        inner = sorted(d.expression.atoms(*_ROUNDED), key=_size)
        for call in inner if not isinstance(d.expression, _ROUNDED) else inner[:-1]:
            plain = call.func(*(a.xreplace(named) for a in call.args))
            if plain not in named:
                symbol = sp.Symbol(f"_{call.func.__name__}{len(named)}", real=True)
                definitions.append((symbol, plain))
                named[plain] = symbol
            named[call] = named[plain]
        definitions.append((d.symbol, d.expression.xreplace(named)))
    return definitions


def _size(expression: sp.Expr) -> tuple[int, Any]:
    return expression.count_ops(), sp.default_sort_key(expression)


def _step(symbol: sp.Symbol, expression: sp.Basic, sign: Any = sp.sign) -> _Step:
    needs = sorted(expression.free_symbols, key=lambda s: s.name)
    slopes = [expression.diff(s).replace(sp.sign, sign) for s in needs]
    return _Step(
        symbol.name,
        tuple(s.name for s in needs),
        function_of(needs, expression, NUMPY),
        tuple(function_of(needs, slope, NUMPY) for slope in slopes),
    )
