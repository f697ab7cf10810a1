"""The generated NumPy module stands alone, broadcasts, and says what the C code says."""

import ast
import subprocess
import sys
import warnings
from dataclasses import fields

import numpy as np
import pytest
from pfaffian.runtime.code.generated_model import host_model, open_generated
from test_c_safety import garbage, is_finite, raw, sensible

FOLDER = open_generated("pendubot")
MODULE = FOLDER.python_module()
SOURCE = FOLDER.path / f"{FOLDER.manifest.model}.py"
CLASSES = {
    role: getattr(MODULE, "".join(w.capitalize() for w in role.split("_")))
    for role in FOLDER.manifest.structures
}
#: How far C and NumPy may part, in units of what a last bit in the inputs makes of the result.
PARTING = 8.0


@pytest.fixture(scope="module")
def host():
    return host_model(FOLDER)


def given(role, records):
    """Return records as the module takes them: one array a field, none of them writable."""
    columns = {n: records[n].copy() for n in records.dtype.names}
    for column in columns.values():
        column.flags.writeable = False
    return CLASSES[role](**columns)


def columns_of(value):
    return {f.name: np.asarray(getattr(value, f.name)) for f in fields(value)}


def nudged(rng, records):
    """Return records with every float moved by one unit in the last place, up or down."""
    moved = records.copy()
    for name in records.dtype.names:
        if records.dtype[name].kind == "f":
            way = np.where(rng.random(len(records)) < 0.5, np.inf, -np.inf)
            moved[name] = np.nextafter(records[name], way)
    return moved


def assert_agree(wanted, function, *batch):
    """Compare `wanted` (C) with `function` (NumPy), scaled by how a last bit moves the result."""
    rng = np.random.default_rng(3)
    here = function(*batch)
    shifted = [function(*(nudged(rng, b) for b in batch)) for _ in range(8)]
    for name, value in here.items():
        spread = np.max([np.abs(s[name] - value) for s in shifted], axis=0)
        allowed = PARTING * np.maximum(spread, np.spacing(np.abs(value)))
        beyond = ~(np.abs(wanted[name] - value) <= allowed)
        assert not beyond.any(), f"{name}: {beyond.sum()} samples, such as {batch[0][beyond][0]}"


def test_it_imports_numpy_alone():
    tree = ast.parse(SOURCE.read_text(encoding="utf-8"))
    imported = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    imported |= {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    assert imported == {"numpy", "dataclasses"}


_ALONE = """
import importlib.util, sys
found = importlib.util.spec_from_file_location("alone", sys.argv[1])
module = importlib.util.module_from_spec(found)
found.loader.exec_module(module)
state, status = module.init(module.SIM)
state, output, status = module.step(state, module.SIM, module.Input(1.0, 0.1, 0.0, 0.0))
print(float(output.tau), *sorted({n.partition(".")[0] for n in sys.modules}))
"""


def fresh_interpreter(code, *arguments):
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_it_runs_in_a_fresh_interpreter_that_loads_nothing_of_ours():
    torque, *loaded = fresh_interpreter(_ALONE, str(SOURCE))
    assert np.isfinite(float(torque))
    assert "numpy" in loaded
    assert not {"pfaffian", "sympy", "casadi", "mpmath", "jinja2", "scipy"} & set(loaded)


def test_importing_the_package_loads_no_compile_time_stage():
    code = "import sys, pfaffian.generated.pendubot.pendubot; print(*sys.modules)"
    loaded = fresh_interpreter(code)
    assert "pfaffian.generated.pendubot.pendubot" in loaded
    assert not {"pfaffian.derive", "pfaffian.cli", "sympy", "casadi", "jinja2"} & set(loaded)


def element(value, shape, index):
    """Return `value` with each field broadcast to `shape` and taken at `index`, as floats."""
    taken = {n: np.broadcast_to(c, shape)[index].item() for n, c in columns_of(value).items()}
    return type(value)(**taken)


def numpy_is_consistent(rng):
    """Return whether NumPy's functions give one element the bits they give it in an array."""
    x = rng.normal(0.0, 3.0, 256)
    functions = (np.sin, np.cos, np.arctan, np.exp, np.expm1, np.tanh, np.sqrt)
    strided = np.repeat(np.abs(x), 2)[::2]
    return all(
        (f(strided) == [f(v) for v in np.abs(x).tolist()]).all() and (f(strided) == f(abs(x))).all()
        for f in functions
    )


def batches():
    """Return (function, arguments of different leading shapes, fields to compare) by name."""
    rng = np.random.default_rng(8)
    state, params, measured = sensible(FOLDER, rng, 60)

    def shaped(role, records, count, shape):
        value = given(role, records[:count])
        return type(value)(**{n: c.reshape(shape) for n, c in columns_of(value).items()})

    law = MODULE.ContinuousState(rng.normal(size=(1, 5)), rng.normal(size=(1, 5)), 0.1)
    plant = MODULE.PlantParams(
        **{
            f.name: params[f.name][:3].reshape(3, 1, 1)
            if f.name in params.dtype.names
            else rng.normal()
            for f in fields(MODULE.PlantParams)
        }
    )
    p = shaped("params", params, 3, (3, 1, 1))
    s, m = shaped("state", state, 5, (1, 5)), shaped("input", measured, 20, (4, 5))
    motion = MODULE.PlantState(**columns_of(m))
    return {
        "step": (MODULE.step, (s, p, m)),
        "init": (MODULE.init, (p,)),
        "continuous": (MODULE.continuous, (law, p, m)),
        "acceleration": (MODULE.acceleration, (plant, motion, MODULE.PlantInput(rng.normal()))),
        "energy": (MODULE.energy, (plant, motion)),
        "input_gain": (MODULE.input_gain, (p, m)),
    }


def flat(result):
    """Return every array of a result: of a class, of a tuple of classes, or the one there is."""
    if isinstance(result, tuple):
        return [a for r in result for a in flat(r)]
    return list(columns_of(result).values()) if hasattr(result, "__dict__") else [result]


@pytest.mark.parametrize("name", batches())
def test_broadcasting_is_elementwise(name):
    function, arguments = batches()[name]
    whole = flat(function(*arguments))
    shape = np.broadcast_shapes(*(c.shape for a in arguments for c in columns_of(a).values()))
    assert shape == ((3, 1, 1) if name == "init" else (3, 4, 5))
    exact = numpy_is_consistent(np.random.default_rng(9))
    for index in np.ndindex(shape):
        one = flat(function(*(element(a, shape, index) for a in arguments)))
        for array, value in zip(whole, one, strict=True):
            there = np.broadcast_to(array, shape)[index]
            if exact:
                assert there == value
            else:
                assert there == pytest.approx(float(value), rel=1e-12, abs=1e-12)


def test_step_agrees_with_c(host):
    rng = np.random.default_rng(10)
    batch = sensible(FOLDER, rng, 20_000)
    after, output = batch[0].copy(), host.records("output", 20_000)
    status = np.zeros(20_000, np.int32)
    host.step(after, batch[1], batch[2], output, status)

    def here(state, params, measured):
        advanced, result, _ = MODULE.step(
            given("state", state), given("params", params), given("input", measured)
        )
        return columns_of(result) | {f"next {n}": c for n, c in columns_of(advanced).items()}

    wanted = {n: output[n] for n in output.dtype.names}
    wanted |= {f"next {n}": after[n] for n in after.dtype.names}
    assert_agree(wanted, here, *batch)
    roles = ("state", "params", "input")
    _, _, codes = MODULE.step(*(given(r, b) for r, b in zip(roles, batch, strict=True)))
    assert (codes == status).all()


def test_init_agrees_with_c(host):
    _, params, _ = sensible(FOLDER, np.random.default_rng(11), 5000)
    state, status = host.records("state", 5000), np.zeros(5000, np.int32)
    host.init(state, params, status)
    assert (status == MODULE.OK).all()
    assert_agree(
        {n: state[n] for n in state.dtype.names},
        lambda p: columns_of(MODULE.init(given("params", p))[0]),
        params,
    )


def test_continuous_law_agrees_with_c(host):
    rng = np.random.default_rng(12)
    _, params, measured = sensible(FOLDER, rng, 20_000)
    inner, law = (host.records(r, 20_000) for r in ("continuous_state", "continuous_output"))
    for name in inner.dtype.names:
        inner[name] = np.abs(rng.normal(0.0, 1.0, 20_000))
    host.continuous(inner, params, measured, law)
    roles = ("continuous_state", "params", "input")
    assert_agree(
        {n: law[n] for n in law.dtype.names},
        lambda *b: columns_of(MODULE.continuous(*map(given, roles, b))),
        *(inner, params, measured),
    )


def test_plant_agrees_with_c(host):
    rng = np.random.default_rng(13)
    _, params, measured = sensible(FOLDER, rng, 20_000)
    plant, motion, applied, rate = (
        host.records(f"plant_{r}", 20_000) for r in ("params", "state", "input", "rate")
    )
    for name in plant.dtype.names:
        known = name in params.dtype.names
        plant[name] = params[name] if known else rng.normal(0.0, 1.0, 20_000)
    for name in motion.dtype.names:
        motion[name] = measured[name]
    applied["tau"] = rng.normal(0.0, 5.0, 20_000)
    energy = np.zeros(20_000)
    host.acceleration(plant, motion, applied, rate)
    host.energy(plant, motion, energy)
    roles = ("plant_params", "plant_state", "plant_input")
    assert_agree(
        {n: rate[n] for n in rate.dtype.names},
        lambda *b: columns_of(MODULE.acceleration(*map(given, roles, b))),
        *(plant, motion, applied),
    )
    assert_agree(
        {"energy": energy},
        lambda *b: {"energy": MODULE.energy(*map(given, roles, b))},
        *(plant, motion),
    )


@pytest.fixture(scope="module")
def spoiled():
    rng = np.random.default_rng(14)
    return [garbage(rng, b) for b in sensible(FOLDER, rng, 200_000)]


def quietly(function, *arguments):
    """Call with every warning an error, those of NumPy's arithmetic included."""
    with warnings.catch_warnings(), np.errstate(all="raise"):
        warnings.simplefilter("error")
        return function(*arguments)


def at_the_limit(output, params):
    """Return where a rounding of the largest part of the torque decides whether it saturates.

    C rounds a product and a sum once, NumPy twice.
    """
    parts = np.abs([output[n] for n in ("p1", "p2", "p3")])
    torque = np.abs(output["p1"] + output["p2"] + output["p3"])
    with np.errstate(all="ignore"):
        return np.abs(torque - params["torque_limit"]) <= PARTING * np.spacing(parts.max(axis=0))


def test_step_on_garbage_says_what_c_says(host, spoiled):
    state, params, measured = spoiled
    after, output = state.copy(), host.records("output", len(state))
    status = np.zeros(len(state), np.int32)
    host.step(after, params, measured, output, status)
    batch = (given("state", state), given("params", params), given("input", measured))
    advanced, result, codes = quietly(MODULE.step, *batch)
    parted = (codes >= MODULE.BAD_INPUT) != (status >= MODULE.BAD_INPUT)
    # One product that C does not round and NumPy does may be infinite for NumPy alone.
    largest = np.max([np.abs(output[n]) for n in output.dtype.names], axis=0)
    assert (largest[parted] > 1e300).all()
    assert parted.mean() < 1e-4
    assert (codes == status)[~at_the_limit(output, params) & ~parted].all()
    assert (codes == status).mean() > 0.9999
    for name, column in columns_of(result).items():
        assert np.isfinite(column).all(), name
        assert not column[codes >= MODULE.BAD_INPUT].any(), name
    good = codes < MODULE.BAD_INPUT
    assert (np.abs(result.tau[good]) <= params["torque_limit"][good]).all()
    refused = ~good & ~parted
    assert (raw(after)[:, refused] == raw(state)[:, refused]).all()
    for name, column in columns_of(advanced).items():
        kept = column[~good].astype(state.dtype[name])
        assert kept.tobytes() == state[name][~good].tobytes(), name


def test_init_on_garbage_says_what_c_says(host, spoiled):
    params = spoiled[1]
    state, status = host.records("state", len(params)), np.zeros(len(params), np.int32)
    host.init(state, params, status)
    fresh, codes = quietly(MODULE.init, given("params", params))
    assert (codes == status).all()
    assert 1000 < (status == MODULE.OK).sum() < len(params) - 1000
    for column in columns_of(fresh).values():
        assert np.isfinite(column).all()
        assert not column[codes == MODULE.BAD_PARAMETER].any()


def test_nothing_warns_or_raises_on_garbage(spoiled):
    state, params, measured = (
        given(r, b[:50_000]) for r, b in zip(("state", "params", "input"), spoiled, strict=True)
    )
    law = MODULE.ContinuousState(state.constraint_offset, state.drift_previous, params.g)
    motion = MODULE.PlantState(**columns_of(measured))
    loads = {f.name: getattr(params, f.name, params.sigma) for f in fields(MODULE.PlantParams)}
    plant = MODULE.PlantParams(**loads)
    quietly(MODULE.continuous, law, params, measured)
    quietly(MODULE.acceleration, plant, motion, MODULE.PlantInput(params.lam))
    quietly(MODULE.energy, plant, motion)
    quietly(MODULE.input_gain, params, measured)
    quietly(MODULE.setpoint, params)


@pytest.mark.parametrize("value", [0.0, float("nan"), float("inf"), 1e308, 5e-324, 0, 10**3])
def test_plain_numbers_are_as_good_as_arrays(value):
    params = MODULE.Params(**{f.name: value for f in fields(MODULE.Params)})
    measured = MODULE.Input(value, value, value, value)
    state, _ = quietly(MODULE.init, params)
    for each in (state, MODULE.State(*[value] * len(fields(MODULE.State)))):
        advanced, output, status = quietly(MODULE.step, each, params, measured)
        assert np.isfinite([float(c) for c in columns_of(output).values()]).all()
        assert 0 <= int(status) < len(FOLDER.manifest.status)
        assert np.shape(advanced.bound_estimate) == ()
    quietly(MODULE.continuous, MODULE.ContinuousState(value, value, value), params, measured)


def test_continuous_law_is_infinite_at_adb_zero_without_a_warning():
    singular = {"theta1": 2.0, "theta2": 1.0, "theta3": 1.0, "lam": 2.0}
    params = MODULE.Params(**(vars(MODULE.SIM) | singular))
    measured = MODULE.Input(0.3, 0.0, 0.5, -0.7)
    law = quietly(MODULE.continuous, MODULE.ContinuousState(0.0, 0.0, 0.1), params, measured)
    assert law.adb == 0.0
    assert np.isinf(law.p1)


def test_fields_of_a_fresh_state_share_no_memory():
    _, params, _ = sensible(FOLDER, np.random.default_rng(15), 4)
    state, _ = MODULE.init(given("params", params))
    columns = list(columns_of(state).values())
    for k, column in enumerate(columns):
        assert not any(np.shares_memory(column, other) for other in columns[:k])


def test_constants_are_the_parameter_sets_of_the_manifest():
    for name, values in FOLDER.manifest.parameter_sets.items():
        constant = getattr(MODULE, name.replace("-", "_").upper())
        assert vars(constant) == {f.name: values[f.name] for f in fields(MODULE.Params)}


def test_status_codes_are_those_of_the_manifest():
    assert [getattr(MODULE, n) for n in FOLDER.manifest.status] == list(range(8))


def test_sampled_flight_stays_with_the_c_code(host):
    params = host.records("params")
    for name in params.dtype.names:
        params[name] = FOLDER.manifest.parameter_sets["sim-designed"][name]
    there, status = host.records("state"), np.zeros(1, np.int32)
    host.init(there, params, status)
    here, _ = MODULE.init(MODULE.SIM_DESIGNED)
    output, measured = host.records("output"), host.records("input")
    for k in range(500):
        for j, name in enumerate(measured.dtype.names):
            measured[name] = np.sin(0.01 * k + j) * (1.0 if j < 2 else 0.5)
        host.step(there, params, measured, output, status)
        at = MODULE.Input(*(float(measured[n][0]) for n in measured.dtype.names))
        here, result, code = MODULE.step(here, MODULE.SIM_DESIGNED, at)
        assert code == status[0]
        assert float(result.tau) == pytest.approx(float(output["tau"][0]), rel=1e-9, abs=1e-12)
    assert is_finite(there).all()
