"""`pfaffian bench chain`: forward dynamics of the n-link chain, side by side with other tools."""

from __future__ import annotations

import random
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pfaffian.cli import output
from pfaffian.runtime.base.errors import CheckError, InputError

if TYPE_CHECKING:
    from pfaffian.derive.ir.program import Program

#: SymPy's own methods grow fast; beyond this many links they would take minutes.
_SLOW = {"lagranges_method": 6, "kanes_method": 8}
_AGREEMENT = 1e-9


def bench_chain(links: str, as_json: bool) -> None:
    """Derive, lower and emit each chain with each tool; count operations and instructions."""
    from pfaffian.benchmarks.chain_peers import PEERS

    rows: list[dict[str, Any]] = []
    for n in _parsed(links):
        reference: dict[str, float] = {}
        for tool, make in PEERS.items():
            if n > _SLOW.get(tool, n):
                continue
            output.note(f"{tool}, {n} links")
            since = time.perf_counter()
            program = make(n)
            seconds = time.perf_counter() - since
            instructions, found = _run(program)
            reference = reference or found
            _compare(n, tool, found, reference)
            rows.append(
                {
                    "n": n,
                    "tool": tool,
                    "derive_s": round(seconds, 3),
                    "ops": sum(program.op_count().values()),
                    "ppc750_instructions": instructions,
                }
            )
    if as_json:
        output.emit_json({"rows": rows})
        return
    output.table(
        "chain of n links: q'' from q, q', torques and parameters",
        ("n", "tool", "derive and lower [s]", "operations", "instructions on the PowerPC 750"),
        [list(r.values()) for r in rows],
    )


def _parsed(links: str) -> list[int]:
    try:
        counts = [int(word) for word in links.split(",")]
    except ValueError as error:
        raise InputError(
            f"--links {links}: {error}", remedy="give numbers of links, such as 2,4,6"
        ) from error
    if not counts or min(counts) < 2:
        raise InputError(f"--links {links}: too few", remedy="give chains of 2 links or more")
    return counts


def _run(program: Program) -> tuple[int, dict[str, float]]:
    """Compile `program` for the PowerPC 750; return its instructions, and results at one point."""
    from pfaffian.benchmarks.function import emit_function
    from pfaffian.runtime.machine.compile import compile_image
    from pfaffian.runtime.machine.emulator import Ppc750Machine
    from pfaffian.runtime.machine.toolchain import ppc750_target

    with tempfile.TemporaryDirectory(prefix="pfaffian-") as scratch:
        folder = Path(scratch)
        for name, text in emit_function(program).items():
            (folder / name).write_text(text, encoding="utf-8")
        sources = sorted(folder.glob("*.c"))
        image = compile_image(ppc750_target(), sources, folder, (f"-Wl,-e,{program.name}",))
    machine = Ppc750Machine(image)
    point = [random.Random(s.name).uniform(0.5, 1.5) for s in program.inputs]
    given, found = np.array(point, ">f8"), np.zeros(len(program.outputs), ">f8")
    given.flags.writeable = False
    count, _ = machine.measure(program.name, lambda: machine.call(program.name, given, found))
    return count, {s.name: float(v) for s, v in zip(program.outputs, found, strict=True)}


def _compare(n: int, tool: str, found: dict[str, float], reference: dict[str, float]) -> None:
    worst = max(abs(found[k] - v) / max(abs(v), 1.0) for k, v in reference.items())
    if not worst < _AGREEMENT:
        raise CheckError(f"{tool} disagrees with ours on {n} links: relative error {worst:.3g}")
