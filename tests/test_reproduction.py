"""The paper's simulations: the numbers behind every verdict of `pfaffian reproduce`."""

from __future__ import annotations

import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from pfaffian.derive.design.place.linear_plant import state_space
from pfaffian.derive.pipeline import derivation_of, lowered_model
from pfaffian.derive.spec.library import find_model
from pfaffian.paper.simulations.as_printed import adaptation_gain, printed_gain
from pfaffian.paper.simulations.baseline import linear_plant, lqr_gain
from pfaffian.paper.simulations.cases import (
    DERIVED,
    DESIGNED,
    LQR,
    PRINTED,
    TERMS,
    case_of,
    changed,
    damping,
    with_printed_adaptation,
)
from pfaffian.paper.simulations.fly import CVODES, STALLED, Task, fly, pack_run, read_run
from pfaffian.paper.simulations.independent import closed_loop, fly_independent
from pfaffian.paper.simulations.loop import SIGNALS, Loop
from pfaffian.paper.simulations.measures import measures
from pfaffian.paper.simulations.mujoco import agreement
from pfaffian.paper.simulations.runs import REST, USED, main_task
from pfaffian.paper.verdicts.theorem import judge
from pfaffian.runtime.code.generated_model import host_model, open_generated
from scipy.optimize import fsolve

FOLDER = open_generated("pendubot")
#: Section 4 of the theory, a prototype with another solver: IAE q1, q2, MAE2 q1, q2.
PROTOTYPE = {
    ("5.1", DERIVED): (0.624, 0.620, 1.15e-2, 1.27e-2),
    ("5.1", DESIGNED): (0.182, 0.166, 2.9e-8, 2.7e-8),
    ("5.1", LQR): (9.76, 9.72, 1.25, 1.25),
    ("5.2", DERIVED): (0.615, 0.611, 1.06e-2, 1.09e-2),
    ("5.2", DESIGNED): (0.183, 0.166, 0.0, 0.0),
}
PROTOTYPE_GAIN = (-29.86, -29.19, -4.66, -2.75)
#: What the solver's absolute tolerance may leave of MAE2, in rad.
RESIDUE = 1e-8


@pytest.fixture(scope="module")
def host():
    return host_model(FOLDER)


@pytest.fixture(scope="module")
def gain(host):
    return lqr_gain(host)


def flight(host, section, column, terms="", gain=(), **how):
    case = case_of(FOLDER, section, column, terms or USED[section], gain)
    return fly(replace(main_task(case), **how), host)


def random_states(count):
    rng = np.random.default_rng(7)
    low, high = np.array([0.5, -0.7, -3, -3, -1, 0]), np.array([2.5, 0.7, 3, 3, 1, 0.3])
    return rng.uniform(low, high, (count, 6))


# --- the equations ------------------------------------------------------------------------------


@pytest.mark.parametrize("column", [DERIVED, DESIGNED])
@pytest.mark.parametrize("section", ["5.1", "5.2", "5.3"])
def test_generated_loop_is_the_papers_equations_typed_in_again(host, section, column):
    case = case_of(FOLDER, section, column, USED[section])
    loop = Loop(case, host)
    x, rate, signals = closed_loop(case)
    evaluate = ca.Function("f", [x], [rate, signals])
    for y in random_states(200):
        theirs = [np.array(v).ravel() for v in evaluate(y)]
        scale = max(1.0, float(np.abs(theirs[0]).max()))
        np.testing.assert_allclose(loop(0.0, y), theirs[0], rtol=1e-9, atol=1e-9 * scale)
        np.testing.assert_allclose(loop.signals(y), theirs[1], rtol=1e-9, atol=1e-9 * scale)


def test_the_printed_law_differs_by_its_gain_alone(host):
    case = case_of(FOLDER, "5.2", PRINTED, TERMS[2])
    printed, derived = Loop(case, host), Loop(replace(case, column=DERIVED), host)
    gains = case.controller
    for y in random_states(50):
        of = dict(zip(SIGNALS, printed.signals(y), strict=True))
        ours = dict(zip(SIGNALS, derived.signals(y), strict=True))
        q2 = y[1]
        det = gains["theta1"] * gains["theta2"] - gains["theta3"] ** 2 * math.cos(q2) ** 2
        ten, fortyeight = gains["lam"] * gains["theta2"] / det, gains["theta2"] / det
        assert printed_gain(gains, q2) == pytest.approx(ten)
        assert adaptation_gain(gains, q2) == pytest.approx(fortyeight)
        assert of["p1"] * ten == pytest.approx(ours["p1"] * ours["adb"])
        assert of["p2"] == pytest.approx(-gains["kappa"] * ten * of["beta"])
        e = y[:2] - [gains["q1d"], gains["q2d"]]
        regressor = (np.linalg.norm(y[2:4]) + 1) ** 2 + (np.linalg.norm(e) + 1) ** 2
        grown = gains["k1"] * regressor * abs(fortyeight * of["beta"]) - gains["k2"] * y[5]
        assert printed(0.0, y)[5] == pytest.approx(grown)
        mixed = Loop(with_printed_adaptation(replace(case, column=DERIVED)), host)
        assert mixed(0.0, y)[5] == pytest.approx(grown)
        assert mixed.signals(y) == derived.signals(y)


def test_lqr_gain_follows_from_the_derived_linearisation(host, gain):
    model = lowered_model(find_model("pendubot"))
    for ours, derived in zip(
        linear_plant(host, "sim"), state_space(model, FOLDER.parameters("sim")), strict=True
    ):
        np.testing.assert_allclose(ours, derived, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(gain, PROTOTYPE_GAIN, atol=0.006)


# --- the figures --------------------------------------------------------------------------------


@pytest.mark.parametrize(("section", "column"), PROTOTYPE)
def test_the_prototypes_figures_are_met_within_two_percent(host, gain, section, column):
    m = measures(flight(host, section, column, gain=gain))
    found = [m[k] for k in ("iae_q1", "iae_q2", "mae2_q1", "mae2_q2")]
    np.testing.assert_allclose(found, PROTOTYPE[section, column], rtol=0.02, atol=RESIDUE)


def test_from_rest_section_51_passes_close_to_the_singular_set(host):
    case = changed(case_of(FOLDER, "5.1", DERIVED, TERMS[1]), "at-rest", REST)
    run = fly(Task(case), host)
    m = measures(run)
    np.testing.assert_allclose([m["iae_q1"], m["iae_q2"]], [1.68, 1.62], rtol=0.02)
    singular = math.acos(1193 / 1752)
    assert 0.0 < singular - np.abs(run.state[:, 1]).max() < 0.013


def test_lqr_rests_where_it_has_lost_its_stability(host, gain):
    """So that nothing coarser than 1e-10 can say where it goes from there."""
    run = flight(host, "5.1", LQR, gain=gain, record=1e-2)
    loop = Loop(run.case, host)

    def fastest(time):
        y = run.state[round(time / 1e-2)]
        step = 1e-6 * np.eye(6)
        columns = [(np.array(loop(0, y + h)) - loop(0, y - h))[:4] / 2e-6 for h in step[:4]]
        return np.linalg.eigvals(np.array(columns).T).real.max()

    assert fastest(2.0) < 0.0 < 5.0 < fastest(4.5)
    loaded = fsolve(lambda q: loop(0, np.array([*q, 0, 0, 0, 0.0]))[2:4], run.state[-1, :2])
    assert loaded[0] - np.pi / 2 == pytest.approx(1.317, abs=1e-3)
    run.state[0] = [*loaded, 0, 0, 0, 0]
    assert fastest(0.0) == pytest.approx(19.3, abs=0.1)
    coarse = flight(host, "5.1", LQR, gain=gain, solver="LSODA", relative=1e-6, absolute=1e-8)
    assert coarse.ended == "speed"


@pytest.mark.parametrize(
    ("section", "terms", "end"),
    [("5.1", TERMS[1], 9.489e-4), ("5.2", TERMS[2], 7.141e-4), ("5.3", TERMS[2], 5.959e-4)],
)
def test_as_printed_it_runs_away_within_a_millisecond(host, section, terms, end):
    case = case_of(FOLDER, section, PRINTED, terms)
    fine = fly(replace(main_task(case), relative=1e-11, absolute=1e-13), host)
    explicit = fly(replace(main_task(case), solver="RK45", relative=1e-9, absolute=1e-11), host)
    for run in (fine, explicit):
        assert run.ended
        assert run.end == pytest.approx(end, rel=1e-3)
        assert run.over_limit is not None
        assert run.over_limit < run.end


def test_as_printed_beta_grows_at_the_rate_of_the_wrong_sign(host):
    run = flight(host, "5.1", PRINTED)
    gains = run.case.controller
    rate = -gains["kappa"] * printed_gain(gains, 0.5) * run.signals["adb"][0]
    beta = np.abs(run.signals["beta"])
    early = (beta > 0.05) & (beta < 2.0)
    measured = np.polyfit(run.time[early], np.log(beta[early]), 1)[0]
    assert rate > 1e4
    assert measured == pytest.approx(rate, rel=0.2)


@pytest.mark.parametrize(("column", "end"), [(DERIVED, 0.66652), (DESIGNED, 0.55758)])
def test_p1_alone_escapes_at_the_singular_set(host, column, end):
    runs = [
        flight(host, "5.1", column, TERMS[0], solver=solver, relative=r, absolute=r / 100)
        for solver, r in (("LSODA", 1e-8), ("LSODA", 1e-11), ("Radau", 1e-9))
    ]
    gains = runs[0].case.controller
    singular = math.acos((gains["lam"] - 1) * gains["theta2"] / gains["theta3"])
    for run in runs:
        assert run.ended in ("speed", "singular", STALLED)
        assert run.end == pytest.approx(end, rel=1e-4)
        assert abs(abs(run.state[-1, 1]) - singular) < 0.01


# --- section 5.3 --------------------------------------------------------------------------------


def test_section_53_oscillates_with_the_papers_gains_whatever_the_solver(host):
    case = replace(case_of(FOLDER, "5.3", DERIVED, TERMS[2]), duration=0.4)
    runs = [
        fly(Task(case), host),
        fly(Task(case, relative=1e-10, absolute=1e-12), host),
        fly_independent(Task(case, solver=CVODES)),
    ]
    for run in runs:
        assert not run.ended
        turns = np.count_nonzero(np.diff(np.sign(run.state[:, 3])))
        assert turns > 100
        assert np.abs(run.signals["tau"]).max() > 7.0
    for run in runs[1:]:
        assert np.abs(run.state[:, :2] - runs[0].state[:, :2]).max() < 1e-6


def test_section_53_is_calm_with_ten_times_kappa_and_with_designed_gains(host):
    stiff = changed(case_of(FOLDER, "5.3", DERIVED, TERMS[2]), "kappa-20", kappa=20.0)
    for case in (stiff, case_of(FOLDER, "5.3", DESIGNED, TERMS[2])):
        run = fly(Task(case), host)
        assert not run.ended
        assert np.abs(run.signals["tau"]).max() < 1.2
        late = run.time > 1.0
        assert np.abs(np.diff(run.state[late, 3])).max() < 1e-3


def test_section_53_designed_is_converged_and_far_from_the_goal(host):
    case = case_of(FOLDER, "5.3", DESIGNED, TERMS[2])
    reference = measures(fly(Task(case), host))
    others = [
        fly(Task(case, "Radau"), host),
        fly(Task(case, relative=1e-10, absolute=1e-12), host),
        fly_independent(Task(case, CVODES)),
    ]
    for other in map(measures, others):
        for key in ("iae_q1", "iae_q2", "mae2_q1", "mae2_q2"):
            assert other[key] == pytest.approx(reference[key], rel=1e-5)
    assert reference["mae2_q2"] > 0.4


@pytest.mark.parametrize("joints", [(2,), (1, 2)])
@pytest.mark.parametrize(("column", "latest"), [(DERIVED, 0.04), (DESIGNED, 0.25)])
def test_friction_that_damps_throws_section_53_into_the_singular_set(host, column, latest, joints):
    case = damping(case_of(FOLDER, "5.3", column, TERMS[2]), joints)
    run = fly(main_task(case), host)
    assert run.ended
    assert run.end < latest


# --- theorem, engine, cache ---------------------------------------------------------------------


@pytest.mark.parametrize(("section", "column"), [("5.1", DERIVED), ("5.2", DESIGNED)])
def test_the_theorem_bounds_the_runs(host, section, column):
    run = flight(host, section, column, record=1e-2)
    judged = judge(run, derivation_of(find_model("pendubot")), host)
    assert judged.certificate.failure() == ""
    assert judged.certificate.least_slack >= 0.0
    bound = judged.claim("p2")
    assert np.abs(run.signals["beta"]).max() <= bound.bound
    # A bound below what was seen must be noticed.
    assert replace(bound, bound=0.9 * bound.largest).broken()


def test_mujoco_flies_section_51_alike(host):
    pytest.importorskip("mujoco")
    found = agreement("section-5.1-designed", host, 1000)
    assert found.steps == 1000
    assert found.largest < 1e-8
    assert found.torque < 1e-5


def test_a_run_comes_back_from_the_cache_as_it_was(host):
    run = flight(host, "5.1", PRINTED, TERMS[0])
    again = read_run(run.task, pack_run(run))
    assert pack_run(again) == pack_run(run)
    assert (again.ended, again.end) == (run.ended, run.end)
