"""The intermediate representation: straight-line programs in single-assignment form.

A `Program` is what every emitter reads. It knows nothing of SymPy or CasADi, so that a cached one
can be emitted or evaluated after a parameter change without importing either.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, TypeVar

T = TypeVar("T")


class Op(StrEnum):
    """What one instruction does; operands are indices of earlier instructions."""

    INPUT = "input"
    CONST = "const"
    ADD = "add"
    SUB = "sub"
    MUL = "mul"
    DIV = "div"
    FMA = "fma"  # a b + c, rounded once
    FMS = "fms"  # a b - c
    FNMS = "fnms"  # c - a b
    NEG = "neg"
    ABS = "abs"
    SIGN = "sign"
    MIN = "min"
    MAX = "max"
    SQRT = "sqrt"
    SIN = "sin"
    COS = "cos"
    ATAN = "atan"
    EXP = "exp"
    EXPM1 = "expm1"
    TANH = "tanh"
    LOG = "log"
    ASIN = "asin"
    ACOS = "acos"
    SINH = "sinh"
    COSH = "cosh"
    LESS = "less"
    LESS_EQUAL = "less_equal"
    EQUAL = "equal"
    NOT = "not"
    AND = "and"
    OR = "or"
    SELECT = "select"


#: The input that holds the time of a time-varying constraint.
TIME_NAME = "time"

#: Marks the plant's own parameters where controller and plant meet, as the two may differ; their
#: group there.
PLANT_PREFIX = "plant_"
PLANT_PARAMETER = "plant_parameter"

#: Operators whose value is a truth value (0 or 1), never a number of the plant.
LOGICAL = frozenset({Op.LESS, Op.LESS_EQUAL, Op.EQUAL, Op.NOT, Op.AND, Op.OR})

#: Operators whose functions stand in a file of their own, which only models that call them get.
FURTHER = frozenset({Op.LOG, Op.ASIN, Op.ACOS, Op.SINH, Op.COSH})


@dataclass(frozen=True)
class Signal:
    """A named scalar that enters or leaves a program.

    `group` says which structure it belongs to: `input` (what is measured), `torque`, `state`,
    `parameter`, `prepared`, `output`, `flag` or `next_state`.
    """

    name: str
    unit: str
    description: str
    group: str


@dataclass(frozen=True)
class Instruction:
    """One assignment. `name` is empty where the value has no name of its own in the derivation."""

    op: Op
    args: tuple[int, ...] = ()
    value: float = 0.0
    name: str = ""
    comment: str = ""


@dataclass(frozen=True)
class Program:
    """Inputs, instructions in order, and for each output the index of the instruction it takes."""

    name: str
    title: str
    inputs: tuple[Signal, ...]
    instructions: tuple[Instruction, ...]
    outputs: tuple[Signal, ...]
    results: tuple[int, ...]

    def op_count(self) -> dict[str, int]:
        """Return how many instructions of each kind the program executes, sorted by kind."""
        free = {Op.INPUT, Op.CONST}
        counts = Counter(str(i.op) for i in self.instructions if i.op not in free)
        return dict(sorted(counts.items()))


def without_dead(program: Program) -> Program:
    """Return `program` without the instructions that no result needs; inputs all stay."""
    alive = set(program.results)
    for index in reversed(range(len(program.instructions))):
        if index in alive:
            alive.update(program.instructions[index].args)
    moved: dict[int, int] = {}
    kept: list[Instruction] = []
    for index, instruction in enumerate(program.instructions):
        if index in alive or instruction.op is Op.INPUT:
            moved[index] = len(kept)
            kept.append(replace(instruction, args=tuple(moved[a] for a in instruction.args)))
    results = tuple(moved[r] for r in program.results)
    return replace(program, instructions=tuple(kept), results=results)


def restricted(program: Program, *groups: str) -> Program:
    """Return `program` with only those outputs, and what they need."""
    pairs = zip(program.outputs, program.results, strict=True)
    kept = [(signal, index) for signal, index in pairs if signal.group in groups]
    outputs, results = tuple(s for s, _ in kept), tuple(i for _, i in kept)
    return without_dead(replace(program, outputs=outputs, results=results))


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


def program_to_json(program: Program) -> dict[str, object]:
    """Return a JSON document of `program`; constants are kept as hexadecimal floats."""
    return {
        "name": program.name,
        "title": program.title,
        "inputs": [list(vars(s).values()) for s in program.inputs],
        "instructions": [
            [str(i.op), list(i.args), i.value.hex(), i.name, i.comment]
            for i in program.instructions
        ],
        "outputs": [list(vars(s).values()) for s in program.outputs],
        "results": list(program.results),
    }


def program_from_json(document: Mapping[str, Any]) -> Program:
    """Rebuild the program that `program_to_json` wrote."""
    return Program(
        name=document["name"],
        title=document["title"],
        inputs=tuple(Signal(*s) for s in document["inputs"]),
        instructions=tuple(
            Instruction(Op(op), tuple(args), float.fromhex(value), name, comment)
            for op, args, value, name, comment in document["instructions"]
        ),
        outputs=tuple(Signal(*s) for s in document["outputs"]),
        results=tuple(document["results"]),
    )
