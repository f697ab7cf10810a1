"""Products and sums fused: one rounding and one instruction for a b + c."""

from __future__ import annotations

from pfaffian.derive.ir.program import Instruction, Op, Program
from pfaffian.derive.optimise.tape import Tape, fixed_values, rewritten, uses


def fuse_multiply_adds(program: Program) -> Program:
    """Replace sums that take a product by fused multiply-adds.

    A product is fused where every use of it is such a sum: then it need not be computed apart.
    What is prepared once is left alone: there every operation counts the same.
    """
    fixed, used = fixed_values(program), uses(program)
    summed: dict[int, int] = {}
    for index, instruction in enumerate(program.instructions):
        if instruction.op in (Op.ADD, Op.SUB) and instruction.args[0] != instruction.args[1]:
            for a in instruction.args:
                summed[a] = summed.get(a, 0) + (not fixed[index])

    def fusible(index: int) -> bool:
        product = program.instructions[index].op is Op.MUL and not fixed[index]
        return product and used[index] == summed.get(index, 0)

    def rewrite(tape: Tape, moved: dict[int, int], index: int, instruction: Instruction) -> int:
        args = tuple(moved[a] for a in instruction.args)
        if instruction.op not in (Op.ADD, Op.SUB) or fixed[index]:
            return tape.copy(instruction, args)
        left, right = instruction.args
        if left == right or not (fusible(left) or fusible(right)):
            return tape.copy(instruction, args)
        # Of two products the one that is used more often stays: the other saves its instruction.
        first = fusible(left) and not (fusible(right) and used[right] < used[left])
        product, other = (left, args[1]) if first else (right, args[0])
        a, b = (moved[x] for x in program.instructions[product].args)
        op = Op.FMA
        if instruction.op is Op.SUB:
            op = Op.FMS if first else Op.FNMS
        return tape.emit(op, a, b, other, name=instruction.name, comment=instruction.comment)

    return rewritten(program, rewrite)
