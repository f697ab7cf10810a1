"""`pfaffian certify` as a command."""

import json

import pytest


@pytest.mark.parametrize(
    ("chosen", "flown"), [("sim", "section-5.1-paper"), ("sim-designed", "section-5.1-designed")]
)
def test_where_no_scenario_is_named_one_that_flies_the_set_is_taken(chosen, flown, run):
    done = run("certify", "pendubot", "--set", chosen, "--json")
    assert json.loads(done.out)["scenario"] == flown


SLIDE = """from pfaffian.derive.authoring import ModelBuilder


def model():
    m = ModelBuilder("slide", title="A slide", source="made up here")
    x, dx = m.coordinate("x", "m", "the slide", bound=2, rate_bound=10)
    mass = m.parameter("mass", "kg", "of the slide")
    m.actuator("push", "N", "on the slide", on={"x": 1})
    approach = m.gain("approach", "1/s", "how fast the slide gets there")
    m.first_order("s1", "m/s", dx + approach * (x - m.setpoint(x)))
    return m.build(kinetic_energy=mass * dx**2 / 2, potential_energy=0 * x)
"""
SET = """title = "twenty tons"
source = "made up here"
[parameters]
mass = "20 t"
[gains]
zero_dynamics_poles = [-5]
xd = "0 m"
sigma = "5 1/s"
eta = "0.001 m/s^2"
kappa = "2e9 kg^2/s"
epsilon = "1 m^2/s^3"
k1 = "0.1 kg^2/s^2"
k2 = "2 1/s"
bound_initial = "0.01 N"
[target]
sample_time = "1 ms"
torque_limit = "50 kN"
singular_threshold = "1e-6 1/kg"
"""
FLIGHT = """title = "ten centimetres"
model = "slide"
set = "lab"
duration = "1 s"
[initial]
x = "10 cm"
"""


def test_a_constant_input_gain_and_no_uncertainty_give_bounds_that_are_exact(workspace, run):
    folder = workspace / "slide"
    (folder / "scenarios").mkdir(parents=True)
    (folder / "spec.py").write_text(SLIDE, encoding="utf-8")
    (folder / "lab.toml").write_text(SET, encoding="utf-8")
    (folder / "scenarios" / "short.toml").write_text(FLIGHT, encoding="utf-8")
    done = run("certify", "./slide", "--json")
    assert done.code == 0, done.err
    document = done.document()
    assert document["assumption1"]["bound"] == pytest.approx(1 / 20000, rel=1e-12)
    assert document["assumption2"]["fhat"]["attained"] == 0.0
    assert document["assumption2"]["fhat"]["bound"] < 1e-300
    assert document["assumption2"]["fhat"]["boxes"] < 10


def test_a_plant_too_large_to_be_bounded_is_refused_by_name(run):
    outcome = run("certify", "chain")
    assert outcome.code == 2
    assert "model chain: no certificate for a plant of 3 coupled coordinates" in outcome.err
