"""Planned motions: they satisfy the ODE and every limit, say so truthfully, and can be followed."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from pfaffian.derive.derivation.derive import Derivation
from pfaffian.derive.pipeline import derivation_of, lowered_model, parameter_set
from pfaffian.derive.plan.check import DEFECT_TOLERANCE, check_plan
from pfaffian.derive.plan.document import plan_text, read_plan, write_plan
from pfaffian.derive.plan.follow import FollowOptions, follow_plan
from pfaffian.derive.plan.planner import Plan, fine_grid, make_plan, recheck
from pfaffian.derive.plan.plant import casadi_rates, numeric_plant
from pfaffian.derive.plan.problem import PlanOptions
from pfaffian.derive.plan.reference import Curve, torque_at
from pfaffian.derive.plan.riccati import Linearised
from pfaffian.derive.sets.parameter_set import ParameterSet
from pfaffian.derive.spec.library import LIBRARY, find_model
from pfaffian.runtime.base.errors import CheckError, InputError
from scipy.integrate import solve_ivp

RIG = LIBRARY / "pendubot/plans/rig.json"
QUICK = PlanOptions(
    end_time=(2.0, 2.0), speed_limits={"x": 2.3}, starts=3, coarse=30, fine=50, seed=1
)


def model_and_set(name: str, chosen: str) -> tuple[Derivation, ParameterSet]:
    folder = find_model(name)
    values = parameter_set(lowered_model(folder), folder, folder.set_path(chosen))
    return derivation_of(folder), values


@pytest.fixture(scope="module")
def cart() -> tuple[Derivation, ParameterSet]:
    return model_and_set("cart_pole", "barto")


@pytest.fixture(scope="module")
def swing(cart: tuple[Derivation, ParameterSet]) -> Plan:
    """Return a swing-up of the cart-pole, with a limit on the cart's speed that is reached."""
    return make_plan(*cart, QUICK)


@pytest.fixture(scope="module")
def rig() -> Plan:
    return read_plan(RIG)


@pytest.mark.parametrize("name", ["pendubot", "acrobot", "furuta", "pvtol", "chain"])
def test_the_plants_that_plan_check_and_simulate_agree(name):
    folder = find_model(name)
    derivation, values = model_and_set(name, next(iter(folder.sets())))
    plant = numeric_plant(derivation, values.as_dict())
    rates = casadi_rates(derivation, values.as_dict())
    rng = np.random.default_rng(7)
    for _ in range(20):
        x, tau = rng.standard_normal(2 * plant.n), rng.standard_normal(plant.m)
        ours = plant.rates(x, tau)
        theirs = np.array(rates(x, tau)).ravel()
        assert ours == pytest.approx(theirs, rel=1e-10, abs=1e-10 * np.max(np.abs(ours)))
        assert plant.quick_rates(x, tau) == pytest.approx(theirs, rel=1e-13, abs=1e-10)


def test_a_swing_up_is_found_from_rest_to_rest_within_its_limits(swing):
    path, problem = swing.trajectory, swing.problem
    assert path.end_time == pytest.approx(2.0)
    assert problem.start == pytest.approx((0.0, -math.pi, 0.0, 0.0))
    assert path.states[0] == pytest.approx(problem.start, abs=1e-12)
    assert path.states[-1] == pytest.approx((0.0, 0.0, 0.0, 0.0), abs=1e-9)
    assert path.torques[0] == path.torques[-1] == pytest.approx(0.0)
    assert np.max(np.abs(path.torques)) <= problem.torque_limits[0]
    assert swing.check.violations == ()
    assert swing.check.defect <= DEFECT_TOLERANCE
    assert 0.99 * 2.3 < swing.check.peak_speed[0] <= 2.3


def test_between_the_nodes_the_plan_is_the_motion_of_the_plant(cart, swing):
    """Radau's method, from every fifth node to the next, on the generated block's CasADi graph."""
    path = swing.trajectory
    rates = casadi_rates(cart[0], cart[1].as_dict())

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        return np.array(rates(x, torque_at(path.times, path.torques, t))).ravel()

    for k in range(0, len(path.times) - 1, 5):
        span = (path.times[k], path.times[k + 1])
        end = solve_ivp(slope, span, path.states[k], method="Radau", rtol=1e-9, atol=1e-11).y[:, -1]
        assert end == pytest.approx(path.states[k + 1], abs=2.0 * DEFECT_TOLERANCE)


def test_without_friction_the_work_done_is_the_energy_gained(swing, rig):
    for plan in (swing, rig):
        check = plan.check
        assert check.work == pytest.approx(check.energy_change, rel=1e-6)
        assert check.energy_used >= abs(check.work)


def test_planning_again_gives_the_same_bytes(cart, swing):
    assert plan_text(make_plan(*cart, QUICK)) == plan_text(swing)


def test_a_plan_file_reads_back_to_the_same_bits(swing, tmp_path):
    path = tmp_path / "swing.json"
    write_plan(swing, path)
    again = read_plan(path)
    assert plan_text(again) == plan_text(swing) == path.read_text()
    for ours, theirs in (
        (swing.trajectory.times, again.trajectory.times),
        (swing.trajectory.states, again.trajectory.states),
        (swing.trajectory.torques, again.trajectory.torques),
        (swing.accelerations, again.accelerations),
        (swing.row.rows, again.row.rows),
        (swing.row.rates, again.row.rates),
        (swing.row.matrices, again.row.matrices),
    ):
        assert ours.tobytes() == theirs.tobytes()
    assert again.problem == swing.problem
    assert again.check == swing.check
    assert again.provenance == swing.provenance


def spoilt(change) -> str:
    document = json.loads(RIG.read_text())
    change(document)
    return json.dumps(document)


#: What is wrong: the change to a good file, and what the message must say.
DAMAGED = {
    "another format": (lambda d: d.update(format="plan 9"), "format = 'plan 9'"),
    "no states": (lambda d: d.pop("states"), "missing states"),
    "one node short": (lambda d: d["torques"].pop(), "torques does not have the shape"),
    "a text for a number": (lambda d: d["states"][3].__setitem__(0, "1"), "not a finite number"),
    "a number without end": (
        lambda d: d["states"][3].__setitem__(0, math.inf),
        "inf is not a finite",
    ),
    "an integer without end": (lambda d: d["problem"].update(sample_time=10**400), "sample_time"),
    "time running back": (lambda d: d["times"].__setitem__(5, 0.0), "times must begin with 0"),
    "no torque limits": (lambda d: d["problem"].pop("torque_limits"), "missing torque_limits"),
    "a truth value": (lambda d: d["provenance"].update(seed=True), "seed = True is no count"),
    "a list for a table": (lambda d: d.update(problem=[]), "problem: must be a table"),
}


@pytest.mark.parametrize("what", DAMAGED)
def test_a_damaged_file_is_refused_with_file_and_key(what, tmp_path):
    change, says = DAMAGED[what]
    path = tmp_path / "broken.json"
    path.write_text(spoilt(change))
    with pytest.raises(InputError) as refused:
        read_plan(path)
    assert str(path) in refused.value.message
    assert says in refused.value.message
    assert refused.value.remedy


def test_the_committed_plan_of_the_rig_is_the_one_that_was_promised(rig):
    """Upright within 1.5 s with at most 2 N m, against the ODE, without any solver."""
    derivation, chosen = model_and_set("pendubot", "rig")
    again = recheck(derivation, chosen, rig, str(RIG))
    assert again.check.violations == ()
    assert again.trajectory.end_time <= 1.5
    assert again.check.peak_torque[0] <= 2.0
    hanging, upright = again.problem.start, again.problem.goal
    assert hanging == pytest.approx((-math.pi / 2, 0.0, 0.0, 0.0))
    assert upright == pytest.approx((math.pi / 2, 0.0, 0.0, 0.0))
    for figure in ("defect", "energy_used", "work"):
        assert getattr(again.check, figure) == pytest.approx(
            getattr(rig.check, figure), rel=1e-6, abs=1e-9
        )


def test_plans_are_no_parameter_sets():
    assert set(find_model("pendubot").sets()) >= {"rig", "sim", "sim-designed"}
    assert {p.parent for p in find_model("pendubot").sets().values()} == {RIG.parent.parent}


#: What was done to a good plan, and what its check must say.
WRONG = {
    "a node moved": (lambda p: p.states.__setitem__((40, 1), p.states[40, 1] + 1e-5), "misses"),
    "more torque than there is": (lambda p: p.torques.__setitem__((9, 0), 2.5), "beyond 2 N*m"),
    "another goal": (lambda p: p.states.__setitem__((-1, 0), 1.5), "it ends 0.0708 away"),
    "another start": (lambda p: p.states.__setitem__((0, 0), -1.5), "it starts 0.0708 away"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_plan_that_is_none_is_refused(what, rig):
    change, says = WRONG[what]
    derivation, chosen = model_and_set("pendubot", "rig")
    path = rig.trajectory
    path = replace(path, states=path.states.copy(), torques=path.torques.copy())
    change(path)
    with pytest.raises(CheckError, match=says.replace("*", r"\*")):
        recheck(derivation, chosen, replace(rig, trajectory=path), "mine.json")


def test_a_smaller_limit_binds_the_plan_and_leaves_the_law_the_rest(cart, swing):
    asked = replace(QUICK, torque_limits={"u": 9.0}, speed_limits={})
    tight = make_plan(*cart, asked)
    assert tight.problem.torque_limits == (9.0,)
    assert tight.problem.available_limits == swing.problem.available_limits == (10.0,)
    assert tight.check.peak_torque[0] <= 9.0


def test_a_limit_that_is_broken_between_the_nodes_is_seen(cart, swing):
    plant = numeric_plant(cart[0], cart[1].as_dict())
    peak = swing.check.peak_speed[1]
    tight = replace(swing.problem, speed_limits=(2.3, peak * (1.0 - 1e-9)))
    said = check_plan(plant, tight, swing.trajectory).violations
    assert len(said) == 1
    assert "dtheta reaches" in said[0]


def test_a_row_that_is_not_of_its_riccati_matrix_is_refused(rig):
    derivation, chosen = model_and_set("pendubot", "rig")
    rows = rig.row.rows.copy()
    rows[7] *= 1.001
    with pytest.raises(CheckError, match=r"the row at 0\.07 s is not B\^T P"):
        recheck(derivation, chosen, replace(rig, row=replace(rig.row, rows=rows)), "mine.json")


def test_a_plan_of_another_plant_or_model_is_refused(rig, cart):
    derivation, chosen = model_and_set("pendubot", "sim")
    with pytest.raises(InputError, match=r"theta1 was 0\.0096, but is 0\.0244"):
        recheck(derivation, chosen, rig, "mine.json")
    with pytest.raises(InputError, match="is a plan of model pendubot"):
        recheck(*cart, rig, "mine.json")
    stale = replace(rig, problem=replace(rig.problem, model_sha256="0" * 64))
    with pytest.raises(InputError, match="the equations of pendubot have changed"):
        recheck(*model_and_set("pendubot", "rig"), stale, "mine.json")


def test_the_row_rates_are_the_derivative_of_the_rows(rig):
    """Boole's rule over the rates of five nodes gives what the row changes by.

    Where the second link whips round, at some of the nodes, 10 ms are coarse for it.
    """
    rows, rates, h = rig.row.rows, rig.row.rates, rig.trajectory.times[1]
    weights = np.array([7.0, 32.0, 12.0, 32.0, 7.0]) * 2.0 * h / 45.0
    change = sum(w * rates[k : len(rates) - 4 + k] for k, w in enumerate(weights))
    off = np.abs(change - (rows[4:] - rows[:-4])) / np.max(np.abs(rows))
    assert np.quantile(off, 0.97) < 1e-3
    assert off.max() < 5e-3
    assert np.max(np.abs(change)) > 0.1 * np.max(np.abs(rows))


def test_on_s_0_the_riccati_function_falls_along_the_linearised_error(rig):
    """V = x^T P x of the error dynamics on s = 0, flown by itself, never rises."""
    derivation, chosen = model_and_set("pendubot", "rig")
    linear = Linearised(casadi_rates(derivation, chosen.as_dict()), 4, 1)
    path = rig.trajectory
    slopes = np.hstack([path.states[:, 2:], rig.accelerations])
    state = Curve(path.times, path.states, slopes)
    row = Curve(path.times, rig.row.rows, rig.row.rates)

    def sliding(t: float, x: np.ndarray) -> np.ndarray:
        a, b, _ = linear(state(t), torque_at(path.times, path.torques, t))
        s, ds = row(t), row.slope(t)
        return a @ x - b @ np.linalg.solve(s @ b, (s @ a + ds) @ x)

    for direction in np.linalg.svd(rig.row.rows[0])[2][1:]:
        span = (0.0, path.end_time)
        run = solve_ivp(sliding, span, direction, t_eval=path.times, rtol=1e-7, atol=1e-10).y.T
        values = [float(x @ p @ x) for x, p in zip(run, rig.row.matrices, strict=True)]
        assert all(b < a * (1.0 + 1e-6) for a, b in pairwise(values))
        assert values[-1] < 0.5 * values[0]
        left = [np.max(np.abs(s @ x)) for s, x in zip(rig.row.rows, run, strict=True)]
        assert max(left) < 1e-3 * np.max(np.abs(rig.row.rows[0]))


def test_the_input_gain_of_the_row_keeps_its_sign(rig, swing):
    for plan in (rig, swing):
        assert plan.row.lyapunov_rate < 0.0
        assert plan.row.input_gain > 0.0
        assert all(np.linalg.eigvalsh(p)[0] > 0.0 for p in plan.row.matrices)


def test_the_law_follows_where_playback_falls_over(rig):
    derivation, _ = model_and_set("pendubot", "rig")
    as_planned, *_, both = follow_plan(derivation, rig, FollowOptions(draws=1))
    assert as_planned.law[0].standing
    assert max(as_planned.law[0].error) < 0.01
    assert as_planned.law[0].energy_used == pytest.approx(rig.check.energy_used, rel=0.01)
    assert both.law[0].standing
    assert both.law[0].peak_torque <= 2.0
    assert not both.playback[0].standing


@pytest.mark.parametrize(
    ("end", "wanted", "sample", "expected"),
    [(1.5, 150, 1e-3, (1.5, 150)), (2.0, 30, 1e-3, (2.0, 25)), (1.009, 100, 1e-3, (1.0, 100))],
)
def test_intervals_are_whole_numbers_of_samples(end, wanted, sample, expected):
    time, intervals = fine_grid(end, wanted, sample)
    assert (time, intervals) == (pytest.approx(expected[0]), expected[1])
    each = time / intervals / sample
    assert each == pytest.approx(round(each))


#: Options that cannot be: what is asked of the cart-pole, and what the message must say.
REFUSED = {
    "no time": (("--end-time", "0"), "--end-time: 0 to 0 s is no end time"),
    "a range turned round": (("--end-time", "3:1"), "3 to 1 s is no end time"),
    "a mass for a time": (("--end-time", "1 kg"), "--end-time"),
    "less than ten samples": (("--end-time", "0.005"), "less than ten sample times"),
    "an unknown actuator": (("--torque-limit", "v=1 N"), "there is no v"),
    "no force at all": (("--torque-limit", "0 N"), "u = 0 is no limit"),
    "a torque for a force": (("--torque-limit", "2 N*m"), "--torque-limit"),
    "an unknown rate": (("--speed-limit", "y=1"), "there is no y"),
    "a speed of nothing in particular": (("--speed-limit", "3"), "does not say of what"),
    "a speed twice": (("--speed-limit", "x=1,x=2"), "x is given twice"),
    "an unknown weight": (
        ("--weights", "power=1"),
        "--weights: there is no weight 'power'",
    ),
    "no weight": (("--weights", "power"), "--weights: 'power' is not of the form NAME=VALUE"),
    "a weight twice": (("--weights", "time=1,time=2"), "--weights: time is given twice"),
    "a negative weight": (("--weights", "speed=-1"), "speed = -1 is no weight"),
    "torque for nothing": (("--weights", "effort=0,smoothness=0"), "not determined"),
    "three weights for four": (("--riccati", "1,1,1"), "3 weights for 4 states"),
    "no starts": (("--seeds", "0"), "--seeds: 0"),
    "a negative seed": (("--seed", "-1"), "--seed: -1"),
    "two intervals": (("--nodes", "2"), "--nodes: 2"),
    "fewer draws than none": (("--draws", "-1"), "--draws: -1"),
    "a start at the goal": (("--start", "theta=0"), "would start at its goal"),
    "a start nowhere": (("--start", "theta=nan"), "--start"),
    "a plan that is no JSON": (("-o", "plan.toml"), "is no .json file"),
    "a folder that is not there": (("-o", "none/plan.json"), "there is no folder none"),
    "a plan to check that is not there": (("--check", "none.json"), "none.json"),
    "checking and planning": (("--check", "a.json", "--seeds", "3"), "--check only checks"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_planned_is_refused(what, refused):
    arguments, says = REFUSED[what]
    refused("plan", "cart_pole", *arguments, says=(says,))


def test_a_plant_that_rests_at_its_setpoint_asks_for_a_start(refused):
    refused("plan", "crane", says=("rests by itself", "--start"))


def test_what_cannot_be_reached_in_time_is_a_failed_check(refused):
    arguments = ("--end-time", "0.2", "--seeds", "2", "--coarse", "20")
    refused("plan", "cart_pole", *arguments, says=("none of 2 starts led to a plan",), code=1)


def test_the_command_plans_writes_draws_and_checks(run, workspace):
    quick = ("--end-time", "2.2", "--seeds", "2", "--coarse", "30", "--nodes", "40")
    few = ("--draws", "0", "--json")
    files = ("-o", "swing.json", "--plot", "swing.svg")
    made = run("plan", "cart_pole", *quick, *files, *few).document()
    assert made["end_time"] == pytest.approx(2.2)
    assert made["defect"] <= DEFECT_TOLERANCE
    assert made["peak_torque"][0] <= made["torque_limits"][0]
    assert [f["case"] for f in made["following"]] == ["as planned"]
    assert Path("swing.svg").read_text().startswith("<?xml")
    checked = run("plan", "cart_pole", "--check", "swing.json", *few)
    assert checked.code == 0
    assert checked.document()["energy_used"] == made["energy_used"]
    document = json.loads(Path("swing.json").read_text())
    document["torques"][5][0] += 0.01
    Path("swing.json").write_text(json.dumps(document))
    spoilt_run = run("plan", "cart_pole", "--check", "swing.json")
    assert spoilt_run.code == 1
    assert "the ODE misses the node" in spoilt_run.err
