"""Sensing on a machine: an encoder that quantises angles, and the C module that reads it.

The C is `runtime/c/pf_sensing.c`; its header says what each parameter, input and output is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import CheckError, InputError
from pfaffian.runtime.contract.runtime_structs import ESTIMATORS as ESTIMATORS
from pfaffian.runtime.contract.runtime_structs import SENSING
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.emulator import Ppc750Machine
from pfaffian.runtime.machine.host import HostMachine, Machine
from pfaffian.runtime.machine.toolchain import host_target, ppc750_target

#: Statuses by their number in `pf_sensing_status_t`.
STATUSES = (
    *("ok", "missing", "jump", "stale", "bad parameter", "lost", "bad arithmetic"),
    "not standing",
)
OK, MISSING, JUMP, STALE, BAD_PARAMETER, LOST, BAD_ARITHMETIC, NOT_STANDING = range(len(STATUSES))


@dataclass(frozen=True)
class SensingParameters:
    """One channel, as `pf_sensing_params_t` describes it; SI units, angles in rad.

    The defaults are the paper's encoder (section 6: 1250 pulses a turn, in quadrature) at 1 kHz
    with the estimator that `pfaffian bench sensing` proposes.
    """

    counts_per_turn: float = 5000.0
    offset: float = 0.0
    sample_time: float = 1e-3
    bandwidth: float = 300.0
    damping: float = math.sqrt(0.5)
    estimator: str = "tracking"
    counter_bits: int = 32
    counter_zero: int = 0
    largest_jump: int = 100
    longest_gap: int = 8
    direction: int = 1


@dataclass(frozen=True)
class Encoder:
    """An incremental encoder behind a counter: angle [rad] to raw value, floor(), modulo 2^bits.

    `offset` is the angle [rad] at which count 0 begins, `counter_zero` what the counter shows then.
    """

    counts_per_turn: float = 5000.0
    offset: float = 0.0
    counter_bits: int = 32
    counter_zero: int = 0
    direction: int = 1

    @property
    def quantum(self) -> float:
        """Return the angle of one count [rad]."""
        return 2.0 * math.pi / self.counts_per_turn

    def counts(self, angle: Array | float) -> Array:
        """Return the counts behind the counter, int64 of the shape of `angle` [rad]."""
        turned = (np.asarray(angle, np.float64) - self.offset) * (self.direction / self.quantum)
        return np.floor(turned).astype(np.int64)

    def raw(self, angle: Array | float) -> Array:
        """Return what the counter shows, uint32 of the shape of `angle` [rad]."""
        shown = (self.counts(angle) + self.counter_zero) & ((1 << self.counter_bits) - 1)
        return np.asarray(shown, np.uint32)


@dataclass(frozen=True)
class Sensed:
    """What some channels gave over some periods: each (periods, channels), in SI units."""

    angle: Array
    velocity: Array
    count: Array
    status: Array


class SensingModule:
    """The C functions of `pf_sensing` on one machine; channels are records of its structures."""

    def __init__(self, machine: Machine) -> None:
        """Check that the structures in the image on `machine` are those of this module."""
        self.machine = machine
        for number, role in enumerate(SENSING):
            there, here = machine.call("pf_sensing_sizeof", number), self._type(role).itemsize
            if there != here:
                raise CheckError(
                    f"{machine.name}: pf_sensing's {role} has {there} bytes in the image, {here} "
                    "in Python",
                    remedy="keep runtime/code/sensing.py and pf_sensing.h alike",
                )

    def _type(self, role: str) -> np.dtype[np.void]:
        order = self.machine.byte_order
        return np.dtype([(name, order + kind) for name, kind in SENSING[role]], align=True)

    def init(self, channels: Sequence[SensingParameters]) -> Array:
        """Return the states of `channels`; raise `InputError` where the C refuses one."""
        state, status = self.init_records([_record(p) for p in channels])
        refused = [p for p, s in zip(channels, status, strict=True) if s != OK]
        if refused:
            raise InputError(
                f"sensing: a parameter is out of its bounds: {refused[0]}",
                remedy="the bounds stand in runtime/c/pf_sensing.h",
            )
        return state

    def init_records(self, channels: Sequence[dict[str, float]]) -> tuple[Array, Array]:
        """Return (states, statuses int32) of channels given member by member, good or bad."""
        params = np.zeros(len(channels), self._type("params"))
        for record, values in zip(params, channels, strict=True):
            for name, value in values.items():
                record[name] = value
        params.flags.writeable = False
        state = np.zeros(len(channels), self._type("state"))
        status = np.zeros(len(channels), self.machine.byte_order + "i4")
        self.machine.call("pf_sensing_batch_init", len(channels), state, params, status)
        return state, status.astype(np.int32)

    def run(self, state: Array, raw: Array, valid: Array | bool = True) -> Sensed:
        """Step the channels of `state` (k,), which advance in place, through all readings.

        `raw` (n, k) or (n, 1), uint32: the counters, the same for all channels in the second form;
        `valid` broadcasts to it.
        """
        shape = (len(raw), len(state))
        given = np.zeros(shape, self._type("input"))
        given["raw"], given["valid"] = raw, valid
        given.flags.writeable = False
        output = np.zeros(shape, self._type("output"))
        status = np.zeros(shape, self.machine.byte_order + "i4")
        self.machine.call(
            "pf_sensing_batch_step", len(state), len(raw), state, given, output, status
        )
        native = [output[n].astype(k) for n, k in SENSING["output"]]
        return Sensed(native[0], native[1], native[2], status.astype(np.int32))

    def retune(self, state: Array, channels: Sequence[SensingParameters]) -> Array:
        """Give the channels of `state` (k,) other parameters; return statuses (k,)."""
        params = np.zeros(len(channels), self._type("params"))
        for record, values in zip(params, map(_record, channels), strict=True):
            for name, value in values.items():
                record[name] = value
        params.flags.writeable = False
        status = np.zeros(len(state), self.machine.byte_order + "i4")
        self.machine.call("pf_sensing_batch_retune", len(state), state, params, status)
        return status.astype(np.int32)

    def rezero(self, state: Array, angles: Sequence[float], periods: int) -> Array:
        """Say that the shafts of `state` (k,) stand at `angles` [rad]; return statuses (k,)."""
        given = np.array(angles, self.machine.byte_order + "f8")
        given.flags.writeable = False
        status = np.zeros(len(state), self.machine.byte_order + "i4")
        self.machine.call("pf_sensing_batch_rezero", len(state), state, given, int(periods), status)
        return status.astype(np.int32)


def _record(parameters: SensingParameters) -> dict[str, float]:
    if parameters.estimator not in ESTIMATORS:
        raise InputError(
            f"sensing: no estimator {parameters.estimator}",
            remedy=f"known: {', '.join(ESTIMATORS)}",
        )
    return {**asdict(parameters), "estimator": ESTIMATORS[parameters.estimator]}


def sensing_sources() -> list[Path]:
    """Return the C files of the module and its harness; their headers stand beside them."""
    folder = Path(str(files("pfaffian.runtime"))) / "c"
    return [folder / "pf_sensing.c", folder / "pf_sensing_harness.c"]


def host_sensing(toolchain: str = "auto") -> SensingModule:
    """Build the module for this machine and load it."""
    sources = sensing_sources()
    image = compile_image(host_target(toolchain), sources, sources[0].parent)
    return SensingModule(HostMachine(image))


def ppc750_sensing(toolchain: str = "auto") -> SensingModule:
    """Build the module for the PowerPC 750 and load it into the emulator."""
    sources = sensing_sources()
    entry = ("-Wl,-e,pf_sensing_batch_step",)
    image = compile_image(ppc750_target(toolchain), sources, sources[0].parent, entry)
    return SensingModule(Ppc750Machine(image))
