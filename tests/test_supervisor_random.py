"""The supervisor against a reference in Python, on random bits, and on the target."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from pfaffian.runtime.code.supervision import (
    Check,
    Fault,
    Mode,
    Order,
    Position,
    Reason,
    ppc750_supervisor,
)
from support_supervisor import (
    BETWEEN,
    HOST,
    INSIDE,
    OUTSIDE,
    PERIOD,
    SEALED,
    Reference,
    Unit,
    expected,
    init_in_place,
    parameters,
    periods,
    sealed,
)

COUNTS = st.integers(1, 4)
ORDERS = st.sampled_from([0, 0, 0, *Order, *Order, 5, 0xFFFFFFFF])
POSITIONS = st.sampled_from([0, *Position, 0x3, 0x6, 0xFFFFFFF0])
MEASURES = st.sampled_from([0.0, INSIDE, 1.0, BETWEEN, 2.0, OUTSIDE, -0.1, np.nan, np.inf, 1e301])
ELAPSED = st.sampled_from([0.5, 1.0, 1.5, 0.4999, 1.5001, 0.0, -1.0, 1e300, np.nan, -np.inf])
CHECKS = st.sampled_from([*Check, 0x200, 0x80000000, 0x1FF, 0xFFFFFFFF, 0x8008])


class AgainstTheReference(RuleBasedStateMachine):
    """Whatever is done to it, the C answers as the reference does, and logs the same."""

    @initialize(
        capture=COUNTS,
        release=COUNTS,
        forgiven=st.integers(0, 3),
        attempts=st.integers(0, 3),
        watchdog=st.integers(0, 6),
        timeout=st.integers(0, 30),
    )
    def begin(self, capture, release, forgiven, attempts, watchdog, timeout):
        self.unit = Unit(
            capture_periods=capture,
            release_periods=release,
            overruns=forgiven,
            attempts=attempts,
            watchdog_time=watchdog * PERIOD,
            swing_up_timeout=timeout * PERIOD,
        )
        self.reference = Reference(capture, release, forgiven, attempts)
        self.reference.watchdog = watchdog * Fraction(PERIOD)
        self.reference.timeout = timeout * Fraction(PERIOD)
        self.beat = self.frame = 0

    def period(
        self, order=0, inner=INSIDE, outer=INSIDE, checks=0, measures=2, elapsed=1.0, position=0
    ):
        """Give both the same period and compare what they say; return it."""
        given = periods(1, self.frame)
        given["heartbeat"], given["command"], given["checks"] = self.beat, order, checks
        given["measures"], given["elapsed"] = measures, elapsed * PERIOD
        given["position"] = position
        given["measure"] = np.inf  # beyond those in use: not looked at
        given["measure"][0, 0, :2] = inner, outer
        if measures > 2:
            given["measure"][0, 0, 2:] = INSIDE
        out = self.unit.feed(given)
        wanted = self.reference.step(
            command=order,
            position=position,
            measure=(inner, outer)[:measures],
            checks=int(checks),
            measures=measures,
            elapsed=elapsed * PERIOD,
            frame=self.frame,
            heartbeat=self.beat,
        )
        assert expected(out[0]) == wanted
        return out

    @rule(order=ORDERS, inner=MEASURES, outer=MEASURES, count=st.integers(1, 5))
    def go_on(self, order, inner, outer, count):
        for _ in range(count):
            self.frame, self.beat = self.frame + 1, self.beat + 1
            self.period(order, inner, outer, measures=2)

    @rule(order=ORDERS, position=POSITIONS, count=st.integers(1, 3))
    def know_the_position_or_not(self, order, position, count):
        for _ in range(count):
            self.frame, self.beat = self.frame + 1, self.beat + 1
            self.period(order, position=position)

    @rule(count=st.integers(1, 40), order=ORDERS, measure=MEASURES)
    def stay(self, count, order, measure):
        for _ in range(count):
            self.frame, self.beat = self.frame + 1, self.beat + 1
            self.period(order, measure, measure, measures=8 if measure == INSIDE else 2)

    @rule(order=st.sampled_from([Order.START, Order.RESET]))
    def try_to_leave(self, order):
        self.go_on(order, OUTSIDE, OUTSIDE, 1)

    @rule(count=st.integers(1, 8), order=ORDERS)
    def fall_silent(self, count, order):
        for _ in range(count):
            self.frame += 1
            self.period(order)

    @rule(elapsed=ELAPSED, order=ORDERS)
    def be_late(self, elapsed, order):
        self.frame, self.beat = self.frame + 1, self.beat + 1
        self.period(order, elapsed=elapsed)

    @rule(order=ORDERS)
    def repeat_the_frame(self, order):
        self.beat += 1
        self.period(order)

    @rule(checks=CHECKS, measures=st.sampled_from([0, 1, 2, 8, 9, 0xFFFFFFFF]), order=ORDERS)
    def find_something(self, checks, measures, order):
        self.frame += 1
        self.period(order, checks=checks, measures=measures)

    @rule(count=st.sampled_from([500, 999, 1001]))
    def be_punctual_for_long(self, count):
        out = self.unit.feed(periods(count, self.frame + 1))
        for k in range(count):
            self.frame = self.beat = self.frame + 1
            wanted = self.reference.step(
                command=0,
                measure=(INSIDE, INSIDE),
                checks=0,
                measures=2,
                elapsed=PERIOD,
                frame=self.frame,
                heartbeat=self.beat,
            )
            assert expected(out[k]) == wanted

    @rule(fault=st.sampled_from([f for f in Fault if f]))
    def trip(self, fault):
        self.frame, self.beat = self.frame + 1, self.beat + 1
        out = self.period()
        entered = int(out["entered"][0])
        HOST.trip(self.unit.state, np.array([fault]), out)
        assert expected(out[0]) == self.reference.trip(fault, entered)

    @rule(bit=st.integers(0, 31), name=st.sampled_from([*SEALED, "seal", "mode_inverse"]))
    def flip(self, bit, name):
        if self.reference.mode == Mode.FAULT or bit % 8:
            return  # seldom: nothing but a new beginning follows
        mode, period = int(self.unit.state["mode"][0]), int(self.unit.state["period"][0])
        self.unit.state[name] ^= np.uint32(1 << bit)
        out = self.unit.feed(periods(1, self.frame + 1))
        assert expected(out[0]) == (3, Fault.STATE_CORRUPT, 5, 1, 0)
        assert name in ("mode", "mode_inverse", "period", "logged") or (
            self.unit.log()[-1][0] == period + 1 and self.unit.log()[-1][2] == mode
        )
        assert expected(self.unit.run(1, command=Order.RESET)[0]) == (3, 1, 5, 0, 0)
        self.begin(3, 2, 0, 0, 0, 0)

    @invariant()
    def logs_are_the_same(self):
        if hasattr(self, "unit"):
            assert self.unit.log() == self.reference.log[-15:]


TestAgainstTheReference = AgainstTheReference.TestCase
TestAgainstTheReference.settings = settings(
    deadline=None, max_examples=60, stateful_step_count=40, derandomize=True
)


def random_records(rng, role, count):
    """Return records of nothing but random bits."""
    layout = HOST.type(role)
    return np.frombuffer(rng.bytes(count * layout.itemsize), layout).copy()


def likely(rng, count):
    """Return (state, params, input) random in every member, most of them as they may be."""
    state, params, given = (random_records(rng, r, count) for r in ("state", "params", "input"))
    params[: count // 2] = parameters(watchdog_time=3.0, swing_up_timeout=2.0, attempts=2)
    for name in ("capture_periods", "release_periods", "attempts", "overruns"):
        params[name] >>= rng.integers(0, 32, count).astype(np.uint32)
    ranges = {"mode": 4, "ready": 2, "reason": len(Reason), "started": 2}
    for name, below in ranges.items():
        state[name] %= below
    faulty = state["mode"] == Mode.FAULT
    fault = state["fault"] % len(Fault)
    state["fault"] = np.where(faulty, np.maximum(fault, 1), 0)
    for name in (*ranges, "fault"):  # what never is, under a seal that fits
        state[name] = np.where(rng.random(count) < 0.01, rng.integers(0, 20, count), state[name])
    for name in ("inside", "outside", "silent", "overruns", "releases", "since"):
        state[name] >>= rng.integers(0, 33, count).astype(np.uint64).clip(0, 31).astype(np.uint32)
    kept = state["seal"].copy(), state["mode_inverse"].copy()
    sealed(state)
    state["seal"] = np.where(rng.random(count) < 0.05, kept[0], state["seal"])
    state["mode_inverse"] = np.where(rng.random(count) < 0.02, kept[1], state["mode_inverse"])
    given["checks"] = np.where(rng.random(count) < 0.8, 0, given["checks"] & given["measures"])
    given["measures"] = np.where(rng.random(count) < 0.9, given["measures"] % 10, given["measures"])
    given["command"] = np.where(rng.random(count) < 0.9, given["command"] % 5, given["command"])
    given["position"] = np.where(rng.random(count) < 0.8, 0, given["position"])
    given["elapsed"] = np.where(rng.random(count) < 0.8, PERIOD, given["elapsed"])
    usual = rng.choice([INSIDE, BETWEEN, OUTSIDE], (count, 8), p=[0.8, 0.1, 0.1])
    given["measure"] = np.where(rng.random((count, 8)) < 0.9, usual, given["measure"])
    beating = rng.random(count) < 0.2
    given["heartbeat"] = np.where(beating, state["heartbeat"], given["heartbeat"])
    given["frame"] = np.where(rng.random(count) < 0.02, state["frame"], given["frame"])
    return state, params, given


def assert_valid(out):
    """Check that outputs are in their enumerations, and torque where it may be."""
    assert (out["mode"] <= max(Mode)).all()
    assert (out["fault"] <= max(Fault)).all()
    assert (out["reason"] <= max(Reason)).all()
    assert (out["entered"] <= 1).all()
    active = (out["mode"] == Mode.SWING_UP) | (out["mode"] == Mode.BALANCE)
    assert (out["torque_allowed"] == active).all()
    assert ((out["fault"] != 0) == (out["mode"] == Mode.FAULT)).all()


@pytest.mark.parametrize("part", range(10))
def test_any_of_a_million_random_bit_patterns_gives_valid_outputs(part):
    rng, count = np.random.default_rng([20, part]), 100_000
    if part == 0:
        drawn = [random_records(rng, r, count) for r in ("state", "params", "input")]
    else:
        drawn = likely(rng, count)
    state, params, given = drawn
    assert (HOST.modes(state) <= max(Mode)).all()
    out = HOST.run(state, params, given[None])[0]
    assert_valid(out)
    again = HOST.run(state, params, random_records(rng, "input", count)[None])[0]
    assert_valid(again)
    assert (HOST.modes(state) == again["mode"]).all()
    garbage = random_records(rng, "output", count)
    HOST.trip(state, rng.integers(0, 2**32, count, np.uint32), garbage)
    assert_valid(garbage)
    assert (garbage["mode"] == Mode.FAULT).all()
    if part:  # nothing of that is empty
        for name, values in (("mode", Mode), ("fault", Fault), ("reason", Reason)):
            assert set(np.unique(out[name])) == {int(v) for v in values}


def test_init_makes_any_memory_sound():
    rng, count = np.random.default_rng(3), 20_000
    params = random_records(rng, "params", count)
    params[::2] = parameters()
    state = random_records(rng, "state", count)
    status = init_in_place(state, params)
    assert (status[::2] == 0).all()
    assert (status[1::2] == 1).all()
    assert (HOST.modes(state) == np.where(status == 0, Mode.IDLE, Mode.FAULT)).all()


def flight(rng, number, count):
    """Return inputs (number, count) of operators who press everything, and seldom a fault."""
    given = periods(number, count=count)
    near = rng.random((number, count)) < np.linspace(0.2, 0.95, count)
    given["measure"] = np.where(near, INSIDE, OUTSIDE)[..., None]
    given["measure"][..., 1] += rng.normal(0.0, 0.2, (number, count))
    pressed = rng.random((number, count))
    given["command"] = np.select(
        [pressed < 0.03, pressed < 0.05, pressed < 0.2], [Order.STOP, 7, Order.RESET], Order.START
    )
    given["elapsed"] *= 1.0 + rng.normal(0.0, 0.25, (number, count))
    rare = rng.random((number, count)) < 0.005
    known = rng.integers(0, 512, (number, count))
    unknown = rng.random((number, count)) < 0.05
    given["checks"] = np.where(rare, np.where(unknown, 0x200, known), 0)
    seldom = rng.random((number, count)) < 0.05
    given["position"] = np.where(seldom, rng.integers(0, 16, (number, count)), 0)
    still = rng.random((number, count)) < 0.3
    given["heartbeat"] = np.cumsum(~still, axis=0)
    frozen = rng.random((number, count)) < 0.002
    given["frame"] = np.cumsum(~frozen, axis=0)
    odd = rng.random((number, count)) < 0.003
    given["measure"][odd, 0] = rng.choice([np.nan, np.inf, -1.0], int(odd.sum()))
    return given


@pytest.mark.target
def test_target_gives_the_bits_of_the_host():
    rng, target = np.random.default_rng(8), ppc750_supervisor()
    count, number = 50, 1000
    params = parameters(count, overruns=3, attempts=4)
    params["sample_time"], params["watchdog_time"] = 1e-3, 2.3e-3
    params["swing_up_timeout"] = 0.0173
    params["capture_periods"] = rng.integers(1, 6, count)
    given = flight(rng, number, count)
    given["elapsed"] *= 1e-3 / PERIOD
    found = []
    for module in (HOST, target):
        state, status = module.init(params)
        assert not status.any()
        out = module.run(state, params, given)
        rows = [module.transition(state, n)[0] for n in range(4)]
        found.append((out.astype(HOST.type("output")), state.astype(HOST.type("state")), rows))
    (host, remembered, rows), (there, memory, others) = found
    assert (host == there).all()
    assert (remembered == memory).all()
    assert (np.array(rows) == np.array(others)).all()
    seen = {Fault(f) for f in np.unique(host["fault"])}
    assert seen >= {Fault.OVERRUN, Fault.WATCHDOG, Fault.SWING_UP_TIMEOUT, Fault.ATTEMPTS}
    assert seen >= {Fault.STALE, Fault.INTERFACE, Fault.NUMERIC}


@pytest.mark.target
def test_target_treats_random_bits_as_the_host_does():
    target, found = ppc750_supervisor(), []
    state, params, given = likely(np.random.default_rng(21), 5000)
    for module in (HOST, target):
        memory = state.astype(module.type("state"))
        out = module.run(memory, params, given[None])[0]
        module.trip(memory, np.arange(5000) % 18, out)
        found.append((out.astype(HOST.type("output")), memory.astype(HOST.type("state"))))
    assert (found[0][0] == found[1][0]).all()
    assert (found[0][1] == found[1][1]).all()
