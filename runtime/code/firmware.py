"""A controller as firmware: built alone for a target, with what it costs there."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.generated_model import (
    GeneratedFolder,
    GeneratedModel,
    emulated_model,
    fill_records,
)
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.emulator import EmulatedMachine, section_bytes
from pfaffian.runtime.machine.sources import controller_sources
from pfaffian.runtime.machine.stack import stack_bound
from pfaffian.runtime.machine.target_files import read_target
from pfaffian.runtime.machine.toolchain import find_target

_SECTIONS = ("-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections")
_MEASURED_STATES = 64


def build_controller(
    folder: GeneratedFolder, target_name: str, toolchain: str = "auto"
) -> tuple[bytes, dict[str, Any]]:
    """Return the image of init and step alone, and its report.

    The report has `text_bytes` (code and constants), `stack_bound_bytes` (by the compiler's frames
    along the deepest path of calls; None on the host, where the C library is called), and where
    the target has an emulator `stack_bytes` and `instructions_per_step` (the worst of some random
    states; None where nothing counts them).
    """
    name, sources = folder.manifest.model, controller_sources(folder.path, folder.manifest)
    include = folder.path / "c"
    target = find_target(target_name, toolchain)
    bound, stack, instructions = None, None, None
    if target.name == "host":
        image = compile_image(target, sources, include)
    else:
        bound = stack_bound(target, sources, include, f"{name}_step")
        keep = (f"-Wl,-e,{name}_step", f"-Wl,-u,{name}_init")
        image = compile_image(target, sources, include, (*_SECTIONS, *keep))
        _check_elf(image, target_name)
    if target.unicorn:
        instructions, stack = measure_step(emulated_model(folder, target))
    sizes = section_bytes(image)
    text = sum(v for k, v in sizes.items() if k.startswith((".text", ".rodata")))
    return image, {
        "model": name,
        "target": target.name,
        "compiler": target.description,
        "text_bytes": text,
        "stack_bytes": stack,
        "stack_bound_bytes": bound,
        "instructions_per_step": instructions,
    }


def _check_elf(image: bytes, reference: str) -> None:
    """Refuse an image that is not for the machine that the target's file names."""
    from elftools.elf.elffile import ELFFile

    described, elf = read_target(reference), ELFFile(io.BytesIO(image))
    order = "<" if elf.little_endian else ">"
    found = (elf["e_machine"], elf.elfclass, order)
    wanted = (described.machine, described.bits, described.byte_order)
    if found != wanted:
        raise InputError(
            f"target {described.name}: the compiler's flags make an image for {found}, "
            f"and the target's file says {wanted}",
            remedy="mend flags, machine, bits or byte_order there",
        )


def measure_step(model: GeneratedModel) -> tuple[int, int]:
    """Return the most instructions and stack bytes of one step over random states."""
    machine = model.machine
    assert isinstance(machine, EmulatedMachine)
    rng = np.random.default_rng(1)
    manifest = model.folder.manifest
    params = fill_records(model.records("params"), model.folder.any_parameters())
    state, measured, output = (model.records(r) for r in ("state", "input", "output"))
    status = np.zeros(1, np.int32)
    model.init(state, params, status)
    most = (0, 0)
    for _ in range(_MEASURED_STATES):
        for name in measured.dtype.names or ():
            measured[name] = rng.normal(0.0, 2.0)
        counted = machine.measure(
            f"{manifest.model}_step",
            lambda: model.step(state, params, measured, output, status),
        )
        most = (max(most[0], counted[0]), max(most[1], counted[1]))
    return most
