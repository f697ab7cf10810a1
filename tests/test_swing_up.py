"""The energy swing-up law: what was derived, what its gains must keep, and the generated code."""

import math
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from pfaffian.derive.derivation.derive import derive
from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.generation import generate
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.names import SWING_UP_LIMIT
from pfaffian.derive.models.pendubot.spec import model as pendubot
from pfaffian.derive.optimise.passes import PASSES
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
from pfaffian.derive.sets.parameter_set import resolve_set
from pfaffian.derive.sets.raw_set import RawSet
from pfaffian.derive.sets.swing_up_limit import enclosed, is_regular, largest_limit
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.spec.model_spec import Matrix
from pfaffian.derive.symbolic.normal_form import is_zero
from pfaffian.derive.verify.compare import LIMIT_ULP, verify
from pfaffian.derive.verify.subjects import CompiledUnderTest, PythonUnderTest
from pfaffian.derive.writer import write_generation
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.compiled import CompiledModel
from pfaffian.runtime.code.generated_model import host_model, open_generated, ppc750_model

SWINGING = ("cart_pole", "furuta", "pendubot")
SOURCE = find_model("pendubot")
MODEL = lowered_model(SOURCE)
SETS = {s.name: s.as_dict() for s in library_sets(MODEL, SOURCE)}


@pytest.fixture(scope="module")
def derivation():
    return derivation_of(SOURCE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the Pendubot generated as it is derived now."""
    path = tmp_path_factory.mktemp("swing_up") / "pendubot"
    emission = Emission(MODEL, library_sets(MODEL, SOURCE))
    write_generation(generate(emission), path)
    return open_generated(str(path))


@pytest.fixture(scope="module")
def host(folder):
    return host_model(folder)


# --- The derivation -----------------------------------------------------------------------------


def theory():
    """Return W, det M and N of the Pendubot as printed in the literature, and its symbols."""
    th1, th2, th3, th4, th5, g = sp.symbols("theta1:6 g", positive=True)
    q1, q2, v1, v2 = sp.symbols("q1 q2 dq1 dq2", real=True)
    det = th1 * th2 - th3**2 * sp.cos(q2) ** 2
    free = (
        th2 * th3 * sp.sin(q2) * (v1 + v2) ** 2
        + th3**2 * sp.cos(q2) * sp.sin(q2) * v1**2
        - th2 * th4 * g * sp.cos(q1)
        + th3 * th5 * g * sp.cos(q2) * sp.cos(q1 + q2)
    )
    return free, det, th2


def test_the_pendubot_law_is_the_one_of_the_literature(derivation):
    free, det, reach = theory()
    block = derivation.block("swing_up")
    found = {d.symbol.name: block.expanded(d.symbol) for d in block.definitions}
    k = dict(zip("PDEV", sp.symbols("kP kD kE kV", positive=True), strict=True))
    error = found["energy_error"]
    bottom = k["D"] * reach + k["E"] * error * det
    v1, q1, q1d = sp.symbols("dq1 q1 q1d", real=True)
    top = -k["D"] * free - det * (k["V"] * v1 + k["P"] * (q1 - q1d))
    assert is_zero(found["drive"] - free)
    assert is_zero(found["det_m"] - det)
    assert is_zero(found["denominator"] - bottom)
    assert is_zero(found["torque"] * found["denominator"] - top)


def test_the_energy_is_measured_from_the_setpoint_at_rest(derivation):
    block = derivation.block("swing_up")
    error = block.expanded(sp.Symbol("energy_error", real=True))
    goal = dict.fromkeys(sp.symbols("dq1 dq2", real=True), 0)
    goal |= dict(zip(sp.symbols("q1 q2", real=True), sp.symbols("q1d q2d", real=True), strict=True))
    assert error.subs(goal) == 0
    upright = dict(zip(sp.symbols("q1d q2d", real=True), (sp.pi / 2, 0), strict=True))
    g, th4, th5 = sp.symbols("g theta4 theta5", positive=True)
    whole = derivation.dynamics.kinetic_energy + derivation.dynamics.potential_energy
    assert is_zero(error.subs(upright) - whole + (th4 + th5) * g)


@pytest.mark.parametrize("name", SWINGING)
def test_the_rate_of_the_lyapunov_function_is_proved(name):
    found = {i.name: i.proved for i in derivation_of(find_model(name)).identities}
    assert found["under the swing-up law V_L falls at the rate kV q_a'^2"]
    assert found["the actuator's row of M q'' = B tau - C q' - G"]


def test_the_rate_of_the_lyapunov_function_in_the_plant_itself(derivation):
    """V_L' by the chain rule along M q'' = B tau - C q' - G, with every expression written out."""
    dynamics, block = derivation.dynamics, derivation.block("swing_up")
    q, v = (sp.Matrix(sp.symbols(n, real=True)) for n in ("q1 q2", "dq1 dq2"))
    found = {d.symbol.name: block.expanded(d.symbol) for d in block.definitions}
    kp, kd, ke, kv = sp.symbols("kP kD kE kV", positive=True)
    error, away = found["energy_error"], q[0] - sp.Symbol("q1d", real=True)
    lyapunov = ke * error**2 / 2 + kd * v[0] ** 2 / 2 + kp * away**2 / 2
    right = dynamics.input_matrix * found["torque"] - dynamics.coriolis_force - dynamics.gravity
    acceleration = dynamics.mass_matrix.adjugate() * right / dynamics.mass_matrix.det()
    rate = sum(lyapunov.diff(x) * dx for x, dx in zip([*q, *v], [*v, *acceleration], strict=True))
    rng = np.random.default_rng(3)
    symbols = sorted((rate + kv).free_symbols, key=lambda s: s.name)
    for _ in range(20):
        at = {
            s: sp.Float(float(x), 40)
            for s, x in zip(symbols, rng.uniform(0.5, 2, 99), strict=False)
        }
        value, wanted = (e.subs(at).evalf(40) for e in (rate, -kv * v[0] ** 2))
        assert abs(value - wanted) < 1e-25 * (1 + abs(wanted))


def test_the_readable_derivation_shows_the_law_and_its_condition():
    for path, text in MODEL.documents:
        if path == "derivation.md":
            assert "## Energy swing-up" in text
            assert "\\mathrm{energy\\_error} =" in text
            assert "regular in every state if and only if" in text


@pytest.mark.parametrize("title", [title for title, _ in PASSES])
def test_a_pass_keeps_the_values_of_the_law(derivation, title):
    from pfaffian.derive.lower.to_program import lower

    program = lower(derivation.block("swing_up"))
    for before, run in PASSES:
        done = run(program)
        if before == title:
            break
        program = done
    rng = np.random.default_rng(5)
    for _ in range(20):
        values = {s.name: v for s, v in zip(program.inputs, rng.uniform(0.1, 2, 99), strict=False)}
        values |= {"theta1": 3.0, "theta2": 2.0, "theta3": 1.0}
        one, other = evaluate(done, values), evaluate(program, values)
        assert all(math.isclose(one[n], v, rel_tol=1e-11, abs_tol=1e-11) for n, v in other.items())


# --- What the specification and the gains must keep ----------------------------------------------


def test_gains_of_the_wrong_dimension_are_refused():
    spec = pendubot()
    swapped = tuple(replace(p, unit="s") if p.name == "kD" else p for p in spec.parameters)
    with pytest.raises(InputError, match="swing-up gain kD has the unit 's'") as caught:
        derive(replace(spec, parameters=swapped))
    assert "kD s^2/q^2" in caught.value.remedy


@pytest.mark.parametrize("column", [(1, 1), (2, 0), (0, -1)])
def test_an_actuator_on_several_coordinates_has_no_swing_up_law(column):
    with pytest.raises(InputError, match="one actuator that acts on one"):
        derive(replace(pendubot(), input_matrix=Matrix(column)))


def theory_limit(v, q2):
    """Return what kD/kE must exceed at q2, q1 where the potential energy is least."""
    th1, th2, th3, th4, th5 = (v[f"theta{k}"] for k in range(1, 6))
    drop = th4 + th5 + np.sqrt(th4**2 + th5**2 + 2 * th4 * th5 * np.cos(q2))
    return v["g"] * drop * (th1 * th2 - (th3 * np.cos(q2)) ** 2) / th2


@pytest.mark.parametrize("name", SETS)
def test_the_limit_is_the_formula_of_the_literature(name):
    values, angles = SETS[name], np.linspace(-np.pi, np.pi, 200_001)
    program = MODEL.program("swing_up_limit")
    for q2 in angles[::20_000]:
        here = evaluate(program, {**values, "q2": float(q2)})[SWING_UP_LIMIT]
        assert here == pytest.approx(theory_limit(values, q2), rel=1e-12)
    found = largest_limit(MODEL, values)
    assert found.least <= found.most <= found.least * (1 + 1e-5)
    # The grid misses the largest value by half the square of its step, at most.
    assert found.most >= theory_limit(values, angles).max()
    assert found.least == pytest.approx(theory_limit(values, angles).max(), rel=1e-6)


def test_an_enclosure_of_the_limit_holds_what_is_inside():
    values, rng = SETS["sim"], np.random.default_rng(11)
    program = MODEL.program("swing_up_limit")
    fixed = {s.name: values[s.name] for s in program.inputs if s.group == "parameter"}
    for _ in range(200):
        low = rng.uniform(-7, 7)
        high = low + 10.0 ** rng.uniform(-6, 1)
        least, most = enclosed(program, {n: (v, v) for n, v in fixed.items()} | {"q2": (low, high)})
        for q2 in np.linspace(low, high, 9):
            assert least <= evaluate(program, {**fixed, "q2": float(q2)})[SWING_UP_LIMIT] <= most


def test_the_limit_decides_to_its_last_digits():
    values = SETS["rig"]
    found = largest_limit(MODEL, values, 1e-9)
    assert is_regular(MODEL, values, found.most * (1 + 1e-6))
    assert not is_regular(MODEL, values, found.least)
    assert not is_regular(MODEL, values, found.least * (1 - 1e-6))


def test_the_denominator_is_positive_just_above_the_limit_and_not_below(host):
    """At rest where the potential energy is least for the worst q2, E~ is all it can miss."""
    values = dict(SETS["rig"])
    found = largest_limit(MODEL, values, 1e-9)
    q2 = found.at["q2"]
    weight = np.array(
        [values["theta4"] + values["theta5"] * np.cos(q2), values["theta5"] * np.sin(q2)]
    )
    measured, params = host.records("input", 2), host.records("params", 2)
    measured["q1"], measured["q2"] = -np.pi / 2 - np.arctan2(weight[1], weight[0]), q2
    for name in params.dtype.names:
        params[name] = values[name]
    params["kD"] = np.array([1 + 1e-4, 1 - 1e-4]) * found.most
    output, status = host.records("swing_up_output", 2), np.zeros(2, np.int32)
    host.swing_up(params, measured, output, status)
    codes = host.folder.manifest.status
    assert output["denominator"][0] > 0.0 > output["denominator"][1]
    assert codes[status[0]] != "NEAR_SINGULAR"
    assert (codes[status[1]], output["tau"][1]) == ("NEAR_SINGULAR", 0.0)


def test_a_set_whose_law_is_singular_somewhere_is_refused_and_the_remedy_works(refused, params):
    path = params('extends = "rig"\n[swing_up]\nkD = "0.01 s^2"\n')
    says = ("swing-up law is singular", "mine.toml", "0.016884", "short of", 'kD to at least "')
    refused("generate", "pendubot", "--params", path, "-o", "out", says=says)
    raw = RawSet("mine", "", "", "mine.toml", {**SETS["rig"], "kD": 0.01})
    with pytest.raises(InputError) as caught:
        resolve_set(MODEL, raw)
    least = float(caught.value.remedy.split('"')[1].split()[0])
    assert 0.0169 <= least <= 0.017
    resolve_set(MODEL, replace(raw, values={**raw.values, "kD": least}))


def test_a_set_that_names_no_gains_has_those_of_the_source():
    for name in ("sim", "sim-designed"):
        values = SETS[name]
        assert (values["kP"], values["kD"], values["kE"]) == (66.35, 9.45, 1.0)


# --- The generated code ---------------------------------------------------------------------------


@pytest.mark.target
def test_the_generated_law_is_within_the_limit_in_every_language_with_the_targets_bits(
    derivation, folder, host
):
    subjects = [PythonUnderTest(folder), CompiledUnderTest(host, "c-host")]
    target = CompiledUnderTest(ppc750_model(folder), "c-ppc750")
    found = verify(
        derivation,
        MODEL,
        list(SETS.values()),
        subjects,
        target,
        3000,
        3000,
        functions=("swing_up",),
    )
    assert {r.language for r in found.functions} == {"python", "c-host", "c-ppc750"}
    assert found.worst_scaled_ulp <= LIMIT_ULP
    assert found.target_mismatches == 0
    assert 0.1 < found.branches["swing_up_saturated"] < 0.9
    assert 0.0 < found.branches["swing_up_near_singular"] < 0.9


def test_any_bits_give_a_finite_torque_within_its_limit(host):
    rng, count = np.random.default_rng(8), 100_000
    measured, params = host.records("input", count), host.records("params", count)
    for name in measured.dtype.names:
        measured[name] = rng.integers(0, 2**64, count, np.uint64, endpoint=False).view(float)
    for name in params.dtype.names:
        params[name] = np.where(
            rng.random(count) < 0.5,
            rng.integers(0, 2**64, count, np.uint64).view(float),
            SETS["rig"][name],
        )
    inside = rng.random(count) < 0.7  # else hardly any measurement is one
    for name in measured.dtype.names:
        measured[name] = np.where(inside, rng.normal(0, 5, count), measured[name])
    output, status = host.records("swing_up_output", count), np.zeros(count, np.int32)
    host.swing_up(params, measured, output, status)
    codes = host.folder.manifest.status
    for name in output.dtype.names:
        assert np.isfinite(output[name]).all()
    idle = np.isin(status, [codes.index(c) for c in ("BAD_INPUT", "BAD_PARAMETER", "NUMERIC")])
    assert (output["tau"][idle] == 0.0).all()
    assert (np.abs(output["tau"][~idle]) <= params["torque_limit"][~idle]).all()
    # A status that stays away would make the claim empty; two are of what has a memory or an init.
    assert {codes[k] for k in np.unique(status)} == {*codes} - {"NOT_READY", "BAD_ARITHMETIC"}


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e5])
@pytest.mark.parametrize("name", ["q1", "q2", "dq1", "dq2"])
def test_no_measurement_no_torque(host, folder, name, bad):
    measured, params = host.records("input"), host.records("params")
    for n in params.dtype.names:
        params[n] = SETS["rig"][n]
    measured[name] = bad
    output, status = host.records("swing_up_output"), np.zeros(1, np.int32)
    host.swing_up(params, measured, output, status)
    assert folder.manifest.status[status[0]] == "BAD_INPUT"
    assert all(output[n][0] == 0.0 for n in output.dtype.names)


def test_the_numpy_module_and_the_compiled_call_give_the_same(folder, host):
    module, rng = folder.python_module(), np.random.default_rng(4)
    compiled = CompiledModel(module, host)
    measured = module.Input(*rng.normal(0, 4, (4, 500)))
    plain, codes = module.swing_up(module.RIG, measured)
    fast, statuses = compiled.swing_up(module.RIG, measured)
    assert (codes == statuses).all()
    for name in ("tau", "energy_error", "denominator"):
        np.testing.assert_allclose(getattr(fast, name), getattr(plain, name), rtol=1e-9, atol=1e-12)


def test_a_model_without_the_law_has_none_of_its_files():
    source = find_model("two_wheeled")
    model = lowered_model(source)
    files = dict(generate(Emission(model, library_sets(model, source))).files)
    assert not any("swing_up" in path for path in files)
    assert "PF_HAS_SWING_UP" not in files["c/pf_model.h"]
    assert "swing_up" not in files["two_wheeled.py"]


# --- Flight ---------------------------------------------------------------------------------------


def fly(host, values, start, period, steps):
    """Return q, q', tau and E~ of each period, shape (steps, 2n + 2), of one held-torque flight."""
    params, plant = host.records("params"), host.records("plant_params")
    for records in (params, plant):
        for n in records.dtype.names:
            records[n] = values[n]
    state, measured = host.records("plant_state"), host.records("input")
    for n, v in start.items():
        state[n] = v
    output, status = host.records("swing_up_output"), np.zeros(1, np.int32)
    applied, step = host.records("plant_input"), host.reals([period / 4])
    rows, actuator = [], host.folder.manifest.actuators[0]
    for _ in range(steps):
        for n in state.dtype.names:
            measured[n] = state[n]
        host.swing_up(params, measured, output, status)
        applied[actuator] = output[actuator]
        rows.append([*state[0], output[actuator][0], output["energy_error"][0]])
        host.plant_step(state, plant, applied, step, 4)
    return np.array(rows)


@pytest.mark.parametrize(
    ("name", "angle", "kick"), [("furuta", "alpha", 0.05), ("cart_pole", "theta", 0.05)]
)
def test_the_other_plants_swing_up_after_a_push(name, angle, kick, tmp_path):
    """The pendulum comes within .26 rad of the upright, a tenth of the energy it lacked off."""
    source = find_model(name)
    model = lowered_model(source)
    sets = library_sets(model, source)
    write_generation(generate(Emission(model, sets)), tmp_path / name)
    host = host_model(open_generated(str(tmp_path / name)))
    values = sets[0].as_dict()
    steps = round(15.0 / values["sample_time"])
    rows = fly(host, values, {angle: math.pi - kick}, values["sample_time"], steps)
    error = np.abs(rows[:, -1]) / abs(rows[0, -1])
    away = np.abs(np.remainder(rows[:, 1] + np.pi, 2 * np.pi) - np.pi)
    assert np.abs(rows[:, -2]).max() <= values["torque_limit"]
    assert ((away < 0.26) & (error < 0.1) & (np.abs(rows[:, 0]) < 1.0)).any()


def test_the_lyapunov_function_falls_as_promised_along_a_flight(host):
    """Held for 20 us the law is nearly continuous: V_L never rises, and falls by kV q1'^2."""
    period, hanging = 2e-5, {"q1": -math.pi / 2}
    v = {**SETS["rig"], "torque_limit": 1e3}
    rows = fly(host, v, hanging, period, 50_000)
    q1, _, dq1, _, _, error = rows.T
    parts = v["kE"] * error**2, v["kD"] * dq1**2, v["kP"] * (q1 - v["q1d"]) ** 2
    lyapunov = 0.5 * sum(parts)
    assert np.diff(lyapunov).max() < 1e-6 * lyapunov[0]
    promised = lyapunov[0] - np.cumsum(v["kV"] * dq1**2) * period
    assert np.abs(lyapunov[1:] - promised[:-1]).max() < 2e-3 * lyapunov[0]


def test_the_rig_swings_up_at_a_kilohertz_within_its_limit(host):
    """From hanging, kV = 2: E~ comes near 0, and the links near the upright with little E~."""
    v = SETS["rig"]
    rows = fly(host, v, {"q1": -math.pi / 2}, 1e-3, 15_000)
    q1, q2, _, _, tau, error = rows.T
    assert v["torque_limit"] == 2.0
    assert np.abs(tau).max() <= 2.0
    assert error[0] == pytest.approx(-2 * (v["theta4"] + v["theta5"]) * v["g"], rel=1e-12)
    assert np.abs(error).min() < 0.01
    turned = np.abs(np.remainder(q2 + np.pi, 2 * np.pi) - np.pi)
    in_box = (np.abs(q1 - v["q1d"]) <= 0.26) & (turned <= 0.26)
    assert in_box.any()
    assert (in_box & (np.abs(error) < 0.5)).any()
