"""A maximum whose operands are compared anyway, as a choice on that comparison."""

from __future__ import annotations

from pfaffian.derive.ir.program import Instruction, Op, Program
from pfaffian.derive.optimise.tape import Tape, rewritten


def share_comparisons(program: Program) -> Program:
    """Replace max(a, b) by (a < b ? b : a) where a < b is asked in any case: exact."""
    asked = {i.args for i in program.instructions if i.op is Op.LESS}

    def rewrite(tape: Tape, moved: dict[int, int], index: int, instruction: Instruction) -> int:
        args = tuple(moved[a] for a in instruction.args)
        if instruction.op is not Op.MAX:
            return tape.copy(instruction, args)
        for a, b in (instruction.args, instruction.args[::-1]):
            if (a, b) in asked:
                less = tape.emit(Op.LESS, moved[a], moved[b])
                return tape.emit(
                    Op.SELECT,
                    less,
                    moved[b],
                    moved[a],
                    name=instruction.name,
                    comment=instruction.comment,
                )
        return tape.copy(instruction, args)

    return rewritten(program, rewrite)
