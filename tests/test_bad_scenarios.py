"""Scenarios that cannot fly: refused with what, where and what to do, before anything is built."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code import generated_model
from pfaffian.runtime.flight.scenario import read_scenario
from pfaffian.runtime.flight.scenario_files import scenario_paths

TEXT = scenario_paths()["section-5.1-paper"].read_text(encoding="utf-8")
#: Where ADB of this set vanishes, (lam - 1) theta2 = theta3 cos q2; by hand, for lam = 2.25.
SINGULAR_Q2 = math.acos(1.25 * 0.004772 / 0.00876)

#: The passage replaced, by what, and what the message must say.
REFUSED = {
    "a syntax error": ("[initial]", "[initial", "is not valid TOML", "line ", "mend the line"),
    "a misspelt key": ("duration =", "duraton =", "unknown key duraton", "mean duration?"),
    "an unknown table": ("[plant]", "[plan]", "unknown key plan", "did you mean plant?"),
    "no duration": ('duration = "10 s"\n', "", "missing duration", "add duration"),
    "no set": ('set = "sim"\n', "", "missing set", "add set"),
    "a list of starts": ("[initial]", "[[initial]]", "initial must be a table", "[initial]"),
    "a number for the set": ('set = "sim"', "set = 1", "set must be a string", 'set = "..."'),
    "an unknown model": (
        'model = "pendubot"',
        'model = "triple_pendulum"',
        "no generated model triple_pendulum",
        "known: acrobot, cart_pole",
    ),
    "an unknown set": ('set = "sim"', 'set = "sam"', "has no parameter set sam", "mean sim?"),
    "a duration in metres": (
        'duration = "10 s"',
        'duration = "10 m"',
        "duration: m has dimension [length], but s ([time]) is needed",
        'for instance "1.0 s"',
    ),
    "a bare duration": ('duration = "10 s"', "duration = 10", "duration: 10 has no unit", "1.0 s"),
    "an endless flight": (
        'duration = "10 s"',
        'duration = "1 year"',
        "duration: 3.15576e+07 s are 3.16e+10 periods of 0.001 s",
        "choose 1 to 10000000 periods",
    ),
    "a flight beyond floats": (
        'duration = "10 s"',
        'duration = "1e308 s"',
        "duration: 1e+308 s are inf periods",
        "choose 1 to 10000000 periods",
    ),
    "no flight at all": ('duration = "10 s"', 'duration = "0 s"', "are 0 periods", "choose 1 to"),
    "a flight into the past": ('duration = "10 s"', 'duration = "-1 s"', "-1 s are", "choose 1"),
    "no substeps": ("substeps = 10", "substeps = 0", "plant_substeps = 0 is no", "1 to 10000"),
    "half a substep": ("substeps = 10", "substeps = 0.5", "substeps = 0.5 is no", "1 to 10000"),
    "a start in metres": (
        'q1 = "1 rad"',
        'q1 = "1 m"',
        "initial.q1: m has dimension [length]",
        'for instance "1.0 rad"',
    ),
    "a joint too many": ('q2 = "0.5 rad"', 'q3 = "0 rad"', "unknown key initial.q3", "known: q1"),
    "a start beyond the domain": (
        'q1 = "1 rad"',
        'q1 = "1e5 rad"',
        "initial.q1 = 100000 is beyond the controller's domain of 10000",
        "start within the domain",
    ),
    "a spin beyond the domain": (
        'dq1 = "1 rad/s"',
        'dq1 = "10000 rpm"',
        "initial.dq1 = 1047.2 is beyond the controller's domain of 1000",
        "start within the domain",
    ),
    "a start inside the singular set": (
        'q2 = "0.5 rad"',
        f'q2 = "{SINGULAR_Q2} rad"',
        "the start lies in the singular set: ADB = ",
        "at q1 = 1, q2 = 0.8218, ADB = -69.95 at the setpoint",
        "start nearer to the setpoint",
    ),
    "a start on the other side of it": (
        'q2 = "0.5 rad"',
        'q2 = "1.2 rad"',
        "the start lies in the singular set: ADB = ",
        "start nearer to the setpoint",
    ),
    "a start a full turn away": (
        'q2 = "0.5 rad"',
        'q2 = "360 deg"',
        "the singular set lies between the start and the setpoint: ADB = ",
        "start nearer to the setpoint",
    ),
    "a negative gain": (
        'k1 = "0 N^2*m^2*s^2"',
        'kappa = "-2 N*m*kg*m^2*s"',
        "controller.kappa = -2 is out of its bounds",
        "pfaffian generate pendubot",
    ),
    "a period of zero": (
        'k1 = "0 N^2*m^2*s^2"',
        'sample_time = "0 s"',
        "controller.sample_time = 0 is out of its bounds",
        "pfaffian generate pendubot",
    ),
    "a disturbance on the controller": (
        'k1 = "0 N^2*m^2*s^2"',
        'joint1_load = "2 N*m"',
        "unknown key controller.joint1_load",
        "known: theta1",
    ),
    "a load in kilograms": (
        'joint1_load = "2 N*m"',
        'joint1_load = "2 kg"',
        "plant.joint1_load: kg has dimension [mass]",
        'for instance "1.0 N*m"',
    ),
    "a plant of negative inertia": (
        'joint1_load = "2 N*m"',
        'theta1 = "-1 kg*m^2"',
        "plant.theta1 = -1 is out of its bounds",
        "pfaffian generate pendubot",
    ),
    "a plant that is no mechanism": (
        'joint1_load = "2 N*m"',
        'theta3 = "0.0109 kg*m^2"',
        "plant: the mass matrix is not positive definite (least eigenvalue -",
        "check the inertias",
    ),
}


@pytest.fixture
def scenario(workspace: Path) -> Callable[[str, str], Path]:
    """Return a function that writes the paper's scenario with one passage replaced."""

    def write(right: str, wrong: str) -> Path:
        assert TEXT.count(right) == 1
        path = workspace / "flight.toml"
        path.write_text(TEXT.replace(right, wrong), encoding="utf-8")
        return path

    return write


def _too_early(*_: object) -> bytes:
    raise AssertionError("built before the scenario was judged")


@pytest.mark.parametrize("what", REFUSED)
def test_a_scenario_is_refused_before_anything_is_built(
    what, scenario, refused, monkeypatch: pytest.MonkeyPatch
):
    right, wrong, *says = REFUSED[what]
    scenario(right, wrong)
    monkeypatch.setattr(generated_model, "compile_image", _too_early)
    refused("simulate", "flight.toml", says=tuple(says))
    refused("pil", "flight.toml", says=tuple(says))


def test_a_message_about_a_scenario_names_its_file(scenario, refused):
    scenario('q1 = "1 rad"', 'q1 = "1 m"')
    refused("simulate", "flight.toml", says=("flight.toml: initial.q1: ",))


def test_the_edge_of_the_singular_set_is_where_the_theory_puts_it(scenario):
    """By hand: |ADB| falls below the threshold of this set, 0.5, 6.3 mrad before it vanishes."""
    det = 0.024454 * 0.004772 - (0.00876 * math.cos(SINGULAR_Q2)) ** 2
    width = 0.5 * det / (0.00876 * math.sin(SINGULAR_Q2))
    assert width == pytest.approx(0.0063, abs=1e-4)
    near = scenario('q2 = "0.5 rad"', f'q2 = "{SINGULAR_Q2 - 1.05 * width!r} rad"')
    assert read_scenario(str(near)).initial["q2"] == SINGULAR_Q2 - 1.05 * width
    inside = scenario('q2 = "0.5 rad"', f'q2 = "{SINGULAR_Q2 - 0.95 * width!r} rad"')
    with pytest.raises(InputError, match="the start lies in the singular set"):
        read_scenario(str(inside))


def test_a_scenario_takes_other_units(scenario):
    path = scenario('dq1 = "1 rad/s"', 'dq1 = "30 rpm"')
    assert read_scenario(str(path)).initial["dq1"] == pytest.approx(math.pi, rel=1e-15)
    path = scenario('duration = "10 s"', 'duration = "0.5 min"')
    assert read_scenario(str(path)).steps == 30_000


def test_a_generated_folder_without_the_scenarios_set_is_named(workspace, run, refused):
    assert run("generate", "pendubot", "--set", "rig", "-o", "made").code == 0
    says = ("made: the generated pendubot has no parameter set sim", "known: rig")
    refused("simulate", "section-5.1-paper", "--generated", "made", says=says)
