"""A flight on the twin: read, step the control unit, advance the rigs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import CheckError, InputError
from pfaffian.runtime.code.generated_model import GeneratedModel
from pfaffian.runtime.twin.recording import Fingerprint, Flight, Recorder, Wanted, own_signal
from pfaffian.runtime.twin.rig import Rigs, plant_model
from pfaffian.runtime.twin.schedule import Schedule
from pfaffian.runtime.twin.sensors import Sensors
from pfaffian.runtime.twin.settings import Fault, TwinScenario
from pfaffian.runtime.twin.statistics import Observer
from pfaffian.runtime.twin.unit import Command, ControlUnit, FlippableUnit

Progress = Callable[[int, int], None]


class Twin:
    """The rigs of a scenario and all that stands between them and a control unit."""

    def __init__(
        self, scenario: TwinScenario, model: GeneratedModel | None = None, threads: int = 1
    ) -> None:
        """Build the plant, unless `model` is one of `plant_model`, and draw the rigs.

        `threads` share the plants' work; the bits do not depend on them.
        """
        self.scenario = scenario
        self.model = model or plant_model(scenario.base.folder)
        self.rigs = Rigs(scenario, self.model, threads)
        self.schedule = Schedule(scenario)
        self.sensors = Sensors(scenario)
        self._flips = [f for f in scenario.faults if f.kind == "flip"]

    def fly(
        self, unit: ControlUnit, wanted: Wanted | None = None, progress: Progress | None = None
    ) -> Flight:
        """Fly once, from start to end: a twin is used up by it."""
        of, turns = self.scenario, self.schedule.turns
        recorder = Recorder(of, wanted or Wanted(), turns)
        observer, fingerprint = Observer(of), Fingerprint(of.rigs)
        unit.start(of.rigs)
        start = self.schedule.starts(0)
        before = np.full(of.rigs, -1)
        try:
            for turn in range(turns):
                following = self.schedule.starts(turn + 1)
                period = self.schedule.periods(start)
                self._flip(unit, before, period)
                reading = self.sensors.read(self.rigs.truth, start, period)
                command = unit.step(reading)
                if turn == 0:
                    _check_command(command, of)
                live = None if start.max() < self.schedule.end else start < self.schedule.end
                time = self._time(start)
                observer.take(time, live, reading.truth, command)
                fingerprint.take(command, live)
                due = recorder.due(turn)
                more = self._energy(recorder) if due else {}
                self.rigs.advance(start, following - start, command.torque)
                if due:
                    more |= self._applied(recorder.rigs)
                    recorder.take(turn, time, live, reading, command, more)
                start, before = following, period.astype(np.int64)
                if progress and (turn + 1) % 100 == 0:
                    progress(turn + 1, turns)
        finally:
            self.rigs.close()
        return recorder.flight(observer.statistics(self.rigs.lost), fingerprint.digests())

    def _time(self, start: Array) -> Array:
        """Return the time of substeps, seconds: k T exactly at nominal instants."""
        return np.asarray(self.scenario.base.sample_time * (start / self.scenario.substeps))

    def _energy(self, recorder: Recorder) -> dict[str, Array]:
        """Return the energy of the recorded rigs before the turn, if it is wanted."""
        name = own_signal(self.scenario, "energy")
        return {name: self.rigs.energy(recorder.rigs)} if recorder.wants(name) else {}

    def _applied(self, rigs: Array) -> dict[str, Array]:
        names = self.scenario.actuators
        own = [own_signal(self.scenario, f"{n}_applied") for n in names]
        return {n: self.rigs.applied[rigs, k] for k, n in enumerate(own)}

    def _flip(self, unit: ControlUnit, before: Array, period: Array) -> None:
        """Flip the bits that are due since the turn before."""
        for fault in self._flips:
            at = self.scenario.periods(fault.time)
            due = self._befallen(fault) & (before < at) & (period >= at)
            if not due.any():
                continue
            if not isinstance(unit, FlippableUnit):
                raise InputError(
                    f"{self.scenario.base.name}: fault flip: the controller has no parameter "
                    "memory to reach",
                    remedy="leave the fault out, or give the unit flip_parameter",
                )
            unit.flip_parameter(np.flatnonzero(due), fault.parameter, fault.bit)

    def _befallen(self, fault: Fault) -> Array:
        return np.array([not fault.rigs or r in fault.rigs for r in self.rigs.numbers])


def fly_twin(
    scenario: TwinScenario,
    unit: ControlUnit,
    wanted: Wanted | None = None,
    *,
    model: GeneratedModel | None = None,
    threads: int = 1,
    progress: Progress | None = None,
) -> Flight:
    """Fly `scenario` with `unit`: see `Twin`."""
    return Twin(scenario, model, threads).fly(unit, wanted, progress)


def _check_command(command: Command, scenario: TwinScenario) -> None:
    """Refuse a command whose arrays have other shapes: C would read past their end."""
    count, n, m = scenario.rigs, len(scenario.coordinates), len(scenario.actuators)
    shapes = {
        "torque": (count, m),
        "mode": (count,),
        "fault": (count,),
        "angle": (count, n),
        "velocity": (count, n),
    }
    for name, shape in shapes.items():
        have = getattr(command, name).shape
        if have != shape:
            raise CheckError(
                f"the control unit's {name} has shape {have}", remedy=f"give shape {shape}"
            )
