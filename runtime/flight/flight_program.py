"""A whole flight inside one program for a target: under qemu's user mode, or on its bare machine.

The program is `runtime/c/pf_flight.c` with the generated controller and plant. It gets one frame,
in which the host says what it believes of the target, and gives one record a period.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from pfaffian.runtime.base.errors import CheckError, MissingToolError
from pfaffian.runtime.contract.dtypes import layout_of
from pfaffian.runtime.contract.manifest import ROLES, Manifest
from pfaffian.runtime.flight.closed_loop import Trajectory
from pfaffian.runtime.flight.scenario import Scenario
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.sources import harness_sources
from pfaffian.runtime.machine.toolchain import find_target, program_target

MAGIC, ORDER, VERSION = 0x50664631, 0x01020304, 1
#: What the bits of a refusal mean; pf_flight.h has the same.
FAULTS = {
    0x01: "1/3 is not rounded to nearest",
    0x02: "subnormals are flushed to zero",
    0x04: "a type has another width",
    0x08: "bytes are in another order",
    0x10: "the protocol or the generated code has another version",
    0x20: "a structure has another size",
    0x40: "a real number has other bits",
    0x80: "the flight is longer than the memory, or its frame is cut short",
}
#: The bare machine: time base, instructions of its emulated clock, and where things lie.
TIME_BASE_HZ = 33_333_333
MEMORY_BYTES, MAILBOX, RECORDS = 0x400_0000, 0x80_0000, 0x81_0000
_ICOUNT = "shift=3,sleep=off"  # an instruction takes 8 ns
_MACHINE = ("-M", "pegasos2", "-cpu", "750gx", "-m", "64", "-vga", "none", "-net", "none")
_QUIET = ("-display", "none", "-monitor", "none", "-serial", "stdio", "-icount", _ICOUNT)
_TIMEOUT = 1200


@dataclass(frozen=True)
class BareReport:
    """What a flight on the bare machine cost; ticks are those of its time base, 30 ns.

    Under the emulated clock an instruction takes 8 ns: figures repeat, but they are instructions,
    not the cycles of a processor.
    """

    periods: int
    period_ticks: int
    overruns: int
    missed: int
    step_ticks: int
    tick_ticks: int
    late_ticks: int
    stack_bytes: int


def _members(manifest: Manifest, role: str, order: str) -> np.dtype[np.void]:
    return layout_of(manifest.structures[role], order)


def frame_type(manifest: Manifest, order: str) -> np.dtype[np.void]:
    """Return the type of pf_frame_t in a target's memory."""
    words = ("magic", "order", "version", "abi", "steps", "substeps")
    return np.dtype(
        [
            *((name, f"{order}u4") for name in words),
            ("sizes", f"{order}u4", (len(ROLES),)),
            ("frame_size", f"{order}u4"),
            ("record_size", f"{order}u4"),
            ("sample_time", f"{order}f8"),
            ("plant_step", f"{order}{manifest.real}"),
            ("third", f"{order}{manifest.real}"),
            ("params", _members(manifest, "params", order)),
            ("plant", _members(manifest, "plant_params", order)),
            ("initial", _members(manifest, "plant_state", order)),
        ],
        align=True,
    )


def record_type(manifest: Manifest, order: str) -> np.dtype[np.void]:
    """Return the type of pf_record_t in a target's memory."""
    return np.dtype(
        [
            *((role, _members(manifest, role, order)) for role in ("input", "output", "state")),
            ("energy", f"{order}{manifest.real}"),
            ("status", f"{order}i4"),
            ("ticks", f"{order}u4"),
        ],
        align=True,
    )


def first_frame(scenario: Scenario, order: str) -> np.ndarray[Any, Any]:
    """Return the frame of `scenario` as one record in a target's byte order."""
    manifest = scenario.folder.manifest
    frame = np.zeros(1, frame_type(manifest, order))
    frame["magic"], frame["order"], frame["version"] = MAGIC, ORDER, VERSION
    frame["abi"], frame["steps"] = manifest.abi, scenario.steps
    frame["substeps"] = scenario.plant_substeps
    frame["sizes"] = [_members(manifest, role, order).itemsize for role in ROLES]
    frame["frame_size"] = frame.dtype.itemsize
    frame["record_size"] = record_type(manifest, order).itemsize
    frame["third"] = np.dtype(manifest.real).type(1.0) / np.dtype(manifest.real).type(3.0)
    frame["sample_time"] = scenario.sample_time
    frame["plant_step"] = scenario.sample_time / scenario.plant_substeps
    for part, values in (
        ("params", scenario.controller),
        ("plant", scenario.plant),
        ("initial", scenario.initial),
    ):
        for name in frame.dtype[part].names or ():
            frame[part][name] = values[name]
    return frame


def refusal(fault: int) -> CheckError:
    """Return the error for a target that refused the first frame."""
    said = [text for bit, text in FAULTS.items() if fault & bit]
    return CheckError(
        f"the target refuses to fly (fault {fault:#x}): {'; '.join(said)}",
        remedy="build for the machine that runs it: IEEE arithmetic, round to nearest, its layout",
    )


def trajectory_of(scenario: Scenario, mode: str, raw: bytes, order: str) -> Trajectory:
    """Return the flight whose records a target of byte order `order` gave."""
    kind = record_type(scenario.folder.manifest, order)
    if len(raw) != scenario.steps * kind.itemsize:
        raise CheckError(
            f"{mode}: {len(raw) // kind.itemsize} of {scenario.steps} periods came back",
            remedy="the target ended early",
        )
    records = np.frombuffer(raw, kind)
    native = records.astype(kind.newbyteorder("="))
    parts = {
        role: native[role].astype(layout_of(scenario.folder.manifest.structures[role]))
        for role in ("input", "output", "state")
    }
    return Trajectory(
        scenario,
        mode,
        np.arange(scenario.steps) * scenario.sample_time,
        parts["input"],
        parts["output"],
        parts["state"],
        native["status"].copy(),
        native["energy"].astype(float),
    )


def _c(*names: str) -> list[Path]:
    root = Path(str(files("pfaffian.runtime"))) / "c"
    return [root / name for name in names]


def linux_program(scenario: Scenario, reference: str) -> tuple[bytes, tuple[str, ...], str]:
    """Return the flight as a Linux program of a target, what runs it, and its byte order."""
    target, runner = program_target(reference)
    folder = scenario.folder
    sources = [
        *harness_sources(folder.path, folder.manifest),
        *_c("pf_flight.c", "pf_flight_linux.c"),
    ]
    image = compile_image(target, sources, folder.path / "c", (), _c("."))
    return image, runner, target.byte_order


def run_program(
    image: bytes, runner: tuple[str, ...], frame: bytes
) -> subprocess.CompletedProcess[bytes]:
    """Run a program of another machine on one frame."""
    with tempfile.TemporaryDirectory(prefix="pfaffian-") as scratch:
        path = Path(scratch) / "flight"
        path.write_bytes(image)
        path.chmod(0o755)
        return subprocess.run(
            [*runner, str(path)], input=frame, capture_output=True, check=False, timeout=_TIMEOUT
        )


def fly_qemu_user(scenario: Scenario, reference: str = "ppc750") -> Trajectory:
    """Fly controller and plant inside a Linux program of the target, under qemu's user mode.

    Raises `MissingToolError` without compiler or emulator, `CheckError` where the target refuses
    the first frame or ends early.
    """
    image, runner, order = linux_program(scenario, reference)
    done = run_program(image, runner, first_frame(scenario, order).tobytes())
    answer = np.frombuffer(done.stdout[:12], f"{order}u4")
    if len(answer) < 3 or answer[0] != MAGIC:
        raise CheckError(
            f"{runner[0]}: the program gave no answer and ended with {done.returncode}",
            remedy=done.stderr.decode(errors="replace").strip()[-2000:],
        )
    if answer[1]:
        raise refusal(int(answer[1]))
    return trajectory_of(scenario, f"pil-qemu-user-{reference}", done.stdout[12:], order)


def bare_program(scenario: Scenario, toolchain: str = "auto") -> bytes:
    """Return the flight as an image for the bare PowerPC 750."""
    target = find_target("ppc750", toolchain)
    folder = scenario.folder
    script = Path(str(files("pfaffian.runtime"))) / "c" / "ppc_bare" / "link.ld"
    sources = [
        *harness_sources(folder.path, folder.manifest),
        *_c("pf_flight.c", "ppc_bare/start.S", "ppc_bare/board.c"),
    ]
    kept = tuple(f for f in target.link if not f.startswith(("-Wl,--image-base", "-Wl,-Ttext")))
    bare = type(target)(
        "ppc750-bare", target.command, target.flags, target.byte_order, (*kept, "-T", str(script))
    )
    return compile_image(bare, sources, folder.path / "c", (), _c(".", "ppc_bare"))


def _mailbox_type(manifest: Manifest) -> np.dtype[np.void]:
    report = ("magic", "fault", "vector", "address", *BareReport.__dataclass_fields__)
    return np.dtype(
        [
            ("frame", frame_type(manifest, ">")),
            ("forced_period_ticks", ">u4"),
            ("kept", ">u4"),
            *((name, ">u4") for name in report),
        ],
        align=True,
    )


def run_bare(
    image: bytes, manifest: Manifest, frame: bytes, forced_period_ticks: int = 0, kept: int = 0
) -> tuple[np.ndarray[Any, Any], bytes]:
    """Run an image on the bare machine; return the mailbox at the end, and the records.

    `kept` bounds the records of a flight longer than the memory: each then takes the place of the
    one so many periods before.

    The machine's memory is a file: the frame is put there before, the records are taken from it.
    """
    if not shutil.which("qemu-system-ppc"):
        raise MissingToolError(
            "no qemu-system-ppc found", remedy="install it: apt-get install qemu-system-ppc"
        )
    kind = _mailbox_type(manifest)
    mailbox = np.zeros(1, kind)
    mailbox["frame"] = np.frombuffer(frame, kind["frame"])
    mailbox["forced_period_ticks"], mailbox["kept"] = forced_period_ticks, kept
    with tempfile.TemporaryDirectory(prefix="pfaffian-") as scratch:
        kernel, memory = Path(scratch) / "flight.elf", Path(scratch) / "memory"
        kernel.write_bytes(image)
        with memory.open("wb") as file:
            file.truncate(MEMORY_BYTES)
            file.seek(MAILBOX)
            file.write(mailbox.tobytes())
        backing = f"memory-backend-file,id=ram,size={MEMORY_BYTES},mem-path={memory},share=on"
        command = ["qemu-system-ppc", *_MACHINE, "-object", backing, "-machine"]
        command += ["memory-backend=ram", *_QUIET, "-kernel", str(kernel)]
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, check=False, timeout=_TIMEOUT
        )
        with memory.open("rb") as file:
            file.seek(MAILBOX)
            found = np.frombuffer(file.read(kind.itemsize), kind)
            periods = min(int(found["periods"][0]), kept or MEMORY_BYTES)
            file.seek(RECORDS)
            raw = file.read(periods * record_type(manifest, ">").itemsize)
    if done.returncode != 0 or found["magic"][0] != MAGIC:
        raise CheckError(
            f"qemu-system-ppc ended with {done.returncode} and the program did not report",
            remedy=(done.stderr + done.stdout).decode(errors="replace").strip()[-2000:],
        )
    return found, raw


def fly_bare(
    scenario: Scenario, toolchain: str = "auto", forced_period_ticks: int = 0
) -> tuple[Trajectory, BareReport]:
    """Fly controller and plant on the bare PowerPC 750, the step inside its timer's interrupt.

    Raises `MissingToolError` without compiler or emulator, `CheckError` where the target refuses
    the first frame, ends early, or ends in an exception.
    """
    manifest = scenario.folder.manifest
    frame = first_frame(scenario, ">").tobytes()
    found, raw = run_bare(bare_program(scenario, toolchain), manifest, frame, forced_period_ticks)
    if found["fault"][0]:
        raise refusal(int(found["fault"][0]))
    if found["vector"][0]:
        raise CheckError(
            f"the target ended in exception {int(found['vector'][0]):#x} "
            f"at {int(found['address'][0]):#x}"
        )
    report = BareReport(**{n: int(found[n][0]) for n in BareReport.__dataclass_fields__})
    return trajectory_of(scenario, "pil-qemu-system", raw, ">"), report


def bare_document(report: BareReport, budget: float) -> dict[str, Any]:
    """Return the document of a bare flight, with the time budget as a share of the period."""
    return {
        **asdict(report),
        "budget_ticks": int(budget * report.period_ticks),
        "step_us": report.step_ticks / TIME_BASE_HZ * 1e6,
        "late_us": report.late_ticks / TIME_BASE_HZ * 1e6,
        "clock": "emulated: 8 ns an instruction",
    }
