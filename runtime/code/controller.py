"""The complete controller of a generated model on a machine: many of them, a period at a time.

The C is `<model>_control.c` of the generation with runtime/c/pf_sensing.c and pf_supervisor.c.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from pfaffian.runtime.base.errors import CheckError, InputError
from pfaffian.runtime.code.generated_model import GeneratedFolder
from pfaffian.runtime.contract.dtypes import layout_of
from pfaffian.runtime.contract.manifest import MEMBER_TYPES, Structure
from pfaffian.runtime.contract.runtime_structs import SENSING, SUPERVISOR
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.emulator import Ppc750Machine
from pfaffian.runtime.machine.host import HostMachine, Machine
from pfaffian.runtime.machine.sources import control_sources, runtime_c
from pfaffian.runtime.machine.toolchain import host_target, ppc750_target

Records = np.ndarray[Any, Any]
ROLES = ("control_params", "control_input", "control_state", "control_output")


class GeneratedController:
    """The C functions of a complete controller on one machine.

    Records are NumPy structured arrays of shape (k,) in the machine's own byte order: they stay
    there, and only what is asked for is converted.
    """

    def __init__(self, folder: GeneratedFolder, machine: Machine) -> None:
        """Check that the structures in the image are those of the manifest.

        Raises `InputError` where the generation has no complete controller.
        """
        self.folder, self.machine = folder, machine
        structures = folder.manifest.control_structures
        if not structures:
            raise InputError(
                f"{folder.path}: model {folder.manifest.model} has no complete controller",
                remedy="write control/SET.toml beside its specification, and regenerate",
            )
        self._types = {role: self._type(structures[role]) for role in ROLES}
        for number, role in enumerate(ROLES):
            there = machine.call("pf_control_sizeof", number)
            if there != self._types[role].itemsize:
                raise CheckError(
                    f"{machine.name}: {role} has {there} bytes in the image, "
                    f"{self._types[role].itemsize} in Python",
                    remedy="regenerate the model; "
                    "keep runtime/contract/runtime_structs.py and the headers alike",
                )

    def _type(self, structure: Structure) -> np.dtype[np.void]:
        order, known = self.machine.byte_order, self.folder.manifest.structures
        inner: dict[str, Any] = {s.name: layout_of(s, order) for s in known.values()}
        for module, layouts in (("sensing", SENSING), ("supervisor", SUPERVISOR)):
            for role, members in layouts.items():
                inner[f"pf_{module}_{role}_t"] = np.dtype(
                    [_member(m, order) for m in members], align=True
                )
        return np.dtype(
            [
                (f.name, inner[f.type] if f.type in inner else order + MEMBER_TYPES[f.type])
                for f in structure.fields
            ],
            align=True,
        )

    def records(self, role: str, count: int = 1) -> Records:
        """Return `count` records of `role`, all zero."""
        return np.zeros(count, self._types[role])

    def params(self, set_name: str, count: int = 1) -> Records:
        """Return `count` parameter blocks as they are generated for `set_name`.

        Raises `InputError` where there is none of that name.
        """
        known = self.folder.manifest.control_sets
        if set_name not in known:
            raise InputError(
                f"{self.folder.path}: no complete controller for parameter set {set_name}",
                remedy=f"known: {', '.join(known)}",
            )
        records = self.records("control_params", count)
        _fill(records, known[set_name])
        return records

    def seal(self, params: Records) -> Records:
        """Write the checksum of what stands in `params` into it, and return it."""
        self.machine.call("pf_control_batch_seal", len(params), params)
        return params

    def init(self, params: Records) -> tuple[Records, Records]:
        """Return (states, statuses int32) of controllers with `params`, good or bad."""
        state = self.records("control_state", len(params))
        status = np.zeros(len(params), self.machine.byte_order + "i4")
        self.machine.call("pf_control_batch_init", len(params), state, _kept(params), status)
        return state, status.astype(np.int32)

    def step(self, state: Records, params: Records, given: Records, output: Records) -> None:
        """Advance every controller by one period; `state` and `output` are written."""
        self.machine.call(
            "pf_control_batch_step", len(state), state, _kept(params), _kept(given), output
        )


def _member(member: tuple[Any, ...], order: str) -> tuple[Any, ...]:
    name, kind, *shape = member
    return (name, order + kind, *shape)


def _kept(records: Records) -> Records:
    """Return `records` as an array that a machine need not copy back."""
    view = records.view()
    view.flags.writeable = False
    return view


def _fill(records: Records, values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        if isinstance(value, Mapping):
            _fill(records[name], value)
        else:
            records[name] = value


def host_control(folder: GeneratedFolder, toolchain: str = "auto") -> GeneratedController:
    """Build the controller in `folder` for this machine and load it."""
    sources = _sources(folder)
    image = compile_image(
        host_target(toolchain, fma=True), sources, folder.path / "c", also=(runtime_c(),)
    )
    return GeneratedController(folder, HostMachine(image))


def ppc750_control(folder: GeneratedFolder, toolchain: str = "auto") -> GeneratedController:
    """Build the controller in `folder` for the PowerPC 750 and load it into the emulator."""
    sources, entry = _sources(folder), ("-Wl,-e,pf_control_batch_step",)
    image = compile_image(
        ppc750_target(toolchain), sources, folder.path / "c", entry, also=(runtime_c(),)
    )
    return GeneratedController(folder, Ppc750Machine(image))


def _sources(folder: GeneratedFolder) -> list[Path]:
    if not folder.manifest.control_structures:
        raise InputError(
            f"{folder.path}: model {folder.manifest.model} has no complete controller",
            remedy="write control/SET.toml beside its specification, and regenerate",
        )
    harness = Path(str(files("pfaffian.runtime"))) / "c" / "pf_control_harness.c"
    return [*control_sources(folder.path, folder.manifest), harness]
