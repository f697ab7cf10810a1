"""The Linux harness `runtime/c/linux`: the controller as a periodic program, on a simulated rig."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.code.generated_model import GeneratedFolder
from pfaffian.runtime.flight.flight_program import first_frame, refusal
from pfaffian.runtime.flight.scenario import Scenario
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.sources import harness_sources
from pfaffian.runtime.machine.toolchain import (
    Target,
    host_target,
    processor_has_fma,
    program_target,
)

_SOURCES = ("pf_flight.c", "linux/pf_linux.c", "linux/pf_loop.c", "linux/pf_rig_simulated.c")


@dataclass(frozen=True)
class HarnessRun:
    """What one run left: exit code, its own report, the records in the target's byte order."""

    code: int
    report: dict[str, Any]
    records: bytes


def harness_target(reference: str) -> tuple[Target, tuple[str, ...]]:
    """Return the target of a whole program, and what runs it: nothing for `host`."""
    if reference != "host":
        return program_target(reference)
    host = host_target()
    fma = ("-mfma",) if processor_has_fma() else ()
    order = "<" if sys.byteorder == "little" else ">"
    return Target("host", host.command, fma, order, ("-pthread",)), ()


def harness_program(folder: GeneratedFolder, reference: str = "host") -> bytes:
    """Return the harness with `folder` as a Linux program for a target."""
    target, _ = harness_target(reference)
    root = Path(str(files("pfaffian.runtime"))) / "c"
    sources = [*harness_sources(folder.path, folder.manifest), *(root / n for n in _SOURCES)]
    return compile_image(target, sources, folder.path / "c", ("-pthread",), (root, root / "linux"))


def run_harness(
    scenario: Scenario,
    words: Sequence[str] = (),
    reference: str = "host",
    interrupt_after: float | None = None,
    frame: bytes | None = None,
) -> HarnessRun:
    """Fly `scenario` in the harness; `words` are its arguments, `frame` another first frame.

    Raises `CheckError` where the target refuses the frame or the program says nothing.
    """
    target, runner = harness_target(reference)
    image = harness_program(scenario.folder, reference)
    sent = first_frame(scenario, target.byte_order).tobytes() if frame is None else frame
    with tempfile.TemporaryDirectory(prefix="pfaffian-") as scratch:
        program, log = Path(scratch) / "harness", Path(scratch) / "records"
        program.write_bytes(image)
        program.chmod(0o755)
        process = subprocess.Popen(
            [*runner, str(program), str(log), *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        if interrupt_after is not None:
            assert process.stdin
            process.stdin.write(sent)
            process.stdin.flush()
            time.sleep(interrupt_after)
            process.send_signal(signal.SIGTERM)
            said, errors = process.communicate(timeout=600)
        else:
            said, errors = process.communicate(sent, timeout=3600)
        records = log.read_bytes() if log.is_file() else b""
    try:
        report = json.loads(said)
    except ValueError as error:
        raise CheckError(
            f"the harness ended with {process.returncode} and no report",
            remedy=errors.decode(errors="replace").strip()[-2000:],
        ) from error
    if report["fault"]:
        raise refusal(int(report["fault"]))
    return HarnessRun(process.returncode, report, records)
