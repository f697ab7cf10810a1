"""The Python functions of a generated model, run by its C: the same classes, the same call."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import InputError, MissingToolError
from pfaffian.runtime.code.generated_model import (
    GeneratedFolder,
    GeneratedModel,
    Records,
    host_model,
    open_generated,
)
from pfaffian.runtime.code.law_step import LawStep, NumpyLawStep
from pfaffian.runtime.contract.manifest import Manifest

Columns = dict[str, Array]
#: What a function does with the records of each role, and the plain array beside them.
Run = Callable[[Mapping[str, Records], Array], None]

#: Samples that cross to C at a time: their records stay in the processor's cache.
BLOCK = 2048
_LARGEST_UINT32 = 2**32 - 1


class CompiledModel:
    """The functions of a generated NumPy module on compiled C, with the bits of the target.

    Arguments are the module's classes, or whatever has the same attributes; fields are numbers or
    arrays that broadcast against each other. What a function works out has the common shape; what
    a step leaves alone is passed on as it was given. What is no function of the law (classes,
    parameter sets, status codes) is the module's own.
    """

    #: Whether C runs behind the call.
    compiled = True

    def __init__(self, module: ModuleType, host: GeneratedModel) -> None:
        """Put the functions of `host` behind those of `module`."""
        self.module, self.host = module, host
        #: A fast controller of one plant: `Controller(params)`, see `law_step.LawStep`.
        self.Controller = partial(LawStep, module, host)

    def __getattr__(self, name: str) -> Any:
        """Return what the module has by that name."""
        return getattr(self.module, name)

    def init(self, params: Any) -> tuple[Any, Array]:
        """Return (state, status) before the first period."""
        made, status = self._run(
            lambda r, plain: self.host.init(r["state"], r["params"], plain),
            {"params": params},
            {"state": _field_names(self.module.State)},
            np.dtype(np.int32),
        )
        return self.module.State(**made["state"]), status

    def prepare(self, state: Any, params: Any) -> tuple[Any, Array]:
        """Return (`state` with what depends on the parameters alone worked out again, status)."""
        fresh, status = self.init(params)
        kept = {n: getattr(state, n) for n in self._remembered()}
        return self.module.State(**(vars(fresh) | kept)), status

    def step(self, state: Any, params: Any, measured: Any) -> tuple[Any, Any, Array]:
        """Return (next state, output, status) of one period of the sampled law."""
        made, status = self._run(
            lambda r, plain: self.host.step(
                r["state"], r["params"], r["input"], r["output"], plain
            ),
            {"state": state, "params": params, "input": measured},
            {"state": self._remembered(), "output": _field_names(self.module.Output)},
            np.dtype(np.int32),
        )
        kept = {n: getattr(state, n) for n in self.module._PREPARED}
        after = self.module.State(**kept, **made["state"])
        return after, self.module.Output(**made["output"]), status

    def continuous(self, state: Any, params: Any, measured: Any) -> Any:
        """Return the output of the continuous law."""
        made, _ = self._run(
            lambda r, _: self.host.continuous(
                r["continuous_state"], r["params"], r["input"], r["continuous_output"]
            ),
            {"continuous_state": state, "params": params, "input": measured},
            {"continuous_output": _field_names(self.module.ContinuousOutput)},
        )
        return self.module.ContinuousOutput(**made["continuous_output"])

    def swing_up(self, params: Any, measured: Any) -> tuple[Any, Array]:
        """Return (output, status) of the energy swing-up law, where the model has one."""
        kind = self.module.SwingUpOutput
        made, status = self._run(
            lambda r, plain: self.host.swing_up(
                r["params"], r["input"], r["swing_up_output"], plain
            ),
            {"params": params, "input": measured},
            {"swing_up_output": _field_names(kind)},
            np.dtype(np.int32),
        )
        return kind(**made["swing_up_output"]), status

    def acceleration(self, params: Any, state: Any, applied: Any) -> Any:
        """Return the accelerations of the plant under the torques in `applied`."""
        made, _ = self._run(
            lambda r, _: self.host.acceleration(
                r["plant_params"], r["plant_state"], r["plant_input"], r["plant_rate"]
            ),
            {"plant_params": params, "plant_state": state, "plant_input": applied},
            {"plant_rate": _field_names(self.module.PlantRate)},
        )
        return self.module.PlantRate(**made["plant_rate"])

    def energy(self, params: Any, state: Any) -> Array:
        """Return the total energy T + V in joule."""
        _, energy = self._run(
            lambda r, plain: self.host.energy(r["plant_params"], r["plant_state"], plain),
            {"plant_params": params, "plant_state": state},
            {},
        )
        return energy

    def _remembered(self) -> tuple[str, ...]:
        """Return the fields of the state that a step may change."""
        return tuple(n for n in _field_names(self.module.State) if n not in self.module._PREPARED)

    def _run(
        self,
        run: Run,
        given: Mapping[str, Any],
        made: Mapping[str, Sequence[str]],
        plain: np.dtype[Any] | None = None,
    ) -> tuple[dict[str, Columns], Array]:
        """Run `run` over blocks of records; return the columns that it made, and the array.

        `given` holds the arguments by role, `made` the names of the members that are written; the
        array is float64 unless `plain` says otherwise.
        """
        columns = {role: self._columns(role, value) for role, value in given.items()}
        shape = np.broadcast_shapes(*(c.shape for g in columns.values() for c in g.values()))
        for group in columns.values():
            group |= {n: np.broadcast_to(c, shape).reshape(-1) for n, c in group.items() if c.ndim}
        count = math.prod(shape)
        block = max(1, min(count, BLOCK))
        records = {role: self.host.records(role, block) for role in {*given, *made}}
        beside = np.zeros(block, plain or np.dtype(float))
        results = {
            role: {n: np.empty(count, records[role].dtype[n]) for n in names}
            for role, names in made.items()
        }
        whole = np.empty(count, beside.dtype)
        for first in range(0, count, block):
            here = slice(first, min(first + block, count))
            part = {role: r[: here.stop - first] for role, r in records.items()}
            for role, group in columns.items():
                for name, column in group.items():
                    if column.ndim:
                        part[role][name] = column[here]
                    elif first == 0 or name in made.get(
                        role, ()
                    ):  # what C wrote over is written again
                        part[role][name] = column
            run(part, beside[: here.stop - first])
            whole[here] = beside[: here.stop - first]
            for role, group in results.items():
                for name, column in group.items():
                    column[here] = part[role][name]
        shaped = {r: {n: c.reshape(shape) for n, c in g.items()} for r, g in results.items()}
        return shaped, whole.reshape(shape)

    def _columns(self, role: str, value: Any) -> Columns:
        kinds = self.host.records(role, 0).dtype
        return {n: _column(role, n, getattr(value, n), kinds[n]) for n in kinds.names or ()}


def _field_names(kind: type) -> tuple[str, ...]:
    return tuple(f.name for f in fields(kind))


def _column(role: str, name: str, value: Any, kind: np.dtype[Any]) -> Array:
    """Return `value` as an array that fits a member of `kind`; raise `InputError` if it does not.

    A C integer has no room for a fraction, a sign or a NaN.
    """
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{role}.{name} is no number: {error}", remedy="give a number or an array of numbers"
        ) from error
    if kind.kind == "f":
        return array
    if not ((array >= 0) & (array <= _LARGEST_UINT32) & (array == np.floor(array))).all():
        raise InputError(
            f"{role}.{name} is not a whole number from 0 to {_LARGEST_UINT32}",
            remedy="give 0 or 1, as init and step return it",
        )
    return array.astype(kind)


class PlainModel:
    """The generated NumPy module where there is no C compiler, under the same call."""

    compiled = False

    def __init__(self, module: ModuleType, manifest: Manifest) -> None:
        """Put `module` behind the call."""
        self.module = module
        self.Controller = partial(NumpyLawStep, module, manifest)

    def __getattr__(self, name: str) -> Any:
        """Return what the module has by that name."""
        return getattr(self.module, name)


def compiled_model(
    reference: str | Path | ModuleType, toolchain: str = "auto"
) -> CompiledModel | PlainModel:
    """Return the functions of a generated model on compiled C.

    `reference` is a model's name, the folder of a generation, or the generated module once it is
    imported, whose classes are then the ones returned. The image comes from the cache by content.
    Without a C compiler the NumPy module stands behind the call, and a `RuntimeWarning` says so.
    """
    folder, module = _opened(reference)
    if not hasattr(module, "_PREPARED"):
        raise InputError(
            f"{folder.path}: the NumPy module is of an older version", remedy="regenerate the model"
        )
    try:
        return CompiledModel(module, host_model(folder, toolchain))
    except MissingToolError as error:
        warnings.warn(
            f"{folder.manifest.model}: NumPy instead of compiled C: {error}",
            RuntimeWarning,
            stacklevel=2,
        )
        return PlainModel(module, folder.manifest)


def _opened(reference: str | Path | ModuleType) -> tuple[GeneratedFolder, ModuleType]:
    if not isinstance(reference, ModuleType):
        folder = open_generated(str(reference))
        return folder, folder.python_module()
    if not getattr(reference, "__file__", None):
        raise InputError(
            f"module {reference.__name__} has no file", remedy="give the model's name or folder"
        )
    return open_generated(str(Path(str(reference.__file__)).parent)), reference
