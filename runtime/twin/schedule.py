"""When each rig samples: instants on the grid of substeps, with jitter, missed and skipped ones."""

from __future__ import annotations

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.twin.draws import Purpose, streams, whole
from pfaffian.runtime.twin.settings import Fault, TwinScenario

_MOST_SUBSTEPS = 2**31 - 1


class Schedule:
    """The sampling instants of N rigs.

    Rigs go through their own instants side by side: in turn j every rig is at its j-th instant,
    whichever that is, and a rig whose flight is over stays at the end.
    """

    def __init__(self, scenario: TwinScenario) -> None:
        """Lay out all instants; where all rigs are regular, none is stored."""
        self._every, self._periods = scenario.substeps, scenario.base.steps
        self._count = scenario.rigs
        self.end = self._every * self._periods
        if self.end > _MOST_SUBSTEPS:
            raise InputError(
                f"{scenario.base.name}: {self.end} substeps are more than a twin counts",
                remedy=f"fly at most {_MOST_SUBSTEPS} substeps: shorter, or fewer a period",
            )
        self._reach = int(scenario.sampling.jitter * self._every + 0.5)
        skips = [f for f in scenario.faults if f.kind == "skip"]
        regular = not (self._reach or scenario.sampling.missed or skips)
        self._starts = None if regular else self._irregular(scenario, skips)
        self.turns = self._periods if self._starts is None else len(self._starts)

    def _irregular(self, scenario: TwinScenario, skips: list[Fault]) -> Array:
        """Return the instants, int32 (turns, N), filled up with the end."""
        rigs = range(scenario.first_rig, scenario.first_rig + scenario.rigs)
        jitter = streams(scenario.seed, rigs, Purpose.JITTER)
        missed = streams(scenario.seed, rigs, Purpose.MISSED)
        found = []
        for number, moved, lost in zip(rigs, jitter, missed, strict=True):
            instants: Array = np.arange(self._periods) * self._every
            if self._reach:
                instants[1:] += whole(moved.random(self._periods), self._reach)[1:]
            kept = lost.random(self._periods) >= scenario.sampling.missed
            for fault in skips:
                if not fault.rigs or number in fault.rigs:
                    kept[slice(*window(scenario, fault))] = False
            kept[0] = True
            found.append(instants[kept].astype(np.int32))
        starts = np.full((max(map(len, found)), len(found)), self.end, np.int32)
        for column, instants in enumerate(found):
            starts[: len(instants), column] = instants
        return starts

    def starts(self, turn: int) -> Array:
        """Return the substep at which each rig samples in `turn`, uint32 (N,); the end after it."""
        if self._starts is None:
            return np.full(self._count, min(turn, self._periods) * self._every, np.uint32)
        if turn >= self.turns:
            return np.full(self._count, self.end, np.uint32)
        return np.asarray(self._starts[turn].astype(np.uint32))

    def periods(self, starts: Array) -> Array:
        """Return which nominal instant each start belongs to, uint32 (N,)."""
        return np.asarray((starts + np.uint32(self._reach)) // np.uint32(self._every), np.uint32)


def window(scenario: TwinScenario, fault: Fault) -> tuple[int, int]:
    """Return the nominal periods (first, last + 1) of a fault: at least one, if within the end."""
    first = scenario.periods(fault.time)
    last = scenario.periods(fault.time + fault.duration)
    return first, max(last, first + 1)
