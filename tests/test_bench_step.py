"""One control step by several tools: the same law, counts that repeat, ratios worked out right."""

import json
from dataclasses import replace

import numpy as np
import pytest
from pfaffian.benchmarks import step_optional_peers
from pfaffian.benchmarks.step import (
    StepStates,
    check_agreement,
    flown_states,
    on_host,
    random_states,
    worst_difference,
)
from pfaffian.benchmarks.step_peers import PEERS, constant_names, given_names, shared_assignments
from pfaffian.cli.bench.step import measured_steps
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.pipeline import derivation_of, lowered_model
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.flight.scenario import read_scenario

NAMES = ["ours", "casadi", "sympy", "hand_libm", "hand", "hand_checked"]
SCENARIO = read_scenario("rig-balance")
BLOCK = derivation_of(find_model("pendubot")).block("step")
CONTROLLER = dict(SCENARIO.controller)


def states_of(count, bound=1.0):
    """Random states; `bound` scales ahat, and with it how often p3 leaves its layer."""
    names = given_names(BLOCK)
    flown = flown_states(SCENARIO, names, count)
    rows = random_states(SCENARIO, names, flown, count)
    rows[:, names.index("bound_estimate")] *= bound
    prepare = lowered_model(find_model("pendubot")).program("prepare")
    known = CONTROLLER | evaluate(prepare, CONTROLLER)
    return StepStates(names, rows, np.array([known[n] for n in constant_names(BLOCK)]))


def loaded(name, states, **changes):
    tool = PEERS[name](BLOCK, SCENARIO.folder, CONTROLLER)
    return on_host(replace(tool, **changes), states)


@pytest.mark.target
def test_benchmark_has_the_keys_of_the_contract_and_its_counts_repeat(run):
    first, second = (
        run("bench", "step", "--states", 3, "--passes", 3, "--rows", 50, "--json").document()
        for _ in range(2)
    )
    assert list(first["ppc750"]) == NAMES
    assert list(first["host_ns"])[: len(NAMES)] == NAMES
    for name, count in first["ppc750_detail"].items():
        assert 100 < count["best"] <= count["median"] <= count["worst"], name
        assert count["median"] == first["ppc750"][name]
        assert 1000 < count["text_bytes"] < 100_000
        assert 0 < count["stack_bytes"] < 4096
    assert first["ppc750_detail"] == second["ppc750_detail"]
    assert first["largest_difference"] == second["largest_difference"]
    assert first["ratio_to_casadi"] == first["ppc750"]["ours"] / first["ppc750"]["casadi"]
    host = first["host_ns"]
    assert first["host_ratios"] == {n: host["ours"] / t for n, t in host.items()}
    assert set(first["host_plain_ns"]) == set(host)
    assert all(v > 0.0 for v in host.values())
    assert set(first["python_ns"]) == {
        "numpy_vectorised",
        "compiled_vectorised",
        "lambdify_loop",
        "lambdify_math_loop",
        "compiled_call",
    }
    assert set(first["missing"]) | set(host) == {*NAMES, *step_optional_peers.OPTIONAL_PEERS}


def test_every_tool_gives_the_same_law_in_every_branch_of_it():
    """The states reach both limits, a first step, both sides of the layer, and ADB near zero."""
    seen = set()
    for threshold, bound, slew in ((1.0, 1.0, 400.0), (1.0, 30.0, 1e8), (40.0, 1.0, 400.0)):
        states = states_of(200, bound)
        changed = {"singular_threshold": threshold, "slew_limit": slew}
        for name, value in changed.items():
            states.constants[constant_names(BLOCK).index(name)] = value
        controller = CONTROLLER | changed
        results = {
            n: on_host(make(BLOCK, SCENARIO.folder, controller), states).results()
            for n, make in PEERS.items()
        }
        assert max(check_agreement(results, "host").values()) < 1e-9
        ours = results["ours"]
        seen |= {("first step", e) for e in states.column("engaged") == 0.0}
        seen |= {("saturated", s) for s in np.abs(ours["tau"]) == controller["torque_limit"]}
        moved = np.abs(ours["tau"] - states.column("tau_previous"))
        reach = controller["sample_time"] * slew
        seen |= {("slewing", m) for m in np.isclose(moved, reach, rtol=1e-12)}
        seen |= {("near singular", n) for n in np.abs(ours["adb"]) < threshold}
        effort = states.column("bound_estimate")[:, None] * regressor(states)[:, None]
        seen |= {("outside", o) for o in np.isclose(np.abs(ours["p3"]), effort[:, 0], rtol=1e-12)}
    wanted = ("first step", "saturated", "slewing", "near singular", "outside")
    assert seen == {(w, b) for w in wanted for b in (False, True)}


def regressor(states):
    """Pi of (47), for the set with the setpoint (pi/2, 0)."""
    e = np.hypot(states.column("q1") - CONTROLLER["q1d"], states.column("q2") - CONTROLLER["q2d"])
    return (np.hypot(states.column("dq1"), states.column("dq2")) + 1.0) ** 2 + (e + 1.0) ** 2


@pytest.mark.parametrize("name", ["hand", "hand_libm", "hand_checked"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("signal", ["q1", "q2", "dq1", "dq2"])
def test_the_step_written_by_hand_refuses_what_is_not_finite_and_keeps_its_state(name, bad, signal):
    states = states_of(2)
    states.column(signal)[:] = bad
    found = loaded(name, states).results()
    for output in ("tau", "p1", "p2", "p3", "s", "beta", "adb"):
        assert (found.pop(output, 0.0) == np.zeros(len(states.given))).all()
    for kept, value in found.items():
        assert (value == states.column(kept)).all(), kept


def test_a_tool_that_computes_another_law_is_refused():
    states = states_of(4)
    results = {n: loaded(n, states).results() for n in ("ours", "hand")}
    check_agreement(results, "host")
    sources = PEERS["hand"](BLOCK, SCENARIO.folder, CONTROLLER).sources
    wrong = sources["hand.c"].replace("law->theta3 * sin2", "law->theta3 * cos2")
    assert wrong != sources["hand.c"]
    results["hand"] = loaded("hand", states, sources={**sources, "hand.c": wrong}).results()
    with pytest.raises(CheckError, match="host: hand disagrees with ours"):
        check_agreement(results, "host")


def test_the_difference_is_relative_and_what_is_not_finite_never_agrees():
    one = {"tau": np.array([2.0, 0.0]), "only_here": np.array([1.0, 1.0])}
    assert worst_difference({"tau": np.array([2.5, 0.125])}, one) == 0.25
    assert worst_difference({"tau": np.array([2.0, np.nan])}, one) == np.inf
    assert worst_difference(one, {"tau": np.array([2.0, np.nan])}) == np.inf


def test_a_state_is_put_back_before_every_pass():
    states = states_of(3)
    tool = loaded("ours", states)
    first = tool.results()
    tool.nanoseconds()
    for name, value in tool.results().items():
        assert (value == first[name]).all(), name


def test_sympys_assignments_come_after_what_they_use():
    assignments, results = shared_assignments(BLOCK)
    known = set(BLOCK.symbols)
    for symbol, value in assignments:
        assert value.free_symbols <= known, symbol
        known.add(symbol)
    assert set().union(*(r.free_symbols for r in results)) <= known


@pytest.mark.parametrize("name", ["symforce", "wrenfold"])
def test_an_optional_tool_gives_the_same_law_where_it_is_installed(name):
    pytest.importorskip(name)
    states = states_of(20)
    found = on_host(step_optional_peers.OPTIONAL_PEERS[name](BLOCK), states).results()
    check_agreement({"ours": loaded("ours", states).results(), name: found}, "host")


@pytest.mark.target
def test_an_optional_tool_that_is_not_installed_is_named(monkeypatch):
    def absent(_block):
        raise ImportError("no such tool")

    monkeypatch.setattr(step_optional_peers, "OPTIONAL_PEERS", {"symforce": absent})
    document = measured_steps(2, 1, 4)
    assert document["missing"] == ["symforce"]
    assert list(document["host_ns"]) == NAMES
    json.dumps(document)
