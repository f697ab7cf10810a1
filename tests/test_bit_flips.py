"""Bit flips in state, parameters and inputs: what leaves the step is finite and bounded each time.

`make flips` prints the rates: how many are refused, have no effect, or change the torque.
"""

import os

import numpy as np
import pytest
from pfaffian.runtime.code.generated_model import fill_records, host_model
from pfaffian.runtime.flight.closed_loop import fly
from pfaffian.runtime.flight.scenario import read_scenario
from test_c_safety import assert_safe, is_finite, raw

COUNT = int(os.environ.get("PFAFFIAN_FLIPS", "100000"))
AFTER = 20
PARTS = ("state", "params", "input")


@pytest.fixture(scope="module")
def model():
    return host_model(read_scenario("section-5.1-designed").folder)


@pytest.fixture(scope="module")
def periods(model):
    """Return (state, params, input) of COUNT periods of a flight, before they were stepped."""
    scenario = read_scenario("section-5.1-designed")
    flown = fly(scenario, model, model, "host")
    rng = np.random.default_rng(71)
    at = rng.integers(1, len(flown.time), COUNT)
    params = fill_records(model.records("params", COUNT), dict(scenario.controller))
    return flown.state[at - 1].copy(), params, flown.measured[at].copy()


def flipped(records, rng):
    """Return `records` with one bit of one member turned over in each, and which member."""
    spoiled = records.copy()
    names = np.array(records.dtype.names)
    which = rng.integers(0, len(names), len(records))
    for k, name in enumerate(names):
        rows = np.flatnonzero(which == k)
        width = records.dtype[str(name)].itemsize
        kind = f"u{width}"
        bits = np.ascontiguousarray(records[str(name)]).view(kind).copy()
        turn = rng.integers(0, 8 * width, len(rows)).astype(kind)
        bits[rows] ^= np.array(1, kind) << turn
        spoiled[str(name)] = bits.view(records.dtype[str(name)])
    return spoiled, names[which]


def step(model, state, params, measured):
    after, output = state.copy(), model.records("output", len(state))
    status = np.full(len(state), -1, np.int32)
    model.step(after, params, measured, output, status)
    return after, output, status


@pytest.mark.parametrize("part", PARTS)
def test_one_flipped_bit_leaves_a_finite_and_bounded_torque(model, periods, part):
    rng = np.random.default_rng(72 + PARTS.index(part))
    clean = dict(zip(PARTS, periods, strict=True))
    _, wanted, _ = step(model, *clean.values())
    batch = {**clean}
    batch[part], member = flipped(clean[part], rng)
    assert (raw(batch[part]) != raw(clean[part])).sum() == COUNT  # each has one, and is another
    after, output, status = step(model, *batch.values())
    assert_safe(batch["state"], batch["params"], after, output, status)
    limit = clean["params"]["torque_limit"]
    kept = member != "torque_limit"  # the limit in force is the one in memory
    assert (np.abs(output["tau"][kept]) <= limit[kept]).all()
    refused, same = status >= 3, output["tau"] == wanted["tau"]
    changed = ~refused & ~same
    report = {
        "refused": refused.mean(),
        "no effect on the torque": (same & ~refused).mean(),
        "torque changed": changed.mean(),
        "changed by more than 1 % of the limit": (
            changed & (np.abs(output["tau"] - wanted["tau"]) > 0.01 * limit)
        ).mean(),
    }
    print(f"\n{part}: {COUNT} flips; " + ", ".join(f"{k} {v:.2%}" for k, v in report.items()))
    assert refused.any()
    assert same.any()
    assert changed.any()


def test_the_periods_after_a_flip_in_the_state_stay_finite_and_bounded(model, periods):
    """What is remembered carries the fault on; it must not grow out of the numbers there are."""
    clean, params, measured = periods
    state, _ = flipped(clean, np.random.default_rng(79))
    for _ in range(AFTER):
        before = state.copy()
        state, output, status = step(model, state, params, measured)
        assert_safe(before, params, state, output, status)
        assert (np.abs(output["tau"]) <= params["torque_limit"]).all()
        assert is_finite(output).all()


def test_init_finds_the_flips_that_leave_the_bounds(model, periods):
    """Called on the parameters again, as after a change, init refuses what is out of bounds."""
    _, params, _ = periods
    spoiled, _ = flipped(params, np.random.default_rng(80))
    state, status = model.records("state", COUNT), np.full(COUNT, -1, np.int32)
    model.init(state, spoiled, status)
    assert set(np.unique(status)) == {0, 4}
    print(f"\ninit refuses {np.mean(status == 4):.2%} of {COUNT} flipped parameter sets")
    accepted = status == 0
    assert is_finite(state)[accepted].all()
