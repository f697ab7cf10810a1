"""Supervision on a machine: the C of `runtime/c/pf_supervisor.c`, driven from Python.

Its header says what each parameter, input and output is; units are records of its structures, in
the byte order of the machine that they are for.
"""

from __future__ import annotations

from enum import IntEnum
from importlib.resources import files
from pathlib import Path

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.contract.runtime_structs import SUPERVISOR
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.emulator import Ppc750Machine
from pfaffian.runtime.machine.host import HostMachine, Machine
from pfaffian.runtime.machine.toolchain import host_target, ppc750_target


class Mode(IntEnum):
    """`pf_mode_t`."""

    IDLE = 0
    SWING_UP = 1
    BALANCE = 2
    FAULT = 3


class Order(IntEnum):
    """`pf_command_t`."""

    NONE = 0
    START = 1
    STOP = 2
    RESET = 3
    REZERO = 4


class Fault(IntEnum):
    """`pf_fault_t`."""

    NONE = 0
    STATE_CORRUPT = 1
    PARAMETER_CHECKSUM = 2
    PARAMETER_BOUNDS = 3
    NOT_FINITE = 4
    RANGE = 5
    ENCODER_JUMP = 6
    STALE = 7
    OVERRUN = 8
    WATCHDOG = 9
    NUMERIC = 10
    SWING_UP_TIMEOUT = 11
    ATTEMPTS = 12
    INTERFACE = 13
    ARITHMETIC = 14
    PARAMETER_FIXED = 15


class Reason(IntEnum):
    """`pf_reason_t`."""

    NONE = 0
    STARTED = 1
    STOPPED = 2
    CAPTURED = 3
    RELEASED = 4
    FAULT = 5
    RESET = 6
    NO_READING = 7
    REZEROED = 8
    REZERO_REFUSED = 9


class Position(IntEnum):
    """The bits of `position`."""

    UNREAD = 0x1
    REZEROED = 0x2
    REFUSED = 0x4
    LOST = 0x8


class Check(IntEnum):
    """The bits of `checks`."""

    PARAMETER_CHECKSUM = 0x01
    PARAMETER_BOUNDS = 0x02
    NOT_FINITE = 0x04
    RANGE = 0x08
    ENCODER_JUMP = 0x10
    STALE = 0x20
    NUMERIC = 0x40
    ARITHMETIC = 0x80
    PARAMETER_FIXED = 0x100


#: Members of `pf_transition_t`, in the order of a row of the log.
TRANSITION = ("period", "frame", "from", "to", "reason", "fault")


class SupervisorModule:
    """The C functions of `pf_supervisor` on one machine."""

    def __init__(self, machine: Machine) -> None:
        """Check that the structures in the image on `machine` are those of this module."""
        self.machine = machine
        for number, role in enumerate(SUPERVISOR):
            there, here = machine.call("pf_supervisor_sizeof", number), self.type(role).itemsize
            if there != here:
                raise CheckError(
                    f"{machine.name}: pf_supervisor's {role} has {there} bytes in the image, "
                    f"{here} in Python",
                    remedy="keep runtime/contract/runtime_structs.py and pf_supervisor.h alike",
                )

    def type(self, role: str) -> np.dtype[np.void]:
        """Return the structure `role` (params, input, state, output) in the machine's order."""
        order = self.machine.byte_order
        members = [(name, order + kind, *shape) for name, kind, *shape in SUPERVISOR[role]]
        return np.dtype(members, align=True)

    def init(self, params: Array) -> tuple[Array, Array]:
        """Return (states, statuses int32) of units with `params` (k,), good or bad."""
        state = np.zeros(len(params), self.type("state"))
        status = np.zeros(len(params), self.machine.byte_order + "i4")
        fixed = self._given(params, "params")
        self.machine.call("pf_supervisor_batch_init", len(params), state, fixed, status)
        return state, status.astype(np.int32)

    def run(self, state: Array, params: Array, inputs: Array) -> Array:
        """Step `state` (k,), which advances in place, through `inputs` (n, k); outputs (n, k)."""
        fixed, given = self._given(params, "params"), self._given(inputs, "input")
        output = np.zeros(given.shape, self.type("output"))
        self.machine.call(
            "pf_supervisor_batch_step", len(state), len(given), state, fixed, given, output
        )
        return output

    def trip(self, state: Array, faults: Array, output: Array) -> None:
        """Trip every unit with its own of `faults` (k,); `state` and `output` (k,) change."""
        given = np.ascontiguousarray(faults, self.machine.byte_order + "u4")
        self.machine.call("pf_supervisor_batch_trip", len(state), state, given, output)

    def modes(self, state: Array) -> Array:
        """Return the mode of every unit, uint32 (k,)."""
        mode = np.zeros(len(state), self.machine.byte_order + "u4")
        self.machine.call("pf_supervisor_batch_mode", len(state), _fixed(state), mode)
        return mode.astype(np.uint32)

    def transition(self, state: Array, number: int) -> tuple[Array, Array]:
        """Return transition `number` of every unit, uint32 (k, 6), and whether it is there (k,)."""
        order = self.machine.byte_order
        rows = np.zeros((len(state), len(TRANSITION)), order + "u4")
        there = np.zeros(len(state), order + "u4")
        self.machine.call(
            "pf_supervisor_batch_log_read", len(state), _fixed(state), number, rows, there
        )
        return rows.astype(np.uint32), there.astype(bool)

    def checksums(self, blocks: Array) -> Array:
        """Return the checksum of each row of `blocks`, float64 (k, n), as uint32 (k,)."""
        found = np.zeros(len(blocks), self.machine.byte_order + "u4")
        given = self._reals(blocks)
        self.machine.call("pf_checksum_batch", len(blocks), blocks.shape[1], given, found)
        return found.astype(np.uint32)

    def limited(self, value: Array, limit: Array) -> Array:
        """Return `pf_limited` of each pair, float64 (k,)."""
        return self._mapped("pf_limited_batch", value, limit)

    def slewed(self, value: Array, previous: Array, step: Array, limit: Array) -> Array:
        """Return `pf_slewed` of each row of four, float64 (k,)."""
        return self._mapped("pf_slewed_batch", value, previous, step, limit)

    def nearest_turn(self, angle: Array, reference: Array) -> Array:
        """Return `pf_nearest_turn` of each pair [rad], float64 (k,)."""
        return self._mapped("pf_nearest_turn_batch", angle, reference)

    def _mapped(self, function: str, *columns: Array) -> Array:
        result = np.zeros(len(columns[0]), self.machine.byte_order + "f8")
        given = [self._reals(c) for c in columns]
        self.machine.call(function, len(result), *given, result)
        return result.astype(np.float64)

    def _given(self, records: Array, role: str) -> Array:
        return _fixed(np.ascontiguousarray(records.astype(self.type(role))))

    def _reals(self, values: Array) -> Array:
        return _fixed(np.ascontiguousarray(values, self.machine.byte_order + "f8"))


def _fixed(records: Array) -> Array:
    """Return `records` as an array that a machine need not copy back."""
    view = records.view()
    view.flags.writeable = False
    return view


def supervisor_sources() -> list[Path]:
    """Return the C files of the module and its harness; their headers stand beside them."""
    folder = Path(str(files("pfaffian.runtime"))) / "c"
    return [folder / "pf_supervisor.c", folder / "pf_supervisor_harness.c"]


def host_supervisor(toolchain: str = "auto") -> SupervisorModule:
    """Build the module for this machine and load it."""
    sources = supervisor_sources()
    image = compile_image(host_target(toolchain), sources, sources[0].parent)
    return SupervisorModule(HostMachine(image))


def ppc750_supervisor(toolchain: str = "auto") -> SupervisorModule:
    """Build the module for the PowerPC 750 and load it into the emulator."""
    sources = supervisor_sources()
    entry = ("-Wl,-e,pf_supervisor_batch_step",)
    image = compile_image(ppc750_target(toolchain), sources, sources[0].parent, entry)
    return SupervisorModule(Ppc750Machine(image))
