"""Names of what this package computes, beside those that a person gives.

A person's names stay what they are. Where one of ours meets one of theirs, ours gives way, by the
one rule here: it gets the suffix `_law`, as often as it takes. Without a meeting it stays the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from pfaffian.runtime.base.given_names import given_away

#: What the laws compute for each actuator; of several, each gets the actuator's name as its ending.
PER_ACTUATOR = (
    "p1",
    "p2",
    "p3",
    "bhat",
    "mu",
    "torque",
    "torque_least",
    "torque_most",
    "torque_slewed",
    "command",
)
#: What the law remembers of each actuator: `thrust_previous`.
PREVIOUS = "previous"


class _Named(Protocol):
    @property
    def name(self) -> str:
        """The name that was declared."""


class Interface(Protocol):
    """What has coordinates, actuators and parameters: a specification, or a lowered model."""

    @property
    def coordinates(self) -> Iterable[_Named]:
        """The generalised coordinates."""

    @property
    def actuators(self) -> Iterable[_Named]:
        """The inputs."""

    @property
    def parameters(self) -> Iterable[_Named]:
        """Everything else that has a value."""


@dataclass(frozen=True)
class OwnNames:
    """Hands out our names: none is one of `declared`, and none is handed out for two things.

    `actuators` are the names of the actuators in order; what is computed for each of several takes
    its ending from them, and may so meet a name of ours that is fixed: that one gives way.
    """

    declared: frozenset[str]
    actuators: tuple[str, ...]

    def __call__(self, name: str) -> str:
        """Return the name of what the law calls `name`."""
        return given_away(name, self._avoided)

    def numbered(self, base: str) -> tuple[str, ...]:
        """Return `base` alone for one servo-constraint, `base1`, `base2`, ... for more."""
        count = len(self.actuators)
        bare = [base] if count == 1 else [f"{base}{k + 1}" for k in range(count)]
        return tuple(self(name) for name in bare)

    def of_actuators(self, base: str) -> tuple[str, ...]:
        """Return `base` alone for one actuator, `base_thrust`, `base_moment`, ... for more."""
        if len(self.actuators) == 1:
            return (self(base),)
        return tuple(self._made[base, a] for a in self.actuators)

    def previous(self, actuator: str) -> str:
        """Return the name of what was last commanded of `actuator`."""
        return self._made[PREVIOUS, actuator]

    def reference(self, coordinates: Sequence[str]) -> tuple[str, ...]:
        """Return the members of a reference in order: q, q', q'', R0, R1, R0', R1', each once.

        R0 and R1 (m, n) hold the weights of q and q', row by row.
        """
        rows = range(1, len(self.actuators) + 1)
        numbers = [str(r) for r in rows] if len(self.actuators) > 1 else [""]
        wanted = [f"{d}{c}_ref" for d in ("", "d", "dd") for c in coordinates]
        wanted += [
            f"row{r}_{d}{c}{ending}"
            for ending in ("", "_rate")
            for d in ("", "d")
            for r in numbers
            for c in coordinates
        ]
        taken, made = set(self._avoided), []
        for name in wanted:
            made.append(given_away(name, taken))
            taken.add(made[-1])
        return tuple(made)

    def given_way(self, members: Iterable[str]) -> dict[str, str]:
        """Return those of `members` that are ours and gave way, by their usual names, sorted."""
        usual = {f"{base}_{a}": name for (base, a), name in self._made.items() if base != PREVIOUS}
        usual |= {f"{a}_{PREVIOUS}": self.previous(a) for a in self.actuators}
        usual |= {name: self(name) for name in self._avoided if name not in usual}
        there = set(members)
        return {n: g for n, g in sorted(usual.items()) if n != g and g in there}

    @cached_property
    def _avoided(self) -> frozenset[str]:
        return self.declared | frozenset(self._made.values())

    @cached_property
    def _made(self) -> dict[tuple[str, str], str]:
        """Return the names that end, or begin, with an actuator's, each once."""
        made: dict[tuple[str, str], str] = {}
        taken = set(self.declared)
        bases = PER_ACTUATOR if len(self.actuators) > 1 else ()
        wanted = {(b, a): f"{b}_{a}" for b in bases for a in self.actuators}
        wanted |= {(PREVIOUS, a): f"{a}_{PREVIOUS}" for a in self.actuators}
        for key, name in wanted.items():
            made[key] = given_away(name, taken)
            taken.add(made[key])
        return made


def declared_names(given: Interface) -> frozenset[str]:
    """Return every name that `given` declares: coordinates with their rates, and all others."""
    motion = {f"{order}{c.name}" for c in given.coordinates for order in ("", "d", "dd")}
    return frozenset(motion | {x.name for x in (*given.actuators, *given.parameters)})


def own_names(given: Interface) -> OwnNames:
    """Return what hands out our names beside those that `given` declares."""
    return OwnNames(declared_names(given), tuple(a.name for a in given.actuators))


def derivative_name(of: str, by: str) -> str:
    """Return the name of d(of)/d(by) in the generated code."""
    return f"{of}_by_{by}"
