"""Programs run: one interpreter in any arithmetic, and its double precision."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from pfaffian.derive.ir.program import Instruction, Op, Program, T


def _sign(x: float) -> float:
    return float(x > 0.0) - float(x < 0.0)


def _exp(x: float) -> float:
    try:
        return math.exp(x)
    except OverflowError:
        return math.inf


def _logarithm(x: float) -> float:
    if x == 0.0:
        return -math.inf
    return math.log(x) if x > 0.0 else math.nan


def _within_one(function: Callable[[float], float]) -> Callable[[float], float]:
    return lambda x: function(x) if abs(x) <= 1.0 else math.nan


def _sinh(x: float) -> float:
    return math.copysign(math.inf, x) if abs(x) > 710.5 else math.sinh(x)


def _cosh(x: float) -> float:
    return math.inf if abs(x) > 710.5 else math.cosh(x)


def _fused(a: float, b: float, c: float) -> float:
    """Return a b + c, rounded once."""
    if not (math.isfinite(a) and math.isfinite(b) and math.isfinite(c)):
        return a * b + c
    from fractions import Fraction  # exact; only emitted programs hold fused operations

    try:
        return float(Fraction(a) * Fraction(b) + Fraction(c))
    except OverflowError:
        return a * b + c


_EVALUATE: dict[Op, Callable[..., float]] = {
    Op.ADD: lambda a, b: a + b,
    Op.SUB: lambda a, b: a - b,
    Op.MUL: lambda a, b: a * b,
    Op.DIV: lambda a, b: a / b if b else math.nan,
    Op.FMA: _fused,
    Op.FMS: lambda a, b, c: _fused(a, b, -c),
    Op.FNMS: lambda a, b, c: _fused(-a, b, c),
    Op.NEG: lambda a: -a,
    Op.ABS: abs,
    Op.SIGN: _sign,
    Op.MIN: lambda a, b: a if a < b else b,
    Op.MAX: lambda a, b: a if a > b else b,
    Op.SQRT: lambda a: math.nan if a < 0.0 else math.sqrt(a),
    Op.SIN: math.sin,
    Op.COS: math.cos,
    Op.ATAN: math.atan,
    Op.EXP: _exp,
    Op.EXPM1: math.expm1,
    Op.TANH: math.tanh,
    Op.LOG: _logarithm,
    Op.ASIN: _within_one(math.asin),
    Op.ACOS: _within_one(math.acos),
    Op.SINH: _sinh,
    Op.COSH: _cosh,
    Op.LESS: lambda a, b: float(a < b),
    Op.LESS_EQUAL: lambda a, b: float(a <= b),
    Op.EQUAL: lambda a, b: float(a == b),
    Op.NOT: lambda a: float(not a),
    Op.AND: lambda a, b: float(bool(a) and bool(b)),
    Op.OR: lambda a, b: float(bool(a) or bool(b)),
    Op.SELECT: lambda c, a, b: a if c else b,
}
#: Operations that IEEE 754 rounds in one way only: the same bits here and on every target.
EXACT = frozenset(
    {Op.ADD, Op.SUB, Op.MUL, Op.DIV, Op.FMA, Op.FMS, Op.FNMS, Op.NEG, Op.ABS, Op.MIN, Op.MAX}
    | {Op.SQRT}
)


def apply(op: Op, *arguments: float) -> float:
    """Return `op` on `arguments` in double precision; NaN for a division by zero and the like."""
    return _EVALUATE[op](*arguments)


def interpret(
    program: Program,
    given: Callable[[str], T],
    constant: Callable[[float], T],
    operate: Callable[[Instruction, list[T]], T],
) -> list[T]:
    """Run `program` in any arithmetic and return the value of every instruction, in order.

    `given` returns an input by its name, `constant` what stands for a number, and `operate` an
    instruction's value from those of its arguments.
    """
    names = iter(program.inputs)
    slots: list[T] = []
    for instruction in program.instructions:
        if instruction.op is Op.INPUT:
            slots.append(given(next(names).name))
        elif instruction.op is Op.CONST:
            slots.append(constant(instruction.value))
        else:
            slots.append(operate(instruction, [slots[a] for a in instruction.args]))
    return slots


def outputs_of(program: Program, slots: Sequence[T]) -> dict[str, T]:
    """Return the outputs of `program` by name, out of the values of its instructions."""
    pairs = zip(program.outputs, program.results, strict=True)
    return {signal.name: slots[index] for signal, index in pairs}


def evaluate(program: Program, values: Mapping[str, float]) -> dict[str, float]:
    """Run `program` in plain Python floats and return its outputs by name.

    It serves the parameter checks, where a handful of values is wanted and importing NumPy would
    cost more than the answer. Division by zero gives NaN.
    """
    slots = interpret(
        program,
        lambda name: float(values[name]),
        lambda value: value,
        lambda instruction, arguments: _EVALUATE[instruction.op](*arguments),
    )
    return outputs_of(program, slots)
