"""Which values have to be checked so that everything that leaves a program is finite."""

from __future__ import annotations

from dataclasses import replace

from pfaffian.derive.ir.program import FURTHER, Op, Program, Signal

#: Where the result is finite only if all operands are; a quotient says so of its numerator alone.
_ALL = FURTHER | {Op.ADD, Op.SUB, Op.MUL, Op.FMA, Op.FMS, Op.FNMS, Op.NEG, Op.ABS, Op.SQRT}


def with_finiteness_checks(program: Program) -> tuple[Program, tuple[str, ...]]:
    """Return `program` with the values to check as further outputs, and the names of those."""
    chosen = values_to_check(program)
    names = tuple(f"check{k}" for k in range(len(chosen)))
    checks = tuple(Signal(name, "", "", "check") for name in names)
    outputs, results = (*program.outputs, *checks), (*program.results, *chosen)
    return replace(program, outputs=outputs, results=results), names


def values_to_check(program: Program) -> tuple[int, ...]:
    """Return the values of `program` whose being finite makes every output finite but flags.

    An infinity or a NaN goes through sums and products: a finite result vouches for its operands.
    What goes through comparisons has to be checked itself. A value held within +-limit is finite
    where it is finite before: the limit stands only in for something larger.
    """
    vouched: set[int] = set()
    pairs = zip(program.outputs, program.results, strict=True)
    leaving = {v for s, i in pairs if s.group != "flag" for v in _behind(program, i)}
    chosen: list[int] = []
    for index in sorted(leaving, reverse=True):
        if index not in vouched:
            chosen.append(index)
            _vouch(program, index, vouched)
    return tuple(sorted(chosen))


def _behind(program: Program, index: int) -> tuple[int, ...]:
    """Return what to check of a value: what its limit is put on, or the value itself.

    A slew limit between the two chooses bounds that need not be finite: then the value is checked,
    and the one that both limits are put on, which vouches for its own parts.
    """
    value = inner = _unlimited(program, index)
    while value != index and program.instructions[inner].op is Op.SELECT:
        inner = program.instructions[inner].args[2]
    return (index, inner) if inner != value else (value,)


def _unlimited(program: Program, index: int) -> int:
    """Return x for (limit < |x| ? +-limit : x), else the value itself."""
    choice = program.instructions[index]
    if choice.op is not Op.SELECT:
        return index
    condition = program.instructions[choice.args[0]]
    if condition.op is not Op.LESS:
        return index
    limit, size = condition.args
    magnitude = program.instructions[size]
    limited = magnitude.op is Op.ABS and magnitude.args[0] == choice.args[2]
    return choice.args[2] if limited and _is_of(program, choice.args[1], limit) else index


def _is_of(program: Program, index: int, limit: int) -> bool:
    """Return whether a value is the limit, its negative, or a choice between the two."""
    if index == limit:
        return True
    value = program.instructions[index]
    if value.op is Op.NEG:
        return value.args[0] == limit
    return value.op is Op.SELECT and all(_is_of(program, a, limit) for a in value.args[1:])


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
