"""What the tests of the supervisor share: inputs, a seal in NumPy, and a reference in Python."""

from dataclasses import dataclass, field
from fractions import Fraction
from math import isfinite

import numpy as np
from pfaffian.runtime.code.supervision import (
    Check,
    Fault,
    Mode,
    Order,
    Position,
    Reason,
    host_supervisor,
)
from pfaffian.runtime.contract.runtime_structs import SUPERVISOR

HOST = host_supervisor()
PERIOD = 2.0**-10  # a power of two: no product below is rounded
INSIDE, BETWEEN, OUTSIDE = 0.5, 1.5, 5.0  # of limits 1 and 2
#: Members of the state under its seal, in that order: all scalars but the complements.
SEALED = [n for n, _, *shape in SUPERVISOR["state"] if not shape and n != "seal"]
SEALED = [n for n in SEALED if not n.endswith("_inverse")]


def parameters(count=1, **changes):
    """Return good parameters: 3 periods to capture, 2 to release, nothing forgiven, no limits."""
    p = np.zeros(count, HOST.type("params"))
    p["sample_time"], p["shortest_period"], p["longest_period"] = PERIOD, 0.5, 1.5
    p["capture_limit"], p["release_limit"] = 1.0, 2.0
    p["capture_periods"], p["release_periods"] = 3, 2
    for name, value in changes.items():
        p[name] = value
    return p


def init_in_place(state, params):
    """Initialise records `state` (k,) as they lie, whatever they hold; return the statuses (k,).

    `HOST.init` hands out memory of zeros, which hides what an init forgets to clear.
    """
    status = np.zeros(len(params), np.int32)
    HOST.machine.call("pf_supervisor_batch_init", len(params), state, params, status)
    return status


def periods(number, frame=1, measure=INSIDE, count=1):
    """Return inputs (number, count) in which nothing is wrong and nothing is ordered."""
    given = np.zeros((number, count), HOST.type("input"))
    given["elapsed"], given["measures"], given["measure"] = PERIOD, 2, measure
    given["frame"] = frame + np.arange(number)[:, None]
    given["heartbeat"] = given["frame"]
    return given


class Unit:
    """One supervisor, whose frames and heartbeats go on by themselves."""

    def __init__(self, **changes):
        """Initialise it with `parameters(**changes)`."""
        self.params, self.frame = parameters(**changes), 0
        self.state, self.status = HOST.init(self.params)

    def given(self, number=1, **columns):
        """Return its next inputs, with `columns` set in every one of them."""
        given = periods(number, self.frame + 1)
        self.frame += number
        for name, value in columns.items():
            given[name] = value
        return given

    def run(self, number=1, **columns):
        """Step it; return the outputs (number,)."""
        return self.feed(self.given(number, **columns))

    def feed(self, given):
        """Step it through inputs (n, 1); return the outputs (n,)."""
        return HOST.run(self.state, self.params, given)[:, 0]

    def bring_to(self, mode):
        """Lead it from IDLE to `mode`, and return itself."""
        self.run(2, measure=OUTSIDE)
        if mode == Mode.FAULT:
            self.run(1, checks=Check.RANGE)
        elif mode != Mode.IDLE:
            self.run(1, measure=OUTSIDE, command=Order.START)
            if mode == Mode.BALANCE:
                self.run(int(self.params["capture_periods"][0]))
        assert HOST.modes(self.state)[0] == mode
        return self

    def log(self):
        """Return every transition that can still be read, oldest first."""
        found = []
        logged = int(self.state["logged"][0])
        for number in range(max(0, logged - 15), logged):
            row, there = HOST.transition(self.state, number)
            assert there[0]
            found.append(tuple(row[0].tolist()))
        return found


def fnv(words, sums):
    """Return the checksums uint32 (k,) after one more word each."""
    mixed = ((sums ^ words).astype(np.uint64) * np.uint64(16777619)).astype(np.uint32)
    return mixed ^ (mixed >> np.uint32(15))


def sealed(state):
    """Write complements and seals into `state` (k,) as the header describes them; return it."""
    for name in ("mode", "fault", "ready"):
        state[f"{name}_inverse"] = ~state[name]
    sums = np.full(len(state), 2166136261, np.uint32)
    for name in SEALED:
        sums = fnv(state[name], sums)
    state["seal"] = sums
    return state


def expected(output):
    """Return one output as a tuple: mode, fault, reason, entered, torque allowed."""
    return tuple(int(output[n]) for n in ("mode", "fault", "reason", "entered", "torque_allowed"))


@dataclass
class Reference:
    """What docs/supervisor.md says, in exact arithmetic and without any seal."""

    capture_periods: int = 3
    release_periods: int = 2
    forgiven: int = 0
    attempts: int = 0
    watchdog: Fraction = Fraction(0)
    timeout: Fraction = Fraction(0)
    mode: Mode = Mode.IDLE
    fault: Fault = Fault.NONE
    reason: Reason = Reason.NONE
    trusted: bool = True
    calls: int = 0
    age: int = 0  # of the mode
    run_in: int = 0
    run_out: int = 0
    frame: int | None = None
    heartbeat: int | None = None
    silent: int = 0
    late: int = 0
    punctual: int = 0
    lost: int = 0
    log: list = field(default_factory=list)

    def go(self, mode, fault, reason):
        """Change the mode, and write it down."""
        shown = self.frame or 0
        self.log.append((self.calls, shown, int(self.mode), int(mode), int(reason), int(fault)))
        self.mode, self.fault, self.reason = mode, fault, reason
        self.age = self.run_in = self.run_out = 0

    def answer(self, before):
        """Return the outputs of a period that began in mode `before`."""
        active = self.mode in (Mode.SWING_UP, Mode.BALANCE)
        return (*map(int, (self.mode, self.fault, self.reason, self.mode != before, active)),)

    def find(self, checks, measures, elapsed, frame, heartbeat):
        """Follow clocks and counters; return what is wrong, the first in order of rank."""
        first, stale = self.frame is None, frame == self.frame
        self.silent = 0 if first or heartbeat != self.heartbeat else self.silent + 1
        self.frame, self.heartbeat, too_late = frame, heartbeat, False
        whole = Fraction(elapsed) / Fraction(PERIOD) if isfinite(elapsed) else None
        if not first:
            if whole is not None and Fraction(1, 2) <= whole <= Fraction(3, 2):
                self.punctual += 1
                if self.punctual % 1000 == 0 and self.late:
                    self.late -= 1
            else:
                self.punctual, self.late = 0, self.late + 1
                too_late = self.late > self.forgiven
        silence = self.silent * Fraction(PERIOD)
        ranked = [(checks & bit, Fault[bit.name]) for bit in Check]
        ranked += [(checks & ~sum(Check) or not 1 <= measures <= 8, Fault.INTERFACE)]
        ranked += [(whole is None, Fault.NOT_FINITE), (stale, Fault.STALE)]
        ranked += [(too_late, Fault.OVERRUN)]
        ranked += [(self.watchdog and silence > self.watchdog, Fault.WATCHDOG)]
        return next((fault for found, fault in ranked if found), Fault.NONE)

    def note(self, reason):
        """Write down what became of an order, once for as long as it is given."""
        if self.reason != reason:
            shown, mode = self.frame or 0, int(self.mode)
            self.log.append((self.calls, shown, mode, mode, int(reason), int(self.fault)))
            self.reason = reason

    def step(self, *, command, measure, position=0, **seen):
        """Return the outputs of one period; `measure` are those in use."""
        before, order = self.mode, command
        self.calls, self.age = self.calls + 1, self.age + 1
        wrong = self.find(**seen)
        if position & Position.REZEROED:
            self.note(Reason.REZEROED)
        elif position & Position.REFUSED:
            self.note(Reason.REZERO_REFUSED)
        if self.mode == Mode.FAULT:
            if order == Order.RESET and not wrong and self.trusted:
                self.late = 0
                self.go(Mode.IDLE, Fault.NONE, Reason.RESET)
        elif wrong:
            self.go(Mode.FAULT, wrong, Reason.FAULT)
        elif order == Order.STOP and self.mode != Mode.IDLE:
            self.go(Mode.IDLE, Fault.NONE, Reason.STOPPED)
        elif self.mode == Mode.IDLE:
            if order == Order.START and position & Position.UNREAD:
                self.note(Reason.NO_READING)
            elif order == Order.START:
                self.lost = 0
                self.go(Mode.SWING_UP, Fault.NONE, Reason.STARTED)
        elif self.mode == Mode.SWING_UP:
            self.run_in = self.run_in + 1 if all(0 <= m <= 1 for m in measure) else 0
            if self.run_in >= self.capture_periods:
                self.go(Mode.BALANCE, Fault.NONE, Reason.CAPTURED)
            elif self.timeout and self.age * Fraction(PERIOD) > self.timeout:
                self.go(Mode.FAULT, Fault.SWING_UP_TIMEOUT, Reason.FAULT)
        else:
            self.run_out = 0 if all(0 <= m <= 2 for m in measure) else self.run_out + 1
            if self.run_out >= self.release_periods:
                self.lost += 1
                if self.attempts and self.lost > self.attempts:
                    self.go(Mode.FAULT, Fault.ATTEMPTS, Reason.FAULT)
                else:
                    self.go(Mode.SWING_UP, Fault.NONE, Reason.RELEASED)
        return self.answer(before)

    def trip(self, fault, entered):
        """Return the outputs after a trip in a period whose step said `entered`."""
        before = self.mode
        if before == Mode.FAULT:
            return (*self.answer(before)[:3], entered, 0)
        self.go(Mode.FAULT, fault, Reason.FAULT)
        return self.answer(before)

    def corrupted(self):
        """Return the outputs of a period in which the memory is found to be changed."""
        self.calls, self.trusted = self.calls + 1, False
        self.go(Mode.FAULT, Fault.STATE_CORRUPT, Reason.FAULT)
        return (3, int(Fault.STATE_CORRUPT), int(Reason.FAULT), 1, 0)
