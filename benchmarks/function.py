"""One program as one C function over arrays, for measurements: no model, no structures."""

from __future__ import annotations

from collections.abc import Mapping

from pfaffian.derive.elementary.coefficients import render_context
from pfaffian.derive.emit.emission import calls_further
from pfaffian.derive.emit.files.c import body_of
from pfaffian.derive.emit.precision import DOUBLE, Precision
from pfaffian.derive.emit.templates import fill
from pfaffian.derive.ir.program import Program

_HEADER = "/* For a measurement. */"


def elementary_sources(
    header: str,
    coefficients: Mapping[str, object],
    precision: Precision = DOUBLE,
    further: bool = False,
) -> dict[str, str]:
    """Return the files of the elementary functions of `precision`, and what they include."""
    context = {"header": header, **precision.names(), **coefficients}
    files = [*precision.elementary_files, *([precision.further_header] if further else [])]
    made = {name: fill(f"c/{name}.j2", context) for name in files}
    f = precision.suffix
    return {**made, f"pf_arithmetic{f}.h": fill("c/pf_arithmetic.h.j2", context)}


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
    scalar = {"header": _HEADER, **DOUBLE.names()}
    files = elementary_sources(_HEADER, render_context(), further=bool(further))
    files["pf_scalar.h"] = fill("c/pf_scalar.h.j2", scalar)
    return {**files, f"{program.name}.c": fill("c/function.c.j2", context)}
