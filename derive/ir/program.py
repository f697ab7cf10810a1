"""The intermediate representation: straight-line programs in single-assignment form.

A `Program` is what every emitter reads. It knows nothing of SymPy or CasADi, so that a cached one
can be emitted or evaluated after a parameter change without importing either.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
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
