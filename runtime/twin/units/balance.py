"""Control units of the twin: the balance law behind the sensing, and a linear baseline."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.generated_model import GeneratedModel, fill_records, ppc750_model
from pfaffian.runtime.code.sensing import (
    JUMP,
    SensingModule,
    SensingParameters,
    host_sensing,
    ppc750_sensing,
)
from pfaffian.runtime.contract.manifest import Manifest
from pfaffian.runtime.twin.angles import turns, wrapped
from pfaffian.runtime.twin.settings import TwinScenario
from pfaffian.runtime.twin.unit import BALANCE, Command, Reading

#: Statuses of a generated step from which the torque is no longer the law's.
_FIRST_FAULT = 3
_SENSING_SHIFT = np.uint32(8)
_LARGEST_JUMP = 100


class Senses(Protocol):
    """Turns a reading into angles and velocities."""

    def start(self, count: int) -> None:
        """Prepare for `count` rigs."""

    def take(self, reading: Reading) -> tuple[Array, Array, Array]:
        """Return (angle (N, n), velocity (N, n), worst sensing status uint32 (N,))."""


class ExactSenses:
    """The plant's own state: no sensor."""

    def start(self, count: int) -> None:
        """Need nothing."""

    def take(self, reading: Reading) -> tuple[Array, Array, Array]:
        """Return the truth."""
        n = reading.truth.shape[1] // 2
        status = np.zeros(len(reading.truth), np.uint32)
        return reading.truth[:, :n], reading.truth[:, n:], status


class EncoderSenses:
    """`pf_sensing` on a machine, one channel a coordinate."""

    def __init__(self, module: SensingModule, channels: Sequence[SensingParameters]) -> None:
        """Take the parameters of the channels, in the order of the coordinates."""
        self._module, self._channels = module, tuple(channels)
        self._state: Array = np.empty(0)

    def start(self, count: int) -> None:
        """Prepare the channels of `count` rigs."""
        self._state = np.tile(self._module.init(self._channels), count)

    def take(self, reading: Reading) -> tuple[Array, Array, Array]:
        """Step every channel by one period."""
        shape = reading.counts.shape
        sensed = self._module.run(
            self._state, reading.counts.reshape(1, -1), reading.valid.reshape(1, -1)
        )
        worst = sensed.status.reshape(shape).max(1).astype(np.uint32)
        return sensed.angle.reshape(shape), sensed.velocity.reshape(shape), worst


class BalanceUnit:
    """The generated balance law on a machine, engaged from the first period on: mode 2 always.

    It has no supervisor: where the sensing gave up (a jump, a stale channel) the torque is zero,
    and `fault` holds the law's status from `BAD_INPUT` on and, above eight bits, the sensing's.
    The law takes the nominal period whatever elapsed.
    """

    def __init__(self, model: GeneratedModel, parameters: dict[str, float], senses: Senses) -> None:
        """Take the law, its parameters in SI units, and what senses for it."""
        self._model, self._parameters, self._senses = model, parameters, senses
        manifest = model.folder.manifest
        self._coordinates, self._actuators = manifest.coordinates, manifest.actuators
        self._outputs = manifest.structures["output"].names()

    def start(self, count: int) -> None:
        """Prepare the law of `count` rigs."""
        model = self._model
        self._params = fill_records(model.records("params", count), self._parameters)
        self._state, self._measured, self._output = (
            model.records(role, count) for role in ("state", "input", "output")
        )
        self._status = np.zeros(count, np.int32)
        model.init(self._state, self._params, self._status)
        self._senses.start(count)

    def step(self, reading: Reading) -> Command:
        """Return one period's command of all rigs."""
        angle, velocity, sensing = self._senses.take(reading)
        for k, name in enumerate(self._coordinates):
            self._measured[name], self._measured[f"d{name}"] = angle[:, k], velocity[:, k]
        if "time" in (self._measured.dtype.names or ()):
            self._measured["time"] = reading.frame * self._parameters["sample_time"]
        self._model.step(self._state, self._params, self._measured, self._output, self._status)
        torque = np.array([self._output[a] for a in self._actuators], np.float64).T
        blind = sensing >= JUMP
        torque[blind] = 0.0
        fault = np.where(self._status >= _FIRST_FAULT, self._status, 0).astype(np.uint32)
        fault |= np.where(blind, sensing, 0).astype(np.uint32) << _SENSING_SHIFT
        signals = {n: self._output[n] for n in self._outputs if n not in self._actuators}
        signals["status"] = self._status
        mode = np.full(len(torque), BALANCE, np.uint32)
        return Command(torque, mode, fault, angle, velocity, signals)

    def flip_parameter(self, rigs: Array, name: str, bit: int) -> None:
        """Invert a bit of a parameter in memory; what init prepared from it stays."""
        if name not in (self._params.dtype.names or ()) or not 0 <= bit < 64:
            raise InputError(
                f"no bit {bit} of a parameter {name} to flip",
                remedy=f"bits 0 to 63 of: {', '.join(self._params.dtype.names or ())}",
            )
        words = self._params[name].copy().view(np.uint64)
        words[rigs] ^= np.uint64(1) << np.uint64(bit)
        self._params[name] = words.view(np.float64)


class StateFeedbackUnit:
    """tau = -K (x - x_d), each rotary coordinate's error taken within half a turn: a baseline.

    `gain` (m, 2n) acts on q before q'; `goal` holds q_d by coordinate, `limit` (m,) bounds the
    torques. The rates of the goal are zero.
    """

    def __init__(
        self,
        manifest: Manifest,
        gain: Array,
        goal: dict[str, float],
        limit: Array,
        senses: Senses,
    ) -> None:
        """Check the shapes; raise `InputError` where they do not fit the model."""
        n, m = len(manifest.coordinates), len(manifest.actuators)
        self._gain, self._limit = np.asarray(gain, float), np.asarray(limit, float)
        if self._gain.shape != (m, 2 * n) or self._limit.shape != (m,):
            raise InputError(
                f"state feedback: gain {self._gain.shape} and limit {self._limit.shape}",
                remedy=f"give shapes ({m}, {2 * n}) and ({m},)",
            )
        self._goal = np.array([goal[c] for c in manifest.coordinates])
        self._turn = turns(manifest)
        self._senses = senses

    def start(self, count: int) -> None:
        """Prepare the sensing of `count` rigs."""
        self._senses.start(count)

    def step(self, reading: Reading) -> Command:
        """Return one period's command of all rigs."""
        angle, velocity, sensing = self._senses.take(reading)
        error = wrapped(angle - self._goal, self._turn)
        torque = np.zeros((len(angle), len(self._gain)))
        for k in range(angle.shape[1]):  # in this order: a matrix product has no fixed one
            torque = torque - error[:, k : k + 1] * self._gain[:, k]
            torque = torque - velocity[:, k : k + 1] * self._gain[:, angle.shape[1] + k]
        blind = sensing >= JUMP
        torque[blind] = 0.0
        torque = np.clip(torque, -self._limit, self._limit)
        fault = np.where(blind, sensing, 0).astype(np.uint32) << _SENSING_SHIFT
        mode = np.full(len(angle), BALANCE, np.uint32)
        return Command(torque, mode, fault, angle, velocity)


def sensing_parameters(scenario: TwinScenario) -> list[SensingParameters]:
    """Return the channels a controller assumes: the nominal encoders, read in mid-count."""
    channels = []
    for name in scenario.coordinates:
        encoder = scenario.channels[name].encoder
        reach = (((1 << encoder.counter_bits) - 1) // 2) // (SensingParameters.longest_gap + 1)
        channels.append(
            SensingParameters(
                counts_per_turn=encoder.counts_per_turn,
                offset=encoder.offset + 0.5 * encoder.direction * encoder.quantum,
                sample_time=scenario.base.sample_time,
                counter_bits=encoder.counter_bits,
                counter_zero=encoder.counter_zero,
                direction=encoder.direction,
                largest_jump=min(_LARGEST_JUMP, max(1, reach)),
            )
        )
    return channels


def balance_unit(
    scenario: TwinScenario, host: GeneratedModel, machine: str = "host"
) -> BalanceUnit:
    """Return the balance law of `scenario` on `host`, or on the emulated target `ppc750`."""
    there = machine == "ppc750"
    model = ppc750_model(scenario.base.folder) if there else host
    senses: Senses = ExactSenses()
    if scenario.channels:
        module = ppc750_sensing() if there else host_sensing()
        senses = EncoderSenses(module, sensing_parameters(scenario))
    return BalanceUnit(model, dict(scenario.base.controller), senses)
