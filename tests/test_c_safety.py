"""The generated controller is safe for every input: garbage in, a bounded torque and a status out.

`sensible` and `garbage` also serve the tests of the NumPy module and of the target.
"""

import itertools
import shutil
import subprocess

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pfaffian.runtime.code.generated_model import fill_records, host_model, open_generated
from pfaffian.runtime.contract.dtypes import layout_of
from pfaffian.runtime.machine.sources import controller_sources

OK, SATURATED, NEAR_SINGULAR, BAD_INPUT, BAD_PARAMETER, NUMERIC, NOT_READY, BAD_ARITHMETIC = range(
    8
)
#: What a step may say: its arithmetic is judged by init.
STATUSES = range(NOT_READY + 1)
REFUSED = (BAD_INPUT, BAD_PARAMETER, NUMERIC, NOT_READY)
LARGEST, TINY, NORMAL = np.finfo(float).max, 5e-324, np.finfo(float).tiny
_SIZES = (
    *(0.0, 1.0, np.inf, np.nan, LARGEST, TINY, NORMAL, NORMAL - TINY, np.pi / 2, 0.5),
    *(1e4, 1e3, 1e-6, 1e154, 1e-154, 1e-162, 1e300, 1e-300, 2.0**53, 1e5),
)
SPECIAL = np.array([sign * size for size in _SIZES for sign in (1.0, -1.0)])
FOLDER = open_generated("pendubot")
SETS = FOLDER.manifest.parameter_sets


def sensible(folder, rng, count):
    """Return (state, params, input) records as they occur: known sets, motions, engaged laws."""
    manifest, model = folder.manifest, host_model(folder)
    state, params, measured = (model.records(r, count) for r in ("state", "params", "input"))
    which = rng.integers(0, len(manifest.parameter_sets), count)
    for name in params.dtype.names:
        column = np.array([s[name] for s in manifest.parameter_sets.values()])
        params[name] = column[which] * rng.uniform(0.9, 1.1, count)
    for name in measured.dtype.names:
        measured[name] = rng.normal(0.0, 3.0, count)
    status = np.zeros(count, np.int32)
    model.init(state, params, status)
    assert (status == OK).all()
    state["engaged"] = rng.integers(0, 2, count)
    state["constraint_offset"], state["drift_previous"] = rng.normal(0.0, 2.0, (2, count))
    state["bound_estimate"] = np.abs(rng.normal(0.0, 0.5, count))
    if "tau_previous" in state.dtype.names:
        state["tau_previous"] = rng.uniform(-1.1, 1.1, count) * params["torque_limit"]
    return state, params, measured


def prepared_members(folder):
    """Return the members of the state that depend on the parameters alone."""
    signals = ("constraint_offset", "drift_previous", "bound_estimate", "tau_previous")
    remembered = ("engaged", *signals)
    return [n for n in folder.manifest.structures["state"].names() if n not in remembered]


def garbage(rng, records):
    """Return `records` with a random share of the members of each record made random or special."""
    count, spoiled = len(records), records.copy()
    share = rng.choice([0.0, 0.02, 0.1, 0.4, 1.0], count)
    for name in records.dtype.names:
        if records.dtype[name].kind == "u":
            wild = rng.integers(0, 2**32, count, dtype=np.uint32)
        else:
            any_bits = rng.integers(0, 2**64, count, dtype=np.uint64).view(float)
            sizes = np.exp(rng.uniform(-700.0, 700.0, count)) * rng.choice([-1.0, 1.0], count)
            near = np.exp(rng.uniform(-25.0, 25.0, count)) * rng.choice([-1.0, 1.0], count)
            kind = rng.integers(0, 4, count)
            wild = np.choose(kind, [any_bits, rng.choice(SPECIAL, count), sizes, near])
        spoiled[name] = np.where(rng.random(count) < share, wild, records[name])
    return spoiled


def raw(records):
    """Return the members of each record as uint64, without the padding between them."""
    columns = [records[n] for n in records.dtype.names]
    return np.stack(
        [c.view(np.uint64) if c.dtype == float else c.astype(np.uint64) for c in columns]
    )


def is_finite(records):
    return np.all([np.isfinite(records[n]) for n in records.dtype.names], axis=0)


@pytest.fixture(scope="module")
def host():
    return host_model(FOLDER)


def stepped(host, state, params, measured):
    """Return (next state, output, status) and leave the arguments as they are."""
    after, count = state.copy(), len(state)
    output, status = host.records("output", count), np.full(count, -1, np.int32)
    for name in output.dtype.names:
        output[name] = np.nan  # what a step does not write must not look like a result
    host.step(after, params, measured, output, status)
    return after, output, status


def assert_safe(before, params, after, output, status):
    assert np.isin(status, STATUSES).all()
    assert is_finite(output).all()
    refused = np.isin(status, REFUSED)
    assert (np.abs(output["tau"][~refused]) <= params["torque_limit"][~refused]).all()
    assert not raw(output)[:, refused].any()  # +0 to the bit
    assert (raw(after)[:, refused] == raw(before)[:, refused]).all()
    assert (after["engaged"][~refused] == 1).all()
    assert is_finite(after)[is_finite(before)].all()


@pytest.mark.parametrize("seed", range(5))
def test_torque_is_finite_and_bounded_on_a_million_garbage_samples(host, seed):
    rng = np.random.default_rng(seed)
    state, params, measured = (garbage(rng, b) for b in sensible(FOLDER, rng, 200_000))
    after, output, status = stepped(host, state, params, measured)
    assert_safe(state, params, after, output, status)
    assert (np.bincount(status, minlength=7) > 1000).all()  # every way out is tried


def test_raw_bit_patterns_everywhere(host):
    rng = np.random.default_rng(99)
    batch = sensible(FOLDER, rng, 100_000)
    for records in batch:
        for name in records.dtype.names:
            if records.dtype[name].kind == "f":
                records[name] = rng.integers(0, 2**64, len(records), dtype=np.uint64).view(float)
    batch[2]["q1"][::2] = 1.0  # half of them get past the check of the measurement
    for name in batch[2].dtype.names:
        batch[2][name][::2] = rng.normal(0.0, 1.0, 50_000)
    after, output, status = stepped(host, *batch)
    assert_safe(batch[0], batch[1], after, output, status)


NUMBERS = st.floats(width=64, allow_nan=True, allow_infinity=True)


PREPARED = prepared_members(FOLDER)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    remembered=st.tuples(st.integers(0, 2**32 - 1), *[NUMBERS] * 4),
    corrupted=st.dictionaries(st.sampled_from(PREPARED), NUMBERS, max_size=4),
    changes=st.dictionaries(st.sampled_from(sorted(SETS["sim"])), NUMBERS, max_size=4),
    measured=st.tuples(*[NUMBERS] * 4),
)
def test_torque_is_finite_and_bounded_for_whatever_hypothesis_finds(
    host, remembered, corrupted, changes, measured
):
    params = fill_records(host.records("params"), SETS["sim"] | changes)
    before, _ = initialised(host, SETS["sim"])
    names = [n for n in before.dtype.names if n not in PREPARED]
    for name, value in (dict(zip(names, remembered, strict=True)) | corrupted).items():
        before[name] = value
    at = host.records("input")
    at[0] = measured
    assert_safe(before, params, *stepped(host, before, params, at))


@pytest.mark.parametrize("member", PREPARED)
@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, -np.inf, LARGEST, TINY])
def test_a_corrupted_prepared_member_gives_no_torque_beyond_the_limit(host, member, value):
    rng = np.random.default_rng(3)
    state, params, measured = sensible(FOLDER, rng, 500)
    state[member] = value
    assert_safe(state, params, *stepped(host, state, params, measured))


def test_a_state_that_init_never_saw_is_refused(host):
    """All zero, as memory is before init: nothing is divided by it."""
    params = fill_records(host.records("params"), SETS["sim"])
    state, output, status = stepped(host, host.records("state"), params, host.records("input"))
    assert status[0] == NOT_READY
    assert not raw(output).any()
    assert not raw(state).any()


def test_measurements_out_of_their_domain_are_refused(host):
    domain = FOLDER.manifest.domain
    names = layout_of(FOLDER.manifest.structures["input"]).names
    params = fill_records(host.records("params"), SETS["sim"])
    state, _ = initialised(host, SETS["sim"])
    for name, sign in itertools.product(names, (-1.0, 1.0)):
        bound = domain[name] * sign
        outside = [bound, np.nextafter(bound, sign * np.inf), sign * np.inf, np.nan, sign * LARGEST]
        inside = [np.nextafter(bound, 0.0), 0.0]
        for value, is_bad in [(v, True) for v in outside] + [(v, False) for v in inside]:
            measured = host.records("input")
            measured[name] = value
            _, output, status = stepped(host, state, params, measured)
            assert (status[0] == BAD_INPUT) == is_bad, (name, value)
            assert output["tau"] == 0.0 or not is_bad


@pytest.mark.parametrize("limit", [0.0, -0.0, -1.0, np.nan, -np.inf])
def test_step_refuses_a_torque_limit_that_is_none(host, limit):
    params = fill_records(host.records("params"), SETS["sim"] | {"torque_limit": limit})
    state, _ = initialised(host, SETS["sim"])
    _, output, status = stepped(host, state, params, host.records("input"))
    assert status[0] == BAD_PARAMETER
    assert not raw(output).any()


def test_an_infinite_torque_limit_is_refused_by_init_and_leaves_the_torque_finite(host):
    _, refused = initialised(host, SETS["sim"] | {"torque_limit": np.inf})
    assert refused == BAD_PARAMETER
    rng = np.random.default_rng(2)
    state, params, measured = sensible(FOLDER, rng, 20_000)
    params["torque_limit"] = np.inf
    before = state.copy()
    for name in before.dtype.names[1:]:
        before[name] *= rng.choice([1.0, 1e100, 1e200, 1e300], 20_000)
    after, output, status = stepped(host, before, params, measured)
    assert set(status) == {OK, SATURATED, NEAR_SINGULAR, NUMERIC}  # the slew limit still binds
    assert_safe(before, params, after, output, status)


def bounds():
    """Return (name, lower, whether it is open, upper) of each parameter, from the source."""
    from pfaffian.derive.spec.library import find_model

    declared = {p.name: p for p in find_model("pendubot").load().parameters}
    names = FOLDER.manifest.structures["params"].names()
    return [(n, declared[n].lower, declared[n].lower_open, declared[n].upper) for n in names]


def initialised(host, values):
    state, status = host.records("state"), np.full(1, -1, np.int32)
    for name in state.dtype.names:
        state[name] = 7
    host.init(state, fill_records(host.records("params"), values), status)
    return state, status[0]


#: What is divided by: 1/epsilon has to be finite, which 1 over a smaller number is not.
SMALLEST = {"epsilon": NORMAL / 4.0}


@pytest.mark.parametrize("name", FOLDER.manifest.structures["params"].names())
def test_init_refuses_each_parameter_out_of_its_bounds_and_accepts_the_bounds(host, name):
    ((_, lower, is_open, upper),) = [b for b in bounds() if b[0] == name]
    wrong = [np.nextafter(lower, -np.inf), np.nextafter(upper, np.inf), np.nan, np.inf, -np.inf]
    if name in SMALLEST:
        lower, is_open = SMALLEST[name], True
        wrong += [lower, TINY, 0.0]
    right = [upper, np.nextafter(lower, np.inf), *([] if is_open else [lower])]
    wrong += [lower, -0.0] if is_open and lower == 0.0 else []
    for value in wrong:
        state, status = initialised(host, SETS["sim"] | {name: value})
        assert status == BAD_PARAMETER, value
        assert not raw(state).any()
    for value in right:
        state, status = initialised(host, SETS["sim"] | {name: value})
        assert status == OK, value
        assert is_finite(state).all()


def test_init_prepares_the_leakage_and_the_adaptation_of_one_period(host):
    for values in SETS.values():
        state, _ = initialised(host, values)
        exponent = -values["k2"] * values["sample_time"]
        assert state["leakage_decay"] == pytest.approx(np.exp(exponent), rel=1e-15)
        step = -values["k1"] * np.expm1(exponent) / values["k2"]
        assert state["adaptation_step"] == pytest.approx(step, rel=1e-15)
        assert state["bound_estimate"] == values["bound_initial"]
        assert state["engaged"] == 0


def test_first_step_engages_with_beta_zero(host):
    rng = np.random.default_rng(4)
    _, params, measured = sensible(FOLDER, rng, 5000)
    state, status = host.records("state", 5000), np.zeros(5000, np.int32)
    host.init(state, params, status)
    after, output, _ = stepped(host, state, params, measured)
    assert (after["engaged"] == 1).all()
    assert (output["beta"] == 0.0).all()
    assert (output["p2"] == 0.0).all()
    assert (output["p3"] == 0.0).all()
    assert (after["constraint_offset"] == -output["s"]).all()


#: With these inertias and weight ADB is 0 exactly at q2 = 0, and 1 - cos q2 over det M nearby.
AT_ZERO = {"theta1": 2.0, "theta2": 1.0, "theta3": 1.0, "lam": 2.0, "theta4": 1.0, "theta5": 0.5}


def near_singularity(host, q2, **changes):
    params = fill_records(host.records("params", len(q2)), SETS["sim"] | AT_ZERO | changes)
    state, status = host.records("state", len(q2)), np.zeros(len(q2), np.int32)
    host.init(state, params, status)
    measured = host.records("input", len(q2))
    measured["q1"], measured["q2"] = 0.3, q2
    measured["dq1"], measured["dq2"] = 0.5, -0.7
    return stepped(host, state, params, measured)


def test_nominal_torque_vanishes_where_adb_is_exactly_zero(host):
    after, output, status = near_singularity(host, np.array([0.0, -0.0]))
    assert (status == NEAR_SINGULAR).all()
    assert (output["adb"] == 0.0).all()
    assert (output["p1"] == 0.0).all()
    assert (output["tau"] == 0.0).all()
    assert is_finite(after).all()


def test_torque_stays_bounded_around_adb_zero_and_p1_falls_with_adb(host):
    q2 = np.concatenate([np.logspace(-162, 0.5, 2000), -np.logspace(-162, 0.5, 2000)])
    after, output, status = near_singularity(host, q2)
    assert is_finite(output).all()
    assert is_finite(after).all()
    threshold = SETS["sim"]["singular_threshold"]
    near = np.abs(output["adb"]) < threshold
    assert near.any()
    assert not near.all()
    assert ((status == NEAR_SINGULAR) == near).all()
    close = (np.abs(q2) < 1e-3) & (output["adb"] != 0.0)
    demand = output["p1"][close] / output["adb"][close] * threshold**2
    assert np.ptp(demand) < 0.01 * np.abs(demand).max()  # p1 = ADB demand / threshold^2
    assert (output["p1"][np.abs(q2) < 1e-9] == 0.0).all()


def test_p1_follows_adb_through_the_threshold_without_a_jump(host):
    _, output, _ = near_singularity(host, np.linspace(0.9, 1.6, 20_001), torque_limit=1e4)
    near = np.abs(output["adb"]) < SETS["sim"]["singular_threshold"]
    (edge,) = np.flatnonzero(near[:-1] & ~near[1:])
    assert abs(output["p1"][edge + 1] - output["p1"][edge]) < 1e-3 * abs(output["p1"][edge])


def test_saturation_holds_integral_and_adaptation_and_gives_the_limit(host):
    rng = np.random.default_rng(5)
    state, params, measured = sensible(FOLDER, rng, 20_000)
    state["engaged"] = 1
    params["torque_limit"] = np.exp(rng.uniform(-12.0, 9.0, 20_000))
    params["slew_limit"] = state["sample_time_slew_limit"] = 1e9  # tests/test_limits.py is about it
    after, output, status = stepped(host, state, params, measured)
    total = output["p1"] + output["p2"] + output["p3"]
    beyond = np.abs(total) > params["torque_limit"]
    assert (status[beyond] != OK).all()
    assert (status[~beyond] != SATURATED).all()
    assert 1000 < beyond.sum() < 19_000
    assert (output["tau"][beyond] == np.sign(total[beyond]) * params["torque_limit"][beyond]).all()
    for name in ("constraint_offset", "bound_estimate"):
        assert (after[name][beyond] == state[name][beyond]).all()
        assert (after[name][~beyond] != state[name][~beyond]).mean() > 0.99
    assert (after["drift_previous"] != state["drift_previous"]).all()


def test_a_law_that_saturates_at_once_still_engages(host):
    params = fill_records(host.records("params"), SETS["sim"] | {"torque_limit": 1e-9})
    state, status = host.records("state"), np.zeros(1, np.int32)
    host.init(state, params, status)
    measured = host.records("input")
    measured["q1"] = 0.5
    after, output, status = stepped(host, state, params, measured)
    assert status[0] == SATURATED
    assert after["engaged"] == 1
    assert after["constraint_offset"] == -output["s"]


_DRIVER = """
#include <float.h>
#include <stdio.h>
#include "pendubot.h"
int main(void)
{
    pendubot_state_t state;
    pendubot_params_t params;
    pendubot_input_t input;
    pendubot_output_t output;
    unsigned long count = 0UL;
    while (fread(&state, sizeof state, 1, stdin) == 1 && fread(&params, sizeof params, 1, stdin)
        && fread(&input, sizeof input, 1, stdin)) {
        int status = (int)pendubot_step(&state, &params, &input, &output);
        if (!(output.tau <= DBL_MAX && output.tau >= -DBL_MAX) || status < 0 || status > 6) {
            return 3;
        }
        (void)pendubot_init(&state, &params);
        count++;
    }
    printf("%lu", count);
    return 0;
}
"""


def run_sanitized(folder, flags, batch):
    """Run the driver over `batch`, built with sanitizers that end it at the first finding."""
    (folder / "driver.c").write_text(_DRIVER)
    sources = [str(p) for p in controller_sources(FOLDER.path, FOLDER.manifest)]
    built = subprocess.run(
        [
            *("gcc", "-std=c99", "-O1", "-g", "-ffp-contract=off", "-fno-sanitize-recover=all"),
            *(*flags, f"-I{FOLDER.path / 'c'}", "driver.c", *sources, "-o", "driver", "-lm"),
        ],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if built.returncode and "cannot find" in built.stderr:
        pytest.skip("gcc has no sanitizer libraries here")
    assert built.returncode == 0, built.stderr
    rows = zip(*([r.tobytes() for r in b] for b in batch), strict=True)
    given = b"".join(part for row in rows for part in row)
    done = subprocess.run([folder / "driver"], input=given, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    assert int(done.stdout) == len(batch[0])


UNDEFINED = "-fsanitize=address,undefined,float-cast-overflow"


@pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
def test_no_undefined_behaviour_on_garbage(tmp_path):
    rng = np.random.default_rng(6)
    batch = [garbage(rng, b) for b in sensible(FOLDER, rng, 40_000)]
    run_sanitized(tmp_path, [UNDEFINED], batch)


@pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
def test_no_division_by_zero_on_any_measurement_and_state_with_sound_parameters(tmp_path):
    rng = np.random.default_rng(7)
    state, params, measured = sensible(FOLDER, rng, 40_000)
    batch = [garbage(rng, state), params, garbage(rng, measured)]
    batch[0][PREPARED] = state[PREPARED]  # as init left them
    run_sanitized(tmp_path, [f"{UNDEFINED},float-divide-by-zero"], batch)
