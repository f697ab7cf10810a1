"""Generated code as something to verify: named inputs in, named outputs out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.code.generated_model import GeneratedFolder, GeneratedModel, Records
from pfaffian.runtime.contract.manifest import Manifest


def _defaults(folder: GeneratedFolder) -> dict[str, float]:
    """Return some valid value for every parameter, for those a function does not look at."""
    return folder.any_parameters()


def _limits(folder: GeneratedFolder) -> list[tuple[str, str]]:
    """Return each actuator with the parameter that limits it."""
    return list(zip(folder.manifest.actuators, folder.manifest.limits, strict=True))


def _saturated(
    folder: GeneratedFolder,
    output: Mapping[str, Array] | Records,
    params: Mapping[str, Array] | Records,
    code: Array,
) -> Array:
    """Return whether a limit binds, bool (N,); the status says it but where NEAR_SINGULAR hides it.

    There the torque at its limit tells, and one that its three parts do not add up to.
    """
    manifest = folder.manifest
    found = np.any([np.abs(output[a]) >= params[p] for a, p in _limits(folder)], axis=0)
    if (
        manifest.own(f"{manifest.actuators[0]}_previous")
        not in manifest.structures["state"].names()
    ):
        return np.asarray(found)
    found |= code == manifest.status.index("SATURATED")
    for actuator in manifest.actuators:
        names = [manifest.of_actuator(part, actuator) for part in ("p1", "p2", "p3")]
        parts = np.array([output[name] for name in names])
        rounding = 8.0 * np.finfo(parts.dtype).eps * np.abs(parts).sum(axis=0)
        found |= np.abs(output[actuator] - parts.sum(axis=0)) > rounding
    return np.asarray(found)


class CompiledUnderTest:
    """The C functions on a machine."""

    def __init__(self, model: GeneratedModel, name: str) -> None:
        """Name the subject; `c-host` or `c-ppc750` by custom."""
        self.model, self.name = model, name

    def evaluate(self, function: str, values: Mapping[str, Array]) -> dict[str, Array]:
        """Return the outputs of `function` by name, float64 of shape (N,)."""
        run = getattr(self, f"_{function}")
        result: dict[str, Array] = run(values, len(next(iter(values.values()))))
        return result

    def _filled(self, role: str, values: Mapping[str, Array], count: int) -> Records:
        records = self.model.records(role, count)
        known = {**_defaults(self.model.folder), **values}
        for name in records.dtype.names or ():
            if name in known:
                records[name] = known[name]
        return records

    def _step(self, values: Mapping[str, Array], count: int) -> dict[str, Array]:
        return self._law(values, count, ())

    def _follow(self, values: Mapping[str, Array], count: int) -> dict[str, Array]:
        return self._law(values, count, ("reference",))

    def _law(
        self, values: Mapping[str, Array], count: int, more: tuple[str, ...]
    ) -> dict[str, Array]:
        """Run one period of a law; `more` are the roles it reads besides the measurement."""
        state, params = self.model.records("state", count), self._filled("params", values, count)
        self.model.init(state, params, np.zeros(count, np.int32))  # what the step takes prepared
        for name in state.dtype.names or ():
            state[name] = values.get(name, state[name])
        output, status = self.model.records("output", count), np.zeros(count, np.int32)
        read = [self._filled(role, values, count) for role in ("input", *more)]
        run: Callable[..., None] = self.model.follow if more else self.model.step
        run(state, params, *read, output, status)
        manifest = self.model.folder.manifest
        saturated = _saturated(self.model.folder, output, params, status)
        singular = status == manifest.status.index("NEAR_SINGULAR")
        return {
            **_columns(output),
            **{n: c for n, c in _columns(state).items() if n != manifest.own("engaged")},
            manifest.own("saturated"): saturated.astype(float),
            manifest.own("near_singular"): singular.astype(float),
        }

    def _prepare(self, values: Mapping[str, Array], count: int) -> dict[str, Array]:
        state, status = self.model.records("state", count), np.zeros(count, np.int32)
        self.model.init(state, self._filled("params", values, count), status)
        return _columns(state)

    def _continuous(self, values: Mapping[str, Array], count: int) -> dict[str, Array]:
        output = self.model.records("continuous_output", count)
        state, params, measured = (
            self._filled(r, values, count) for r in ("continuous_state", "params", "input")
        )
        self.model.continuous(state, params, measured, output)
        return _columns(output)

    def _swing_up(self, values: Mapping[str, Array], count: int) -> dict[str, Array]:
        output, status = self.model.records("swing_up_output", count), np.zeros(count, np.int32)
        params, measured = (self._filled(r, values, count) for r in ("params", "input"))
        self.model.swing_up(params, measured, output, status)
        return {**_columns(output), **_flags(status, self.model.folder.manifest)}

    def _acceleration(self, values: Mapping[str, Array], count: int) -> dict[str, Array]:
        rate = self.model.records("plant_rate", count)
        params, state, applied = (
            self._filled(r, values, count) for r in ("plant_params", "plant_state", "plant_input")
        )
        self.model.acceleration(params, state, applied, rate)
        return _columns(rate)

    def _energy(self, values: Mapping[str, Array], count: int) -> dict[str, Array]:
        energy = self.model.reals(np.zeros(count))
        params, state = (self._filled(r, values, count) for r in ("plant_params", "plant_state"))
        self.model.energy(params, state, energy)
        return {"energy": energy.astype(float)}


class PythonUnderTest:
    """The generated NumPy module."""

    name = "python"

    def __init__(self, folder: GeneratedFolder) -> None:
        """Import the module of `folder`."""
        self._folder, self._module = folder, folder.python_module()

    def evaluate(self, function: str, values: Mapping[str, Array]) -> dict[str, Array]:
        """Return the outputs of `function` by name, float64 of shape (N,)."""
        count = len(next(iter(values.values())))
        result: dict[str, Any] = getattr(self, f"_{function}")(values)
        return {n: np.broadcast_to(np.asarray(v, float), (count,)) for n, v in result.items()}

    def _filled(self, role: str, values: Mapping[str, Array]) -> Any:
        structure = self._folder.manifest.structures[role]
        kind = getattr(self._module, "".join(w.capitalize() for w in role.split("_")))
        known = {**_defaults(self._folder), **values}
        return kind(**{n: known.get(n, 0.0) for n in structure.names()})

    def _step(self, values: Mapping[str, Array]) -> dict[str, Any]:
        return self._law(values, self._module.step, ())

    def _follow(self, values: Mapping[str, Array]) -> dict[str, Any]:
        return self._law(values, self._module.follow, ("reference",))

    def _law(self, values: Mapping[str, Array], run: Any, more: tuple[str, ...]) -> dict[str, Any]:
        params = self._filled("params", values)
        prepared, _ = self._module.init(params)
        for name in vars(prepared):
            setattr(prepared, name, values.get(name, getattr(prepared, name)))
        read = [self._filled(role, values) for role in ("input", *more)]
        state, output, status = run(prepared, params, *read)
        own = self._folder.manifest.own
        return {
            **vars(output),
            **{n: v for n, v in vars(state).items() if n != own("engaged")},
            own("saturated"): _saturated(self._folder, vars(output), vars(params), status),
            own("near_singular"): status == self._module.NEAR_SINGULAR,
        }

    def _prepare(self, values: Mapping[str, Array]) -> dict[str, Any]:
        return dict(vars(self._module.init(self._filled("params", values))[0]))

    def _continuous(self, values: Mapping[str, Array]) -> dict[str, Any]:
        roles = ("continuous_state", "params", "input")
        return dict(vars(self._module.continuous(*(self._filled(r, values) for r in roles))))

    def _swing_up(self, values: Mapping[str, Array]) -> dict[str, Any]:
        arguments = (self._filled(r, values) for r in ("params", "input"))
        output, status = self._module.swing_up(*arguments)
        return {**vars(output), **_flags(status, self._folder.manifest)}

    def _acceleration(self, values: Mapping[str, Array]) -> dict[str, Any]:
        roles = ("plant_params", "plant_state", "plant_input")
        return dict(vars(self._module.acceleration(*(self._filled(r, values) for r in roles))))

    def _energy(self, values: Mapping[str, Array]) -> dict[str, Any]:
        roles = ("plant_params", "plant_state")
        return {"energy": self._module.energy(*(self._filled(r, values) for r in roles))}


def _columns(records: Records) -> dict[str, Array]:
    return {n: records[n].astype(float) for n in records.dtype.names or ()}


def _flags(status: Array, manifest: Manifest) -> dict[str, Array]:
    """Return as numbers which samples have the status that each flag of a law stands for."""
    return {
        manifest.own(flag): (status == manifest.status.index(flag.upper())).astype(float)
        for flag in ("saturated", "near_singular")
    }
