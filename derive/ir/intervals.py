"""Interval arithmetic over the intermediate representation: enclosures that hold for a whole box.

Every operation is rounded outward by a few units in the last place, more than the rounding of the
operation itself, so that an enclosure is one in real arithmetic too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from pfaffian.derive.ir.evaluate import interpret, outputs_of
from pfaffian.derive.ir.program import LOGICAL, Instruction, Op, Program
from pfaffian.runtime.base.arrays import Array

Interval = tuple[Array, Array]

_ULPS = 4.0
_TURN = 2.0 * np.pi
#: An extremum this near to an end of the interval counts as inside.
_SLACK = 1e-12


def _outward(low: Array, high: Array) -> Interval:
    """Round outward; what is not a number becomes the whole line."""
    low = np.where(np.isnan(low), -np.inf, low)
    high = np.where(np.isnan(high), np.inf, high)
    below = np.where(np.isfinite(low), _ULPS * np.spacing(np.abs(low)), 0.0)
    above = np.where(np.isfinite(high), _ULPS * np.spacing(np.abs(high)), 0.0)
    return low - below, high + above


def _multiply(a: Interval, b: Interval) -> Interval:
    products = np.stack([a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]])
    return products.min(axis=0), products.max(axis=0)


def _square(a: Interval) -> Interval:
    low, high = _magnitude(a)
    return low * low, high * high


def _divide(a: Interval, b: Interval) -> Interval:
    crosses = (b[0] <= 0.0) & (b[1] >= 0.0)
    low, high = _multiply(a, (1.0 / b[1], 1.0 / b[0]))
    # The reciprocals were rounded before the product: one unit each, within what is added outside.
    return np.where(crosses, -np.inf, low), np.where(crosses, np.inf, high)


def _magnitude(a: Interval) -> Interval:
    inner = np.where((a[0] <= 0.0) & (a[1] >= 0.0), 0.0, np.minimum(np.abs(a[0]), np.abs(a[1])))
    return inner, np.maximum(np.abs(a[0]), np.abs(a[1]))


def _contains_turn(a: Interval, offset: float) -> Array:
    """Return whether offset + 2 pi k lies in the interval for some integer k."""
    first = np.ceil((a[0] - offset) / _TURN - _SLACK)
    return np.asarray(first <= (a[1] - offset) / _TURN + _SLACK)


def _cosine(a: Interval, shift: float = 0.0) -> Interval:
    """Enclose cos(x - shift)."""
    ends = np.cos(a[0] - shift), np.cos(a[1] - shift)
    low = np.where(_contains_turn(a, shift + np.pi), -1.0, np.minimum(*ends) - _SLACK)
    high = np.where(_contains_turn(a, shift), 1.0, np.maximum(*ends) + _SLACK)
    return np.maximum(low, -1.0), np.minimum(high, 1.0)


def _rising(function: Callable[[Array], Array]) -> Callable[[Interval], Interval]:
    return lambda a: (function(a[0]), function(a[1]))


def _within(
    function: Callable[[Interval], Interval], low: float, high: float
) -> Callable[[Interval], Interval]:
    """Enclose by `function` what lies within its domain, the rest by the whole line."""

    def enclose(a: Interval) -> Interval:
        inside = (a[0] >= low) & (a[1] <= high)
        below, above = function(a)
        return np.where(inside, below, -np.inf), np.where(inside, above, np.inf)

    return enclose


def _select(_: Interval, a: Interval, b: Interval) -> Interval:
    """Enclose both sides: the truth of a comparison is not looked at."""
    return np.minimum(a[0], b[0]), np.maximum(a[1], b[1])


def _even(function: Callable[[Array], Array]) -> Callable[[Interval], Interval]:
    """Enclose an even function that rises with |x|."""
    return lambda a: _rising(function)(_magnitude(a))


_OPERATIONS: dict[Op, Callable[..., Interval]] = {
    Op.ADD: lambda a, b: (a[0] + b[0], a[1] + b[1]),
    Op.SUB: lambda a, b: (a[0] - b[1], a[1] - b[0]),
    Op.MUL: _multiply,
    Op.DIV: _divide,
    Op.NEG: lambda a: (-a[1], -a[0]),
    Op.ABS: _magnitude,
    Op.MIN: lambda a, b: (np.minimum(a[0], b[0]), np.minimum(a[1], b[1])),
    Op.MAX: lambda a, b: (np.maximum(a[0], b[0]), np.maximum(a[1], b[1])),
    Op.SQRT: lambda a: (np.sqrt(np.maximum(a[0], 0.0)), np.sqrt(np.maximum(a[1], 0.0))),
    Op.SIN: lambda a: _cosine(a, np.pi / 2.0),
    Op.COS: _cosine,
    Op.ATAN: _rising(np.arctan),
    Op.EXP: _rising(np.exp),
    Op.EXPM1: _rising(np.expm1),
    Op.TANH: _rising(np.tanh),
    Op.SIGN: _rising(np.sign),
    Op.LOG: _within(_rising(np.log), 0.0, np.inf),
    Op.ASIN: _within(_rising(np.arcsin), -1.0, 1.0),
    Op.ACOS: _within(lambda a: (np.arccos(a[1]), np.arccos(a[0])), -1.0, 1.0),
    Op.SINH: _rising(np.sinh),
    Op.COSH: _even(np.cosh),
    **dict.fromkeys(LOGICAL, lambda *_: (np.asarray(0.0), np.asarray(1.0))),
    Op.SELECT: _select,
}


def _apply(instruction: Instruction, arguments: list[Interval]) -> Interval:
    if instruction.op not in _OPERATIONS:
        raise NotImplementedError(f"no interval for the operation {instruction.op}")
    a = instruction.args
    if instruction.op is Op.MUL and a[0] == a[1]:
        found = _square(arguments[0])  # x * x is not the product of two independent values
    else:
        found = _OPERATIONS[instruction.op](*arguments)
    return _outward(*found)


def enclose(program: Program, box: Mapping[str, Interval]) -> dict[str, Interval]:
    """Return an enclosure of every output of `program` over boxes.

    `box` maps each input to its ends, arrays of shape (N,) or scalars; the outputs come as pairs
    of arrays of that shape. A choice is enclosed by both of its sides.
    """

    def given(name: str) -> Interval:
        low, high = box[name]
        return np.asarray(low, float), np.asarray(high, float)

    with np.errstate(all="ignore"):
        slots = interpret(program, given, lambda x: (np.asarray(x), np.asarray(x)), _apply)
    return outputs_of(program, slots)
