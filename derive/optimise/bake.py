"""A parameter set folded into the step: its values become constants of the program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from pfaffian.derive.ir.evaluate import EXACT, apply, interpret, outputs_of
from pfaffian.derive.ir.program import Instruction, Op, Program
from pfaffian.derive.optimise.tape import Tape, rewritten


@dataclass(frozen=True)
class Baked:
    """The step and what it prepares, with the constants the step reads by name, in order."""

    step: Program
    prepare: Program
    constants: tuple[tuple[str, float], ...]


def bake(step: Program, prepare: Program, values: Mapping[str, float]) -> Baked:
    """Fold the parameters `values` into `step`.

    What `prepare` computes by arithmetic alone is a constant too; the rest (the exponential of the
    leakage) is still computed at run time, by the functions of the target. Every fold is the
    operation the target would have done, so the bits do not change.
    """
    known = _arithmetic_results(prepare, values)
    constants = {**values, **known}
    taken: dict[str, float] = {}
    inputs = []
    for signal in step.inputs:
        if signal.group in ("parameter", "prepared") and signal.name in constants:
            taken[signal.name] = constants[signal.name]
            inputs.append(replace(signal, group="baked"))
        else:
            inputs.append(signal)
    folded = _without_neutral(replace(step, inputs=tuple(inputs)), taken)
    used = {folded.instructions[a].name for i in folded.instructions for a in i.args}
    used |= {folded.instructions[r].name for r in folded.results}
    left = [k for k, s in enumerate(prepare.outputs) if s.name not in known]
    kept = replace(
        prepare,
        outputs=tuple(prepare.outputs[k] for k in left),
        results=tuple(prepare.results[k] for k in left),
    )
    named = tuple((n, v) for n, v in taken.items() if n in used)
    return Baked(folded, kept, named)


def _arithmetic_results(prepare: Program, values: Mapping[str, float]) -> dict[str, float]:
    """Return the prepared values that follow from `values` by exactly rounded operations."""

    def operate(instruction: Instruction, arguments: list[float | None]) -> float | None:
        known = [a for a in arguments if a is not None]
        if instruction.op not in EXACT or len(known) < len(arguments):
            return None
        return apply(instruction.op, *known)

    found = outputs_of(prepare, interpret(prepare, values.get, lambda value: value, operate))
    prepared = [s.name for s in prepare.outputs if s.group == "prepared"]
    return {n: v for n in prepared if (v := found[n]) is not None}


def _without_neutral(step: Program, values: Mapping[str, float]) -> Program:
    """Drop x - 0 and 1 x where the 0 or 1 is one of `values`: both are exact."""
    neutral = {Op.SUB: (1, 0.0), Op.MUL: (None, 1.0)}

    def is_value(index: int, value: float) -> bool:
        i = step.instructions[index]
        return i.op is Op.INPUT and values.get(i.name) == value

    def rewrite(tape: Tape, moved: dict[int, int], index: int, instruction: Instruction) -> int:
        args = tuple(moved[a] for a in instruction.args)
        place, value = neutral.get(instruction.op, (None, None))
        if value is not None:
            for k, argument in enumerate(instruction.args):
                if (place is None or place == k) and is_value(argument, value):
                    return args[1 - k]
        return tape.copy(instruction, args)

    return rewritten(step, rewrite)
