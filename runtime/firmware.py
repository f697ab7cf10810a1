"""A controller as firmware: built alone for a target, with what it costs there."""

from __future__ import annotations

from typing import Any

import numpy as np
from pfaffian.runtime.errors import InputError
from pfaffian.runtime.generated_model import (
    GeneratedFolder,
    GeneratedModel,
    fill_records,
    ppc750_model,
)
from pfaffian.runtime.machine import Ppc750Machine, section_bytes
from pfaffian.runtime.toolchain import (
    compile_image,
    controller_sources,
    host_target,
    ppc750_target,
)

TARGETS = ("host", "ppc750")
_SECTIONS = ("-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections")
_MEASURED_STATES = 64


def build_controller(
    folder: GeneratedFolder, target_name: str, toolchain: str = "auto"
) -> tuple[bytes, dict[str, Any]]:
    """Return the image of init and step alone, and its report.

    The report has `text_bytes` (code and constants), `stack_bytes` and `instructions_per_step`
    (the worst of some random states; None on the host, where nothing counts them).
    """
    if target_name not in TARGETS:
        raise InputError(
            f"unknown target {target_name}", remedy=f"known targets: {', '.join(TARGETS)}"
        )
    if toolchain not in ("auto", "zig", "gcc"):
        raise InputError(f"unknown toolchain {toolchain}", remedy="choose auto, zig or gcc")
    name, sources = folder.manifest.model, controller_sources(folder.path, folder.manifest)
    include = folder.path / "c"
    if target_name == "host":
        target = host_target(toolchain)
        image = compile_image(target, sources, include)
        stack, instructions = None, None
    else:
        target = ppc750_target(toolchain)
        keep = (f"-Wl,-e,{name}_step", f"-Wl,-u,{name}_init")
        image = compile_image(target, sources, include, (*_SECTIONS, *keep))
        instructions, stack = measure_step(ppc750_model(folder, toolchain))
    sizes = section_bytes(image)
    text = sum(v for k, v in sizes.items() if k.startswith((".text", ".rodata")))
    return image, {
        "model": name,
        "target": target_name,
        "compiler": target.description,
        "text_bytes": text,
        "stack_bytes": stack,
        "instructions_per_step": instructions,
    }


def measure_step(model: GeneratedModel) -> tuple[int, int]:
    """Return the most instructions and stack bytes of one step over random states."""
    machine = model.machine
    assert isinstance(machine, Ppc750Machine)
    rng = np.random.default_rng(1)
    manifest = model.folder.manifest
    params = fill_records(
        model.records("params"), dict(next(iter(manifest.parameter_sets.values())))
    )
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
