"""The complete generated controller as a control unit: swing-up, capture, balance, faults."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.toml import suggestion
from pfaffian.runtime.code.controller import GeneratedController, host_control, ppc750_control
from pfaffian.runtime.code.generated_model import GeneratedModel
from pfaffian.runtime.twin.settings import TwinScenario
from pfaffian.runtime.twin.unit import Command, Reading

_OK = 0
#: Members of the output that are no signals of their own.
_TAKEN = ("law", "mode", "fault")


class ControllerUnit:
    """`<model>_control_step` on a machine, one state a rig.

    Its signals are the members of the output, those of the law among them under their own names.
    """

    def __init__(self, module: GeneratedController, params: Array) -> None:
        """Take sealed parameters, one record; raise `InputError` where `init` refuses them."""
        self._module, self._one = module, params
        manifest = module.folder.manifest
        self._coordinates, self._actuators = manifest.coordinates, manifest.actuators
        self._law = [n for n in manifest.structures["output"].names() if n not in self._actuators]
        _, status = module.init(params)
        if status[0] != _OK:
            raise InputError(
                f"{manifest.model}: the complete controller refuses its parameters",
                remedy="the bounds stand in pf_sensing.h, pf_supervisor.h and the parameters",
            )

    def start(self, count: int) -> None:
        """Prepare the controllers of `count` rigs: all in IDLE."""
        self._params = np.repeat(self._one, count)
        self._state, _ = self._module.init(self._params)
        self._given = self._module.records("control_input", count)
        self._output = self._module.records("control_output", count)

    def step(self, reading: Reading) -> Command:
        """Return one period's command of all rigs."""
        given, output = self._given, self._output
        for k, name in enumerate(self._coordinates):
            given[f"{name}_raw"], given[f"{name}_valid"] = reading.counts[:, k], reading.valid[:, k]
        for name in ("elapsed", "frame", "heartbeat", "command"):
            given[name] = getattr(reading, name)
        self._module.step(self._state, self._params, given, output)
        signals = {n: _native(output["law"][n]) for n in self._law}
        own = [n for n in output.dtype.names or () if n not in (*_TAKEN, *self._actuators)]
        own = [n for n in own if n.removeprefix("d") not in self._coordinates]
        signals |= {n: _native(output[n]) for n in own}
        return Command(
            torque=_columns(output, self._actuators),
            mode=_native(output["mode"]),
            fault=_native(output["fault"]),
            angle=_columns(output, self._coordinates),
            velocity=_columns(output, [f"d{c}" for c in self._coordinates]),
            signals=signals,
        )

    def flip_parameter(self, rigs: Array, name: str, bit: int) -> None:
        """Invert a bit of a parameter of the law in memory; its checksum stays what it was."""
        known = self._params["law"].dtype.names or ()
        if name not in known or not 0 <= bit < 64:
            raise InputError(
                f"no bit {bit} of a parameter {name} to flip",
                remedy=f"bits 0 to 63; {suggestion(name, list(known))}",
            )
        words = _native(self._params["law"][name]).view(np.uint64)
        words[rigs] ^= np.uint64(1) << np.uint64(bit)
        self._params["law"][name] = words.view(np.float64)


def _native(column: Array) -> Array:
    return column.astype(column.dtype.newbyteorder("="))


def _columns(records: Array, names: Any) -> Array:
    return np.array([_native(records[n]) for n in names], np.float64).T.copy()


def complete_params(
    module: GeneratedController,
    set_name: str,
    law: Mapping[str, float],
    changes: Mapping[str, Any],
) -> Array:
    """Return one sealed parameter block: that of `set_name` with `law` and `changes` in it.

    `law` are the law's parameters in SI units; its sample time is that of sensing and supervision
    too. `changes` go by member, `supervisor.watchdog_time` or `swing_up`. Raises `InputError` for
    a member that is not there.
    """
    params = module.params(set_name)
    for name in params["law"].dtype.names or ():
        params["law"][name] = law[name]
    for member in params.dtype.names or ():
        if "sample_time" in (params[member].dtype.names or ()):
            params[member]["sample_time"] = law["sample_time"]
    for path, value in changes.items():
        *groups, last = path.split(".")
        records = params
        for word in groups:
            records = _member(records, word, path)
        _member(records, last, path)
        records[last] = value
    return module.seal(params)


def _member(records: Array, name: str, path: str) -> Array:
    known = records.dtype.names or ()
    if name not in known:
        raise InputError(f"control: no member {path}", remedy=suggestion(name, list(known)))
    return np.asarray(records[name])


def complete_unit(
    scenario: TwinScenario, host: GeneratedModel, machine: str = "host"
) -> ControllerUnit:
    """Return the complete controller of `scenario` on the host, or on the target `ppc750`."""
    folder = scenario.base.folder
    module = ppc750_control(folder) if machine == "ppc750" else host_control(folder)
    params = complete_params(
        module, scenario.base.set_name, scenario.base.controller, scenario.control
    )
    return ControllerUnit(module, params)
