"""What `import pfaffian` gives: every cell of a notebook, against sources of its own.

The linearisation is compared with differences of the generated acceleration, the controller with
the generated C, a flight with what the command line prints, the nominal law with the generated one.
"""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys

import numpy as np
import pfaffian as pf
import pytest
from pfaffian.derive.spec.library import library_models
from pfaffian.runtime.code.generated_model import fill_records, host_model, open_generated
from scipy.integrate import solve_ivp
from support_plants import written_plant

NAMES = tuple(library_models())
DESIGNED = "section-5.1-designed"


@pytest.fixture(scope="module")
def pendubot():
    return pf.load("pendubot")


@pytest.fixture(scope="module")
def designed(pendubot):
    return pendubot.parameters("sim-designed")


def test_the_package_names_its_version_and_nothing_else_is_imported():
    code = (
        "import sys, pfaffian\n"
        "assert set(dir(pfaffian)) >= {'load', 'models', '__version__'}\n"
        "loaded = {n.partition('.')[0] for n in sys.modules}\n"
        "assert not loaded & {'sympy', 'casadi', 'numpy', 'scipy', 'typer'}, loaded\n"
        "assert not [n for n in sys.modules if n.startswith('pfaffian.')]\n"
        "pfaffian.models(), pfaffian.load('tora')\n"
        "assert not {'sympy', 'casadi', 'numpy', 'scipy'} & set(sys.modules)\n"
        "print(pfaffian.__version__)\n"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    from importlib.metadata import version

    assert said.stdout.strip() == version("pfaffian")
    with pytest.raises(AttributeError, match="no attribute 'lod'"):
        _ = pf.lod


def test_models_are_those_that_the_command_lists(run):
    listed = run("models", "--json").document()
    table = pf.models()
    assert [row.name for row in table] == listed["models"]
    assert {(r.name, s) for r in table for s in r.sets} == {
        (s["model"], s["set"]) for s in listed["sets"]
    }
    flown = {(s["model"], s["scenario"]) for s in listed["scenarios"]}
    assert {(r.name, s) for r in table for s in r.scenarios} == flown
    assert repr(table).splitlines()[0].split() == ["model", "sets", "scenarios"]
    assert table._repr_html_().count("<tr>") == 1 + len(NAMES)


def test_a_derivation_is_in_sympy_and_shows_itself(pendubot):
    import sympy as sp

    found = pendubot.derive()
    q2 = sp.Symbol("q2", real=True)
    theta1, theta2, theta3 = (s for s in sorted(found.M.free_symbols - {q2}, key=str))
    assert (
        sp.Matrix(
            [
                [theta1 + theta2 + 2 * theta3 * sp.cos(q2), theta2 + theta3 * sp.cos(q2)],
                [theta2 + theta3 * sp.cos(q2), theta2],
            ]
        )
        == found.M
    )
    assert sp.simplify(found.ADB - (found.A * found.M.inv() * found.B)[0]) == 0
    assert sp.Matrix([1, 0]) == found.B
    assert not found.unproved
    assert repr(found) == "<equations of pendubot: M 2x2, B 2x1, 8 of 8 identities proved>"
    latex = found._repr_latex_()
    assert latex.startswith("$\\displaystyle")
    assert "\\theta_1" in latex
    assert "\\dot{q}" in latex
    assert pendubot._repr_latex_() == latex
    with pytest.raises(AttributeError):
        found.M = None


@pytest.mark.parametrize("name", ["pendubot", "cart_pole", "pvtol"])
def test_the_nominal_torque_is_that_of_the_generated_law(name):
    import sympy as sp

    model = pf.load(name)
    p = model.parameters()
    found = model.derive()
    torque = found.p1
    symbols = sorted(torque.free_symbols, key=str)
    rng = np.random.default_rng(7)
    states = model.linearisation().states
    channels = dict(zip(states, rng.normal(0.0, 0.3, len(states)), strict=True))
    values = {**p, **channels}
    wanted = sp.lambdify(symbols, list(torque))(*(values[s.name] for s in symbols))
    code = open_generated(name)
    module = code.python_module()
    params = module.Params(**{n: p[n] for n in code.manifest.structures["params"].names()})
    state = module.ContinuousState(
        **dict.fromkeys(code.manifest.structures["continuous_state"].names(), 0.0)
    )
    out = module.continuous(state, params, module.Input(**channels))
    actuators = code.manifest.actuators
    parts = ["p1"] if len(actuators) == 1 else [f"p1_{a}" for a in actuators]
    given = [getattr(out, n) for n in parts]
    np.testing.assert_allclose(given, wanted, rtol=1e-9)


def test_parameters_are_completed_as_a_file_that_extends_the_set(pendubot, designed, tmp_path):
    from pfaffian.derive.pipeline import lowered_model, parameter_set

    file = tmp_path / "heavy.toml"
    file.write_text('extends = "sim-designed"\n[parameters]\nm2 = "800 g"\n')
    folder = library_models()["pendubot"]
    wanted = parameter_set(lowered_model(folder), folder, file).as_dict()
    for given in (pendubot.parameters("sim-designed", m2="0.8 kg"), pendubot.parameters(file)):
        assert dict(given) == wanted
    changed = pendubot.parameters("sim-designed", m2="0.8 kg")
    assert changed["theta2"] > designed["theta2"]
    assert changed.units["m2"] == "kg"
    assert repr(changed) == "<parameters sim-designed-changed of pendubot: 49 values>"
    assert "<td>0.8</td><td>kg</td>" in changed._repr_html_()
    poles = pendubot.parameters("sim", zero_dynamics_poles=[-5, "-4+2j", "-4-2j"])
    assert poles["lam1"] == pytest.approx(
        pendubot.design("sim", poles=[-5, -4 + 2j, -4 - 2j]).gains["lam1"]
    )


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"m2": 0.8}, "m2: 0.8 has no unit"),
        ({"m2": "0.8 s"}, "m2"),
        ({"m2": "-1 kg"}, "m2 = -1 kg is out of bounds"),
        ({"mm2": "1 kg"}, "unknown parameter mm2"),
        ({"lam": 1.01}, "zero dynamics are unstable"),
        ({"zero_dynamics_poles": [1.0, -2.0, -3.0]}, "is not a stable pole"),
    ],
)
def test_changes_that_a_file_would_be_refused_for_are_refused(pendubot, changes, says):
    with pytest.raises(pf.InputError, match="sim-changed") as error:
        pendubot.parameters("sim", **changes)
    assert says in error.value.message
    assert error.value.remedy


@pytest.mark.parametrize("name", NAMES)
def test_the_linearisation_is_that_of_the_generated_acceleration(name):
    model = pf.load(name)
    p = model.parameters()
    system = model.linearisation(p)
    code = open_generated(name)
    module = code.python_module()
    structures = code.manifest.structures
    plant = module.PlantParams(**{n: p.get(n, 0.0) for n in structures["plant_params"].names()})
    rest = module.setpoint(module.Params(**{n: p[n] for n in structures["params"].names()}))
    x0 = np.array([float(rest.get(s, 0.0)) for s in system.states])
    n, m = len(x0) // 2, len(system.inputs)

    def rates(x, u):
        state = module.PlantState(**dict(zip(system.states, x, strict=True)))
        given = module.acceleration(plant, state, module.PlantInput(*u))
        return np.array([float(getattr(given, f"dd{s}")) for s in system.states[:n]])

    unit = np.array([rates(x0, u) - rates(x0, np.zeros(m)) for u in np.eye(m)]).T
    held = np.linalg.lstsq(unit, -rates(x0, np.zeros(m)), rcond=None)[0]
    step = 1e-6
    slopes = np.array(
        [
            (rates(x0 + step * e, held) - rates(x0 - step * e, held)) / (2 * step)
            for e in np.eye(2 * n)
        ]
    ).T
    scale = max(1.0, np.abs(slopes).max())
    np.testing.assert_allclose(system.A[n:], slopes, atol=2e-7 * scale)
    np.testing.assert_array_equal(system.A[:n], np.eye(2 * n)[n:])
    np.testing.assert_allclose(system.B[n:], unit, rtol=1e-9, atol=1e-12)
    assert not system.B[:n].any()


def test_linearise_returns_a_state_space_of_python_control(pendubot, designed):
    control = pytest.importorskip("control", reason="needs the extra notebook")
    system, plain = pendubot.linearise(designed), pendubot.linearisation(designed)
    assert isinstance(system, control.StateSpace)
    np.testing.assert_array_equal(system.A, plain.A)
    assert tuple(system.state_labels) == plain.states == ("q1", "q2", "dq1", "dq2")
    assert tuple(system.input_labels) == ("tau",)
    assert max(control.poles(system).real) > 0  # upright, it falls


@pytest.mark.parametrize(("package", "call"), [("control", "linearise"), ("pandas", "to_pandas")])
def test_a_package_that_is_not_installed_is_named_with_how_to_get_it(
    pendubot, designed, monkeypatch, package, call
):
    flown = pendubot.simulate(DESIGNED, duration="10 ms")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(pf.MissingToolError, match="is not installed") as error:
        flown.to_pandas() if call == "to_pandas" else pendubot.linearise(designed)
    assert f"pip install {package}" in error.value.remedy


@pytest.mark.parametrize("name", NAMES)
def test_a_controller_has_the_bits_of_the_generated_c(name):
    model = pf.load(name)
    p = model.parameters()
    controller = model.controller(p)
    assert controller.compiled
    code = open_generated(name)
    host = host_model(code)
    params = fill_records(host.records("params"), dict(p))
    state, measured, output = (host.records(r) for r in ("state", "input", "output"))
    status = np.zeros(1, np.int32)
    host.init(state, params, status)
    rng = np.random.default_rng(3)
    batch, given = model.batch(p), []
    goal = model.closed_loop(p).setpoint
    for _ in range(20):
        near = {n: goal.get(n, 0.0) + rng.normal(0.0, 0.1) for n in measured.dtype.names}
        fill_records(measured, near)
        host.step(state, params, measured, output, status)
        torque = controller.step(**near)
        wanted = [float(output[a][0]) for a in code.manifest.actuators]
        assert np.atleast_1d(torque).tolist() == wanted
        assert controller.status == code.manifest.status[status[0]]
        given.append((list(near.values()), wanted))
    for row, wanted in given:
        many = batch.step(np.tile(row, (3, 1)))
        assert many.shape == (3, len(wanted))
        assert many.tolist() == [wanted] * 3


def test_a_batch_keeps_its_number_and_its_columns(pendubot, designed):
    batch = pendubot.batch(designed)
    many = batch.step(np.random.default_rng(0).normal(size=(1000, 4)))
    assert many.shape == (1000, 1)
    assert batch.status.shape == (1000,)
    with pytest.raises(pf.InputError, match="not \\(1000, 4\\)"):
        batch.step(np.zeros((10, 4)))
    batch.reset()
    with pytest.raises(pf.InputError, match="not \\(k, 4\\)") as error:
        batch.step(np.zeros((10, 3)))
    assert "q1, q2, dq1, dq2" in error.value.remedy
    with pytest.raises(pf.InputError, match="got q1"):
        pendubot.controller(designed).step(q1=1.0)


def test_a_flight_is_the_one_that_the_command_prints(pendubot, run):
    printed = run("simulate", DESIGNED, "--json").document()
    flown = pendubot.simulate(DESIGNED)
    assert flown.sha256 == printed["trajectory_sha256"]
    assert {k: printed[k] for k in flown.metrics} == dict(flown.metrics)
    assert len(flown) == printed["steps"] == flown.time.size
    assert dict(flown.status) == printed["status"]
    assert (flown.set_name, flown.mode) == (printed["set"], printed["mode"])
    other = run("simulate", DESIGNED, "--set", "sim", "--json").document()
    assert pendubot.simulate(DESIGNED, "sim").sha256 == other["trajectory_sha256"]


def test_a_flight_becomes_a_frame_a_file_and_a_figure(pendubot, tmp_path):
    flown = pendubot.simulate(DESIGNED, duration="50 ms")
    pd = pytest.importorskip("pandas", reason="needs the extra notebook")
    frame = flown.to_pandas()
    assert isinstance(frame, pd.DataFrame)
    assert frame.index.name == "time"
    np.testing.assert_array_equal(frame["q1"].to_numpy(), flown["q1"])
    path = flown.to_csv(tmp_path / "t.csv")
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert [float(r["tau"]) for r in rows] == flown["tau"].tolist()
    assert [float(r["time"]) for r in rows] == flown.time.tolist()
    above, below = flown.plot().axes
    lines = {line.get_label(): line for line in (*above.lines, *below.lines)}
    np.testing.assert_array_equal(lines["q1 [rad]"].get_ydata(), flown["q1"])
    np.testing.assert_array_equal(lines["tau [N*m]"].get_ydata(), flown["tau"])
    assert "iae_q1" in flown._repr_html_()
    assert repr(flown).startswith(f"<flight {DESIGNED}, set sim-designed: 50 periods")


def test_changes_of_a_flight_are_those_of_a_file(pendubot, tmp_path, run):
    flown = pendubot.simulate(
        DESIGNED, q1="50 deg", m2="0.1 kg", duration="0.2 s", plant={"theta4": "0.02 kg*m"}
    )
    (tmp_path / "heavy.toml").write_text('extends = "sim-designed"\n[parameters]\nm2 = "0.1 kg"\n')
    folder = tmp_path / "code"
    made = pendubot.generate(folder, tmp_path / "heavy.toml")
    assert made.sets == ("heavy",)
    scenario = tmp_path / "s.toml"
    text = (library_scenario(DESIGNED)).read_text()
    lines = [
        'duration = "0.2 s"'
        if x.startswith("duration")
        else 'q1 = "50 deg"'
        if x.startswith("q1")
        else x
        for x in text.splitlines()
        if not x.startswith("set ")
    ]
    scenario.write_text('set = "heavy"\n' + "\n".join(lines) + "\n")
    document = json.loads(run("simulate", scenario, "--generated", folder, "--json").out)
    same = pendubot.simulate(DESIGNED, q1="50 deg", m2="0.1 kg", duration="0.2 s")
    assert same.sha256 == document["trajectory_sha256"]
    assert flown.sha256 != same.sha256


def library_scenario(name):
    from pfaffian.runtime.flight.scenario_files import find_scenario

    return find_scenario(name)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda m: m.simulate("nowhere"), "unknown scenario nowhere"),
        (lambda m: m.simulate("tora-damping"), "flies tora, not pendubot"),
        (lambda m: m.simulate("rig-balance-twin"), "flies on the twin"),
        (lambda m: m.simulate(DESIGNED, q1="1 kg"), "initial.q1"),
        (lambda m: m.simulate(DESIGNED, q3="1 rad"), "unknown parameter q3"),
        (lambda m: m.simulate(DESIGNED, duration="0 s"), "duration"),
        (lambda m: m.simulate(DESIGNED, plant={"mass": "1 kg"}), "unknown key plant.mass"),
        (lambda m: m.parameters("simm"), "no parameter set simm"),
        (lambda m: m.controller(pf.load("tora").parameters()), "is not of model pendubot"),
        (lambda m: m.closed_loop().rhs(0.0, [1.0, 2.0]), "a state has shape"),
        (lambda m: m.design(poles=[-1, -2]), "poles=: 2 poles for zero dynamics of order 3"),
        (lambda m: m.design(poles=[-1, -2, -3], riccati=[1, 1, 1, 1]), "are both given"),
        (lambda m: m.generate("x", bake=True, precision="single"), "bake= comes in double"),
        (lambda m: m.plan(speed_limit="q9=1"), "speed_limit=: there is no q9"),
    ],
)
def test_bad_input_is_of_the_one_family_and_says_what_to_do(pendubot, workspace, call, says):
    with pytest.raises(pf.InputError) as error:
        call(pendubot)
    assert says in error.value.message
    assert error.value.remedy
    assert "--" not in str(error.value)
    assert isinstance(error.value, pf.PfaffianError)
    assert not list(workspace.iterdir())


def test_the_closed_loop_is_a_right_hand_side_for_a_solver(pendubot, designed):
    """Undisturbed, (q, q') moves as it does with the law's own states; s follows (6)."""
    loop = pendubot.closed_loop(designed)
    start = [1.0, 0.5, 0.0, 0.0]
    options = {"rtol": 1e-8, "atol": 1e-10, "t_eval": np.linspace(0.0, 1.0, 11)}
    short = solve_ivp(loop.rhs, (0.0, 1.0), start, "LSODA", **options)
    whole = solve_ivp(loop.rhs, (0.0, 1.0), loop.engage(start), "LSODA", **options)
    assert short.success
    assert whole.success
    assert loop.states[:4] == ("q1", "q2", "dq1", "dq2")
    np.testing.assert_allclose(short.y, whole.y[:4], atol=1e-6)
    arrived = solve_ivp(loop.rhs, (0, 10), start).y[:, -1]
    np.testing.assert_allclose(arrived, [np.pi / 2, 0.0, 0.0, 0.0], atol=1e-3)


def test_gains_for_poles_are_those_that_the_command_finds(pendubot, run):
    found = pendubot.design("sim", poles=[-6, "-4+2j", -4 - 2j], curve=False)
    printed = run("design", "pendubot", "--set", "sim", "--poles", "-6,-4+2j,-4-2j", "--json")
    assert dict(found.gains) == printed.document()["gains"]
    np.testing.assert_allclose(
        sorted(found.poles, key=str), sorted([-6, -4 + 2j, -4 - 2j], key=str), rtol=1e-9
    )
    assert found.stable
    assert not found.failure
    taken = pendubot.parameters("sim", **found.changed)
    assert {n: taken[n] for n in found.gains} == dict(found.gains)
    assert "lam1" in found._repr_html_()
    by_weights = pendubot.design("sim", riccati=[10, 10, 0.1, 0.1], delay="5 ms")
    assert by_weights.method == "riccati"
    assert "kappa" in by_weights.changed


def test_code_is_verified_and_built_as_the_commands_do(pendubot, run, tmp_path):
    words = ("--samples", "5", "--target-samples", "5", "--json")
    printed = run("verify", "pendubot", *words).document()
    found = pendubot.verify(samples=5, target_samples=5)
    assert found.passed
    assert found.document["worst_scaled_ulp"] == printed["worst_scaled_ulp"]
    assert found.worst_scaled_ulp <= 4.0
    assert (found.target_samples, found.target_mismatches) == (5, 0)
    assert "<td>step</td>" in found._repr_html_()
    built, shown = pendubot.build("ppc750"), run("build", "pendubot", "--json").document()
    assert built.document == shown
    assert built.save(tmp_path / "image.elf").read_bytes()[:4] == b"\x7fELF"
    with pytest.raises(pf.InputError, match="nowhere"):
        pendubot.build("nowhere")


def test_a_run_flies_changed_parameters_in_the_loop_and_reports(pendubot, workspace):
    scenario = workspace / "short.toml"
    text = library_scenario(DESIGNED).read_text()
    scenario.write_text(re.sub(r"(?m)^duration = .*$", 'duration = "0.2 s"', text))
    p = pendubot.parameters("sim-designed", m2="0.1 kg")
    report = pendubot.run(p, scenario=scenario, samples=5)
    assert report.passed
    assert not report.failure
    (flight,) = report.flights
    assert (flight["set"], flight["differing_bits"], flight["steps"]) == (p.name, 0, 200)
    here = pendubot.simulate(scenario, p)
    assert flight["trajectory_sha256"] == here.sha256
    assert report.verification.passed
    assert report.build["text_bytes"] > 0
    shown = report._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    assert "&lt;html" in shown
    page = report.save(workspace / "report.html")
    assert page.read_text() == report.html


def test_a_certificate_has_the_claims_that_the_command_prints(run):
    printed = run("certify", "tora", "--json").document()
    found = pf.load("tora").certify()
    assert not found.failure
    assert (found.scenario, found.set_name) == (printed["scenario"], printed["set"])
    assert [c.bound for c in found.claims] == [c["bound"] for c in printed["flight"]["claims"]]
    assert {n: list(side) for n, side in found.region.items()} == printed["region"]
    assert "largest seen" in found._repr_html_()


def test_a_plan_is_found_checked_kept_and_generated(workspace):
    model = pf.load("cart_pole")
    found = model.plan("barto", seeds=2, coarse=20, nodes=40)
    assert found.states.shape == (len(found.time), 4)
    np.testing.assert_allclose(found.states[-1], 0.0, atol=1e-9)  # upright, at rest
    assert abs(found.states[0, 1]) == pytest.approx(np.pi)
    assert found.save("swing.json").is_file()
    made = model.generate("code", "barto", plan="swing.json")
    assert open_generated("code").manifest.plans == made.sets == ("barto",)
    with pytest.raises(pf.CheckError, match="none of 1 starts led to a plan") as error:
        model.plan("barto", seeds=1, coarse=10, nodes=40, end_time="0.2 s")
    assert "more starts (seeds=)" in error.value.remedy


#: Of a plant that no part of this package knows.
SCENARIO = """title = "from the left"
model = "oblique"
set = "lab"
duration = "2 s"

[initial]
x = "-0.1 m"
"""


def test_a_plant_from_outside_does_it_all(workspace, run):
    folder = workspace / "oblique"
    written_plant(folder, "oblique")
    (folder / "scenarios").mkdir()
    (folder / "scenarios" / "left.toml").write_text(SCENARIO)
    model = pf.load(folder)
    assert (model.folder, model.sets, model.scenarios) == (folder, ("lab",), ("left",))
    p = model.parameters("lab", bob="250 g")
    controller = model.controller(p)
    assert controller.compiled
    states = model.linearisation(p).states
    assert states == ("x", "th", "dx", "dth")
    force = controller.step(x=-0.1, th=0.0, dx=0.0, dth=0.0)
    assert model.batch(p).step([[-0.1, 0.0, 0.0, 0.0]] * 2).tolist() == [[force]] * 2
    arrived = solve_ivp(model.closed_loop(p).rhs, (0.0, 6.0), [-0.1, 0.0, 0.0, 0.0]).y[:, -1]
    np.testing.assert_allclose(arrived, np.zeros(4), atol=1e-3)
    flown = model.simulate("left")
    assert not list(workspace.glob("generated*"))
    run("generate", "oblique")
    printed = run(
        "simulate", folder / "scenarios" / "left.toml", "--generated", "generated/oblique", "--json"
    )
    assert flown.sha256 == printed.document()["trajectory_sha256"]
    assert model.generate("again").changed
    assert not model.generate("again").changed
    assert model.design(poles=[-5, -5, -5]).stable
