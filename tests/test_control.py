"""The complete generated controller: modes, capture, faults, on the host and on the target."""

import math

import numpy as np
import pytest
from pfaffian.derive.design.place.linear_plant import state_space
from pfaffian.derive.pipeline import library_sets, lowered_model
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.base.checksum import checksum_of
from pfaffian.runtime.base.toml import read_toml
from pfaffian.runtime.code.controller import host_control, ppc750_control
from pfaffian.runtime.code.generated_model import open_generated
from pfaffian.runtime.contract.runtime_structs import SENSING, SUPERVISOR
from pfaffian.runtime.flight.scenario_files import find_scenario
from pfaffian.runtime.twin import Wanted, fly_twin, plant_model
from pfaffian.runtime.twin.files.read import twin_of
from pfaffian.runtime.twin.units.complete import complete_unit
from scipy.linalg import solve_continuous_are

IDLE, SWING_UP, BALANCE, FAULT = range(4)
START, STOP, RESET = 1, 2, 3
STARTED, STOPPED, CAPTURED, RELEASED, FAULTED, WAS_RESET = range(1, 7)
FOLDER = open_generated("pendubot")
QUANTUM = 2.0 * math.pi / 5000.0
HANGING = round(-0.5 * math.pi / QUANTUM)


@pytest.fixture(scope="module", params=["host", pytest.param("ppc750", marks=pytest.mark.target)])
def module(request):
    return host_control(FOLDER) if request.param == "host" else ppc750_control(FOLDER)


@pytest.fixture(scope="module")
def host():
    return host_control(FOLDER)


class Board:
    """One controller behind good readings, until told otherwise."""

    def __init__(self, module):
        self.module = module
        self.params = module.params("rig")
        self.state, status = module.init(self.params)
        assert status[0] == 0
        self.given, self.output = (module.records(f"control_{r}") for r in ("input", "output"))
        self.counts = [HANGING, 0]

    def step(self, **wrong):
        given = self.given
        given["q1_raw"], given["q2_raw"] = (c & 0xFFFFFFFF for c in self.counts)
        given["q1_valid"] = given["q2_valid"] = 1
        given["elapsed"], given["command"] = 1e-3, 0
        given["frame"] += 1
        given["heartbeat"] += 1
        for name, value in wrong.items():
            given[name] = value
        self.module.step(self.state, self.params, given, self.output)
        return self.output

    def started(self):
        self.step()
        self.step(command=START)
        for _ in range(3):
            self.step()
        assert self.mode() == SWING_UP
        return self

    def mode(self):
        return int(self.output["mode"][0])

    def fault(self):
        return int(self.output["fault"][0])


# --- Modes ---------------------------------------------------------------------------------


def test_nothing_is_commanded_before_start_and_after_stop(module):
    board = Board(module)
    for _ in range(5):
        board.step()
    assert (board.mode(), float(board.output["tau"][0])) == (IDLE, 0.0)
    board.step(command=START)
    assert (board.mode(), int(board.output["reason"][0])) == (SWING_UP, STARTED)
    for _ in range(20):
        board.step()
    assert board.output["tau"][0] != 0.0
    board.step(command=STOP)
    assert (board.mode(), int(board.output["reason"][0])) == (IDLE, STOPPED)
    assert board.output["tau"][0] == 0.0


def swung(changes, seconds=4.0, machine="host", turns=0.0):
    document = read_toml(find_scenario("rig-swing-up"))
    document["duration"] = f"{seconds} s"
    document["initial"] = {"q1": f"{-0.5 * math.pi + turns * 2.0 * math.pi} rad"}
    document["twin"] |= {"control": changes}
    scenario = twin_of(document, find_scenario("rig-swing-up"))
    model = plant_model(scenario.base.folder)
    return fly_twin(scenario, complete_unit(scenario, model, machine), Wanted(), model=model)


@pytest.fixture(scope="module")
def flight():
    return swung({}, 6.0)


def test_from_hanging_to_upright_within_the_limit_and_held(flight):
    found = flight.statistics
    assert found.captured[0]
    assert found.balance_time[0] < 1.5
    assert found.peak_torque[0, 0] <= 2.0
    assert found.violations[0] == 0
    assert (found.mae2[0] < 0.03).all()
    modes = flight.signals["mode"][:, 0]
    assert [int(m) for m, n in zip(modes[1:], modes[:-1], strict=True) if m != n] == [BALANCE]
    assert flight.signals["reason"][-1, 0] == CAPTURED


@pytest.mark.target
def test_a_flight_has_the_same_bits_on_the_target(flight):
    there = swung({}, 6.0, "ppc750")
    assert there.sha256() == flight.sha256()
    for name in flight.signals:
        one, other = (np.ascontiguousarray(f.signals[name]) for f in (flight, there))
        assert one.tobytes() == other.tobytes(), name


def test_integral_and_estimate_start_afresh_at_capture(flight):
    modes = flight.signals["mode"][:, 0]
    first = int(np.flatnonzero(modes == BALANCE)[0])
    assert flight.signals["beta"][first, 0] == 0.0  # (6): s(0) is that of this period
    assert flight.signals["phase"][first - 1, 0] == 2  # along the plan until then


def test_two_turns_away_is_the_same_place(flight):
    moved = swung({}, 2.5, turns=2.0).statistics
    assert moved.captured[0]
    assert moved.balance_time[0] == pytest.approx(flight.statistics.balance_time[0], abs=2e-3)


def test_the_energy_law_is_used_where_it_is_chosen_and_where_the_plan_is_left():
    chosen = swung({"swing_up": "energy"}, 0.5)
    assert set(chosen.signals["phase"][5:, 0].tolist()) == {1}
    left = swung({"plan_error_q1": 1e-2}, 0.5)
    assert {1, 2} <= set(left.signals["phase"][:, 0].tolist())
    assert left.signals["phase"][-1, 0] == 1
    none = swung({"swing_up": "none"}, 0.2)
    assert not none.signals["tau"].any()


@pytest.mark.parametrize("law", ["nominal", "feedback"])
def test_the_baselines_hold_it_too(law):
    found = swung({"balance": law}, 6.0).statistics
    assert found.balance_time[0] < 1.5
    assert (found.mae2[0] < 0.1).all()


def test_the_feedback_is_the_regulator_of_section_five():
    """Q = I, R = 1 on the linearisation that the model's blocks give."""
    source = find_model("pendubot")
    model = lowered_model(source)
    values = next(s for s in library_sets(model, source) if s.name == "rig").as_dict()
    a, b = state_space(model, values)
    gain = (b.T @ solve_continuous_are(a, b, np.eye(4), np.eye(1)))[0]
    params = FOLDER.manifest.control_sets["rig"]
    ours = [params[f"feedback_tau_{n}"] for n in ("q1", "q2", "dq1", "dq2")]
    assert ours == pytest.approx(gain.tolist(), rel=1e-8)


# --- Parameters ----------------------------------------------------------------------------


def leaves(record):
    """Yield (path, record, name) of every scalar and array member of a parameter block."""
    for name in record.dtype.names:
        if record[name].dtype.names:
            for path, inner, last in leaves(record[name]):
                yield f"{name}.{path}", inner, last
        else:
            yield name, record, name


def test_the_seal_is_that_of_the_generated_constants(module):
    params = module.params("rig")
    before = int(params["checksum"][0])
    assert int(module.seal(params)["checksum"][0]) == before


def test_every_flipped_parameter_is_a_fault_in_the_same_period(module):
    whole = Board(module).started()
    for path, _, _ in list(leaves(whole.params)):
        board = Board(module)
        board.state, board.given, board.params = (
            r.copy() for r in (whole.state, whole.given, whole.params)
        )
        record, name = next((r, n) for p, r, n in leaves(board.params) if p == path)
        raw = record[name].reshape(-1)[:1].copy()
        raw.view(np.uint8)[raw.dtype.itemsize // 2] ^= 1
        record[name].reshape(-1)[:1] = raw
        board.step()
        assert (board.mode(), board.output["tau"][0]) == (FAULT, 0.0), path
        assert board.fault() in (2, 3), path  # 3 where it is out of the supervisor's bounds too


def test_a_sealed_block_out_of_its_bounds_is_a_fault(module):
    board = Board(module).started()
    board.params["law"]["theta1"] = -1.0
    module.seal(board.params)
    board.step()
    assert (board.mode(), board.fault()) == (FAULT, 3)
    assert board.output["tau"][0] == 0.0


def test_a_change_that_is_sealed_and_sound_is_taken(module):
    board = Board(module).started()
    board.params["law"]["torque_limit"] = 0.01
    module.seal(board.params)
    for _ in range(50):
        board.step()
        assert abs(board.output["tau"][0]) <= 0.01
    assert board.mode() == SWING_UP


# --- Faults --------------------------------------------------------------------------------

#: What is given wrong in one period, and the fault it is.
WRONG = {
    "elapsed not a number": ({"elapsed": math.nan}, 4),
    "elapsed infinite": ({"elapsed": math.inf}, 4),
    "stale frame": ({"frame": 5}, 7),
    "encoder 1 jumps": ({"q1_raw": HANGING + 4000 & 0xFFFFFFFF}, 6),
    "encoder 2 jumps": ({"q2_raw": 500}, 6),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_fault_is_latched_in_the_same_period_until_reset(module, what):
    board, (wrong, code) = Board(module).started(), WRONG[what]
    assert int(board.given["frame"][0]) == 5
    board.step(**wrong)
    assert (board.mode(), board.fault()) == (FAULT, code)
    assert board.output["tau"][0] == 0.0
    for k in range(1000):
        board.step(command=(START, STOP, 0)[k % 3])
        assert (board.mode(), board.fault(), board.output["tau"][0]) == (FAULT, code, 0.0)
    board.step(command=RESET)
    assert (board.mode(), int(board.output["reason"][0])) == (IDLE, WAS_RESET)
    board.step(command=START)
    assert board.mode() == SWING_UP


def test_a_reset_while_the_cause_lasts_is_refused(module):
    board = Board(module).started()
    board.step(elapsed=math.nan)
    board.step(elapsed=math.nan, command=RESET)
    assert (board.mode(), board.fault()) == (FAULT, 4)


def test_overruns_are_forgiven_three_times(module):
    board = Board(module).started()
    for _ in range(3):
        board.step(elapsed=0.01)
        assert board.mode() == SWING_UP
    board.step(elapsed=0.01)
    assert (board.mode(), board.fault()) == (FAULT, 8)


def test_the_watchdog_expires_after_its_time(module):
    board = Board(module).started()
    last = int(board.given["heartbeat"][0])
    for k in range(110):
        board.step(heartbeat=last)
        assert (board.mode() == FAULT) == (k >= 100), k
    assert board.fault() == 9


def test_missing_readings_are_bridged_and_then_a_fault(module):
    board = Board(module).started()
    for k in range(12):
        board.step(q2_valid=0)
        assert (board.mode() == FAULT) == (k >= 8), k
    assert board.fault() == 7


def test_a_link_beyond_its_range_is_a_fault(module):
    board = Board(module).started()
    for _ in range(200):  # 100 counts a period: 126 rad/s, as fast as the encoder is believed
        board.counts[1] += 100
        board.step()
    assert board.mode() == SWING_UP
    coarse = Board(module)  # 100 counts a period now are a turn
    coarse.params["q2_encoder"]["counts_per_turn"] = 100.0
    module.seal(coarse.params)
    coarse.state, _ = module.init(coarse.params)
    coarse.started()
    for _ in range(20):
        coarse.counts[1] += 100
        coarse.step()
        if coarse.mode() == FAULT:
            break
    assert (coarse.mode(), coarse.fault()) == (FAULT, 5)
    assert abs(coarse.output["dq2"][0]) > 1e3
    assert coarse.output["tau"][0] == 0.0
    coarse.step(q2_valid=0, command=RESET)
    assert coarse.mode() == FAULT  # as fast as ever


def test_a_supervisor_whose_memory_contradicts_itself_stops(module):
    for name, bit in (("mode", 0), ("mode_inverse", 3), ("fault", 1), ("ready", 0)):
        board = Board(module).started()
        board.state["supervisor"][name] ^= 1 << bit
        board.step()
        assert (board.mode(), board.fault()) == (FAULT, 1), name
        assert board.output["tau"][0] == 0.0
        board.step(command=RESET)
        assert board.mode() == FAULT  # only init makes it trusted again


def wild(rng, records, share):
    """Invert random bits of a share of the bytes of every record."""
    raw = records.view(np.uint8).reshape(len(records), -1)
    hit = rng.random(raw.shape) < share[:, None]
    raw[hit] = rng.integers(0, 256, int(hit.sum()), dtype=np.uint8)


def test_whatever_bits_come_in_the_torque_is_finite_within_its_limit_and_the_mode_is_one(host):
    rng, count = np.random.default_rng(77), 50_000
    for sealed in (False, True):
        board = Board(host).started()
        state, params, given = (
            np.repeat(r, count) for r in (board.state, board.params, board.given)
        )
        for records in (state, params, given):
            wild(rng, records, rng.choice([0.0, 0.002, 0.02, 1.0], count))
        if sealed:
            host.seal(params)
        output = host.records("control_output", count)
        host.step(state, params, given, output)
        tau, limit = output["tau"], params["law"]["torque_limit"]
        assert np.isfinite(tau).all()
        assert (output["mode"] <= FAULT).all()
        allowed = np.isin(output["mode"], (SWING_UP, BALANCE))
        assert not tau[~allowed].any()
        assert (np.abs(tau[allowed]) <= limit[allowed]).all()
        assert allowed.any()
        assert ((output["fault"] != 0) == (output["mode"] == FAULT)).all()


def test_the_layouts_are_what_the_checksum_runs_over(host):
    """The generated constants' checksum is that of `runtime.checksum` over the same words."""
    assert {"params", "state", "input", "output"} <= set(SENSING) & set(SUPERVISOR)
    assert checksum_of([1.0, 2]) != checksum_of([2, 1.0])
    assert int(host.params("rig")["checksum"][0]) == FOLDER.manifest.control_sets["rig"]["checksum"]
