"""What a flight on the twin leaves: signals of a few rigs, and a digest of what all commanded."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.given_names import given_away
from pfaffian.runtime.base.toml import suggestion
from pfaffian.runtime.twin.settings import TwinScenario
from pfaffian.runtime.twin.statistics import Statistics
from pfaffian.runtime.twin.unit import BALANCE, Command, Reading

_BLOCK = 64


@dataclass(frozen=True)
class Wanted:
    """What to record: of which rigs (indices), every how many turns, and which signals.

    Signals are the plant's coordinates and rates by name, `angle_Q` and `velocity_Q` as sensed,
    `counts_Q`, `valid_Q`, `ACTUATOR` as commanded and `ACTUATOR_applied` at the period's end,
    `elapsed`, `frame`, `heartbeat`, `command`, `mode`, `fault`, `energy`, and the unit's own. Empty
    means all.
    """

    rigs: Sequence[int] = (0,)
    every: int = 1
    signals: Sequence[str] = ()


@dataclass(frozen=True)
class Flight:
    """A flight of N rigs on the twin.

    `time` (K, R) holds the sampling instants of the R recorded rigs, seconds, NaN after a rig's
    last one; `signals` (K, R) by name. `digests` are the SHA-256 of every rig's outputs: torque,
    angle, velocity and signals of each turn as float64, then mode and fault, little-endian.
    """

    scenario: TwinScenario
    rigs: tuple[int, ...]
    time: Array
    signals: Mapping[str, Array]
    statistics: Statistics
    digests: tuple[str, ...]

    def sha256(self) -> str:
        """Return the digest of a single rig's outputs, or that of all digests in order."""
        if len(self.digests) == 1:
            return self.digests[0]
        return hashlib.sha256("".join(self.digests).encode()).hexdigest()


class Fingerprint:
    """The SHA-256 of the outputs of every rig, taken some turns at a time."""

    def __init__(self, count: int) -> None:
        """Prepare for `count` rigs."""
        self._hashes = [hashlib.sha256() for _ in range(count)]
        self._rows: list[Array] = []
        self._live: Array = np.zeros(count, np.int64)

    def take(self, command: Command, live: Array | None) -> None:
        """Take the outputs of one turn; a rig that is not in `live` has none any more."""
        parts = [command.torque, command.angle, command.velocity]
        parts += [command.signals[n][:, None] for n in sorted(command.signals)]
        parts += [command.mode[:, None], command.fault[:, None]]
        self._rows.append(np.concatenate(parts, 1, dtype="<f8"))
        self._live += 1 if live is None else live
        if len(self._rows) == _BLOCK:
            self._flush()

    def _flush(self) -> None:
        if not self._rows:
            return
        block = np.ascontiguousarray(np.stack(self._rows, 1))  # (N, turns, width)
        for total, rows, kept in zip(self._hashes, block, self._live.tolist(), strict=True):
            total.update(memoryview(rows[:kept]))
        self._rows, self._live = [], np.zeros_like(self._live)

    def digests(self) -> tuple[str, ...]:
        """Return the digests so far, hexadecimal."""
        self._flush()
        return tuple(h.hexdigest() for h in self._hashes)


class Recorder:
    """Keeps the wanted signals of the wanted rigs."""

    def __init__(self, scenario: TwinScenario, wanted: Wanted, turns: int) -> None:
        """Check `wanted`; raise `InputError` for rigs that do not fly or no decimation."""
        self._rigs = np.array(wanted.rigs, np.int64).reshape(-1)
        if wanted.every < 1 or ((self._rigs < 0) | (self._rigs >= scenario.rigs)).any():
            raise InputError(
                f"recording rigs {tuple(wanted.rigs)} every {wanted.every} turns",
                remedy=f"choose rigs from 0 to {scenario.rigs - 1}, and every 1 turn or more",
            )
        self._wanted, self._scenario = wanted, scenario
        self._rows = -(-turns // wanted.every)
        self._time = np.full((self._rows, len(self._rigs)), np.nan)
        self._logs: dict[str, Array] = {}

    @property
    def rigs(self) -> Array:
        """Return the indices of the rigs that are recorded."""
        return self._rigs

    def due(self, turn: int) -> bool:
        """Return whether a turn is recorded."""
        return len(self._rigs) > 0 and turn % self._wanted.every == 0

    def wants(self, name: str) -> bool:
        """Return whether a signal is recorded."""
        return not self._wanted.signals or name in self._wanted.signals

    def take(
        self,
        turn: int,
        time: Array,
        live: Array | None,
        reading: Reading,
        command: Command,
        more: Mapping[str, Array],
    ) -> None:
        """Record a turn; `more` holds signals (R,) of the recorded rigs."""
        row, rigs = turn // self._wanted.every, self._rigs
        signals = _signals(self._scenario, reading, command)
        if not self._logs:
            self._open({n: a[rigs] for n, a in signals.items()} | dict(more))
        alive = np.ones(len(rigs), bool) if live is None else live[rigs]
        self._time[row, alive] = time[rigs][alive]
        for name, log in self._logs.items():
            values = more[name] if name in more else signals[name][rigs]
            log[row, alive] = values[alive]

    def _open(self, found: Mapping[str, Array]) -> None:
        names = self._wanted.signals or tuple(found)
        for name in names:
            if name not in found:
                raise InputError(
                    f"no signal {name} to record", remedy=suggestion(name, sorted(found))
                )
        shape = (self._rows, len(self._rigs))
        self._logs = {n: np.zeros(shape, found[n].dtype) for n in names}

    def flight(self, statistics: Statistics, digests: tuple[str, ...]) -> Flight:
        """Return the flight recorded."""
        rigs = tuple(int(r) for r in self._rigs)
        return Flight(self._scenario, rigs, self._time, self._logs, statistics, digests)


def own_signal(scenario: TwinScenario, name: str) -> str:
    """Return the name of a signal of ours, beside the coordinates and actuators of `scenario`."""
    rates = (f"d{c}" for c in scenario.coordinates)
    return given_away(name, (*scenario.coordinates, *rates, *scenario.actuators))


def _signals(scenario: TwinScenario, reading: Reading, command: Command) -> dict[str, Array]:
    """Return all signals of a turn that reading and command hold, (N,) by name.

    A name of ours that a coordinate or actuator has gives way.
    """
    found: dict[str, Array] = {}
    own = partial(own_signal, scenario)
    n = len(scenario.coordinates)
    for k, name in enumerate(scenario.coordinates):
        found[name], found[f"d{name}"] = reading.truth[:, k], reading.truth[:, n + k]
        found[own(f"angle_{name}")] = command.angle[:, k]
        found[own(f"velocity_{name}")] = command.velocity[:, k]
        found[own(f"counts_{name}")] = reading.counts[:, k]
        found[own(f"valid_{name}")] = reading.valid[:, k]
    for k, name in enumerate(scenario.actuators):
        found[name] = command.torque[:, k]
    for name in ("elapsed", "frame", "heartbeat", "command"):
        found[own(name)] = getattr(reading, name)
    return {**found, "mode": command.mode, "fault": command.fault, **command.signals}


def differing_bits(one: Flight, other: Flight) -> int:
    """Return how many bits of all recorded signals differ between two flights of equal length."""
    total = 0
    for name, mine in one.signals.items():
        width = f"u{mine.dtype.itemsize}"
        changed = mine.view(width) ^ other.signals[name].astype(mine.dtype).view(width)
        total += int(np.bitwise_count(changed).sum())
    return total


def entered_at(flight: Flight) -> int:
    """Return the index from which BALANCE lasted to the end, or -1."""
    other = np.flatnonzero(flight.signals["mode"][:, 0] != BALANCE)
    first = int(other[-1]) + 1 if len(other) else 0
    return first if first < len(flight.time) else -1
