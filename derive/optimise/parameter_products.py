"""Products sorted: what depends on parameters alone comes together, to be prepared once."""

from __future__ import annotations

from pfaffian.derive.ir.program import Instruction, Op, Program
from pfaffian.derive.optimise.tape import Tape, fixed_values, rewritten, uses


def gather_parameters(program: Program) -> Program:
    """Reorder chains of products and quotients so that their parameters meet in one factor.

    cos(q1) g theta4 becomes (g theta4) cos(q1), and x/epsilon becomes x (1/epsilon): the factor in
    parentheses no longer changes from period to period. Twice a value counts as a product by two.
    """
    fixed, used = fixed_values(program), uses(program)

    def inside(index: int) -> bool:
        """Whether this factor is a product that nothing else needs: then it is taken apart."""
        inner = program.instructions[index]
        apart = inner.op in (Op.MUL, Op.DIV) or _is_double(inner)
        return apart and used[index] <= 1 + _is_double(inner) and not inner.name

    def factors(index: int, top: bool) -> tuple[list[int], list[int], float]:
        """Return the factors above and below the line, as old indices, and a power of two."""
        inner = program.instructions[index]
        if not top and not inside(index):
            return [index], [], 1.0
        if _is_double(inner):
            above, below, power = factors(inner.args[0], False)
            return above, below, 2.0 * power
        left = factors(inner.args[0], False)
        right = factors(inner.args[1], False)
        if inner.op is Op.DIV:
            return left[0] + right[1], left[1] + right[0], left[2] / right[2]
        return left[0] + right[0], left[1] + right[1], left[2] * right[2]

    def rewrite(tape: Tape, moved: dict[int, int], index: int, instruction: Instruction) -> int:
        args = tuple(moved[a] for a in instruction.args)
        if fixed[index] or instruction.op not in (Op.MUL, Op.DIV):
            return tape.copy(instruction, args)
        above, below, power = factors(index, True)
        ours = [[i for i in part if fixed[i]] for part in (above, below)]
        moving = [[i for i in part if not fixed[i]] for part in (above, below)]
        count = len(ours[0]) + len(ours[1]) + (power != 1.0)
        if count < 2 and not (ours[1] and moving[0]):
            return tape.copy(instruction, args)
        factor = _factor(tape, [moved[i] for i in ours[0]], [moved[i] for i in ours[1]], power)
        top = _product(tape, [*(moved[i] for i in moving[0]), factor])
        if not moving[1]:
            return _named(tape, top, instruction)
        bottom = _product(tape, [moved[i] for i in moving[1]])
        return tape.emit(Op.DIV, top, bottom, name=instruction.name, comment=instruction.comment)

    return rewritten(program, rewrite)


def negate_parameters(program: Program) -> Program:
    """Replace -(p x), p a parameter, by (-p) x where nothing else needs p x: exact."""
    fixed, used = fixed_values(program), uses(program)

    def rewrite(tape: Tape, moved: dict[int, int], index: int, instruction: Instruction) -> int:
        args = tuple(moved[a] for a in instruction.args)
        if instruction.op is not Op.NEG or fixed[index]:
            return tape.copy(instruction, args)
        product = program.instructions[instruction.args[0]]
        alone = used[instruction.args[0]] == 1 and product.op is Op.MUL
        ours = [a for a in product.args if fixed[a]] if alone else []
        if len(ours) != 1:
            return tape.copy(instruction, args)
        other = product.args[0] if product.args[1] == ours[0] else product.args[1]
        minus = tape.emit(Op.NEG, moved[ours[0]])
        return tape.emit(
            Op.MUL,
            moved[other],
            minus,
            name=instruction.name,
            comment=instruction.comment,
        )

    return rewritten(program, rewrite)


def _is_double(instruction: Instruction) -> bool:
    return instruction.op is Op.ADD and instruction.args[0] == instruction.args[1]


def _factor(tape: Tape, above: list[int], below: list[int], power: float) -> int:
    if power == 2.0 and above:
        above = [tape.emit(Op.ADD, above[0], above[0]), *above[1:]]
    elif power != 1.0 or not above:
        above = [*above, tape.const(power)]
    top = _product(tape, above)
    return tape.emit(Op.DIV, top, _product(tape, below)) if below else top


def _product(tape: Tape, factors: list[int]) -> int:
    total = factors[0]
    for factor in factors[1:]:
        total = tape.emit(Op.MUL, total, factor)
    return total


def _named(tape: Tape, index: int, instruction: Instruction) -> int:
    """Give the value the name of the instruction it replaces."""
    held = tape.instructions[index]
    return tape.emit(
        held.op,
        *held.args,
        value=held.value,
        name=instruction.name or held.name,
        comment=instruction.comment or held.comment,
    )
