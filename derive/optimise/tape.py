"""Writing programs: an instruction list that finds what it already holds.

Every pass copies a program onto a new tape and changes what it cares about; equal values are merged
and what no output needs is dropped on the way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

from pfaffian.derive.ir.program import Instruction, Op, Program, without_dead

_COMMUTATIVE = frozenset({Op.ADD, Op.MUL, Op.AND, Op.OR, Op.EQUAL})
#: Rewrites one instruction of the old program, given by its index; where earlier ones went is in
#: `moved`. Returns where its value is on the tape.
Rewrite = Callable[["Tape", dict[int, int], int, Instruction], int]


class Tape:
    """Instructions in order; `emit` returns the index of the value, new or known."""

    def __init__(self) -> None:
        """Start empty."""
        self.instructions: list[Instruction] = []
        self._known: dict[tuple[object, ...], int] = {}

    def emit(
        self, op: Op, *args: int, value: float = 0.0, name: str = "", comment: str = ""
    ) -> int:
        """Return the index of `op` on `args`; a name goes to a value that has none yet."""
        ordered = tuple(sorted(args)) if op in _COMMUTATIVE else args
        key = (op, ordered, value.hex())
        known = None if op is Op.INPUT else self._known.get(key)
        if known is None:
            self.instructions.append(Instruction(op, args, value, name, comment))
            self._known[key] = len(self.instructions) - 1
            return len(self.instructions) - 1
        held = self.instructions[known]
        if name and not held.name and op is not Op.CONST:
            self.instructions[known] = replace(held, name=name, comment=comment)
        return known

    def copy(self, instruction: Instruction, args: tuple[int, ...]) -> int:
        """Emit `instruction` with these arguments."""
        return self.emit(
            instruction.op,
            *args,
            value=instruction.value,
            name=instruction.name,
            comment=instruction.comment,
        )

    def const(self, value: float) -> int:
        """Return the index of a constant."""
        return self.emit(Op.CONST, value=value)


def rewritten(program: Program, rewrite: Rewrite) -> Program:
    """Return `program` with each instruction passed through `rewrite`, without what is dead."""
    tape, moved = Tape(), dict[int, int]()
    for index, instruction in enumerate(program.instructions):
        if instruction.op is Op.INPUT:
            moved[index] = tape.copy(instruction, ())
        else:
            moved[index] = rewrite(tape, moved, index, instruction)
    return finished(program, tape.instructions, tuple(moved[r] for r in program.results))


def finished(
    program: Program, instructions: Sequence[Instruction], results: tuple[int, ...]
) -> Program:
    """Return `program` with these instructions, without those that no result needs."""
    return without_dead(replace(program, instructions=tuple(instructions), results=results))


def uses(program: Program) -> Counter[int]:
    """Return how often each value is used, as an argument or as a result."""
    found = Counter(a for i in program.instructions for a in i.args)
    found.update(program.results)
    return found


def fixed_values(program: Program) -> list[bool]:
    """Return for each instruction whether it depends on parameters and constants alone.

    What `init` prepares does too.
    """
    groups = iter(program.inputs)
    fixed: list[bool] = []
    for instruction in program.instructions:
        if instruction.op is Op.INPUT:
            fixed.append(next(groups).group in ("parameter", "prepared"))
        else:
            fixed.append(all(fixed[a] for a in instruction.args))
    return fixed
