"""The batch form gives every sample the bits of the scalar functions, whatever is beside it."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from conftest import tree
from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.generation import generate
from pfaffian.derive.pipeline import library_sets, lowered_model
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.writer import write_generation
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.batch import batch_model
from pfaffian.runtime.code.generated_model import (
    GeneratedFolder,
    fill_records,
    host_model,
    open_generated,
)
from pfaffian.runtime.contract.manifest import read_manifest
from pfaffian.runtime.flight.batch_flight import fly_many
from pfaffian.runtime.flight.closed_loop import fly
from pfaffian.runtime.flight.scenario import read_scenario
from pfaffian.runtime.machine.sources import batch_sources
from pfaffian.runtime.machine.toolchain import COMMON_FLAGS, host_target, vector_flags

MODELS = ("pendubot", "pvtol")
SCENARIOS = {"pendubot": "section-5.1-designed", "pvtol": "pvtol-hover"}
COUNT = 6007  # odd: the last samples do not fill a vector


def generated(name, path, bake=False):
    source = find_model(name)
    model = lowered_model(source)
    sets = library_sets(model, source)
    emission = Emission(model, sets[:1] if bake else sets, bake, batch=True)
    write_generation(generate(emission), path)
    return GeneratedFolder(path, read_manifest(path))


@pytest.fixture(scope="module", params=MODELS)
def folder(request, tmp_path_factory):
    return generated(request.param, tmp_path_factory.mktemp("batch") / request.param)


@pytest.fixture(scope="module")
def batch(folder):
    return batch_model(folder)


def parameters_of(folder):
    return folder.parameters(next(iter(folder.manifest.parameter_sets)))


def random_step(folder, host, count, seed):
    """Return (state, params, measured) of every kind: ordinary, extreme, singular, refused."""
    rng = np.random.default_rng(seed)
    state, measured = host.records("state", count), host.records("input", count)
    params = fill_records(host.records("params", count), parameters_of(folder))
    host.init(state, params, np.zeros(count, np.int32))
    kind = np.arange(count) % 8
    for name in measured.dtype.names:
        bound = folder.manifest.domain.get(name, 100.0)
        measured[name] = rng.normal(0.0, 3.0, count)
        measured[name] = np.where(kind == 1, rng.uniform(-1.2, 1.2, count) * bound, measured[name])
    odd = [np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, 1e300, -1e300]
    for row in np.flatnonzero(kind == 2):
        measured[str(rng.choice(measured.dtype.names))][row] = odd[rng.integers(len(odd))]
    prepared = set(state.dtype.names)
    for name in sorted(prepared):
        if name != "engaged" and not state[name].any():
            state[name] = rng.normal(0.0, 2.0, count)
    state["bound_estimate"] = np.abs(rng.normal(0.0, 1.0, count))
    state["engaged"] = rng.integers(0, 2, count)
    for row in np.flatnonzero(kind == 3):  # memory that overflows or is no number
        state[str(rng.choice(["bound_estimate", *remembered(folder)]))][row] = rng.choice(odd)
    for limit in folder.manifest.limits:
        scale = np.where(kind == 4, 1e-3, np.where(kind == 5, 1e6, 1.0))
        params[limit] *= scale
        params[limit] = np.where((kind == 6) & (rng.random(count) < 0.3), np.nan, params[limit])
    if "singular_threshold_squared" in prepared:
        near = (kind == 7) & (rng.random(count) < 0.7)
        state["singular_threshold_squared"] = np.where(
            near, 1e4, state["singular_threshold_squared"]
        )
    return state, params, measured


def remembered(folder):
    names = folder.manifest.structures["state"].names()
    return [n for n in names if n.startswith(("constraint_offset", "drift_previous"))]


def same_bits(columns, records):
    """Return where a column and a record differ by a bit, over all members."""
    bad = np.zeros(columns.count, bool)
    for name in columns.names():
        one, other = columns[name], np.ascontiguousarray(records[name])
        width = f"u{one.dtype.itemsize}"
        bad |= one.view(width) != other.view(width)
    return np.flatnonzero(bad)


def both_steps(folder, batch, state, params, measured):
    """Run the scalar step and the batch step; return what differs, and the statuses."""
    host, count = batch.host, len(state)
    columns = {
        "state": batch.columns("state", count).spread(state),
        "params": batch.columns("params", count).spread(params),
        "input": batch.columns("input", count).spread(measured),
        "output": batch.columns("output", count),
    }
    output = host.records("output", count)
    status, status_batch = np.zeros(count, np.int32), np.zeros(count, np.int32)
    host.step(state, params, measured, output, status)
    batch.step(*columns.values(), status_batch)
    bad = np.union1d(same_bits(columns["state"], state), same_bits(columns["output"], output))
    return np.union1d(bad, np.flatnonzero(status != status_batch)), status


def test_the_step_gives_the_bits_of_the_scalar_step_whatever_the_status(folder, batch):
    state, params, measured = random_step(folder, batch.host, COUNT, 7)
    for name in state.dtype.names:
        state[name][::101] = 0  # as if init had never been called
    bad, status = both_steps(folder, batch, state, params, measured)
    assert not len(bad), bad[:5]
    seen = {folder.manifest.status[k] for k in status}
    assert seen == set(folder.manifest.status) - {"BAD_ARITHMETIC"}  # of init alone


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 31])
def test_few_samples_are_as_good_as_many(folder, batch, count):
    state, params, measured = random_step(folder, batch.host, count, count)
    bad, _ = both_steps(folder, batch, state, params, measured)
    assert not len(bad)


def random_plant(folder, host, count, seed):
    rng = np.random.default_rng(seed)
    params = fill_records(host.records("plant_params", count), parameters_of(folder))
    state, applied = host.records("plant_state", count), host.records("plant_input", count)
    for name in params.dtype.names:
        zero = np.abs(rng.normal(0.0, 0.1, count))
        params[name] = np.where(params[name] == 0.0, zero, params[name])
        params[name] *= rng.uniform(0.7, 1.3, count)
    for records in (state, applied):
        for name in records.dtype.names:
            records[name] = rng.normal(0.0, 3.0, count)
    return params, state, applied


def same_numbers(columns, records):
    """Check that all numbers have the same bits; return how many values are no number in both.

    Which NaN an operation on two NaNs gives is the compiler's choice.
    """
    none = 0
    for name in columns.names():
        lost = np.isnan(records[name])
        none += lost.sum()
        assert (np.isnan(columns[name]) == lost).all()
        left, right = columns[name][~lost], records[name][~lost]
        assert left.tobytes() == np.ascontiguousarray(right).tobytes()
    return none


def test_the_acceleration_gives_the_bits_of_the_scalar_one(folder, batch):
    host = batch.host
    params, state, applied = random_plant(folder, host, COUNT, 8)
    odd = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, 2e5, -2e5, 1e300])
    rng = np.random.default_rng(9)
    for row in range(0, COUNT, 5):
        state[str(rng.choice(state.dtype.names))][row] = rng.choice(odd)
    rate = host.records("plant_rate", COUNT)
    columns = [
        batch.columns(role, COUNT).spread(records)
        for role, records in (
            ("plant_params", params),
            ("plant_state", state),
            ("plant_input", applied),
        )
    ]
    made = batch.columns("plant_rate", COUNT)
    host.acceleration(params, state, applied, rate)
    batch.acceleration(*columns, made)
    assert same_numbers(made, rate) > 100


def test_the_plant_step_gives_the_bits_of_the_scalar_one(folder, batch):
    host = batch.host
    params, state, applied = random_plant(folder, host, COUNT, 10)
    step = np.full(COUNT, 1e-3)
    columns = batch.columns("plant_state", COUNT).spread(state)
    given = batch.columns("plant_params", COUNT).spread(params)
    forces = batch.columns("plant_input", COUNT).spread(applied)
    host.plant_step(state, params, applied, step, 7)
    batch.plant_step(columns, given, forces, step, 7)
    assert same_numbers(columns, state) < COUNT // 100  # few have run away to what is no number


def test_a_baked_batch_gives_the_bits_of_the_baked_step(tmp_path):
    folder = generated("pendubot", tmp_path / "baked", bake=True)
    batch = batch_model(folder)
    state, params, measured = random_step(folder, batch.host, 1001, 11)
    bad, _ = both_steps(folder, batch, state, params, measured)
    assert not len(bad)


def test_without_vectors_the_bits_are_the_same(folder, batch, monkeypatch):
    monkeypatch.setattr("pfaffian.runtime.code.batch.vector_flags", lambda: ("-O3",))
    plain = batch_model(folder)
    state, params, measured = random_step(folder, plain.host, 2003, 12)
    bad, _ = both_steps(folder, plain, state, params, measured)
    assert not len(bad)


def test_gcc_works_on_several_samples_at_once_in_every_loop(folder, tmp_path):
    if shutil.which("gcc") is None or "-mavx2" not in vector_flags():
        pytest.skip("needs gcc and a processor with AVX2")
    source = batch_sources(folder.path, folder.manifest)[0]
    flags = [*COMMON_FLAGS, *host_target("gcc", fma=True).flags, *vector_flags()]
    done = subprocess.run(
        ["gcc", *flags, "-fopt-info-vec", "-c", source, "-o", tmp_path / "b.o"],
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    loops = {
        int(line.split(":")[1])
        for line in done.stderr.splitlines()
        if source.name in line and "loop vectorized" in line
    }
    lines = source.read_text().splitlines()
    each = {k + 1 for k, line in enumerate(lines, 1) if line.strip() == "PF_EACH_SAMPLE"}
    assert len(each) == 3
    assert each <= loops


def test_the_c_is_clean_and_needs_no_library(folder, tmp_path):
    source = batch_sources(folder.path, folder.manifest)[0]
    strict = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror"]
    for flags in ([], ["-O3", "-ffreestanding"]):
        command = ["gcc", *strict, *flags, "-ffp-contract=off", "-fno-math-errno", "-c", source]
        subprocess.run([*command, "-o", tmp_path / "b.o"], check=True, timeout=300)
    for word in ("malloc", "static double", "stdio", "math.h"):
        assert word not in source.read_text()


# ---- many flights -------------------------------------------------------------------------------


def perturbed(scenario, count, seed):
    rng = np.random.default_rng(seed)
    plant = {
        n: v * rng.uniform(0.9, 1.1, count) for n, v in scenario.plant.items() if n != "g" and v
    }
    initial = {n: v + rng.normal(0.0, 0.01, count) for n, v in scenario.initial.items()}
    return plant, initial


def test_many_flights_are_the_flights_one_by_one_to_the_bit(folder, batch):
    scenario = read_scenario(SCENARIOS[folder.manifest.model], folder.path)
    scenario = replace(scenario, steps=150)
    plant, initial = perturbed(scenario, 9, 13)
    names = [
        n for role in ("input", "output", "state") for n in folder.manifest.structures[role].names()
    ]
    many = fly_many(scenario, batch, plant=plant, initial=initial, signals=names)
    again = fly_many(scenario, batch, plant=plant, initial=initial)
    host = host_model(folder)
    for k in range(9):
        one = replace(
            scenario,
            plant={**scenario.plant, **{n: a[k] for n, a in plant.items()}},
            initial={**scenario.initial, **{n: a[k] for n, a in initial.items()}},
        )
        alone = fly(one, host, host, "host")
        assert (many.status[:, k] == alone.status).all()
        for records in (alone.state, alone.output, alone.measured):
            for name in records.dtype.names:
                column = many.signals[name][:, k]
                assert column.tobytes() == records[name].astype(float).tobytes(), (k, name)
    for name, log in again.signals.items():
        assert log.tobytes() == many.signals[name].tobytes()


def test_flights_in_two_parts_are_flights_in_one(folder, batch, monkeypatch):
    scenario = replace(read_scenario(SCENARIOS[folder.manifest.model], folder.path), steps=20)
    plant, _ = perturbed(scenario, 11, 14)
    whole = fly_many(scenario, batch, plant=plant)
    monkeypatch.setattr("pfaffian.runtime.flight.batch_flight._TOGETHER", 4)
    parts = fly_many(scenario, batch, plant=plant)
    for name, log in whole.signals.items():
        assert log.tobytes() == parts.signals[name].tobytes()


def test_what_cannot_be_flown_is_refused(folder, batch):
    scenario = read_scenario(SCENARIOS[folder.manifest.model], folder.path)
    name = next(iter(scenario.plant))
    for wrong, says in (
        ({"plant": {"nothing": np.ones(3)}}, "nothing"),
        ({"controller": {"sample_time": np.ones(3)}}, "sample_time"),
        ({"plant": {name: np.ones(3)}, "initial": {next(iter(scenario.initial)): np.ones(4)}}, "4"),
        ({}, "shapes"),
        ({"plant": {name: np.ones(3)}, "signals": ["nothing"]}, "nothing"),
    ):
        with pytest.raises(InputError, match=says):
            fly_many(scenario, batch, **wrong)


def test_arrays_of_another_length_or_type_are_refused(folder, batch):
    state = batch.columns("state", 4)
    others = [batch.columns(role, 4) for role in ("params", "input")]
    with pytest.raises(InputError, match="columns"):
        batch.step(state, *others, batch.columns("output", 5), np.zeros(4, np.int32))
    with pytest.raises(InputError, match="int64"):
        batch.step(state, *others, batch.columns("output", 4), np.zeros(4, np.int64))
    with pytest.raises(InputError, match="float32"):
        batch.columns("plant_state", 4, **{next(iter(state_names(batch))): np.zeros(4, np.float32)})


def state_names(batch):
    return batch.folder.manifest.structures["plant_state"].names()


def test_a_model_without_the_batch_form_says_how_to_get_it():
    with pytest.raises(InputError, match="batch form") as refused:
        batch_model(open_generated("pendubot"))
    assert "--batch" in refused.value.remedy


def test_without_the_option_nothing_of_it_is_generated(tmp_path, run):
    assert run("generate", "pendubot", "-o", tmp_path / "plain").code == 0
    assert run("generate", "pendubot", "--batch", "-o", tmp_path / "with").code == 0
    plain, more = tree(tmp_path / "plain"), tree(tmp_path / "with")
    assert set(more) - set(plain) == {
        "c/pendubot_batch.c",
        "c/pendubot_batch.h",
        "c/pf_elementary_batch.h",
    }
    listing = ("manifest.json", "c/Makefile", "c/CMakeLists.txt")  # of what there is
    assert all(more[p] == plain[p] for p in plain if p not in listing)


def test_the_bench_compares_bits_before_it_times(run):
    document = run("bench", "batch", "pvtol", "--samples", 64, "--passes", 2, "--json").document()
    for row in ("step", "plant_step (10 substeps)"):
        assert set(document[row]) == {"scalar_ns", "batch_ns", "ratio"}
        assert document[row]["ratio"] > 0.0
