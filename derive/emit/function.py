"""One program as one C function over arrays, for measurements: no model, no structures."""

from __future__ import annotations

from pfaffian.derive.elementary import render_context
from pfaffian.derive.emit.c import body_of
from pfaffian.derive.emit.emitter import ELEMENTARY_FILES, calls_further, fill
from pfaffian.derive.emit.precision import DOUBLE
from pfaffian.derive.program import Program


def emit_function(program: Program) -> dict[str, str]:
    """Return `program` as one C function over arrays, with the elementary functions it calls.

    `void NAME(const double in[], double out[])`; the order is that of the program's inputs and
    outputs. It serves measurements, where no structures are wanted.
    """
    body = body_of(program, lambda index, _: f"in[{index}]")
    further = DOUBLE.further_header if calls_further(program) else ""
    context: dict[str, object] = {
        "further_header": further,
        "name": program.name,
        "inputs": len(program.inputs),
        "outputs": len(program.outputs),
        "lines": body.lines,
        "results": list(body.results.values()),
    }
    elementary = {"header": "/* For a measurement. */", **render_context()}
    names = [*ELEMENTARY_FILES, *filter(None, [further])]
    files = {n: fill(f"c/{n}.j2", elementary) for n in names}
    scalar = {"header": "/* For a measurement. */", **DOUBLE.names()}
    files["pf_scalar.h"] = fill("c/pf_scalar.h.j2", scalar)
    return {**files, f"{program.name}.c": fill("c/function.c.j2", context)}
