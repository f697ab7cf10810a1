"""One division for every value that divides: 1/d once, then products."""

from __future__ import annotations

from collections import Counter

from pfaffian.derive.ir.program import Instruction, Op, Program
from pfaffian.derive.optimise.tape import Tape, rewritten


def share_divisions(program: Program) -> Program:
    """Replace x/d, y/d, ... by products with 1/d, where d divides more than once.

    A quotient becomes a product of a rounded reciprocal: one more rounding, for a division, the
    slowest of all operations, less.
    """
    divisors = Counter(i.args[1] for i in program.instructions if i.op is Op.DIV)

    def rewrite(tape: Tape, moved: dict[int, int], index: int, instruction: Instruction) -> int:
        args = tuple(moved[a] for a in instruction.args)
        if instruction.op is not Op.DIV or divisors[instruction.args[1]] < 2:
            return tape.copy(instruction, args)
        above, below = args
        name = program.instructions[instruction.args[1]].name
        inverse = tape.emit(Op.DIV, tape.const(1.0), below, name=f"inverse_{name}" if name else "")
        if tape.instructions[above] == tape.instructions[tape.const(1.0)]:
            return inverse
        return tape.emit(Op.MUL, above, inverse, name=instruction.name, comment=instruction.comment)

    return rewritten(program, rewrite)
