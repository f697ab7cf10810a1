"""The supervisor in C: every transition with its reason, every fault at once, and latched."""

import re
from functools import partial

import numpy as np
import pytest
from conftest import REPOSITORY
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.code.supervision import (
    Check,
    Fault,
    Mode,
    Order,
    Position,
    Reason,
    SupervisorModule,
    supervisor_sources,
)
from support_supervisor import (
    BETWEEN,
    HOST,
    OUTSIDE,
    PERIOD,
    Unit,
    expected,
    parameters,
)

IDLE, SWING_UP, BALANCE, FAULT = Mode
NONE, START, STOP, RESET, REZERO = Order
FOLDER = supervisor_sources()[0].parent


def test_every_transition_has_its_reason_and_its_debounce():
    unit = Unit()
    given = unit.given(22)
    given["measure"][:5] = OUTSIDE
    given["command"][1] = START
    given["measure"][11] = OUTSIDE  # once: not released
    given["measure"][13:15] = np.nan
    given["command"][18] = STOP
    given["checks"][19] = Check.RANGE
    given["command"][20] = RESET
    out = unit.feed(given)
    modes = [IDLE] + [SWING_UP] * 6 + [BALANCE] * 7 + [SWING_UP] * 3 + [BALANCE]
    assert out["mode"].tolist() == [*modes, IDLE, FAULT, IDLE, IDLE]
    changes = [1, 7, 14, 17, 18, 19, 20]
    reasons = [Reason.STARTED, Reason.CAPTURED, Reason.RELEASED, Reason.CAPTURED, Reason.STOPPED]
    assert np.flatnonzero(out["entered"]).tolist() == changes
    assert out["reason"][changes].tolist() == [*reasons, Reason.FAULT, Reason.RESET]
    assert out["reason"][0] == Reason.NONE
    assert (out["torque_allowed"] == np.isin(out["mode"], [SWING_UP, BALANCE])).all()


@pytest.mark.parametrize("mode", [SWING_UP, BALANCE])
def test_stop_ends_every_active_mode_and_start_leaves_idle_only(mode):
    unit = Unit().bring_to(mode)
    assert expected(unit.run(command=START)[0])[3] == 0
    assert expected(unit.run(command=STOP)[0]) == (IDLE, 0, Reason.STOPPED, 1, 0)
    assert expected(unit.run(command=STOP)[0]) == (IDLE, 0, Reason.STOPPED, 0, 0)
    assert expected(unit.run(command=START)[0]) == (SWING_UP, 0, Reason.STARTED, 1, 1)


def test_start_is_refused_for_as_long_as_an_encoder_has_given_no_reading():
    unit = Unit()
    unit.run(1)
    for _ in range(3):
        out = unit.run(1, command=START, position=Position.UNREAD)[0]
        assert expected(out) == (IDLE, 0, Reason.NO_READING, 0, 0)
    assert [row[2:] for row in unit.log()] == [(IDLE, IDLE, Reason.NO_READING, 0)]  # once
    assert expected(unit.run(1, command=START)[0]) == (SWING_UP, 0, Reason.STARTED, 1, 1)


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize(
    ("bit", "reason"),
    [
        (Position.REZEROED, Reason.REZEROED),
        (Position.REFUSED, Reason.REZERO_REFUSED),
        (Position.REZEROED | Position.REFUSED, Reason.REZEROED),
    ],
)
def test_what_became_of_a_rezero_is_told_once_and_changes_no_mode(mode, bit, reason):
    unit = Unit(capture_periods=10).bring_to(mode)
    before, fault = len(unit.log()), int(unit.state["fault"][0])
    for out in unit.run(4, command=REZERO, position=bit):
        assert expected(out) == (mode, fault, reason, 0, mode in (SWING_UP, BALANCE))
    assert [row[2:] for row in unit.log()[before:]] == [(mode, mode, reason, fault)]


@pytest.mark.parametrize("command", [RESET, 4, 5, 0x80000001, 0xFFFFFFFF])
@pytest.mark.parametrize("mode", [IDLE, SWING_UP, BALANCE])
def test_reset_outside_fault_and_unknown_commands_do_nothing(mode, command):
    unit = Unit(capture_periods=100).bring_to(mode)
    assert (unit.run(20, command=command)["mode"] == mode).all()


def test_capture_needs_its_periods_in_a_row_with_every_measure_within():
    unit = Unit(capture_periods=4)
    unit.run(1, command=START)
    given = unit.given(12)
    given["measure"][[3, 7]] = BETWEEN
    assert (unit.feed(given)["mode"] == [SWING_UP] * 11 + [BALANCE]).all()
    for wrong in (np.nan, -1e-300, np.inf, np.nextafter(1.0, 2.0), 1e301):
        unit = Unit(capture_periods=1)
        unit.run(1, command=START)
        given = unit.given(3)
        given["measure"][:, 0, 1] = wrong
        assert (unit.feed(given)["mode"] == SWING_UP).all()
        given = unit.given(1)
        given["measure"][:, 0, :2], given["measure"][:, 0, 2:] = 1.0, wrong  # of two in use
        assert unit.feed(given)["mode"] == BALANCE


def test_release_needs_its_periods_in_a_row_and_holds_between_the_limits():
    unit = Unit(release_periods=3).bring_to(BALANCE)
    assert (unit.run(100, measure=BETWEEN)["mode"] == BALANCE).all()
    assert (unit.run(2, measure=OUTSIDE)["mode"] == BALANCE).all()
    assert (unit.run(1, measure=2.0)["mode"] == BALANCE).all()
    assert (unit.run(3, measure=OUTSIDE)["mode"] == [BALANCE, BALANCE, SWING_UP]).all()


def test_a_measure_that_is_far_is_outside_the_widest_limits():
    far = 1e301
    unit = Unit(capture_limit=1e300, release_limit=1e300)
    unit.run(1, command=START)
    assert (unit.run(5, measure=far)["mode"] == SWING_UP).all()
    assert unit.run(3, measure=1e300)["mode"][-1] == BALANCE
    assert unit.run(2, measure=far)["mode"][-1] == SWING_UP


IN_INPUT = {
    "elapsed is no number": ({"elapsed": np.nan}, Fault.NOT_FINITE),
    "elapsed is infinite": ({"elapsed": np.inf}, Fault.NOT_FINITE),
    "elapsed is -infinite": ({"elapsed": -np.inf}, Fault.NOT_FINITE),
    "period too long": ({"elapsed": PERIOD * 1.5000001}, Fault.OVERRUN),
    "period too short": ({"elapsed": PERIOD * 0.4999999}, Fault.OVERRUN),
    "time ran backwards": ({"elapsed": -PERIOD}, Fault.OVERRUN),
    "no measure": ({"measures": 0}, Fault.INTERFACE),
    "one measure too many": ({"measures": 9}, Fault.INTERFACE),
    "measures garbled": ({"measures": 0xFFFFFFFF}, Fault.INTERFACE),
    **{f"check {b.name}": ({"checks": b}, Fault[b.name]) for b in Check},
    **{f"unknown check {k}": ({"checks": 1 << k}, Fault.INTERFACE) for k in range(9, 32)},
}
AT_BALANCE = {
    name: (lambda unit, columns=columns: unit.run(1, **columns), fault)
    for name, (columns, fault) in IN_INPUT.items()
}


def stale(unit):
    return unit.run(1, frame=unit.frame)


def unheard(unit):
    beat = unit.frame
    assert not unit.run(5, heartbeat=beat)["fault"].any()
    return unit.run(1, heartbeat=beat)


def out_of_bounds(unit):
    good = unit.params["sample_time"][0]
    unit.params["sample_time"] = np.nan
    found = unit.run(1)
    unit.params["sample_time"] = good
    return found


def tripped(unit):
    found = unit.run(1)
    assert found["torque_allowed"] == 1
    HOST.trip(unit.state, np.array([Fault.NUMERIC]), found)
    return found


def released(unit):
    for _ in range(2):
        assert unit.run(2, measure=OUTSIDE)["mode"][-1] == SWING_UP
        assert unit.run(3)["mode"][-1] == BALANCE
    return unit.run(2, measure=OUTSIDE)[1:]


def timed_out(unit):
    assert (unit.run(2, measure=OUTSIDE)["mode"] == [BALANCE, SWING_UP]).all()
    assert (unit.run(20, measure=OUTSIDE)["mode"] == SWING_UP).all()
    return unit.run(1, measure=OUTSIDE)


AT_BALANCE |= {
    "the same frame": (stale, Fault.STALE),
    "heartbeat stands": (unheard, Fault.WATCHDOG),
    "parameter out of bounds": (out_of_bounds, Fault.PARAMETER_BOUNDS),
    "law without result": (tripped, Fault.NUMERIC),
    "released once too often": (released, Fault.ATTEMPTS),
    "no capture in time": (timed_out, Fault.SWING_UP_TIMEOUT),
}
STRICT = {
    "watchdog_time": 5 * PERIOD,
    "swing_up_timeout": 20 * PERIOD,
    "attempts": 2,
}


@pytest.mark.parametrize(("cause", "fault"), AT_BALANCE.values(), ids=AT_BALANCE)
def test_fault_ends_torque_in_its_own_call_and_stays_until_a_reset(cause, fault):
    unit = Unit(**STRICT).bring_to(BALANCE)
    out = cause(unit)
    assert expected(out[0]) == (FAULT, fault, Reason.FAULT, 1, 0)
    later = unit.run(10_000, command=START)
    assert (later["mode"] == FAULT).all()
    assert (later["fault"] == fault).all()
    assert not later["torque_allowed"].any()
    assert not later["entered"].any()
    assert (unit.run(10, command=STOP)["fault"] == fault).all()
    assert expected(unit.run(1, command=RESET)[0]) == (IDLE, 0, Reason.RESET, 1, 0)
    assert expected(unit.run(1, command=START)[0]) == (SWING_UP, 0, Reason.STARTED, 1, 1)


@pytest.mark.parametrize(("columns", "fault"), IN_INPUT.values(), ids=IN_INPUT)
@pytest.mark.parametrize("mode", [IDLE, SWING_UP, BALANCE])
def test_fault_is_found_in_every_mode_and_no_reset_helps_while_its_cause_lasts(
    mode, columns, fault
):
    unit = Unit().bring_to(mode)
    out = unit.run(50, **columns, command=RESET)
    assert (out["mode"] == FAULT).all()
    assert (out["fault"] == fault).all()
    assert not out["torque_allowed"].any()
    assert (unit.run(2)["mode"] == FAULT).all()
    assert unit.run(1, command=RESET)["mode"] == IDLE


def test_no_reset_helps_while_frame_heartbeat_or_parameters_stay_wrong():
    unit = Unit(watchdog_time=5 * PERIOD)
    out = unit.run(20, heartbeat=7, command=RESET)
    assert (out["fault"] == [Fault.NONE] * 6 + [Fault.WATCHDOG] * 14).all()
    assert (unit.run(1, heartbeat=8)["mode"] == FAULT).all()
    assert unit.run(1, heartbeat=9, command=RESET)["mode"] == IDLE
    assert (unit.run(20, frame=5, command=RESET)["fault"][1:] == Fault.STALE).all()
    assert unit.run(1, command=RESET)["mode"] == IDLE
    unit.params["longest_period"] = 0.0
    assert (unit.run(20, command=RESET)["fault"] == Fault.PARAMETER_BOUNDS).all()
    unit.params["longest_period"] = 1.5
    assert unit.run(1, command=RESET)["mode"] == IDLE


def test_of_several_findings_the_first_in_order_is_the_fault():
    ranks = [*((b, Fault[b.name]) for b in Check), (0x4000, Fault.INTERFACE)]
    for first in range(len(ranks)):
        checks = sum(int(bit) for bit, _ in ranks[first:])
        out = Unit().bring_to(BALANCE).run(1, checks=checks, frame=1, elapsed=np.nan)
        assert out["fault"] == ranks[first][1]
    later = [{"elapsed": np.nan, "frame": 6}, {"frame": 6, "elapsed": 1.0}]
    later += [{"elapsed": 1.0, "heartbeat": 6}]
    wanted = [Fault.NOT_FINITE, Fault.STALE, Fault.OVERRUN]
    for columns, fault in zip(later, wanted, strict=True):
        unit = Unit(watchdog_time=PERIOD / 2).bring_to(BALANCE)
        assert unit.frame == 6
        assert unit.run(1, **columns)["fault"] == fault


BAD = {
    "sample_time": (0.0, 9e-7, 1.1, np.nan, np.inf, -1e-3),
    "shortest_period": (-1e-9, 1.01, np.nan),
    "longest_period": (0.99, 1001.0, np.nan, np.inf),
    "watchdog_time": (-1.0, 1.1e6, np.nan),
    "swing_up_timeout": (-1.0, 1.1e6, np.nan),
    "capture_limit": (-1e-300, 2.1, np.nan, np.inf),
    "release_limit": (0.9, 1.1e300, np.nan, np.inf),
    "capture_periods": (0,),
    "release_periods": (0,),
}


@pytest.mark.parametrize(("member", "value"), [(m, v) for m, row in BAD.items() for v in row])
def test_bad_parameters_are_refused_at_init_for_good(member, value):
    unit = Unit(**{member: value})
    assert unit.status == 1
    assert HOST.modes(unit.state) == FAULT
    assert unit.log() == [(0, 0, IDLE, FAULT, Reason.FAULT, Fault.PARAMETER_BOUNDS)]
    assert (unit.run(3, command=RESET)["fault"] == Fault.PARAMETER_BOUNDS).all()
    unit.params = parameters()
    out = unit.run(3, command=RESET)
    assert (out["mode"] == FAULT).all()
    assert not out["torque_allowed"].any()
    if member.endswith("limit"):
        for k in range(8):
            limits = np.array([1.0 if member == "capture_limit" else 2.0] * 8)
            limits[k] = value
            assert Unit(**{member: limits}).status == 1
    assert Unit().status == 0


def test_forgiven_overruns_are_counted_and_forgotten_one_a_thousand_good_periods():
    unit = Unit(overruns=3)
    unit.run(5)
    for _ in range(3):
        assert (unit.run(1, elapsed=9.0)["mode"] == IDLE).all()
        assert (unit.run(999)["mode"] == IDLE).all()
    unit.run(1)
    assert unit.state["overruns"] == 2
    assert (unit.run(1, elapsed=9.0)["mode"] == IDLE).all()
    assert (unit.run(1, elapsed=9.0)["fault"] == Fault.OVERRUN).all()
    unit.run(100, elapsed=9.0, command=RESET)
    assert unit.run(1, command=RESET)["mode"] == IDLE
    assert not unit.run(3, elapsed=9.0)["fault"].any()  # a reset forgets them all
    assert unit.run(1, elapsed=9.0)["fault"] == Fault.OVERRUN
    assert not Unit().run(1, elapsed=9.0)["fault"].any()  # before the first there is no period
    for exact in (0.5, 1.5):
        assert not Unit().run(9, elapsed=exact * PERIOD)["fault"].any()


def test_capture_and_stop_come_before_the_timeout():
    for columns, mode in (({"command": STOP}, IDLE), ({}, BALANCE), ({"measure": OUTSIDE}, FAULT)):
        unit = Unit(swing_up_timeout=10 * PERIOD)
        unit.run(1, command=START)
        assert (unit.run(8, measure=OUTSIDE)["mode"] == SWING_UP).all()
        assert (unit.run(2)["mode"] == SWING_UP).all()
        assert unit.run(1, **columns)["mode"] == mode
    unit = Unit().bring_to(SWING_UP)
    assert (unit.run(100_000, measure=OUTSIDE)["mode"] == SWING_UP).all()  # 0: no timeout


def test_start_gives_all_attempts_again_and_none_are_counted_with_zero():
    def lose(unit, times):
        for _ in range(times):
            unit.run(3)
            out = unit.run(2, measure=OUTSIDE)[1]
        return out

    unit = Unit(attempts=2).bring_to(SWING_UP)
    assert lose(unit, 2)["mode"] == SWING_UP
    unit.run(1, command=STOP)
    unit.run(1, command=START, measure=OUTSIDE)
    assert lose(unit, 2)["mode"] == SWING_UP
    assert lose(unit, 1)["fault"] == Fault.ATTEMPTS
    assert lose(Unit().bring_to(SWING_UP), 1000)["mode"] == SWING_UP


def test_trip_stops_at_once_keeps_the_first_fault_and_takes_no_unknown_one():
    for number, fault in ((Fault.RANGE, Fault.RANGE), (0, Fault.NUMERIC), (16, Fault.NUMERIC),
                          (0xFFFFFFFF, Fault.NUMERIC)):  # fmt: skip
        unit = Unit().bring_to(BALANCE)
        out = unit.run(1)
        HOST.trip(unit.state, np.array([number], np.uint32), out)
        assert expected(out[0]) == (FAULT, fault, Reason.FAULT, 1, 0)
        HOST.trip(unit.state, np.array([Fault.STALE]), out)
        assert expected(out[0]) == (FAULT, fault, Reason.FAULT, 1, 0)
        assert expected(unit.run(1)[0]) == (FAULT, fault, Reason.FAULT, 0, 0)
        assert len(unit.log()) == 3


def test_names_are_those_of_the_header_and_the_table_in_the_docs_has_every_fault():
    header = (FOLDER / "pf_supervisor.h").read_text(encoding="utf-8")
    for prefix, names in (
        ("PF_MODE_", Mode),
        ("PF_COMMAND_", Order),
        ("PF_FAULT_", Fault),
        ("PF_REASON_", Reason),
        ("PF_CHECK_", Check),
        ("PF_POSITION_", Position),
    ):
        found = re.findall(rf"\b{prefix}(\w+) =? ?(0x[0-9a-f]+|\d+)", header)
        assert {n: int(value, 0) for n, value in found} == {n.name: n.value for n in names}
    text = (REPOSITORY / "docs" / "supervisor.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([A-Z_]+)` \|", text, re.MULTILINE)
    assert sorted(rows) == sorted(f.name for f in Fault if f)


def test_images_with_other_structures_are_refused():
    class Other:
        name, byte_order = "other", "="
        call = partial(lambda self, *words: 8, None)

    with pytest.raises(CheckError, match=r"8 bytes in the image, \d+"):
        SupervisorModule(Other())
