"""What the complete controller measures, and how long it follows a plan."""

import itertools

import pytest
from pfaffian.runtime.code.controller import host_control, ppc750_control
from support_control import (
    BALANCE,
    ENERGY,
    FOLDER,
    NO_SWING_UP,
    PLAN,
    START,
    SWING_UP,
    UPRIGHT,
    Board,
)


@pytest.fixture(scope="module", params=["host", pytest.param("ppc750", marks=pytest.mark.target)])
def module(request):
    return host_control(FOLDER) if request.param == "host" else ppc750_control(FOLDER)


@pytest.fixture(scope="module")
def host():
    return host_control(FOLDER)


def test_a_torque_jump_while_balancing_releases_nothing(module):
    """The measure of a jump is there for the moment of capture; in BALANCE it is zero."""
    jump, most = len(FOLDER.manifest.coordinates) + 3, 0.02
    board = Board(module, swing_up=ENERGY)
    limits = {n: board.params["supervisor"][n].copy() for n in ("capture_limit", "release_limit")}
    for values in limits.values():
        values[0, jump] = most
    board.change(
        supervisor__release_periods=1, **{f"supervisor__{n}": v for n, v in limits.items()}
    )
    board.balancing()
    largest = 0.0
    for k in range(40):  # a few counts to and fro: the torque of the law jumps
        before = board.torque()
        board.counts[1] = 10 * (k // 4 % 2)
        board.step()
        assert board.mode() == BALANCE
        largest = max(largest, abs(board.torque() - before))
    assert largest > 2.0 * most


def test_a_torque_jump_beyond_its_limit_forbids_the_capture(module):
    jump = len(FOLDER.manifest.coordinates) + 3
    board = Board(module, swing_up=NO_SWING_UP)
    limits = board.params["supervisor"]["capture_limit"].copy()
    limits[0, jump] = 1e-9
    board.change(supervisor__capture_limit=limits)
    board.counts = [UPRIGHT - 40, 20]
    board.step()
    for command in (START, *[0] * 20):
        board.step(command=command)
        assert board.mode() == SWING_UP
    assert abs(board.output["law"]["tau"][0]) > 1e-3


@pytest.mark.parametrize("patience", [0.0, 0.1])
def test_the_plan_is_followed_for_its_patience_after_its_end_and_no_longer(host, patience):
    """The arm is held still, and tolerances are wide open: the time alone decides."""
    wide = {f"plan_error_{c}": 1e6 for c in FOLDER.manifest.coordinates}
    board = Board(host, swing_up=PLAN, plan_patience=patience, **wide)
    board.step()
    board.step(command=START)
    followed = 0
    while int(board.output["phase"][0]) == PLAN and followed < 5000:
        followed += 1
        board.step()
    assert board.mode() == SWING_UP
    assert int(board.output["phase"][0]) == ENERGY
    seconds = 1.5  # of the plan of the set rig, docs/planning.md
    assert abs(followed - (seconds + patience) / 1e-3) <= 2.0


def test_the_torque_goes_on_from_the_last_one_by_one_slew_step_a_period(module):
    """From 0 it climbs by a step a period towards what the energy law asks for."""
    step = 0.01
    board = Board(module, swing_up=ENERGY, law__slew_limit=step / 1e-3)
    board.step()
    board.step(command=START)
    torques = [board.torque()]
    for _ in range(20):
        board.counts[0] += 2
        board.step()
        torques.append(board.torque())
    moves = [abs(b - a) for a, b in itertools.pairwise(torques)]
    assert max(moves) <= step * (1.0 + 1e-12)
    assert max(map(abs, torques)) > 5.0 * step
