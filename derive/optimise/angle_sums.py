"""cos(a + b) from the sines and cosines of a and b, where those are needed anyway."""

from __future__ import annotations

from pfaffian.derive.ir.program import Instruction, Op, Program
from pfaffian.derive.optimise.tape import Tape, rewritten


def reuse_angle_sums(program: Program) -> Program:
    """Replace sin and cos of a sum or difference by two products of what is already there.

    It is done where the sine or cosine of each of both angles is computed in any case: the other
    half of a pair costs less than a third angle. The result is as good: the sum of the angles
    need not be rounded.
    """
    taken = {i.args[0] for i in program.instructions if i.op in (Op.SIN, Op.COS)}

    def rewrite(tape: Tape, moved: dict[int, int], index: int, instruction: Instruction) -> int:
        args = tuple(moved[a] for a in instruction.args)
        if instruction.op not in (Op.SIN, Op.COS):
            return tape.copy(instruction, args)
        angle = program.instructions[instruction.args[0]]
        if angle.op not in (Op.ADD, Op.SUB) or not set(angle.args) <= taken:
            return tape.copy(instruction, args)
        a, b = (moved[x] for x in angle.args)
        return _expanded(tape, instruction, angle.op is Op.ADD, a, b)

    return rewritten(program, rewrite)


def _expanded(tape: Tape, instruction: Instruction, plus: bool, a: int, b: int) -> int:
    """Emit sin(a +- b) = sin a cos b +- cos a sin b, or cos a cos b -+ sin a sin b."""
    sine_b, cosine_b = tape.emit(Op.SIN, b), tape.emit(Op.COS, b)
    sine_a, cosine_a = tape.emit(Op.SIN, a), tape.emit(Op.COS, a)
    if instruction.op is Op.SIN:
        first, second = tape.emit(Op.MUL, sine_a, cosine_b), tape.emit(Op.MUL, cosine_a, sine_b)
        op = Op.ADD if plus else Op.SUB
    else:
        first, second = tape.emit(Op.MUL, cosine_a, cosine_b), tape.emit(Op.MUL, sine_a, sine_b)
        op = Op.SUB if plus else Op.ADD
    return tape.emit(op, first, second, name=instruction.name, comment=instruction.comment)
