"""No fault makes the complete controller command what it may not."""

import math

import pytest
from pfaffian.runtime.code.controller import host_control, ppc750_control
from support_control import (
    BALANCE,
    ENERGY,
    FAULT,
    FEEDBACK,
    FOLDER,
    HANGING,
    IDLE,
    RELEASED,
    RESET,
    START,
    STOP,
    SWING_UP,
    UPRIGHT,
    WAS_RESET,
    Board,
)

CORRUPT, CHECKSUM, BOUNDS, NOT_FINITE, RANGE, JUMP, STALE = range(1, 8)
OVERRUN, WATCHDOG, NUMERIC, TIMEOUT, ATTEMPTS = range(8, 13)
MODES = (IDLE, SWING_UP, BALANCE, FAULT)


@pytest.fixture(scope="module", params=["host", pytest.param("ppc750", marks=pytest.mark.target)])
def module(request):
    return host_control(FOLDER) if request.param == "host" else ppc750_control(FOLDER)


@pytest.fixture(scope="module")
def host():
    return host_control(FOLDER)


# --- One fault at a time -------------------------------------------------------------------

#: What is given wrong in one period, and the fault it is.
WRONG = {
    "elapsed not a number": ({"elapsed": math.nan}, NOT_FINITE),
    "elapsed infinite": ({"elapsed": math.inf}, NOT_FINITE),
    "elapsed minus infinity": ({"elapsed": -math.inf}, NOT_FINITE),
    "encoder 1 jumps": ({"q1_raw": 3000}, JUMP),
    "encoder 2 jumps": ({"q2_raw": 0x80000000}, JUMP),
}


@pytest.mark.parametrize("mode", [IDLE, SWING_UP, BALANCE])
@pytest.mark.parametrize("what", WRONG)
def test_a_fault_is_latched_in_the_same_period_until_reset(module, what, mode):
    board = Board(module, swing_up=ENERGY).brought_to(mode)
    wrong, code = WRONG[what]
    board.step(**wrong)
    assert board.is_stopped_by(code)
    for k in range(100):
        board.step(command=(START, STOP, 0)[k % 3])
        assert board.is_stopped_by(code)
    board.step(command=RESET, elapsed=math.nan)
    assert board.is_stopped_by(code), "a cause was there"
    board.step(command=RESET)
    assert (board.mode(), board.fault(), board.reason()) == (IDLE, 0, WAS_RESET)
    board.step(command=START)
    assert board.mode() == SWING_UP


def test_a_frame_that_stands_still_is_a_fault(module):
    board = Board(module).started()
    board.step(frame=int(board.given["frame"][0]))
    assert board.is_stopped_by(STALE)
    board.step(command=RESET)
    assert board.mode() == IDLE


def test_a_link_turning_too_fast_is_a_fault(module):
    board = Board(module, q2_encoder__counts_per_turn=100.0).started()
    for _ in range(20):  # as far as the encoder is believed: a whole turn a period
        board.counts[1] += 100
        board.step()
        if board.mode() == FAULT:
            break
    assert board.is_stopped_by(RANGE)
    assert abs(board.output["dq2"][0]) > 1e3


def test_an_angle_beyond_its_domain_is_a_fault_where_a_turn_is_not_the_same_place(host):
    board = Board(host, q2_encoder__counts_per_turn=50.0, q2_turns=0)
    board.step()
    for _ in range(20_000):
        board.counts[1] += 5
        board.step()
        if board.mode() == FAULT:
            break
    assert board.is_stopped_by(RANGE)
    assert abs(board.output["q2"][0]) >= 1e4
    for _ in range(100):
        board.counts[1] -= 5
        board.step()
    board.step(command=RESET)
    assert board.mode() == IDLE


def test_turning_a_link_by_hand_for_long_is_no_fault(host):
    board = Board(host, q1_encoder__counts_per_turn=100.0)
    board.counts = [-25, 0]
    board.step()
    for _ in range(20_000):  # 2000 turns, 12 600 rad
        board.counts[0] += 10
        board.step()
        assert board.mode() == IDLE
    assert abs(board.output["q1"][0] - 0.5 * math.pi) <= math.pi + 1e-6


def test_a_law_without_a_usable_result_is_a_fault(module):
    board = Board(module, swing_up=ENERGY, balance=FEEDBACK).balancing()
    board.change(feedback_tau_q1=1e300, feedback_tau_q2=-1e300)
    board.counts = [UPRIGHT - 20, 20]
    board.step()
    assert board.mode() == BALANCE  # too much, but a number: limited
    assert abs(board.torque()) <= board.params["law"]["torque_limit"][0]
    board.params["feedback_tau_q1"] = 1e301
    board.module.seal(board.params)
    board.step()
    assert board.is_stopped_by(BOUNDS)
    none = Board(module, swing_up=ENERGY, balance=FEEDBACK).balancing()
    none.change(feedback_tau_q1=1e300, feedback_tau_dq1=1e300)
    for _ in range(10):  # more than 1 rad/s: the product is beyond 1e300
        none.counts[0] += 2
        none.step()
        if none.mode() == FAULT:
            break
    assert none.is_stopped_by(NUMERIC)
    none.change(feedback_tau_q1=0.0, feedback_tau_dq1=0.0)
    none.step(command=RESET)
    assert none.mode() == IDLE


def test_no_capture_within_its_time_is_a_fault(module):
    board = Board(module, supervisor__swing_up_timeout=0.02)
    board.step()
    board.step(command=START)
    for k in range(1, 25):
        board.step()
        assert (board.mode() == FAULT) == (k > 20), k
    assert board.is_stopped_by(TIMEOUT)


def released(board):
    """Push link 1 out of BALANCE, as fast as the encoder is believed, and bring it back."""
    for sign in (1, -1):
        for _ in range(16):
            board.counts[0] += sign * 100
            board.step()
            if board.mode() == FAULT:
                return board
    for _ in range(60):
        board.step()
    return board


def test_released_more_often_than_allowed_is_a_fault(module):
    board = Board(module, swing_up=ENERGY, supervisor__attempts=1).balancing()
    released(board)
    assert board.mode() == BALANCE
    released(board)
    assert board.is_stopped_by(ATTEMPTS)


def test_memory_starts_afresh_at_every_capture(module):
    board = Board(module, swing_up=ENERGY).balancing()
    for k in range(200):
        board.counts[1] = k // 10
        board.step()
    assert board.state["law"]["constraint_offset"][0] != 0.0
    before = []
    for sign in (1, -1):
        for _ in range(16):
            board.counts[0] += sign * 100
            before.append((board.mode(), board.reason()))
            board.step()
    assert (SWING_UP, RELEASED) in before
    while board.mode() != BALANCE:
        board.step()
    law, out = board.state["law"], board.output["law"]
    assert law["constraint_offset"][0] == -out["s"][0]
    assert out["beta"][0] == 0.0
    start = board.params["law"]["bound_initial"][0]
    assert law["bound_estimate"][0] in (start, start * law["leakage_decay"][0])
    assert law["tau_previous"][0] == board.output["tau"][0]


def test_a_link_that_turned_over_in_balance_is_taken_where_it_is_when_released(host):
    """Else the laws after it would turn it all the way back."""
    board = Board(host, swing_up=ENERGY, supervisor__release_periods=60).balancing()
    for _ in range(50):  # a whole turn in 50 periods
        board.counts[0] += 100
        board.step()
    assert board.mode() == BALANCE
    assert board.output["q1"][0] > 2.2 * math.pi
    while board.mode() == BALANCE:
        board.step()
    assert board.output["q1"][0] == pytest.approx(0.5 * math.pi, abs=1e-2)


# --- What only init mends ------------------------------------------------------------------


@pytest.mark.parametrize("channel", ["q1", "q2"])
def test_a_position_that_was_lost_is_a_fault_until_init(module, channel):
    board = Board(module).started()
    for k in range(12):
        board.step(**{f"{channel}_valid": 0})
        assert (board.mode() == FAULT) == (k >= 8), k
    assert board.is_stopped_by(STALE)
    for _ in range(20):
        board.step(command=RESET)
        assert board.is_stopped_by(STALE), "the count is not known any more"
    board.state, status = module.init(board.params)
    assert status[0] == 0
    board.started()


def test_a_jump_that_lasts_is_a_lost_position(module):
    board = Board(module).started()
    board.counts[0] += 4000
    for _ in range(20):
        board.step(command=RESET)
        assert board.is_stopped_by(JUMP)


def test_parameters_that_init_refused_are_a_fault_in_every_period(module):
    params = module.params("rig")
    params["law"]["kappa"] = -1.0
    module.seal(params)
    state, status = module.init(params)
    assert status[0] != 0
    good = Board(module)
    good.state = state
    for command in (0, START, RESET, START):
        good.step(command=command)
        assert good.is_stopped_by(BOUNDS)


# --- Parameters that are sealed anew -------------------------------------------------------

#: One change a part of the block that is out of bounds, sealed by mistake.
BAD = {
    "a law's parameter": {"law__theta1": -1.0},
    "no number": {"law__kappa": math.nan},
    "an encoder's parameter": {"q1_encoder__counts_per_turn": 0.0},
    "an encoder's jump": {"q2_encoder__largest_jump": 0},
    "another period for an encoder": {"q1_encoder__sample_time": 2e-3},
    "another period for the supervisor": {"supervisor__sample_time": 2e-3},
    "a supervisor's parameter": {"supervisor__capture_periods": 0},
    "release before capture": {"supervisor__release_limit": 0.0},
    "a gain beyond all bounds": {"feedback_tau_q1": math.inf},
    "a negative tolerance": {"plan_start_q1": -1.0},
    "an unknown swing-up": {"swing_up": 3},
    "an unknown balance law": {"balance": 3},
    "an unknown plan": {"plan": 2},
    "half a turn": {"q1_turns": 2},
}


@pytest.mark.parametrize("what", BAD)
def test_a_bad_block_is_a_fault_until_a_good_one_is_sealed_and_reset(module, what):
    board = Board(module).started()
    good = board.params.copy()
    board.change(**BAD[what])
    for command in (0, RESET, START, RESET):
        board.step(command=command)
        assert board.is_stopped_by(BOUNDS), what
    board.params = good
    board.step()
    assert board.is_stopped_by(BOUNDS), "nothing but RESET leads out"
    board.step(command=RESET)
    assert board.mode() == IDLE
    board.change(law__torque_limit=0.5)
    for command in (START, 0, 0, 0, 0, 0):
        board.step(command=command)
    assert board.mode() == SWING_UP
    assert 0.0 < abs(board.torque()) <= 0.5


@pytest.mark.parametrize("mode", [IDLE, SWING_UP])
def test_other_encoder_parameters_are_in_force_from_the_next_period(module, mode):
    board = Board(module, swing_up=ENERGY).brought_to(mode)
    before = board.state["q1_encoder"].copy()
    board.change(q1_encoder__bandwidth=100.0)
    names = ["velocity_gain", "error_kept"]
    if mode == IDLE:  # in SWING_UP it would be a fault
        board.change(q1_encoder__offset=0.25)
        names.append("offset")
    board.step()
    after, fresh = board.state["q1_encoder"], module.init(board.params)[0]["q1_encoder"]
    for name in names:
        assert after[name][0] == fresh[name][0] != before[name][0]
    assert after["count"][0] == before["count"][0] == HANGING
    assert board.mode() == mode
