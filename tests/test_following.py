"""The law along a plan, and the plan as a table: the same in C and Python, and it swings up."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import THOROUGH
from pfaffian.cli.code.generate import generate_files
from pfaffian.cli.code.verify import verification
from pfaffian.derive.generate_model import Extras
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
from pfaffian.derive.plan.document import read_plan
from pfaffian.derive.plan.follow import (
    FollowingLaw,
    FollowOptions,
    _moved,
    _moved_start,
    _run,
    follow_plan,
)
from pfaffian.derive.plan.plant import numeric_plant
from pfaffian.derive.plan.reference import Curve
from pfaffian.derive.sets.plan_table import PlanTable, plan_table
from pfaffian.derive.spec.library import LIBRARY, find_model
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.generated_model import (
    GeneratedModel,
    fill_records,
    host_model,
    open_generated,
    ppc750_model,
)

PLAN = LIBRARY / "pendubot/plans/rig.json"
WILD = (math.nan, math.inf, -math.inf, -1.0, -0.0, 0.0, 5e-324, 1.5, 1e9, 2.0**31, 1e308, -1e308)
PERIOD = 1e-3
#: kappa (ADB)^2 of set rig at the setpoint in 1/s, to two digits.
RATE = 20.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the pendubot generated now: what is committed may be older."""
    path = tmp_path_factory.mktemp("follow") / "pendubot"
    generate_files("pendubot", None, None, path, False, Extras(), True)
    return open_generated(str(path))


@pytest.fixture(scope="module")
def model(folder) -> GeneratedModel:
    return host_model(folder)


@pytest.fixture(scope="module")
def plan():
    return read_plan(PLAN)


@pytest.fixture(scope="module")
def table() -> PlanTable:
    source = find_model("pendubot")
    lowered = lowered_model(source)
    chosen = next(s for s in library_sets(lowered, source) if s.name == "rig")
    return plan_table(lowered, chosen, PLAN)


def fly(model: GeneratedModel, parameters, start, seconds, truth=None):
    """Fly the plan at 1 kHz; return times, states (k+1, 4), torques, references, energy used."""
    manifest = model.folder.manifest
    params = fill_records(model.records("params"), parameters)
    known = {p.name: 0.0 for p in manifest.parameters} | dict(parameters) | dict(truth or {})
    plant = fill_records(model.records("plant_params"), known)
    state, status = model.records("state"), np.zeros(1, np.int32)
    model.init(state, params, status)
    x, measured = model.records("plant_state"), model.records("input")
    output, applied = model.records("output"), model.records("plant_input")
    reference, step = model.records("reference"), np.full(1, PERIOD / 2.0)
    names = ("q1", "q2", "dq1", "dq2")
    for name, value in zip(names, start, strict=True):
        x[name] = value
    states, torques, used = [[float(x[n][0]) for n in names]], [], 0.0
    for k in range(round(seconds / PERIOD)):
        model.plan_at("rig", np.full(1, k * PERIOD), reference)
        for name in names:
            measured[name] = x[name]
        model.follow(state, params, measured, reference, output, status)
        applied["tau"] = output["tau"]
        before = abs(float(output["tau"][0] * x["dq1"][0]))
        model.plant_step(x, plant, applied, step, 2)
        used += (before + abs(float(output["tau"][0] * x["dq1"][0]))) / 2.0 * PERIOD
        states.append([float(x[n][0]) for n in names])
        torques.append(float(output["tau"][0]))
    return np.array(states), np.array(torques), used


def references(model: GeneratedModel, times):
    found = model.records("reference", len(times))
    model.plan_at("rig", np.asarray(times, float), found)
    return found


def test_the_following_law_agrees_with_the_oracle_everywhere(folder):
    found = verification("pendubot", 300, 300, folder.path)
    assert found["passed"], found["worst_scaled_ulp"]
    said = {f["language"] for f in found["functions"] if f["function"] == "follow"}
    assert said == {"python", "c-host", "c-ppc750"}


def test_a_reference_at_rest_with_the_balance_row_gives_the_balance_law(model):
    values = model.folder.parameters("rig")
    params = fill_records(model.records("params"), values)
    rng = np.random.default_rng(7)
    one, other = model.records("state"), model.records("state")
    status = np.zeros(1, np.int32)
    model.init(one, params, status)
    model.init(other, params, status)
    reference = model.records("reference")
    rest = {"q1_ref": values["q1d"], "q2_ref": values["q2d"], "row_q2": values["lam2"]}
    rest |= {"row_dq1": values["lam"], "row_q1": values["lam"] * values["lam1"], "row_dq2": 1.0}
    for name, value in rest.items():
        reference[name] = value
    a, b, measured = model.records("output"), model.records("output"), model.records("input")
    worst = 0.0
    for _ in range(500):
        for name in measured.dtype.names:
            measured[name] = rng.normal(0.0, 0.3) + values.get(f"{name}d", 0.0)
        model.step(one, params, measured, a, status)
        model.follow(other, params, measured, reference, b, status)
        largest = max(abs(float(a[n][0])) for n in ("tau", "p1", "p2", "p3"))
        worst = max(worst, abs(float(a["tau"][0] - b["tau"][0])) / math.ulp(largest))
        other[...] = one  # one period at a time: offsets are sums, whose roundings add up
    assert worst <= 64.0, worst


def test_the_table_is_the_plans_curve(model, plan, table):
    path, n = plan.trajectory, 2
    times = np.random.default_rng(3).uniform(0.0, path.end_time, 2000)
    found = references(model, times)
    state = Curve(path.times, path.states, np.hstack([path.states[:, n:], plan.accelerations]))
    row = Curve(path.times, plan.row.rows, plan.row.rates)
    names = table.members
    for k, t in enumerate(times):
        wanted = [*state(t), *state.slope(t)[n:]]
        wanted += [*(table.scale * row(t)).ravel(), *(table.scale * row.slope(t)).ravel()]
        got = [float(found[name][k]) for name in names]
        assert got == pytest.approx(wanted, rel=1e-9, abs=1e-9)


def test_every_node_reads_back_to_its_bits(model, plan, table):
    for k in (0, 150):
        found = references(model, [k * table.period])
        for i, name in enumerate(table.members[:4]):
            assert float(found[name][0]) == plan.trajectory.states[k][i]


def test_the_row_is_scaled_to_the_balance_laws_input_gain(model, plan, table):
    values = model.folder.parameters("rig")
    plant = numeric_plant(derivation_of(find_model("pendubot")), values)
    q = plan.trajectory.states[-1]
    mass, _, inputs = plant.matrices(q[:2], q[2:])
    column = np.linalg.solve(mass, inputs)
    balance = abs(float((np.array([values["lam"], 1.0]) @ column).item()))
    own = abs(float((table.scale * plan.row.rows[-1][:, 2:] @ column).item()))
    assert own == pytest.approx(balance, rel=1e-12)


def test_wild_times_give_finite_references(model):
    found = references(model, WILD)
    for name in found.dtype.names:
        assert np.all(np.isfinite(found[name]))
    first, last = references(model, [0.0])[0], references(model, [1e9])[0]
    assert found[0] == found[1 + 1] == first  # no number, -inf
    assert found[1] == last


def test_wild_references_give_torques_within_the_limit(model):
    values = model.folder.parameters("rig")
    rng = np.random.default_rng(5)
    count = 5000
    params = fill_records(model.records("params", count), values)
    state, status = model.records("state", count), np.zeros(count, np.int32)
    model.init(state, params, status)
    bits = rng.integers(0, 2**64, (3, count, 14), np.uint64, endpoint=False).view(np.float64)
    reference, measured = model.records("reference", count), model.records("input", count)
    for k, name in enumerate(reference.dtype.names):
        reference[name] = np.where(rng.random(count) < 0.5, bits[0, :, k], rng.normal(size=count))
    for k, name in enumerate(measured.dtype.names):
        measured[name] = np.where(rng.random(count) < 0.1, bits[1, :, k], rng.normal(size=count))
    output = model.records("output", count)
    model.follow(state, params, measured, reference, output, status)
    assert np.all(np.abs(output["tau"]) <= values["torque_limit"])
    for records in (output, state):
        assert all(np.all(np.isfinite(records[n])) for n in records.dtype.names)


def test_the_generated_controller_swings_the_generated_plant_up(model, plan):
    values = model.folder.parameters("rig")
    states, torques, used = fly(model, values, plan.problem.start, 2.5)
    wanted = references(model, np.arange(1501) * PERIOD)
    error = [
        np.max(np.abs(states[:1501, i] - wanted[n])) for i, n in enumerate(("q1_ref", "q2_ref"))
    ]
    derivation = derivation_of(find_model("pendubot"))
    law = follow_plan(derivation, plan, FollowOptions(draws=0))[0].law[0]
    print("following error", error, law.error, "peak", np.abs(torques).max(), law.peak_torque)
    print("energy", used, law.energy_used, "end", states[1500] - plan.trajectory.states[-1])
    assert np.all(np.abs(states[1500:, 0] - math.pi / 2) < 0.01)
    assert np.all(np.abs(states[1500:, 1]) < 0.01)
    assert np.abs(torques).max() < 2.0
    assert max(error) < 0.02
    assert used == pytest.approx(law.energy_used, rel=0.02)


def test_starts_and_plants_off_by_five_percent_are_caught_as_by_the_python_law(model, plan):
    """Both laws fly the same draws, with the same rates; the Python one lacks p3."""
    values = model.folder.parameters("rig")
    derivation = derivation_of(find_model("pendubot"))
    options = FollowOptions(sigma=values["sigma"], rate=RATE, draws=5 if THOROUGH else 2)
    python = {f.case: f.law for f in follow_plan(derivation, plan, options)}
    rng = np.random.default_rng(options.seed)
    nominal = dict(plan.problem.parameters)
    starts = [_moved_start(plan, options.spread, rng) for _ in range(options.draws)]
    plants = [_moved(nominal, options.spread, rng) for _ in range(options.draws)]
    own = plan.problem.start
    flights = {
        "start off by 5 %": [(x, {}) for x in starts],
        "parameters off by 5 %": [(own, p) for p in plants],
        "both": list(zip(starts, plants, strict=True)),
    }
    for case, pairs in flights.items():
        for run, (start, truth) in zip(python[case], pairs, strict=True):
            states, _, _ = fly(model, values, start, 3.5, truth)
            left = np.abs(states[-500:] - plan.trajectory.states[-1])[:, :2].max()
            assert (left < 0.1) == run.standing, (case, left)
            assert left < 0.1, (case, left)


@pytest.mark.parametrize("sigma", [2.0, 20.0])
def test_a_plant_that_is_off_is_held_or_lost_by_both_laws_alike(model, plan, sigma):
    """A plant off by less than 5 %: an earlier plan lost it with sigma 2 1/s and not with 20."""
    values = model.folder.parameters("rig") | {"sigma": sigma}
    rng = np.random.default_rng(0)
    rng.uniform(-1.0, 1.0, 16)
    nominal = {k: v for k, v in plan.problem.parameters if v}
    truth = {k: v * (1.0 + 0.05 * rng.uniform(-1.0, 1.0)) for k, v in nominal.items()}
    derivation = derivation_of(find_model("pendubot"))
    known = {p.name: p.default or 0.0 for p in derivation.spec.parameters}
    known |= dict(plan.problem.parameters)
    options = FollowOptions(sigma=sigma, rate=RATE)
    law = FollowingLaw(plan, numeric_plant(derivation, known), options)
    start = np.array(plan.problem.start)
    python = _run(plan, numeric_plant(derivation, known | truth), start, law, options)
    states, _, _ = fly(model, values, start, 3.5, truth)
    left = np.abs(states[-500:] - plan.trajectory.states[-1])[:, :2].max()
    assert (left < 0.1) == python.standing


def test_the_flight_on_the_target_has_the_same_bits(model, plan):
    values = model.folder.parameters("rig")
    there = ppc750_model(model.folder)
    here = fly(model, values, plan.problem.start, 1.5)
    other = fly(there, values, plan.problem.start, 1.5)
    assert np.array_equal(here[0].view(np.uint64), other[0].view(np.uint64))
    assert np.array_equal(here[1].view(np.uint64), other[1].view(np.uint64))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"model_sha256": "0" * 64}, "equations of pendubot have changed"),
        ({"model": "acrobot"}, "plan of model acrobot"),
        ({"set": "sim"}, "plan of set sim"),
        ({"parameters": {"theta1": 0.01}}, "theta1 was 0.01"),
    ],
)
def test_a_plan_that_does_not_fit_is_refused(tmp_path: Path, change, says):
    source = find_model("pendubot")
    lowered = lowered_model(source)
    chosen = next(s for s in library_sets(lowered, source) if s.name == "rig")
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(json.loads(PLAN.read_text()) | change))
    with pytest.raises(InputError, match=says):
        plan_table(lowered, chosen, path)


def test_another_law_does_not_orphan_a_plan():
    lowered = lowered_model(find_model("pendubot"))
    assert replace(lowered, sha256="0").plant_sha256 == json.loads(PLAN.read_text())["model_sha256"]


def test_a_model_without_a_plan_gets_no_file_for_it(run, workspace):
    assert run("generate", "cart_pole", "-o", "here").code == 0
    assert not list((workspace / "here").rglob("*follow*"))
    assert "plans" not in json.loads((workspace / "here/manifest.json").read_text())
    assert run("generate", "pendubot", "--set", "sim", "-o", "sim").code == 0
    assert not list((workspace / "sim").rglob("*_plan.*"))


def test_the_numeric_law_starts_where_the_emitted_one_does(plan):
    """The numeric law is the one that plans are judged with; it must accept this plan."""
    derivation = derivation_of(find_model("pendubot"))
    known = {p.name: p.default or 0.0 for p in derivation.spec.parameters}
    plant = numeric_plant(derivation, known | dict(plan.problem.parameters))
    law = FollowingLaw(plan, plant, FollowOptions())
    assert np.all(np.abs(law(0.0, np.array(plan.problem.start))) < 0.2)
