"""What depends on parameters alone moves from the step into the preparation."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable
from dataclasses import replace

from pfaffian.derive.ir.program import FURTHER, LOGICAL, Instruction, Op, Program, Signal
from pfaffian.derive.optimise.tape import Tape, finished, fixed_values

_WORDS = {Op.MUL: "", Op.ADD: "plus_", Op.SUB: "minus_", Op.DIV: "over_"}
_NUMBERS = {0.5: "half", 1.0: "one", 2.0: "two", math.pi: "pi"}
_LONGEST = 40
#: A comment of the derivation, and the unit at its end.
_COMMENT = re.compile(r"(.*?)(?: \[(\S+)\])?")
_FUSED = (Op.FMA, Op.FMS, Op.FNMS)
#: From which operand on all have the unit of the result.
_FIRST_ALIKE = {
    **dict.fromkeys((Op.ADD, Op.SUB, Op.NEG, Op.ABS, Op.MIN, Op.MAX), 0),
    **dict.fromkeys(_FUSED, 2),
    Op.SELECT: 1,
}
#: Operations whose result has no unit.
_PURE = LOGICAL | FURTHER | {Op.CONST, Op.SIGN, Op.SIN, Op.COS, Op.ATAN, Op.EXP, Op.EXPM1, Op.TANH}


def hoist(step: Program, prepare: Program, declared: Iterable[str] = ()) -> tuple[Program, Program]:
    """Return (step, prepare) with every value of parameters alone computed in `prepare`.

    The step takes them as inputs of the group `prepared`. Only what the rest of the step uses
    directly moves; constants stay where they are. No value gets a name that is `declared`.
    """
    fixed = fixed_values(step)
    wanted = _frontier(step, fixed)
    if not wanted:
        return step, prepare
    taken = {s.name for s in (*step.inputs, *prepare.inputs, *prepare.outputs)}
    taken |= {i.name for p in (step, prepare) for i in p.instructions if i.name}
    taken |= set(declared)
    signals = _signals(step, wanted, taken, _units(step, prepare, fixed))
    return _without(step, wanted, signals), _extended(prepare, step, wanted, signals)


def _frontier(step: Program, fixed: list[bool]) -> list[int]:
    """Return the fixed values that are computed, and that a moving one or a result uses."""
    free = (Op.INPUT, Op.CONST, Op.NEG)
    needed = set(step.results)
    for index, instruction in enumerate(step.instructions):
        if not fixed[index]:
            needed.update(instruction.args)
    return [i for i in sorted(needed) if fixed[i] and step.instructions[i].op not in free]


def _signals(
    step: Program, wanted: list[int], taken: set[str], units: dict[int, str]
) -> list[Signal]:
    """Name what is prepared by what it is; numbers where a name would be too long."""
    texts, names = _texts(step)
    found = []
    for index in wanted:
        own = step.instructions[index]
        base = own.name or names[index]
        if not re.fullmatch(r"[A-Za-z]\w*", base) or len(base) > _LONGEST:
            base = next(n for k in itertools.count(1) if (n := f"prepared{k}") not in taken)
        name = next(n for k in itertools.count() if (n := base + "_" * k) not in taken)
        taken.add(name)
        said = _COMMENT.fullmatch(own.comment)
        text, unit = said.groups() if said else (own.comment, None)
        found.append(Signal(name, unit or units.get(index, ""), text or texts[index], "prepared"))
    return found


def _units(step: Program, prepare: Program, fixed: list[bool]) -> dict[int, str]:
    """Return the unit of each fixed value that has one by the units of what enters."""
    from pfaffian.derive.symbolic.units import unit_product  # loads SymPy and pint

    units: dict[int, str] = {}
    known = {s.name: s.unit for s in prepare.outputs if s.group == "prepared"}
    for index, i in enumerate(step.instructions):
        if not fixed[index]:
            continue
        if i.op is Op.INPUT:
            signal = step.inputs[index]
            units[index] = unit_product((known.get(signal.name, signal.unit), 1))
            continue
        found = set()
        if all(a in units for a in i.args):
            # A number in a sum takes the unit of the other side.
            alike = i.args[_FIRST_ALIKE.get(i.op, len(i.args)) :]
            found = {units[a] for a in alike if step.instructions[a].op is not Op.CONST}
            if i.op in (Op.MUL, Op.DIV, *_FUSED):
                power = -1 if i.op is Op.DIV else 1
                found.add(unit_product((units[i.args[0]], 1), (units[i.args[1]], power)))
        if i.op in _PURE or len(found) == 1:
            units[index] = "" if i.op in _PURE else found.pop()
    return units


def _texts(step: Program) -> tuple[dict[int, str], dict[int, str]]:
    """Return each fixed value as a formula, and as words joined by underscores."""
    texts: dict[int, str] = {}
    names: dict[int, str] = {}
    signs = {Op.MUL: " ", Op.ADD: " + ", Op.SUB: " - ", Op.DIV: "/"}
    for index, i in enumerate(step.instructions):
        if any(a not in texts for a in i.args):
            continue
        if i.op is Op.INPUT:
            texts[index] = names[index] = i.name
        elif i.op is Op.CONST:
            texts[index] = "pi" if i.value == math.pi else f"{i.value:.6g}"
            names[index] = _NUMBERS.get(i.value, "constant")
        elif i.op in signs:
            a, b = i.args
            sides = [
                f"({texts[x]})" if " + " in texts[x] or " - " in texts[x] else texts[x]
                for x in (a, b)
            ]
            texts[index] = sides[0] + signs[i.op] + sides[1]
            if a == b and i.op in (Op.ADD, Op.MUL):
                texts[index] = f"2 {sides[0]}" if i.op is Op.ADD else f"{sides[0]}^2"
            names[index] = _words(step, i, names)
        elif i.op is Op.NEG:
            texts[index], names[index] = f"-{texts[i.args[0]]}", f"minus_{names[i.args[0]]}"
        else:
            inner = ", ".join(texts[a] for a in i.args)
            texts[index] = f"{i.op}({inner})"
            names[index] = "_".join([str(i.op), *(names[a] for a in i.args)])
    return texts, names


def _words(step: Program, i: Instruction, names: dict[int, str]) -> str:
    a, b = i.args
    if i.op is Op.MUL and a == b:
        return f"{names[a]}_squared"
    if i.op is Op.ADD and a == b:
        return f"twice_{names[a]}"
    if i.op is Op.DIV and step.instructions[a].op is Op.CONST and names[a] == "one":
        return f"inverse_{names[b]}"
    return f"{names[a]}_{_WORDS[i.op]}{names[b]}"


def _without(step: Program, wanted: list[int], signals: list[Signal]) -> Program:
    """Return `step` with the `wanted` values as inputs."""
    first = len(step.inputs)
    tape = Tape()
    moved: dict[int, int] = {}
    for index in range(first):
        moved[index] = tape.copy(step.instructions[index], ())
    for index, signal in zip(wanted, signals, strict=True):
        moved[index] = tape.emit(Op.INPUT, name=signal.name)
    for index, instruction in enumerate(step.instructions):
        if index not in moved and all(a in moved for a in instruction.args):
            moved[index] = tape.copy(instruction, tuple(moved[a] for a in instruction.args))
    inputs = (*step.inputs, *signals)
    done = finished(step, tape.instructions, tuple(moved[r] for r in step.results))
    return replace(done, inputs=inputs)


def _extended(prepare: Program, step: Program, wanted: list[int], signals: list[Signal]) -> Program:
    """Return `prepare` with the `wanted` values of `step` as further outputs."""
    names = [s.name for s in prepare.inputs]
    needed = _ancestors(step, wanted)
    entering = [s for k, s in enumerate(step.inputs) if k in needed]
    prepared = {s.name: r for s, r in zip(prepare.outputs, prepare.results, strict=True)}
    added = [s for s in entering if s.name not in names and s.name not in prepared]
    tape = Tape()
    inside: dict[int, int] = {}
    count = len(prepare.inputs)
    for index in range(count):
        inside[index] = tape.copy(prepare.instructions[index], ())
    place = {s.name: k for k, s in enumerate(prepare.inputs)}
    for signal in added:
        place[signal.name] = tape.emit(Op.INPUT, name=signal.name)
    for index in range(count, len(prepare.instructions)):
        old = prepare.instructions[index]
        inside[index] = tape.copy(old, tuple(inside[a] for a in old.args))
    moved: dict[int, int] = {}
    for index in sorted(needed):
        i = step.instructions[index]
        if i.op is Op.INPUT:
            name = step.inputs[index].name
            moved[index] = place[name] if name in place else inside[prepared[name]]
        else:
            moved[index] = tape.copy(i, tuple(moved[a] for a in i.args))
    for index, signal in zip(wanted, signals, strict=True):
        held = tape.instructions[moved[index]]
        comment = signal.description + (f" [{signal.unit}]" if signal.unit else "")
        tape.instructions[moved[index]] = replace(held, name=signal.name, comment=comment)
    results = (*(inside[r] for r in prepare.results), *(moved[i] for i in wanted))
    done = finished(prepare, tape.instructions, results)
    return replace(done, inputs=(*prepare.inputs, *added), outputs=(*prepare.outputs, *signals))


def _ancestors(program: Program, indices: list[int]) -> set[int]:
    found = set(indices)
    for index in reversed(range(len(program.instructions))):
        if index in found:
            found.update(program.instructions[index].args)
    return found
