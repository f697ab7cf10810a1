"""Whether the energy swing-up law is regular in every state: what kD/kE must exceed, enclosed.

The condition is kD/kE > limit(q) for all q, with `limit` a program of the lowered model. Intervals
in plain floats bound it over whole boxes of q, so that a few boxes decide for a set with some room:
a warm generation reads every set of a model, and NumPy would cost more than that.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from pfaffian.derive.ir.evaluate import evaluate, interpret
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.names import ANGLE_GROUP, SWING_UP_LIMIT, SWING_UP_PROGRAM
from pfaffian.derive.ir.program import LOGICAL, Instruction, Op, Program

Interval = tuple[float, float]
Box = tuple[Interval, ...]
#: Every operation is widened by more than its rounding, relative and absolute.
_WIDER, _LEAST = 2.0**-50, 2.0**-1060
#: An extremum of a cosine this near to an end of an interval counts as inside.
_SLACK = 1e-12
_TURN = 2.0 * math.pi
#: Boxes after which a condition that is not decided counts as violated: its margin is nothing.
_MOST_BOXES = 20_000


@dataclass(frozen=True)
class Limit:
    """The largest limit over all q: between `least`, which it has at `at`, and `most`."""

    least: float
    most: float
    at: Mapping[str, float]


def _multiply(a: Interval, b: Interval) -> Interval:
    products = [x * y for x in a for y in b]
    return min(products), max(products)


def _square(a: Interval) -> Interval:
    low = 0.0 if a[0] <= 0.0 <= a[1] else min(abs(a[0]), abs(a[1]))
    high = max(abs(a[0]), abs(a[1]))
    return low * low, high * high


def _divide(a: Interval, b: Interval) -> Interval:
    if b[0] <= 0.0 <= b[1]:
        return -math.inf, math.inf
    quotients = [x / y for x in a for y in b]
    return min(quotients), max(quotients)


def _contains_turn(a: Interval, offset: float) -> bool:
    first = math.ceil((a[0] - offset) / _TURN - _SLACK)
    return first <= (a[1] - offset) / _TURN + _SLACK


def _cosine(a: Interval, shift: float = 0.0) -> Interval:
    """Enclose cos(x - shift)."""
    ends = math.cos(a[0] - shift), math.cos(a[1] - shift)
    low = -1.0 if _contains_turn(a, shift + math.pi) else min(ends) - _SLACK
    high = 1.0 if _contains_turn(a, shift) else max(ends) + _SLACK
    return max(low, -1.0), min(high, 1.0)


def _minus(a: Interval) -> Interval:
    return -a[1], -a[0]


def _rising(
    function: Callable[[float], float], low: float = -math.inf, high: float = math.inf
) -> Callable[[Interval], Interval]:
    """Enclose a rising function by its ends; what leaves its domain becomes the whole line."""

    def enclose(a: Interval) -> Interval:
        if not low <= a[0] <= a[1] <= high:
            return -math.inf, math.inf
        return function(a[0]) - _SLACK * abs(function(a[0])), function(a[1]) + _SLACK * abs(
            function(a[1])
        )

    return enclose


def _magnitude(a: Interval) -> Interval:
    inner = 0.0 if a[0] <= 0.0 <= a[1] else min(abs(a[0]), abs(a[1]))
    return inner, max(abs(a[0]), abs(a[1]))


def _hull(a: Interval, b: Interval) -> Interval:
    return min(a[0], b[0]), max(a[1], b[1])


_OPERATIONS: dict[Op, Callable[..., Interval]] = {
    Op.ADD: lambda a, b: (a[0] + b[0], a[1] + b[1]),
    Op.SUB: lambda a, b: (a[0] - b[1], a[1] - b[0]),
    Op.MUL: _multiply,
    Op.DIV: _divide,
    Op.NEG: _minus,
    Op.SQRT: lambda a: (math.sqrt(max(a[0], 0.0)), math.sqrt(max(a[1], 0.0))),
    Op.SIN: lambda a: _cosine(a, math.pi / 2.0),
    Op.COS: _cosine,
    Op.ABS: _magnitude,
    Op.MIN: lambda a, b: (min(a[0], b[0]), min(a[1], b[1])),
    Op.MAX: lambda a, b: (max(a[0], b[0]), max(a[1], b[1])),
    Op.SIGN: lambda a: (
        -1.0 if a[0] < 0.0 else float(a[0] > 0.0),
        1.0 if a[1] > 0.0 else -float(a[1] < 0.0),
    ),
    Op.ATAN: _rising(math.atan),
    Op.TANH: _rising(math.tanh),
    Op.EXP: _rising(math.exp, -700.0, 700.0),
    Op.EXPM1: _rising(math.expm1, -700.0, 700.0),
    Op.LOG: _rising(math.log, 2.0**-1000),
    Op.ASIN: _rising(math.asin, -1.0, 1.0),
    Op.ACOS: lambda a: _minus(_rising(lambda x: -math.acos(x), -1.0, 1.0)(a)),
    Op.SINH: _rising(math.sinh, -700.0, 700.0),
    Op.COSH: lambda a: _rising(math.cosh, 0.0, 700.0)(_magnitude(a)),
    # Either side may be taken: the truth of a comparison is not looked at.
    **dict.fromkeys(LOGICAL, lambda *_: (0.0, 1.0)),
    Op.SELECT: lambda _, a, b: _hull(a, b),
}


def _outward(a: Interval) -> Interval:
    if not (math.isfinite(a[0]) and math.isfinite(a[1])):
        return -math.inf, math.inf
    return (
        a[0] - _WIDER * abs(a[0]) - _LEAST,
        a[1] + _WIDER * abs(a[1]) + _LEAST,
    )


def enclosed(program: Program, box: Mapping[str, Interval]) -> Interval:
    """Return an enclosure of the one output of `program` over a box of inputs, by name.

    What is not bounded becomes the whole line. Raises `NotImplementedError` for an operation that
    has no interval here.
    """

    def operate(instruction: Instruction, arguments: list[Interval]) -> Interval:
        a = instruction.args
        if instruction.op is Op.MUL and a[0] == a[1]:
            return _outward(_square(arguments[0]))
        if instruction.op not in _OPERATIONS:
            raise NotImplementedError(f"{program.name}: no interval for {instruction.op}")
        return _outward(_OPERATIONS[instruction.op](*arguments))

    slots = interpret(program, box.__getitem__, lambda x: (x, x), operate)
    return slots[program.results[0]]


class _Search:
    """The limit over boxes of q, the parameters fixed."""

    def __init__(self, model: LoweredModel, values: Mapping[str, float]) -> None:
        self._program = model.program(SWING_UP_PROGRAM)
        bounds = {c.name: c.bound for c in model.coordinates}
        moving = [s for s in self._program.inputs if s.group != "parameter"]
        self.names = [s.name for s in moving]
        self.whole: Box = tuple(
            (-math.pi, math.pi) if s.group == ANGLE_GROUP else (-bounds[s.name], bounds[s.name])
            for s in moving
        )
        self._point = {
            s.name: values[s.name] for s in self._program.inputs if s.group == "parameter"
        }
        self._fixed = {n: (v, v) for n, v in self._point.items()}

    def most(self, box: Box) -> float:
        """Return what the limit does not exceed in `box`."""
        here = dict(zip(self.names, box, strict=True))
        return enclosed(self._program, {**self._fixed, **here})[1]

    def middle(self, box: Box) -> tuple[float, dict[str, float]]:
        """Return the limit in the middle of `box`, and that point."""
        at = {n: 0.5 * (a + b) for n, (a, b) in zip(self.names, box, strict=True)}
        return evaluate(self._program, {**self._point, **at})[SWING_UP_LIMIT], at

    def halves(self, box: Box) -> tuple[Box, Box]:
        """Return `box` cut in two across its longest side, in parts of the whole."""
        parts = [
            (b - a) / (high - low) for (a, b), (low, high) in zip(box, self.whole, strict=True)
        ]
        k = parts.index(max(parts))
        low, high = box[k]
        middle = 0.5 * (low + high)
        return (
            (*box[:k], (low, middle), *box[k + 1 :]),
            (*box[:k], (middle, high), *box[k + 1 :]),
        )


def is_regular(model: LoweredModel, values: Mapping[str, float], ratio: float) -> bool:
    """Return whether `ratio`, kD/kE, exceeds the limit in every q, proved by intervals.

    `values` are the parameters by name. A ratio within rounding of the limit does not.
    """
    search = _Search(model, values)
    waiting = [search.whole]
    for _ in range(_MOST_BOXES):
        if not waiting:
            return True
        box = waiting.pop()
        if search.most(box) < ratio:
            continue
        if not search.middle(box)[0] < ratio or not box:
            return False
        waiting += search.halves(box)
    return False


def largest_limit(
    model: LoweredModel, values: Mapping[str, float], tolerance: float = 1e-6
) -> Limit:
    """Return the largest limit over all q, enclosed to `tolerance` relative where that succeeds."""
    search = _Search(model, values)
    best, at = search.middle(search.whole)
    waiting = [(-search.most(search.whole), search.whole)]
    for _ in range(_MOST_BOXES):
        most, box = -waiting[0][0], waiting[0][1]
        if not box or most <= best + tolerance * abs(best):
            break
        heapq.heappop(waiting)
        for half in search.halves(box):
            value, point = search.middle(half)
            if value > best:
                best, at = value, point
            heapq.heappush(waiting, (-search.most(half), half))
    return Limit(best, -waiting[0][0], at)
