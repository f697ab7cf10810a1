"""Zeros at the origin of coordinates that neither plant nor constraint sees are no instability."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pfaffian.derive.pipeline import derivation_of, lowered_model
from pfaffian.derive.spec.library import find_model

HEAD = """\
import sympy as sp
from pfaffian.derive.authoring import ModelBuilder


def model():
"""
#: A satellite with one reaction wheel: the wheel is cyclic, the momentum about the axis conserved.
SATELLITE = (
    HEAD
    + """\
    m = ModelBuilder("sat", title="Satellite with a reaction wheel", source="made up here")
    b, db = m.coordinate("body", "rad", "attitude", bound=1000, rate_bound=1000)
    w, dw = m.coordinate("wheel", "rad", "wheel against the body", bound=1e6, rate_bound=1e4)
    jb = m.parameter("body_inertia", "kg*m^2", "body without wheel")
    jw = m.parameter("wheel_inertia", "kg*m^2", "wheel")
    m.actuator("tau", "N*m", "wheel motor", on={"wheel": 1})
CONSTRAINT
    return m.build(
        kinetic_energy=(jb * db**2 + jw * (db + dw) ** 2) / 2,
        potential_energy=sp.S.Zero,
    )
"""
)
ATTITUDE = """\
    rate = m.gain("rate_b", "1/s", "attitude")
    m.holonomic("s", "rad", b - sp.Symbol("bodyd", real=True), rate)
"""
#: The same with the rate of the wheel in s, and with a second wheel on the same axis.
RATE_TOO = """\
    rate = m.gain("rate_b", "1/s", "attitude")
    m.first_order("s", "rad/s", db + rate * (b - sp.Symbol("bodyd", real=True)) - dw / 1000)
"""
TWO_WHEELS = SATELLITE.replace(
    "    jb = m",
    '    v, dv = m.coordinate("spare", "rad", "spare wheel", bound=1e6, rate_bound=1e4)\n'
    "    jb = m",
).replace("(db + dw) ** 2", "((db + dw) ** 2 + (db + dv) ** 2)")
#: A cart that holds its place below a bob on a spring: nothing damps the bob.
FREE_BOB = (
    HEAD
    + """\
    m = ModelBuilder("bob", title="Cart with a free oscillator on it", source="made up here")
    x, dx = m.coordinate("x", "m", "cart", bound=100, rate_bound=100)
    y, dy = m.coordinate("y", "m", "bob beside the cart", bound=100, rate_bound=100)
    a, b = m.parameter("body_inertia", "kg", "cart"), m.parameter("wheel_inertia", "kg", "bob")
    m.actuator("tau", "N", "force", on={"x": 1})
    rate = m.gain("rate_b", "1/s", "of the cart")
    m.holonomic("s", "m", x - sp.Symbol("xd", real=True), rate)
    return m.build(
        kinetic_energy=(a * dx**2 + b * (dx + dy) ** 2) / 2, potential_energy=7 * b * y**2 / 2 * K
    )
"""
)
#: Two carts joined by a spring, asked for their distance alone: the place of both is cyclic.
DISTANCE = (
    HEAD
    + """\
    m = ModelBuilder("pair", title="Two carts on a spring", source="made up here")
    x, dx = m.coordinate("x", "m", "first", bound=100, rate_bound=100)
    y, dy = m.coordinate("y", "m", "second", bound=100, rate_bound=100)
    a, b = m.parameter("body_inertia", "kg", "first"), m.parameter("wheel_inertia", "kg", "second")
    k = m.parameter("k", "N/m", "spring")
    m.actuator("tau", "N", "between them", on={"x": -1, "y": 1})
    rate = m.gain("rate_b", "1/s", "of the distance")
    m.holonomic("s", "m", y - x, rate)
    return m.build(
        kinetic_energy=(a * dx**2 + b * dy**2) / 2, potential_energy=k * (y - x) ** 2 / 2
    )
"""
)
SET = """\
title = "flown"
source = "made up here"
[parameters]
body_inertia = "10 kg*m^2"
wheel_inertia = "0.05 kg*m^2"
[gains]
rate_b = "1 1/s"
bodyd = "30 deg"
sigma = "1 1/s"
eta = "0.0001 1/s^2"
kappa = "100 kg^2*m^4/s"
epsilon = "1 1/s^3"
k1 = "0.1 kg^2*m^4/s^2"
k2 = "2 1/s"
bound_initial = "0.1 N*m"
[target]
sample_time = "100 ms"
torque_limit = "1 N*m"
singular_threshold = "0.001 1/(kg*m^2)"
"""
#: The same numbers for a plant that moves along a line.
LINE = (
    SET.replace("kg*m^2", "kg")
    .replace("kg^2*m^4", "kg^2")
    .replace("N*m", "N")
    .replace('bodyd = "30 deg"\n', "")
    .replace('"0.0001 1/s^2"', '"0.0001 m/s^2"')
    .replace('"1 1/s^3"', '"1 m^2/s^3"')
)


@pytest.fixture
def plant(workspace):
    """Return a function that writes a plant of one set, `lab`, into the folder `plant`."""

    def write(spec: str, parameters: str = SET):
        folder = workspace / "plant"
        folder.mkdir(exist_ok=True)
        (folder / "spec.py").write_text(spec, encoding="utf-8")
        (folder / "lab.toml").write_text(parameters, encoding="utf-8")
        return folder

    return write


def satellite(constraint: str = ATTITUDE) -> str:
    return SATELLITE.replace("CONSTRAINT\n", constraint)


def test_the_wheel_of_a_satellite_is_cyclic_and_its_zeros_are_no_instability(plant, run):
    plant(satellite())
    derived = run("derive", "./plant", "--set", "lab", "--json").document()
    assert derived["design"]["stable"] is True
    assert derived["design"]["routh_column"] == [1.0, 1.0]
    (note,) = derived["design"]["cyclic"]
    assert note.startswith("wheel is cyclic, and s does not contain it")
    assert [m["condition"] for m in derived["design"]["hurwitz"]] == ["rate_b > 0"]
    said = run("derive", "./plant", "--set", "lab").out
    assert "wheel is cyclic" in said
    assert "off by -0" not in said


def test_design_places_the_poles_beside_the_zeros_of_a_cyclic_coordinate(plant, run):
    plant(satellite())
    made = run("design", "./plant", "--poles=-2.5", "--json").document()
    assert made["gains"]["rate_b"] == pytest.approx(2.5, rel=1e-12)
    assert made["stable"] is True
    refused = run("design", "./plant", "--poles=-1,-1,-1")
    assert refused.code == 2
    assert "3 poles for zero dynamics of order 1" in refused.err


def test_an_unstable_attitude_is_refused_with_gains_that_are_taken(plant, run):
    folder = plant(satellite(), SET.replace('rate_b = "1 1/s"', 'rate_b = "-1 1/s"'))
    done = run("generate", "./plant", "-o", "out")
    assert done.code == 2
    assert "violated: rate_b > 0 (off by 1)" in done.err
    assert 'take rate_b = "6 1/s"' in " ".join(done.err.split())
    (folder / "lab.toml").write_text(SET.replace('rate_b = "1 1/s"', 'rate_b = "6 1/s"'))
    assert run("generate", "./plant", "-o", "out").code == 0


def test_a_second_wheel_is_cyclic_too(plant, run):
    plant(TWO_WHEELS.replace("CONSTRAINT\n", ATTITUDE))
    model = lowered_model(find_model("./plant"))
    zeros = derivation_of(find_model("./plant")).zero_dynamics
    assert zeros.at_origin == 4
    assert [d.name for d in zeros.cyclic] == ["wheel", "spare"]
    assert len(model.program("zero_polynomial").outputs) == 6
    done = run("derive", "./plant", "--set", "lab", "--json")
    assert done.document()["design"]["stable"] is True


def test_of_a_wheel_whose_rate_is_in_s_only_the_angle_is_free(plant):
    plant(satellite(RATE_TOO))
    zeros = derivation_of(find_model("./plant")).zero_dynamics
    assert [(d.name, d.zeros) for d in zeros.cyclic] == [("wheel", 1)]
    assert zeros.at_origin == 1


def test_carts_asked_for_their_distance_are_free_to_go(plant, run):
    values = LINE.replace("[gains]", 'k = "3 N/m"\n[gains]')
    plant(DISTANCE, values)
    zeros = derivation_of(find_model("./plant")).zero_dynamics
    assert [(d.name, d.zeros) for d in zeros.cyclic] == [("x + y", 2)]
    done = run("derive", "./plant", "--set", "lab", "--json")
    assert done.document()["design"]["zero_dynamics_poles"] == [[-1.0, 0.0]]


def test_shafts_behind_a_gear_are_free_to_turn_together(plant, run):
    ratio = '    n = m.parameter("ratio", "", "of the gear")\n    m.actuator("tau"'
    spec = DISTANCE.replace('    m.actuator("tau"', ratio).replace("y - x", "y - n * x")
    plant(spec, LINE.replace("[gains]", 'k = "3 N/m"\nratio = 5\n[gains]'))
    zeros = derivation_of(find_model("./plant")).zero_dynamics
    assert [(d.name, d.zeros) for d in zeros.cyclic] == [("ratio*y + x", 2)]
    done = run("derive", "./plant", "--set", "lab", "--json")
    assert done.document()["design"]["zero_dynamics_poles"] == [[-1.0, 0.0]]


def test_both_angles_at_once_are_refused_for_the_momentum_that_is_conserved(plant, refused):
    values = SET.replace(
        'rate_b = "1 1/s"\n', 'weight_body = 2\nrate_body = "1 1/s"\nrate_wheel = "1 1/s"\n'
    )
    plant(satellite(""), values)
    says = (
        "the zero dynamics are marginal, nothing damps them,",
        "which never holds (it is zero)",
        "the momentum along body is conserved, as no actuator changes it",
    )
    assert "for poles at" not in refused("generate", "./plant", "-o", "out", says=says)


def test_what_swings_without_damping_is_marginal_and_no_gains_are_proposed(plant, refused):
    plant(
        FREE_BOB.replace("* K", '* m.parameter("k", "1/s^2", "slope")'),
        LINE.replace("[gains]", 'k = "3 1/s^2"\n[gains]'),
    )
    says = (
        "the zero dynamics are marginal, nothing damps them,",
        "which never holds (it is zero)",
        "choose another servo-constraint",
    )
    said = refused("generate", "./plant", "-o", "out", says=says)
    assert "off by -0" not in said
    assert "for poles at" not in said


FLIGHT = """\
title = "to 30 degrees from -40, the wheel already turning"
model = "plant"
set = "lab"
duration = "60 s"
[initial]
body = "-40 deg"
dbody = "0.05 rad/s"
dwheel = "30 rad/s"
"""


@pytest.mark.target
def test_a_satellite_is_generated_verified_and_flown_to_its_attitude(plant, run, workspace):
    plant(satellite())
    assert run("generate", "./plant", "-o", "out").code == 0
    done = run("verify", "./plant", "--generated", "out", "--samples", "300", "--json")
    assert done.document()["passed"], done.err
    (workspace / "fly.toml").write_text(FLIGHT, encoding="utf-8")
    flown = run("simulate", "fly.toml", "--generated", "out", "--json").document()
    assert flown["mae2_body"] < 1e-9
    # The momentum (jb + jw) b' + jw w' of the start is all in the wheel at the end.
    momentum = 10.05 * 0.05 + 0.05 * 30.0
    assert flown["peak_torque"] == 1.0
    assert flown["mae2_wheel"] > 0.9 * momentum / 0.05 * 50.0


def test_zeros_within_rounding_are_divided_out_and_slow_poles_are_not():
    from pfaffian.derive.sets.routh import without_origin

    assert without_origin((2.0, 6.0, 1e-16, -3e-17), 2) == (2.0, 6.0)
    assert without_origin((2.0, 6.0, 1e-16, -3e-17), 1) == (2.0, 6.0, 1e-16)
    slow = tuple(np.poly([-1e-6, -1.0, -2.0]))
    assert without_origin(slow, 2) == slow
    assert without_origin((1.0, 1.0, math.nan), 2)[:2] == (1.0, 1.0)
