"""What the controllers of N rigs are shown: counters, clocks and orders, and what breaks there."""

from __future__ import annotations

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.twin.draws import Blocks, Purpose, uniform, whole
from pfaffian.runtime.twin.schedule import window
from pfaffian.runtime.twin.settings import Channel, Fault, TwinScenario
from pfaffian.runtime.twin.unit import COMMANDS, Reading


class Sensors:
    """Makes the reading of each turn; the arrays of a reading hold until the next one."""

    def __init__(self, scenario: TwinScenario) -> None:
        """Draw what each rig's encoders have of their own."""
        self.scenario = scenario
        count, names = scenario.rigs, scenario.coordinates
        rigs = range(scenario.first_rig, scenario.first_rig + count)
        self._channels = [scenario.channels.get(n, Channel()) for n in names]
        draws = uniform(scenario.seed, rigs, Purpose.OFFSET, len(names))
        width = np.array([c.offset_spread for c in self._channels])
        self.offset = width * (2.0 * draws - 1.0)
        self._noise = np.array([c.noise for c in self._channels])
        self._dropout = np.array([c.dropout for c in self._channels])
        seed, n = scenario.seed, len(names)
        self._noise_draws = Blocks(seed, rigs, Purpose.NOISE, n) if self._noise.any() else None
        self._dropout_draws = (
            Blocks(seed, rigs, Purpose.DROPOUT, n) if self._dropout.any() else None
        )
        self._faults = [
            (f, *window(scenario, f), _chosen(f, rigs))
            for f in scenario.faults
            if f.kind not in ("skip", "flip")
        ]
        self._orders = [(scenario.periods(o.time), COMMANDS[o.value]) for o in scenario.orders]
        self._raw = np.zeros((count, n), np.uint32)
        self._frozen = self._raw.copy()
        self._before = np.zeros(count, np.uint32)
        self._clocks: dict[str, Array] = {}
        self._period = np.full(count, -1)

    def read(self, truth: Array, start: Array, period: Array) -> Reading:
        """Return the reading at substeps `start` (N,), of nominal periods `period` (N,).

        `truth` (N, 2n) holds q and q' of the plants.
        """
        count, n = self._raw.shape
        noise = whole(self._noise_draws.take(), self._noise) if self._noise_draws else None
        self._count(truth, noise)
        valid = np.ones((count, n), np.uint32)
        if self._dropout_draws:
            valid[self._dropout_draws.take() < self._dropout] = 0
        elapsed = self._elapsed(start, period)
        clocks = {"frame": period.copy(), "heartbeat": period.copy()}
        for fault, first, last, rigs in self._faults:
            active = rigs & (period >= first) & (period < last)
            self._break(fault, active, valid, elapsed, clocks)
        self._frozen, self._clocks = self._raw.copy(), clocks
        command = self._command(period)
        self._before = start.copy()
        return Reading(
            self._raw.copy(),
            valid,
            elapsed,
            clocks["frame"],
            clocks["heartbeat"],
            command,
            truth.copy(),
        )

    def _count(self, truth: Array, noise: Array | None) -> None:
        for k, channel in enumerate(self._channels):
            encoder = channel.encoder
            counts = encoder.counts(truth[:, k] - self.offset[:, k]) + encoder.counter_zero
            if noise is not None:
                counts += noise[:, k]
            self._raw[:, k] = counts & ((1 << encoder.counter_bits) - 1)

    def _elapsed(self, start: Array, period: Array) -> Array:
        """Return the time since the turn before; one nominal period in the first turn."""
        steps = start.astype(np.int64) - self._before
        steps[period == 0] = self.scenario.substeps
        return np.asarray(self.scenario.base.sample_time * (steps / self.scenario.substeps))

    def _break(
        self, fault: Fault, active: Array, valid: Array, elapsed: Array, clocks: dict[str, Array]
    ) -> None:
        """Put one fault into the reading of the rigs in which it is `active`."""
        if not active.any():
            return
        if fault.joint:
            k = self.scenario.coordinates.index(fault.joint)
        if fault.kind == "freeze_encoder":
            self._raw[active, k] = self._frozen[active, k]
        elif fault.kind == "jump":
            mask = (1 << self._channels[k].encoder.counter_bits) - 1
            self._raw[active, k] = (self._raw[active, k].astype(np.int64) + fault.counts) & mask
        elif fault.kind == "drop_reading":
            valid[active, k] = 0
        elif fault.kind == "nan_elapsed":
            elapsed[active] = np.nan
        else:
            name = "frame" if fault.kind == "stall_frame" else "heartbeat"
            clocks[name][active] = self._clocks[name][active] if self._clocks else 0

    def _command(self, period: Array) -> Array:
        """Return the last order that fell into the time since the turn before, uint32 (N,)."""
        command = np.zeros(len(period), np.uint32)
        for at, value in self._orders:
            command[(period >= at) & (self._period < at)] = value
        self._period = period.astype(np.int64)
        return command


def _chosen(fault: Fault, rigs: range) -> Array:
    """Return which of `rigs` a fault befalls, bool (N,)."""
    return np.array([not fault.rigs or r in fault.rigs for r in rigs])
