"""What flies on the twin: readings in, commands out, once a period, for N rigs at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from pfaffian.runtime.base.arrays import Array

#: Orders of the operator, as `Reading.command` shows them.
NO_COMMAND, START, STOP, RESET = range(4)
COMMANDS = {"start": START, "stop": STOP, "reset": RESET}
#: Modes of a controller, as `Command.mode` shows them.
IDLE, SWING_UP, BALANCE, FAULT = range(4)
MODES = ("idle", "swing-up", "balance", "fault")


@dataclass(frozen=True)
class Reading:
    """What the controllers of N rigs of n coordinates read at the start of a period.

    `counts` uint32 (N, n) are the encoders' counters, `valid` uint32 (N, n) is 0 where there was no
    reading. `elapsed` float64 (N,) is the time since the period before, seconds (the nominal
    period in the first one). `frame` uint32 (N,) counts sampling instants and `heartbeat` (N,)
    those of whoever supervises the controller; `command` (N,) is the operator's order. `truth` is
    the plant's own state, float64 (N, 2n), q before q': no controller has it, ideal units of tests
    do. The arrays are the twin's own, and hold until the next reading.
    """

    counts: Array
    valid: Array
    elapsed: Array
    frame: Array
    heartbeat: Array
    command: Array
    truth: Array


@dataclass(frozen=True)
class Command:
    """What the controllers of N rigs command: `torque` float64 (N, m), SI units.

    `mode` and `fault` are uint32 (N,), 0 for no fault; `angle` and `velocity` float64 (N, n) are
    what was sensed, `signals` (N,) by name whatever else is worth logging. The names are the same
    in every period.
    """

    torque: Array
    mode: Array
    fault: Array
    angle: Array
    velocity: Array
    signals: Mapping[str, Array] = field(default_factory=dict)


class ControlUnit(Protocol):
    """A controller of N rigs, each with a memory of its own."""

    def start(self, count: int) -> None:
        """Prepare for `count` rigs, before the first period."""

    def step(self, reading: Reading) -> Command:
        """Return what is commanded in this period."""


@runtime_checkable
class FlippableUnit(Protocol):
    """A controller whose parameters the fault `flip` can reach."""

    def flip_parameter(self, rigs: Array, name: str, bit: int) -> None:
        """Invert bit `bit` of parameter `name` in rigs (k,); raise `InputError` for no such one."""
