"""One controller of one plant, stepped a period at a time: in compiled C, or in NumPy."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Mapping
from dataclasses import fields, replace
from operator import attrgetter
from types import ModuleType
from typing import Any

import numpy as np
from pfaffian.runtime.base.errors import InputError, MissingToolError
from pfaffian.runtime.base.toml import suggestion
from pfaffian.runtime.code.generated_model import GeneratedModel
from pfaffian.runtime.contract.dtypes import layout_of
from pfaffian.runtime.contract.manifest import Manifest
from pfaffian.runtime.machine.host import HostMachine

_ROLES = ("state", "params", "input", "output")
_OK = 0


class LawStep:
    """A controller in compiled C that keeps its structures and their addresses between calls.

    One call costs about what calling C from Python costs at all. It is not to be called from
    several threads at once.
    """

    #: Whether C runs behind the call.
    compiled = True

    def __init__(self, module: ModuleType, host: GeneratedModel, params: Any) -> None:
        """Start with `params`, an object of the module's `Params`.

        Raises `InputError` where a parameter is out of its bounds, `MissingToolError` where
        `host` is not this machine.
        """
        if not isinstance(host.machine, HostMachine):
            raise MissingToolError(
                f"a controller runs on this machine, not on {host.machine.name}",
                remedy="build the model for the host",
            )
        manifest = host.folder.manifest
        layouts = {role: layout_of(manifest.structures[role]) for role in _ROLES}
        kinds: dict[str, Any] = {role: _structure(layouts[role]) for role in _ROLES}
        self._kinds, self._module, self._manifest = kinds, module, manifest
        self._state, self._params = kinds["state"](), kinds["params"]()
        self._input, self._output = kinds["input"](), kinds["output"]()
        self._arguments = tuple(
            ctypes.byref(s) for s in (self._state, self._params, self._input, self._output)
        )
        self._init, self._prepare, self._step = (
            host.machine.entry(f"{manifest.model}_{name}") for name in ("init", "prepare", "step")
        )
        signals = layouts["input"]
        self._signals = signals.names or ()
        self._pack = struct.Struct("@" + "".join(signals[n].char for n in self._signals)).pack_into
        self._commanded = attrgetter(*manifest.actuators)
        self._code = _OK
        self._take({n: getattr(params, n) for n in layouts["params"].names or ()})
        self.reset()

    def step(self, *measured: float, **named: float) -> Any:
        """Return the torque of one period: a float, or a tuple where there are several actuators.

        The measurements come in the order of the class `Input`, or by name, in SI units. Raises
        `InputError` where they are not those; a value that is out of range is no error but a
        status, with torque 0.
        """
        if named:
            measured = in_order(self._signals, measured, named)
        try:
            self._pack(self._input, 0, *measured)
        except struct.error as error:
            raise _wrong_signals(self._signals, str(error)) from error
        self._code = self._step(*self._arguments)
        return self._commanded(self._output)

    @property
    def status(self) -> str:
        """Return the name of the last step's status."""
        return self._manifest.status[self._code]

    @property
    def state(self) -> Any:
        """Return what the controller remembers now, as the module's `State`."""
        return _copied(self._module.State, self._state)

    @state.setter
    def state(self, value: Any) -> None:
        for field in fields(self._module.State):
            number = getattr(value, field.name)
            whole = isinstance(getattr(self._state, field.name), int)
            setattr(self._state, field.name, int(number) if whole else float(number))

    @property
    def output(self) -> Any:
        """Return everything the last step gave, as the module's `Output`."""
        return _copied(self._module.Output, self._output)

    @property
    def params(self) -> Any:
        """Return a copy of the parameters in force; `prepare` changes them."""
        return _copied(self._module.Params, self._params)

    def reset(self) -> None:
        """Go back to before the first period, with the parameters in force."""
        self._init(self._arguments[0], self._arguments[1])
        self._output, self._code = self._kinds["output"](), _OK
        self._arguments = (*self._arguments[:3], ctypes.byref(self._output))

    def prepare(self, **changes: float) -> None:
        """Change parameters between two periods; the rest of the state stays as it is.

        Raises `InputError` for an unknown name or a value out of its bounds, and changes nothing.
        """
        _check_names(self._module, changes)
        self._take({**vars(self.params), **changes})
        self._prepare(self._arguments[0], self._arguments[1])

    def _take(self, values: Mapping[str, float]) -> None:
        """Take over `values` if the generated code accepts them."""
        if not self._accepts(values):
            known = next(iter(self._manifest.parameter_sets.values()))
            faults = [n for n in values if not self._accepts({**known, n: values[n]})]
            raise _refused(self._manifest.model, {n: values[n] for n in faults or values})
        for name, value in values.items():
            setattr(self._params, name, value)

    def _accepts(self, values: Mapping[str, float]) -> bool:
        """Return whether init accepts `values`, tried on a state and parameters of its own."""
        state, params = self._kinds["state"](), self._kinds["params"]()
        for field in fields(self._module.Params):
            setattr(params, field.name, values[field.name])
        return self._init(ctypes.byref(state), ctypes.byref(params)) == _OK


class NumpyLawStep:
    """The same controller in NumPy, for where there is no C compiler: slower by far."""

    compiled = False

    def __init__(self, module: ModuleType, manifest: Manifest, params: Any) -> None:
        """Start with `params`; raises `InputError` where a parameter is out of its bounds."""
        self._module, self._manifest = module, manifest
        self._signals = tuple(f.name for f in fields(module.Input))
        self.state: Any = None
        self._take(params)
        self.reset()

    def step(self, *measured: float, **named: float) -> Any:
        """Return the torque of one period, as `Controller.step` does."""
        values = in_order(self._signals, measured, named)
        after, given, code = self._module.step(
            self.state, self.params, self._module.Input(*map(float, values))
        )
        self.state, self.output, self._code = _plain(after), _plain(given), int(code)
        return attrgetter(*self._manifest.actuators)(self.output)

    @property
    def status(self) -> str:
        """Return the name of the last step's status."""
        return self._manifest.status[self._code]

    def reset(self) -> None:
        """Go back to before the first period, with the parameters in force."""
        self.state = _plain(self._module.init(self.params)[0])
        self.output = self._module.Output(*(0.0 for _ in fields(self._module.Output)))
        self._code = _OK

    def prepare(self, **changes: float) -> None:
        """Change parameters between two periods, as `Controller.prepare` does."""
        _check_names(self._module, changes)
        self._take(replace(self.params, **changes))
        self.state = _plain(self._module.prepare(self.state, self.params)[0])

    def _take(self, params: Any) -> None:
        if not self._module.parameters_are_valid(params):
            raise _refused(self._manifest.model, vars(params))
        self.params = replace(params)


def in_order(
    signals: tuple[str, ...], measured: tuple[float, ...], named: Mapping[str, float]
) -> tuple[float, ...]:
    """Return measurements in the order of `signals`; raise `InputError` if they are not those."""
    given = {**dict(zip(signals, measured, strict=False)), **named}
    if len(measured) + len(named) != len(signals) or set(given) != set(signals):
        found = [*map(str, measured), *named]
        raise _wrong_signals(signals, f"got {', '.join(found) or 'none'}")
    return tuple(given[n] for n in signals)


def _wrong_signals(signals: tuple[str, ...], found: str) -> InputError:
    return InputError(
        f"step takes one number for each measurement: {found}",
        remedy=f"give {', '.join(signals)}, in this order or by name",
    )


def _check_names(module: ModuleType, changes: Mapping[str, float]) -> None:
    known = [f.name for f in fields(module.Params)]
    for name in changes:
        if name not in known:
            raise InputError(f"no parameter {name}", remedy=suggestion(name, known))


def _refused(model: str, values: Mapping[str, float]) -> InputError:
    shown = ", ".join(f"{n} = {v}" for n, v in values.items())
    return InputError(
        f"{model}: a parameter is not finite or out of its bounds: {shown}",
        remedy=f"its bounds stand in {model}_params.h and in parameters_are_valid of the module",
    )


def _structure(layout: Any) -> Any:
    """Return a NumPy structure as a class of ctypes, with the same offsets."""
    return np.ctypeslib.as_ctypes_type(layout)


def _copied(kind: type, source: Any) -> Any:
    return kind(**{f.name: getattr(source, f.name) for f in fields(kind)})


def _plain(value: Any) -> Any:
    """Return `value` with a float in each field."""
    return type(value)(*(float(getattr(value, f.name)) for f in fields(value)))
