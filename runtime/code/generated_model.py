"""A generated model on a machine: its functions on NumPy structures."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from pfaffian.runtime.base.errors import CheckError, InputError
from pfaffian.runtime.base.toml import suggestion
from pfaffian.runtime.contract.dtypes import layout_of
from pfaffian.runtime.contract.manifest import (
    MANIFEST_NAME,
    OPTIONAL_ROLES,
    ROLES,
    Manifest,
    read_manifest,
)
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.emulator import EmulatedMachine
from pfaffian.runtime.machine.host import HostMachine, Machine
from pfaffian.runtime.machine.sources import harness_sources
from pfaffian.runtime.machine.toolchain import Target, host_target, ppc750_target

Records = np.ndarray[Any, Any]


@dataclass(frozen=True)
class GeneratedFolder:
    """A folder that holds one generation, with its manifest."""

    path: Path
    manifest: Manifest

    def parameters(self, name: str) -> dict[str, float]:
        """Return the parameter set called `name`; raise `InputError` if there is none."""
        sets = self.manifest.parameter_sets
        if name not in sets:
            raise InputError(
                f"{self.path}: the generated {self.manifest.model} has no parameter set {name}",
                remedy=suggestion(name, sorted(sets)),
            )
        return dict(sets[name])

    def any_parameters(self) -> dict[str, float]:
        """Return some value of every parameter: those of the first set, or 1 where there is none.

        Code that was generated before a set was complete works with any values its caller gives.
        """
        for values in self.manifest.parameter_sets.values():
            return dict(values)
        roles = [r for r in ("params", "plant_params") if r in self.manifest.structures]
        return {n: 1.0 for r in roles for n in self.manifest.structures[r].names()}

    def python_module(self) -> ModuleType:
        """Import the generated NumPy module from this folder."""
        path = self.path / f"{self.manifest.model}.py"
        if not path.is_file():
            raise InputError(f"{path}: is missing", remedy="regenerate the model")
        module = ModuleType(f"_pfaffian_generated_{self.manifest.model}")
        sys.modules[module.__name__] = module  # dataclasses look their module up by name
        try:
            # Compiled here, not imported: bytecode left in the folder could outlive a regeneration.
            exec(compile(path.read_bytes(), str(path), "exec"), vars(module))
        except Exception as error:
            raise InputError(
                f"{path}: {type(error).__name__}: {error}", remedy="regenerate the model"
            ) from error
        return module


def generated_models() -> dict[str, Path]:
    """Return the folders of the generated models that come with this package, by name."""
    root = Path(str(files("pfaffian.generated")))
    return {p.parent.name: p.parent for p in sorted(root.glob(f"*/{MANIFEST_NAME}"))}


def open_generated(reference: str) -> GeneratedFolder:
    """Return the generated model called `reference`, or the one in the folder of that path.

    Of a plant's own folder it is what `generate` wrote for it here: `generated/NAME`.
    """
    known = generated_models()
    path = known.get(reference, Path(reference))
    if not (path / MANIFEST_NAME).is_file() and (path / "spec.py").is_file():
        path = Path("generated") / path.resolve().name
    if not (path / MANIFEST_NAME).is_file():
        raise InputError(
            f"no generated model {reference}",
            remedy=f"{suggestion(reference, sorted(known))}; or generate it first",
        )
    return GeneratedFolder(path, read_manifest(path))


class GeneratedModel:
    """The C functions of a generated model on one machine.

    Structures are NumPy structured arrays of shape (k,) in native byte order, one record a sample;
    what a function writes is written in place.
    """

    def __init__(self, folder: GeneratedFolder, machine: Machine) -> None:
        """Check that the image on `machine` agrees with the manifest, byte order and sizes."""
        self.folder, self.machine = folder, machine
        structures = folder.manifest.structures
        roles = {r: k for k, r in enumerate((*ROLES, *OPTIONAL_ROLES)) if r in structures}
        self._native = {role: layout_of(structures[role]) for role in roles}
        self._there = {role: layout_of(structures[role], machine.byte_order) for role in roles}
        fault = machine.call("pf_target_check")
        if fault:
            raise CheckError(
                f"{machine.name}: the target's arithmetic is not what the code assumes "
                f"(fault {fault:#x})",
                remedy="use IEEE arithmetic, round to nearest, subnormals kept",
            )
        for role, number in roles.items():
            size = machine.call("pf_sizeof", number)
            if size != self._there[role].itemsize:
                raise CheckError(
                    f"{machine.name}: {structures[role].name} has {size} bytes in the image, "
                    f"{self._there[role].itemsize} in the manifest",
                    remedy="regenerate and build again",
                )

    @cached_property
    def _same_order(self) -> bool:
        return self.machine.byte_order == "="

    def reals(self, values: Any) -> Records:
        """Return `values` as an array of the code's precision."""
        return np.asarray(values, self.folder.manifest.real)

    def records(self, role: str, count: int = 1) -> Records:
        """Return `count` zeroed records of the structure of `role`."""
        return np.zeros(count, self._native[role])

    def _call(self, function: str, count: int, *arguments: tuple[Records, str, bool] | int) -> None:
        """Call a batch function; each array comes with its role and whether it is written."""
        passed: list[Records | int] = [count]
        written: list[tuple[Records, Records]] = []
        for argument in arguments:
            if isinstance(argument, int):
                passed.append(argument)
                continue
            array, role, changes = argument
            self._check(function, array, role, count)
            if self._same_order:
                passed.append(array)
                continue
            kind = self._there.get(role) or np.dtype(self.machine.byte_order + role)
            there = array.astype(kind)
            there.flags.writeable = changes
            passed.append(there)
            if changes:
                written.append((array, there))
        self.machine.call(function, *passed)
        for array, there in written:
            array[...] = there

    def _check(self, function: str, array: Records, role: str, count: int) -> None:
        """Refuse an array that the C code would read past its end or with another layout."""
        wanted = self._native.get(role) or np.dtype(role)
        if array.dtype != wanted or array.shape != (count,):
            raise InputError(
                f"{function}: {role} has type {array.dtype} and shape {array.shape}",
                remedy=f"give records(...) of that role with shape ({count},)",
            )

    def init(self, state: Records, params: Records, status: Records) -> None:
        """Prepare states for their first period; `status` is int32 of shape (k,)."""
        self._call(
            "pf_batch_init",
            len(state),
            (state, "state", True),
            (params, "params", False),
            (status, "i4", True),
        )

    def step(
        self, state: Records, params: Records, measured: Records, output: Records, status: Records
    ) -> None:
        """Advance the sampled law by one period."""
        self._call(
            "pf_batch_step",
            len(state),
            (state, "state", True),
            (params, "params", False),
            (measured, "input", False),
            (output, "output", True),
            (status, "i4", True),
        )

    def follow(
        self,
        state: Records,
        params: Records,
        measured: Records,
        reference: Records,
        output: Records,
        status: Records,
    ) -> None:
        """Advance the sampled law along a reference by one period; the model must have a plan."""
        self._call(
            "pf_batch_follow",
            len(state),
            (state, "state", True),
            (params, "params", False),
            (measured, "input", False),
            (reference, "reference", False),
            (output, "output", True),
            (status, "i4", True),
        )

    def plan_at(self, name: str, time: Records, reference: Records) -> None:
        """Write the reference of the plan of set `name` at each of `time` in s, of shape (k,)."""
        plans = self.folder.manifest.plans
        if name not in plans:
            raise InputError(
                f"{self.folder.path}: has no plan of set {name}",
                remedy=suggestion(name, sorted(plans)),
            )
        self._call(
            "pf_batch_plan_at",
            len(time),
            (time, self.folder.manifest.real, False),
            (reference, "reference", True),
            plans.index(name),
        )

    def continuous(
        self, state: Records, params: Records, measured: Records, output: Records
    ) -> None:
        """Evaluate the continuous law."""
        self._call(
            "pf_batch_continuous",
            len(state),
            (state, "continuous_state", False),
            (params, "params", False),
            (measured, "input", False),
            (output, "continuous_output", True),
        )

    def swing_up(
        self, params: Records, measured: Records, output: Records, status: Records
    ) -> None:
        """Evaluate the energy swing-up law; raise `InputError` where the model has none."""
        if "swing_up_output" not in self._native:
            raise InputError(
                f"{self.folder.manifest.model} has no energy swing-up law",
                remedy="declare one in its specification, then generate it again",
            )
        self._call(
            "pf_batch_swing_up",
            len(params),
            (params, "params", False),
            (measured, "input", False),
            (output, "swing_up_output", True),
            (status, "i4", True),
        )

    def acceleration(
        self, params: Records, state: Records, applied: Records, rate: Records
    ) -> None:
        """Evaluate the forward dynamics of the plant."""
        self._call(
            "pf_batch_acceleration",
            len(state),
            (params, "plant_params", False),
            (state, "plant_state", False),
            (applied, "plant_input", False),
            (rate, "plant_rate", True),
        )

    def energy(self, params: Records, state: Records, energy: Records) -> None:
        """Evaluate T + V; `energy` is of the code's precision, of shape (k,)."""
        self._call(
            "pf_batch_energy",
            len(state),
            (params, "plant_params", False),
            (state, "plant_state", False),
            (energy, self.folder.manifest.real, True),
        )

    def plant_step(
        self, state: Records, params: Records, applied: Records, step: Records, substeps: int
    ) -> None:
        """Advance the plant by `substeps` Runge-Kutta steps of `step` seconds.

        `step` is of the code's precision, of shape (k,).
        """
        self._call(
            "pf_batch_plant_step",
            len(state),
            (state, "plant_state", True),
            (params, "plant_params", False),
            (applied, "plant_input", False),
            (step, self.folder.manifest.real, False),
            substeps,
        )


def host_model(folder: GeneratedFolder, toolchain: str = "auto") -> GeneratedModel:
    """Build `folder` for this machine and load it."""
    sources = harness_sources(folder.path, folder.manifest)
    return GeneratedModel(
        folder,
        HostMachine(compile_image(host_target(toolchain, fma=True), sources, folder.path / "c")),
    )


def twice_rounding_model(folder: GeneratedFolder, toolchain: str = "auto") -> GeneratedModel:
    """Build `folder`, of single precision, for this machine with the emulator's multiply-add.

    Unicorn computes `fmadds` and its kin in double and rounds that to single: twice, where the
    processor rounds once. About one result in 2^29 differs. This build does as the emulator does.
    """
    sources = harness_sources(folder.path, folder.manifest)
    extra = ("-D__builtin_fmaf(a,b,c)=((float)((double)(a)*(double)(b)+(double)(c)))",)
    image = compile_image(host_target(toolchain), sources, folder.path / "c", extra)
    return GeneratedModel(folder, HostMachine(image))


def emulated_model(folder: GeneratedFolder, target: Target) -> GeneratedModel:
    """Build `folder` for `target` and load it into its emulator."""
    sources = harness_sources(folder.path, folder.manifest)
    image = compile_image(target, sources, folder.path / "c", ("-Wl,-e,pf_target_check",))
    return GeneratedModel(folder, EmulatedMachine(image, target.unicorn, target.name))


def ppc750_model(folder: GeneratedFolder, toolchain: str = "auto") -> GeneratedModel:
    """Build `folder` for the PowerPC 750 and load it into the emulator."""
    return emulated_model(folder, ppc750_target(toolchain))


def fill_records(records: Records, values: dict[str, float]) -> Records:
    """Write `values` into every record, by member name, and return `records`."""
    for name in records.dtype.names or ():
        records[name] = values[name]
    return records
