"""The complete controller moves nothing before it knows where the plant is, on host and target."""

import math

import pytest
from pfaffian.derive.emit.files.controller import FIXED_ENCODER
from pfaffian.runtime.code.controller import host_control, ppc750_control
from pfaffian.runtime.code.supervision import Fault, Position, Reason
from support_control import (
    BALANCE,
    ENERGY,
    FAULT,
    FEEDBACK,
    FOLDER,
    IDLE,
    QUANTUM,
    RESET,
    START,
    SWING_UP,
    Board,
    seal_memory,
)

REZERO = 4
STATUS = FOLDER.manifest.status


@pytest.fixture(scope="module", params=["host", pytest.param("ppc750", marks=pytest.mark.target)])
def module(request):
    return host_control(FOLDER) if request.param == "host" else ppc750_control(FOLDER)


def position(board):
    return int(board.output["position"][0])


# --- No reading yet ------------------------------------------------------------------------


@pytest.mark.parametrize("silent", [("q1_valid", "q2_valid"), ("q1_valid",), ("q2_valid",)])
def test_start_without_a_reading_of_every_encoder_is_refused(module, silent):
    """It swung up by an angle that nobody had read: 1.3 N m until the gap expired."""
    board = Board(module, swing_up=ENERGY, q1_encoder__longest_gap=64, q2_encoder__longest_gap=64)
    missing = dict.fromkeys(silent, 0)
    for _ in range(60):
        board.step(command=START, **missing)
        assert (board.mode(), board.torque()) == (IDLE, 0.0)
        assert board.reason() == Reason.NO_READING
        assert position(board) == Position.UNREAD
    board.step(command=START)
    assert (board.mode(), position(board)) == (SWING_UP, 0)


def test_an_offset_does_not_stand_in_for_a_reading(module):
    """With half a turn of offset a hanging arm was "balanced"."""
    board = Board(module, swing_up=ENERGY, q1_encoder__offset=0.5 * math.pi)
    for _ in range(5):
        board.step(command=START, q1_valid=0, q2_valid=0)
        assert (board.mode(), board.torque()) == (IDLE, 0.0)


def test_readings_before_init_do_not_count(module):
    board = Board(module).started()
    board.state, _ = module.init(board.params)
    board.step(command=START, q1_valid=0)
    assert (board.mode(), board.reason()) == (IDLE, Reason.NO_READING)


# --- A position that was lost --------------------------------------------------------------


@pytest.mark.parametrize("mode", [IDLE, SWING_UP, BALANCE])
@pytest.mark.parametrize("shift", [101, 150, 4000, -333])
def test_a_jump_that_lasts_is_no_motion_and_ends_by_no_reset(module, mode, shift):
    board = Board(module, swing_up=ENERGY).brought_to(mode)
    angle, count = board.output["q1"].copy(), board.state["q1_encoder"]["count"].copy()
    board.counts[0] += shift
    for k in range(80):
        board.step(command=(RESET, START)[k % 2])
        assert board.is_stopped_by(Fault.ENCODER_JUMP), k
        board.counts[0] += 1  # and the shaft goes on
    assert (board.state["q1_encoder"]["count"] == count).all()
    assert position(board) == Position.LOST
    assert math.remainder(float(board.output["q1"][0] - angle[0]), 2.0 * math.pi) == pytest.approx(
        0.0, abs=1e-9
    )


def test_a_glitch_of_one_period_loses_no_position(module):
    board = Board(module, swing_up=ENERGY).started()
    board.step(q1_raw=3000)
    assert board.is_stopped_by(Fault.ENCODER_JUMP)
    board.step()
    assert position(board) == 0
    board.step(command=RESET)
    assert board.mode() == IDLE


@pytest.mark.parametrize("how", ["jump", "gap"])
def test_a_lost_position_is_known_again_at_the_known_place(module, how):
    board = Board(module, swing_up=ENERGY, rezero_periods=20).started()
    board.counts[0] += 4000
    wrong = {} if how == "jump" else {"q1_valid": 0}
    for _ in range(12):
        board.step(**wrong)
    code = Fault.ENCODER_JUMP if how == "jump" else Fault.STALE
    assert board.is_stopped_by(code)
    for _ in range(20):
        board.step()
        assert board.is_stopped_by(code)
    board.step(command=REZERO)
    assert board.is_stopped_by(code), "only RESET ends a fault"
    assert (board.reason(), position(board)) == (Reason.REZEROED, Position.REZEROED)
    for name, home in (("q1", -0.5 * math.pi), ("q2", 0.0)):
        off = math.remainder(float(board.output[name][0]) - home, 2.0 * math.pi)
        assert abs(off) <= QUANTUM
    assert (board.output["dq1"][0], board.output["dq2"][0]) == (0.0, 0.0)
    board.step(command=RESET)
    assert board.mode() == IDLE
    board.step(command=START)
    assert board.mode() == SWING_UP
    before = float(board.output["q1"][0])
    board.counts[0] += 7
    board.step()
    assert board.output["q1"][0] - before == pytest.approx(7 * QUANTUM, abs=1e-12)


def refused(board):
    before = board.state["q1_encoder"]["count"].copy()
    board.step(command=REZERO)
    assert position(board) & Position.REFUSED
    assert (board.state["q1_encoder"]["count"] == before).all()
    return board.torque()


def test_a_rezero_is_refused_where_it_could_not_be_right(module):
    early = Board(module, rezero_periods=20)
    for _ in range(5):
        early.step()
    refused(early)
    assert (early.mode(), early.reason()) == (IDLE, Reason.REZERO_REFUSED)
    moving = Board(module, rezero_periods=20)
    for _ in range(40):
        moving.counts[1] += 1
        moving.step()
    refused(moving)
    nowhere = Board(module, rezero_periods=0)
    for mode in (SWING_UP, BALANCE):
        running = Board(module, swing_up=ENERGY, rezero_periods=1).brought_to(mode)
        refused(running)
        assert (running.mode(), running.reason()) == (mode, Reason.REZERO_REFUSED)
    for _ in range(300):
        nowhere.step()
    refused(nowhere)
    spoiled = Board(module, rezero_periods=1)
    for _ in range(5):
        spoiled.step()
    spoiled.params["home_q1"] = 1.0  # not sealed
    assert refused(spoiled) == 0.0
    assert spoiled.fault() == Fault.PARAMETER_CHECKSUM


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1001.0, -1e300])
def test_a_known_place_out_of_bounds_is_refused_with_the_block(module, bad):
    board = Board(module).started()
    board.change(home_q2=bad)
    board.step()
    assert board.is_stopped_by(Fault.PARAMETER_BOUNDS)


# --- Parameters that may change at rest only -----------------------------------------------

FIXED = {
    **{f"{c}_encoder__{n}": None for c in ("q1", "q2") for n in FIXED_ENCODER},
    "q1_turns": 0,
    "q2_turns": 0,
    "plan": 0,
    "sample_time": None,
}
_NEW = {"counts_per_turn": 4000.0, "offset": 0.1, "counter_bits": 24, "counter_zero": 3}
_NEW |= {"direction": -1}


def change(board, what):
    if what == "sample_time":
        groups = ("law", "supervisor", "q1_encoder", "q2_encoder")
        board.change(**{f"{g}__sample_time": 2e-3 for g in groups})
    else:
        value = FIXED[what]
        board.change(**{what: _NEW[what.split("__")[1]] if value is None else value})


@pytest.mark.parametrize("mode", [SWING_UP, BALANCE])
@pytest.mark.parametrize("what", FIXED)
def test_what_says_where_and_when_may_change_at_rest_only(module, what, mode):
    """A plan took twice its time at twice the period; a direction turned round in BALANCE."""
    board = Board(module, swing_up=ENERGY, q1_encoder__bandwidth=250.0).brought_to(mode)
    change(board, what)
    board.step(elapsed=float(board.params["law"]["sample_time"][0]))
    assert board.is_stopped_by(Fault.PARAMETER_FIXED)
    board.step(command=RESET, elapsed=float(board.params["law"]["sample_time"][0]))
    assert board.mode() == IDLE
    at_rest = Board(module, swing_up=ENERGY).brought_to(IDLE)
    change(at_rest, what)
    at_rest.step(elapsed=float(at_rest.params["law"]["sample_time"][0]))
    assert (at_rest.mode(), at_rest.fault()) == (IDLE, 0)


def test_every_member_that_says_where_is_among_the_fixed():
    names = set(module_names("q1_encoder"))
    assert set(FIXED_ENCODER) <= names
    tuned = {"sample_time", "bandwidth", "damping", "estimator", "largest_jump", "longest_gap"}
    assert names - set(FIXED_ENCODER) == tuned


def module_names(group):
    return FOLDER.manifest.control_sets["rig"][group]


# --- The reason of a fault -----------------------------------------------------------------


def test_law_status_stays_in_the_period_of_the_fault_that_it_explains(module):
    board = Board(module, swing_up=ENERGY, balance=FEEDBACK).balancing()
    board.change(feedback_tau_q1=1e300, feedback_tau_dq1=1e300)
    for _ in range(10):
        board.counts[0] += 2
        board.step()
        if board.mode() == FAULT:
            break
    assert board.is_stopped_by(Fault.NUMERIC)
    assert STATUS[int(board.output["law_status"][0])] == "NUMERIC"
    board.step()
    assert STATUS[int(board.output["law_status"][0])] == "OK"


def test_a_law_without_a_finite_result_says_so_in_the_fault(module):
    board = Board(module, swing_up=ENERGY).balancing()
    board.state["law"]["drift_previous"] = math.nan
    board.state = seal_memory(board.state)  # as if it had come about by itself
    board.step()
    assert board.is_stopped_by(Fault.NUMERIC)
    assert STATUS[int(board.output["law_status"][0])] == "NUMERIC"
