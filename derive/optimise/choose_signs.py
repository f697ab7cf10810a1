"""Signs: a factor of 1 or -1 as a choice, and differences as sums with what leaves negated."""

from __future__ import annotations

from pfaffian.derive.ir.program import Instruction, Op, Program
from pfaffian.derive.optimise.tape import Tape, rewritten


def add_negatives(program: Program) -> Program:
    """Replace a - x by a + (-x) where -x leaves the program anyway: exact, and x itself may go."""
    leaving = set(program.results)
    negated = {
        i.args[0]: i for k, i in enumerate(program.instructions) if i.op is Op.NEG and k in leaving
    }

    def rewrite(tape: Tape, moved: dict[int, int], index: int, instruction: Instruction) -> int:
        args = tuple(moved[a] for a in instruction.args)
        if instruction.op is not Op.SUB or instruction.args[1] not in negated:
            return tape.copy(instruction, args)
        minus = tape.copy(negated[instruction.args[1]], (args[1],))
        return tape.emit(Op.ADD, args[0], minus, name=instruction.name, comment=instruction.comment)

    return rewritten(program, rewrite)


def choose_signs(program: Program) -> Program:
    """Replace (c ? -1 : 1) y by (c ? -y : y): exact, and a change of sign for a product."""

    def condition(index: int) -> int | None:
        choice = program.instructions[index]
        if choice.op is not Op.SELECT:
            return None
        first, second = (program.instructions[a] for a in choice.args[1:])
        minus = first.op is Op.CONST and first.value == -1.0
        plus = second.op is Op.CONST and second.value == 1.0
        return choice.args[0] if minus and plus else None

    def rewrite(tape: Tape, moved: dict[int, int], index: int, instruction: Instruction) -> int:
        args = tuple(moved[a] for a in instruction.args)
        if instruction.op is not Op.MUL:
            return tape.copy(instruction, args)
        for mine, other in (instruction.args, instruction.args[::-1]):
            found = condition(mine)
            if found is not None:
                y = moved[other]
                return tape.emit(
                    Op.SELECT,
                    moved[found],
                    tape.emit(Op.NEG, y),
                    y,
                    name=instruction.name,
                    comment=instruction.comment,
                )
        return tape.copy(instruction, args)

    return rewritten(program, rewrite)
