"""Which values have to be checked so that everything that leaves a program is finite."""

from __future__ import annotations

from pfaffian.derive.program import Op, Program

#: Where the result is finite only if all operands are; a quotient says so of its numerator alone.
_ALL = frozenset({Op.ADD, Op.SUB, Op.MUL, Op.FMA, Op.FMS, Op.FNMS, Op.NEG, Op.ABS, Op.SQRT})


def values_to_check(program: Program) -> tuple[str, ...]:
    """Return outputs of `program` whose being finite makes every output finite but flags.

    An infinity or a NaN goes through sums and products: a finite result vouches for its operands.
    What goes through comparisons has to be checked itself.
    """
    vouched: set[int] = set()
    chosen: list[str] = []
    pairs = list(zip(program.outputs, program.results, strict=True))
    for signal, index in sorted(pairs, key=lambda pair: -pair[1]):
        if signal.group == "flag" or index in vouched:
            continue
        chosen.append(signal.name)
        _vouch(program, index, vouched)
    ordered = [s.name for s in program.outputs]
    return tuple(sorted(chosen, key=ordered.index))


def _vouch(program: Program, index: int, vouched: set[int]) -> None:
    if index in vouched:
        return
    vouched.add(index)
    instruction = program.instructions[index]
    if instruction.op in _ALL:
        for argument in instruction.args:
            _vouch(program, argument, vouched)
    elif instruction.op is Op.DIV:
        _vouch(program, instruction.args[0], vouched)
