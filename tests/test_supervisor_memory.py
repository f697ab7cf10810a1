"""The memory of the supervisor: its log, and what is seen of a changed bit."""

import numpy as np
import pytest
from pfaffian.runtime.code.supervision import Fault, Mode, Order, Reason
from support_supervisor import HOST, OUTSIDE, SEALED, Unit, expected, sealed

IDLE, SWING_UP, BALANCE, FAULT = Mode
START, STOP, RESET = Order.START, Order.STOP, Order.RESET


def test_the_log_keeps_the_last_transitions_and_says_what_is_gone():
    unit = Unit()
    written = []
    for k in range(50):
        order, ends = ((START, (IDLE, SWING_UP)), (STOP, (SWING_UP, IDLE)))[k % 2]
        reason = Reason.STARTED if order == START else Reason.STOPPED
        unit.run(k % 3, measure=OUTSIDE)
        unit.run(1, measure=OUTSIDE, command=order)
        written.append((int(unit.state["period"][0]), unit.frame, *ends, reason, Fault.NONE))
        assert unit.log() == written[-15:]
        for number in (k + 1, k + 2, k - 15, k - 16, 0xFFFFFFFF):
            if not max(0, k - 14) <= number <= k:
                assert not HOST.transition(unit.state, number & 0xFFFFFFFF)[1][0]


def test_the_log_goes_on_where_its_count_wraps():
    unit = Unit()
    unit.state["logged"], unit.state["period"] = 0xFFFFFFFE, 0xFFFFFFFD
    sealed(unit.state)
    for order in (START, STOP, START, STOP):
        unit.run(1, command=order)
    assert unit.state["logged"] == 2
    rows = [HOST.transition(unit.state, n) for n in (0, 1, 2, 0xFFFFFFFF)]
    assert [bool(there[0]) for _, there in rows] == [True, True, False, False]
    assert [int(row[0, 0]) for row, _ in rows[:2]] == [0, 1]


@pytest.mark.parametrize("member", ["since", "silent", "overruns", "good"])
def test_counters_stay_at_the_largest_value(member):
    most = 0xFFFFFFFF
    unit = Unit(overruns=most)
    columns = {"heartbeat": 0, "measure": OUTSIDE}
    unit.run(1, command=START, **columns)
    unit.state[member] = most - 2
    sealed(unit.state)
    columns |= {"elapsed": 9.0} if member == "overruns" else {}
    for value in (most - 1, most, most, most):
        assert unit.run(1, **columns)["mode"] == SWING_UP
        assert unit.state[member] == value


WORDS = [*SEALED, "mode_inverse", "fault_inverse", "ready_inverse", "seal"]


@pytest.mark.parametrize("mode", Mode)
def test_every_flipped_bit_but_the_logs_is_a_fault_and_no_reset_helps(mode):
    unit = Unit().bring_to(mode)
    states = np.repeat(unit.state, 32 * len(WORDS))
    for k, name in enumerate(WORDS):
        states[name][32 * k : 32 * (k + 1)] ^= np.uint32(1) << np.arange(32, dtype=np.uint32)
    assert (HOST.modes(states) == FAULT).all()
    given = np.repeat(unit.given(3, command=RESET), len(states), axis=1)
    tripped = states.copy()
    out = HOST.run(states, np.repeat(unit.params, len(states)), given)
    wanted = (FAULT, Fault.STATE_CORRUPT, Reason.FAULT, 1, 0)
    assert {expected(o) for o in out[0]} == {wanted}
    assert {expected(o) for o in out[1:].ravel()} == {(*wanted[:3], 0, 0)}
    there = np.zeros(len(states), HOST.type("output"))
    there["torque_allowed"], there["mode"] = 1, BALANCE  # as the step before the flip said
    HOST.trip(tripped, np.full(len(states), Fault.NUMERIC), there)
    assert {expected(o) for o in there} == {wanted}


@pytest.mark.parametrize("mode", Mode)
def test_a_flipped_bit_in_the_log_changes_nothing_but_the_log(mode):
    unit = Unit().bring_to(mode)
    bits = 16 * 6 * 32
    states = np.repeat(unit.state, bits)
    log = states["log"].reshape(bits, -1)
    log[np.arange(bits), np.arange(bits) // 32] ^= (1 << (np.arange(bits) % 32)).astype(np.uint32)
    states["log"] = log.reshape(bits, 16, 6)
    given = np.repeat(unit.given(5), bits, axis=1)
    out = HOST.run(states, np.repeat(unit.params, bits), given)
    assert (out == unit.feed(given[:, :1])[:, None]).all()


def test_only_init_ends_a_fault_of_the_memory_and_the_log_survives_it():
    unit = Unit().bring_to(BALANCE)
    before = unit.log()
    unit.state["inside"] ^= np.uint32(4)
    unit.run(1)
    assert unit.log()[:-1] == before
    assert unit.log()[-1][2:] == (BALANCE, FAULT, Reason.FAULT, Fault.STATE_CORRUPT)
    assert (unit.run(10_000, command=RESET)["mode"] == FAULT).all()
    unit.state, status = HOST.init(unit.params)
    assert status == 0
    assert unit.run(1, command=START)["mode"] == SWING_UP


@pytest.mark.parametrize("mode", list(Mode))
def test_a_mode_changed_with_its_complement_is_a_fault(mode):
    """The seal runs over every scalar: a change that the complements do not show is seen by it."""
    for other in set(Mode) - {mode}:
        unit = Unit().bring_to(mode)
        unit.state["mode"], unit.state["mode_inverse"] = other, ~np.uint32(other)
        assert expected(unit.run(1)[0])[:2] == (FAULT, Fault.STATE_CORRUPT)


def test_the_seal_is_the_checksum_of_the_members_in_their_order():
    unit = Unit().bring_to(BALANCE)
    assert sealed(unit.state.copy())["seal"] == unit.state["seal"]
