"""The batch form of a generated model: many samples a call, one array a member, on this machine."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.generated_model import (
    GeneratedFolder,
    GeneratedModel,
    Records,
    host_model,
)
from pfaffian.runtime.contract.manifest import MEMBER_TYPES, Structure
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.host import HostMachine
from pfaffian.runtime.machine.sources import batch_sources
from pfaffian.runtime.machine.toolchain import host_target, vector_flags

_LINE = 64


class Columns:
    """A structure of arrays: `columns[name]` is member `name` of every sample, shape (k,)."""

    def __init__(self, structure: Structure, count: int, shared: Mapping[str, Array]) -> None:
        """Take the arrays in `shared` by member name, and allocate the others, zeroed."""
        self.count = count
        self._types = {f.name: np.dtype(MEMBER_TYPES[f.type]) for f in structure.fields}
        own = [n for n in self._types if n not in shared]
        fresh = dict(zip(own, _rows(len(own), count), strict=True))
        self._arrays = {
            n: shared[n] if n in shared else fresh[n][: count * t.itemsize].view(t)
            for n, t in self._types.items()
        }
        for name, array in self._arrays.items():
            if array.shape != (count,) or array.dtype != self._types[name]:
                raise InputError(
                    f"{structure.name}.{name} has type {array.dtype} and shape {array.shape}",
                    remedy=f"give an array of {self._types[name]} with shape ({count},)",
                )
        self.addresses = np.array([a.ctypes.data for a in self._arrays.values()], np.uintp)

    def __getitem__(self, name: str) -> Array:
        """Return the array of member `name`, not a copy."""
        return self._arrays[name]

    def names(self) -> tuple[str, ...]:
        """Return the names of the members in order."""
        return tuple(self._arrays)

    def spread(self, records: Records) -> Columns:
        """Copy structured records of shape (k,) into the arrays, and return these columns."""
        for name, array in self._arrays.items():
            array[...] = records[name]
        return self

    def gather(self, records: Records) -> Records:
        """Copy the arrays into structured records of shape (k,), and return the records."""
        for name, array in self._arrays.items():
            records[name] = array
        return records


def _rows(rows: int, count: int) -> Array:
    """Return zeroed rows of at least 8 `count` bytes, an odd number of cache lines apart.

    Rows whose distance is a large power of two would all compete for the same places in a cache.
    """
    lines = -(-8 * max(count, 1) // _LINE) | 1
    raw = np.zeros(rows * lines * _LINE + _LINE, np.uint8)
    first = -raw.ctypes.data % _LINE
    return raw[first : first + rows * lines * _LINE].reshape(rows, lines * _LINE)


class BatchModel:
    """The batch form on this machine; what a function writes is written in place.

    A sample gets the bits that `GeneratedModel` on the same machine gives it; only the bits of
    accelerations that are NaN are not fixed. No two arrays of one call may overlap.
    """

    def __init__(self, folder: GeneratedFolder, machine: HostMachine, host: GeneratedModel) -> None:
        """Take the image on `machine`; `host` serves what is called once, as `init` is."""
        self.folder, self.machine, self.host = folder, machine, host

    def columns(self, role: str, count: int, **shared: Array) -> Columns:
        """Return the structure of `role` for `count` samples; `shared` arrays are used as given."""
        return Columns(self.folder.manifest.structures[role], count, shared)

    def init(self, state: Columns, params: Columns, status: Array) -> None:
        """Prepare states for their first period; `status` is int32 of shape (k,)."""
        records = self.host.records("state", state.count)
        given = params.gather(self.host.records("params", state.count))
        self.host.init(records, given, status)
        state.spread(records)

    def step(
        self, state: Columns, params: Columns, measured: Columns, output: Columns, status: Array
    ) -> None:
        """Advance the sampled law by one period."""
        _check(status, "i4", state.count)
        self._call("step", (state, params, measured, output), status)

    def acceleration(
        self, params: Columns, state: Columns, applied: Columns, rate: Columns
    ) -> None:
        """Evaluate the forward dynamics of the plant."""
        self._call("acceleration", (params, state, applied, rate))

    def plant_step(
        self, state: Columns, params: Columns, applied: Columns, step: Array, substeps: int
    ) -> None:
        """Advance the plant by `substeps` Runge-Kutta steps of `step` seconds, shape (k,)."""
        _check(step, "f8", state.count)
        self._call("plant_step", (state, params, applied), step, substeps)

    def _call(self, function: str, columns: tuple[Columns, ...], *more: Array | int) -> None:
        count = columns[0].count
        if any(c.count != count for c in columns):
            raise InputError(
                f"batch {function}: columns of {sorted({c.count for c in columns})} samples",
                remedy="give columns of one length",
            )
        name = f"{self.folder.manifest.model}_batch_{function}"
        self.machine.call(name, count, *(c.addresses for c in columns), *more)


def _check(array: Array, kind: str, count: int) -> None:
    if array.dtype != np.dtype(kind) or array.shape != (count,):
        raise InputError(
            f"an array has type {array.dtype} and shape {array.shape}",
            remedy=f"give one of {kind} with shape ({count},)",
        )


def batch_model(folder: GeneratedFolder, toolchain: str = "auto") -> BatchModel:
    """Build the batch form in `folder` for this machine and load it.

    Raises `InputError` where the model was generated without it.
    """
    sources = batch_sources(folder.path, folder.manifest)
    if not sources[0].is_file():
        raise InputError(
            f"{folder.path}: holds no batch form of {folder.manifest.model}",
            remedy=f"generate it: pfaffian generate {folder.manifest.model} --batch",
        )
    target = host_target(toolchain, fma=True)
    image = compile_image(target, sources, folder.path / "c", vector_flags())
    return BatchModel(folder, HostMachine(image), host_model(folder, toolchain))
