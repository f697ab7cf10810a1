"""The passes in their order, and what each of them saved."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from pfaffian.derive.ir.lowered import PassReport
from pfaffian.derive.ir.program import Program
from pfaffian.derive.optimise.angle_sums import reuse_angle_sums
from pfaffian.derive.optimise.choose_signs import add_negatives, choose_signs
from pfaffian.derive.optimise.fuse_multiply_adds import fuse_multiply_adds
from pfaffian.derive.optimise.hoist import hoist
from pfaffian.derive.optimise.parameter_products import gather_parameters, negate_parameters
from pfaffian.derive.optimise.schedule import call_early
from pfaffian.derive.optimise.share_comparisons import share_comparisons
from pfaffian.derive.optimise.share_divisions import share_divisions
from pfaffian.derive.optimise.tape import rewritten

#: Programs that are emitted and run again and again; `step` may prepare what does not change.
EMITTED = ("step", "continuous", "acceleration", "energy")
#: Emitted too, where a model has them.
OPTIONAL = ("swing_up", "follow")


def merge_equal_values(program: Program) -> Program:
    """Compute each value once (CSE), whichever way round its operands stand."""
    return rewritten(
        program, lambda tape, moved, _, i: tape.copy(i, tuple(moved[a] for a in i.args))
    )


PASSES: tuple[tuple[str, Callable[[Program], Program]], ...] = (
    ("equal values", merge_equal_values),
    ("signs", choose_signs),
    ("negatives", add_negatives),
    ("comparisons", share_comparisons),
    ("angle sums", reuse_angle_sums),
    ("shared divisions", share_divisions),
    ("parameters gathered", gather_parameters),
    ("signs of parameters", negate_parameters),
    ("multiply-add", fuse_multiply_adds),
)


def optimise(
    programs: Sequence[Program], declared: Iterable[str] = ()
) -> tuple[tuple[Program, ...], tuple[PassReport, ...]]:
    """Return the programs with the emitted ones optimised, and what each pass did.

    What moves into the preparation gets no name that is `declared`.
    """
    reports: list[PassReport] = []
    found = {p.name: p for p in programs}
    emitted = (*EMITTED, *(name for name in OPTIONAL if name in found))
    for name in emitted:
        for title, run in PASSES:
            found[name] = _reported(found[name], title, run, reports)
    step, prepare = hoist(found["step"], found["prepare"], declared)
    reports.append(PassReport("step", "prepared once", _size(found["step"]), _size(step)))
    found["step"], found["prepare"] = step, merge_equal_values(prepare)
    for name in emitted:
        found[name] = _reported(found[name], "calls first", call_early, reports)
    return tuple(found[p.name] for p in programs), tuple(reports)


def optimised(program: Program) -> Program:
    """Return one program after every pass that needs no other."""
    for _, run in PASSES:
        program = run(program)
    return call_early(program)


def _reported(
    program: Program,
    title: str,
    run: Callable[[Program], Program],
    reports: list[PassReport],
) -> Program:
    done = run(program)
    reports.append(PassReport(program.name, title, _size(program), _size(done)))
    return done


def _size(program: Program) -> int:
    return sum(program.op_count().values())
