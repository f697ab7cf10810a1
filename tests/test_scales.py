"""A plant brings its own scale: a micromirror and a ship go from spec to verified firmware."""

from __future__ import annotations

import math

import pytest
from pfaffian.derive.pipeline import lowered_model
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.spec.model_spec import Actuator
from pfaffian.derive.spec.standard_parameters import LABORATORY, Domain, law_parameters

MIRROR = """\
import sympy as sp
from pfaffian.derive.authoring import ModelBuilder


def model():
    m = ModelBuilder("mirror", title="Torsional micromirror", source="own")
    a, da = m.coordinate("frame", "rad", "driven frame", bound=10, rate_bound=1e7)
    b, db = m.coordinate("tilt", "rad", "mirror against the frame", bound=10, rate_bound=1e7)
    ja = m.parameter("frame_inertia", "kg*m^2", "frame")
    jb = m.parameter("mirror_inertia", "kg*m^2", "mirror")
    k = m.parameter("k", "N*m/rad", "hinge between them")
    h = m.parameter("h", "N*m/rad", "hinge of the frame")
    m.actuator("tau", "N*m", "comb drive", on={"frame": 1})
    return m.build(
        kinetic_energy=ja * da**2 / 2 + jb * (da + db) ** 2 / 2,
        potential_energy=k * b**2 / 2 + h * a**2 / 2,
    )
"""
MIRROR_SET = """\
title = "mirror"
source = "made up here"
[parameters]
frame_inertia = "3e-19 kg*m^2"
mirror_inertia = "1e-19 kg*m^2"
k = "1e-11 N*m/rad"
h = "2e-11 N*m/rad"
[gains]
zero_dynamics_poles = [-20000, -20000, -20000]
sigma = "20000 1/s"
eta = "1 1/s^2"
kappa = "2e-33 kg^2*m^4/s"
epsilon = "1e12 1/s^3"
k1 = "1e-44 kg^2*m^4/s^2"
k2 = "2000 1/s"
bound_initial = "1e-14 N*m"
[target]
sample_time = "200 ns"
torque_limit = "1e-10 N*m"
singular_threshold = "1e15 1/(kg*m^2)"
"""
SHIP = """\
import sympy as sp
from pfaffian.derive.authoring import ModelBuilder


def model():
    m = ModelBuilder("ship", title="Ship with a hanging load", source="own")
    x, dx = m.coordinate("x", "m", "along the track", bound=1e6, rate_bound=100)
    a, da = m.coordinate("swing", "rad", "of the load from hanging", bound=100, rate_bound=100)
    ship = m.parameter("ship_mass", "kg", "with the water it moves")
    load = m.parameter("load_mass", "kg", "load")
    rope = m.parameter("rope", "m", "rope")
    g = m.parameter("g", "m/s^2", "gravity")
    m.actuator("thrust", "N", "of the propellers", on={"x": 1})
    p = sp.Matrix([x + rope * sp.sin(a), -rope * sp.cos(a)])
    v = p.diff(x) * dx + p.diff(a) * da
    return m.build(
        kinetic_energy=(ship * dx**2 + load * v.dot(v)) / 2, potential_energy=load * g * p[1]
    )
"""
SHIP_SET = """\
title = "ship"
source = "made up here"
[parameters]
ship_mass = "100000 t"
load_mass = "2000 t"
rope = "40 m"
g = "9.81 m/s^2"
[gains]
zero_dynamics_poles = [-0.2, -0.2, -0.2]
xd = "12 km"
sigma = "0.5 1/s"
eta = "1e-5 1/s^2"
kappa = "1e20 kg^2*m^2/s"
epsilon = "1e-3 1/s^3"
k1 = "1e8 kg^2*m^2/s^2"
k2 = "0.1 1/s"
bound_initial = "1e4 N"
[target]
sample_time = "1.5 s"
torque_limit = "5e7 N"
singular_threshold = "1e-12 1/(kg*m)"
"""


def written(workspace, spec: str, text: str):
    folder = workspace / "plant"
    folder.mkdir(exist_ok=True)
    (folder / "spec.py").write_text(spec, encoding="utf-8")
    (folder / "lab.toml").write_text(text, encoding="utf-8")
    return folder


@pytest.mark.target
@pytest.mark.parametrize(("spec", "text"), [(MIRROR, MIRROR_SET), (SHIP, SHIP_SET)])
def test_a_mirror_and_a_ship_are_generated_built_and_verified(spec, text, workspace, run):
    written(workspace, spec, text)
    done = run("generate", "./plant", "-o", "out")
    assert done.code == 0, done.err
    built = run("build", "./plant", "--generated", "out", "--target", "ppc750", "--json")
    assert built.code == 0, built.err
    arguments = ("./plant", "--generated", "out", "--samples", "200", "--json")
    found = run("verify", *arguments).document()
    assert found["passed"], found
    assert found["target_mismatches"] == 0


def test_what_a_plant_does_not_bound_is_bounded_by_nothing_but_its_sign(workspace):
    written(workspace, MIRROR, MIRROR_SET)
    for p in lowered_model(find_model("./plant")).parameters:
        assert p.upper == math.inf, p.name
        assert p.lower in (0.0, -math.inf), p.name


def test_a_value_that_is_zero_where_it_divides_is_still_refused(workspace, refused):
    for key in ("sample_time", "singular_threshold", "frame_inertia"):
        line = next(x for x in MIRROR_SET.splitlines() if x.startswith(key))
        unit = line.split('"')[1].split(" ", 1)[1]
        written(workspace, MIRROR, MIRROR_SET.replace(line, f'{key} = "0 {unit}"'))
        says = (f"{key} = 0", "give a value greater than 0")
        refused("generate", "./plant", "-o", "out", says=says)


def test_the_laboratory_keeps_the_bounds_the_library_is_verified_in():
    law = law_parameters([Actuator("u", "N", "force")], ["m/s"], LABORATORY)
    by_name = {p.name: (p.lower, p.upper) for p in law}
    assert by_name["sample_time"] == (1e-6, 1.0)
    assert by_name["singular_threshold"] == (1e-9, 1e6)
    assert by_name["torque_limit"] == (0.0, 1e4)
    assert Domain().law == math.inf
