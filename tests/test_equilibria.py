"""Set-points are solved for: rounded, left out, and refused where no equilibrium is near."""

from __future__ import annotations

import math

import mpmath
import pytest
from pfaffian.derive.pipeline import library_sets, lowered_model, parameter_set
from pfaffian.derive.sets.raw_set import read_set
from pfaffian.derive.spec.library import find_model, library_models

FLEXIBLE = """\
import sympy as sp
from pfaffian.derive.authoring import ModelBuilder


def model():
    m = ModelBuilder("flex", title="Arm with an elastic joint", source="made up here")
    q, dq = m.coordinate("q", "rad", "link from straight down", bound=1000, rate_bound=1000)
    th, dth = m.coordinate("th", "rad", "motor", bound=1000, rate_bound=1000)
    il = m.parameter("link_inertia", "kg*m^2", "about the joint")
    im = m.parameter("motor_inertia", "kg*m^2", "rotor times N^2")
    k = m.parameter("k", "N*m/rad", "spring")
    w = m.parameter("w", "N*m", "weight times lever")
    m.actuator("tau", "N*m", "motor", on={"th": 1})
    return m.build(
        kinetic_energy=il * dq**2 / 2 + im * dth**2 / 2,
        potential_energy=-w * sp.cos(q) + k * (th - q) ** 2 / 2,
    )
"""
SET = """\
title = "flex"
source = "made up here"
[parameters]
link_inertia = "0.3 kg*m^2"
motor_inertia = "0.05 kg*m^2"
k = "100 N*m/rad"
w = "4.905 N*m"
[gains]
zero_dynamics_poles = [-8, -8, -8]
{point}
sigma = "5 1/s"
eta = "0.001 1/s^2"
kappa = "20 kg^2*m^4/s"
epsilon = "1 1/s^3"
k1 = "0.1 kg^2*m^4/s^2"
k2 = "2 1/s"
bound_initial = "0.1 N*m"
[target]
sample_time = "1 ms"
torque_limit = "50 N*m"
singular_threshold = "0.01 1/(kg*m^2)"
"""
ARM = """\
import sympy as sp
from pfaffian.derive.authoring import ModelBuilder
from pfaffian.derive.spec import TIME


def model():
    m = ModelBuilder("hand", title="Two prismatic axes at an angle", source="made up here")
    x, dx = m.coordinate("x", "m", "first", bound=100, rate_bound=100)
    a, da = m.coordinate("a", "rad", "second", bound=100, rate_bound=100)
    j = m.parameter("link_inertia", "kg*m^2", "of the arm")
    mass = m.parameter("motor_inertia", "kg", "of the cart")
    l = m.parameter("k", "m", "length")
    swing = m.parameter("w", "m", "half stroke")
    pace = m.parameter("pace", "rad/s", "frequency")
    m.actuator("f", "N", "first", on={"x": 1})
    m.actuator("tau", "N*m", "second", on={"a": 1})
    rate = m.gain("approach", "1/s", "to the line")
    m.holonomic("across", "m", l * sp.sin(a) - l / 3, rate)
    m.holonomic("along", "m", x + l * sp.cos(a) - 2 * l - swing * sp.sin(pace * TIME), rate)
    return m.build(
        kinetic_energy=(mass * dx**2 + j * da**2) / 2, potential_energy=sp.S.Zero
    )
"""
ARM_SET = """\
title = "hand"
source = "made up here"
[parameters]
link_inertia = "0.3 kg*m^2"
motor_inertia = "2 kg"
k = "0.5 m"
w = "0.1 m"
pace = "3 rad/s"
[gains]
approach = "5 1/s"
{point}
sigma = "5 1/s"
eta = "0.001 m/s^2"
kappa = "20 kg^2/s"
epsilon = "1 m^2/s^3"
k1 = "0.1 kg^2/s^2"
k2 = "2 1/s"
bound_initial = "0.1 N"
[target]
sample_time = "1 ms"
f_limit = "100 N"
tau_limit = "50 N*m"
singular_threshold = "0.01 1/(kg^2*m)"
"""


@pytest.fixture
def solved(workspace):
    """Return a function that gives values and notes of a set with these set-points."""

    def read(point: str, spec: str = FLEXIBLE, text: str = SET):
        folder = workspace / "plant"
        folder.mkdir(exist_ok=True)
        (folder / "spec.py").write_text(spec, encoding="utf-8")
        path = folder / "lab.toml"
        path.write_text(text.format(point=point), encoding="utf-8")
        source = find_model("./plant")
        found = parameter_set(lowered_model(source), source, path)
        return found.as_dict(), found.notes

    return read


def motor_angle(q: float) -> float:
    """Return the angle of the motor that holds the link at `q`, in closed form at 30 digits."""
    with mpmath.workdps(30):
        return float(mpmath.mpf(q) + mpmath.mpf("4.905") * mpmath.sin(mpmath.mpf(q)) / 100)


def test_the_motor_angle_of_an_elastic_joint_may_be_left_out(solved):
    values, notes = solved('qd = "45 deg"')
    assert values["qd"] == math.radians(45.0)
    assert values["thd"] == pytest.approx(motor_angle(math.radians(45.0)), rel=4e-16)
    (note,) = notes
    assert "thd = 0.82008175" in note
    assert "solved for as it was left out" in note


@pytest.mark.parametrize("written", ["0.8 rad", "0.82 rad", "0.820081751015 rad"])
def test_a_rounded_angle_is_completed_and_the_other_stays(written, solved):
    values, notes = solved(f'qd = "45 deg"\nthd = "{written}"')
    assert values["qd"] == math.radians(45.0)
    assert values["thd"] == pytest.approx(motor_angle(math.radians(45.0)), rel=4e-16)
    assert "was rounded from" in notes[0]


def test_the_link_follows_from_the_motor_too(solved):
    values, _ = solved('thd = "0.82008175101464840 rad"')
    assert motor_angle(values["qd"]) == pytest.approx(values["thd"], rel=4e-16)
    assert values["qd"] == pytest.approx(math.radians(45.0), rel=1e-15)


def test_an_exact_equilibrium_is_left_bit_for_bit(solved):
    exact = motor_angle(math.radians(45.0))
    values, _ = solved(f'qd = "45 deg"\nthd = "{exact!r} rad"')
    assert abs(values["thd"] - exact) <= math.ulp(exact)
    values, notes = solved("")
    assert (values["qd"], values["thd"], notes) == (0.0, 0.0, ())


def test_a_set_point_far_from_equilibrium_is_refused_with_force_coordinate_and_the_nearest(
    workspace, refused
):
    folder = workspace / "plant"
    folder.mkdir()
    (folder / "spec.py").write_text(FLEXIBLE, encoding="utf-8")
    (folder / "lab.toml").write_text(SET.format(point='qd = "45 deg"\nthd = "0.9 rad"'))
    force = 4.905 * math.sin(math.pi / 4) - 100.0 * (0.9 - math.pi / 4)
    says = (
        f"lab.toml: the setpoint is not an equilibrium: gravity leaves {force:.3g} N*m on q",
        'the nearest is qd = "0.8',
        "what is left out is solved for",
    )
    refused("generate", "./plant", "-o", "out", says=says)


def test_an_angle_that_rounds_to_another_than_the_equilibrium_is_not_bent(workspace, refused):
    folder = workspace / "plant"
    folder.mkdir()
    (folder / "spec.py").write_text(FLEXIBLE, encoding="utf-8")
    (folder / "lab.toml").write_text(SET.format(point='qd = "1 deg"\nthd = "0 rad"'))
    refused("generate", "./plant", "-o", "out", says=("the setpoint is not an equilibrium",))


def test_on_a_moving_line_what_is_left_out_is_sought_where_the_line_begins(solved):
    values, _ = solved("", ARM, ARM_SET)
    assert values["ad"] == pytest.approx(math.asin(1.0 / 3.0), rel=1e-15)
    assert values["xd"] == pytest.approx(1.0 - 0.5 * math.cos(math.asin(1.0 / 3.0)), rel=1e-15)
    values, _ = solved('ad = "0.34 rad"\nxd = "0.7 m"', ARM, ARM_SET)
    assert values["ad"] == pytest.approx(math.asin(1.0 / 3.0), rel=1e-15)
    assert values["xd"] == 0.7


def test_of_several_equilibria_the_nearest_to_what_is_given_is_taken(solved, workspace):
    up = solved('qd = "3.1416 rad"\nthd = "3.1416 rad"')[0]
    assert up["qd"] == pytest.approx(math.pi, abs=5e-5)
    assert up["thd"] == pytest.approx(motor_angle(up["qd"]), rel=4e-16)
    second = solved('qd = "-6.28 rad"')[0]
    assert second["thd"] == pytest.approx(motor_angle(-6.28), rel=4e-16)


@pytest.mark.parametrize("name", library_models())
def test_no_set_point_of_the_library_is_moved(name):
    folder = find_model(name)
    model = lowered_model(folder)
    for found in library_sets(model, folder):
        assert found.notes == ()
        raw = read_set(folder.set_path(found.name), model.parameters, folder.sets())
        given = {n: v for n, v in raw.values.items() if n in found.as_dict()}
        assert given == {n: found.as_dict()[n] for n in given}
