"""Order of instructions: calls of elementary functions first, each as soon as it can be made.

A call takes most registers with it. Made early, it finds few values that have to be kept.
"""

from __future__ import annotations

from dataclasses import replace

from pfaffian.derive.ir.program import FURTHER, Op, Program

_CALLS = frozenset({Op.SIN, Op.COS, Op.ATAN, Op.SQRT, Op.TANH, Op.EXP, Op.EXPM1} | FURTHER)


def call_early(program: Program) -> Program:
    """Return `program` with every call, and what it depends on, before the rest."""
    order: list[int] = []
    done: set[int] = set()

    def place(index: int) -> None:
        if index in done:
            return
        done.add(index)
        for argument in program.instructions[index].args:
            place(argument)
        order.append(index)

    for index, instruction in enumerate(program.instructions):
        if instruction.op is Op.INPUT:
            place(index)
    for index, instruction in enumerate(program.instructions):
        if instruction.op in _CALLS:
            place(index)
    for index in range(len(program.instructions)):
        place(index)
    moved = {old: new for new, old in enumerate(order)}
    return replace(
        program,
        instructions=tuple(
            replace(i, args=tuple(moved[a] for a in i.args))
            for i in (program.instructions[k] for k in order)
        ),
        results=tuple(moved[r] for r in program.results),
    )
