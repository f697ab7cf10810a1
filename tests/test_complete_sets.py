"""Sets without gains, the sets that `verify` draws around, and where M is positive definite."""

from __future__ import annotations

import json
import math

import pytest
from pfaffian.cli.code.generate import generate_files
from pfaffian.cli.code.verify import verification
from pfaffian.derive.generate_model import Extras
from pfaffian.derive.pipeline import complete_sets, lowered_model
from pfaffian.derive.sets.definiteness import Definiteness, definiteness_of, points_within_bounds
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.base.errors import InputError

SPEC = """
from pfaffian.derive.authoring import ModelBuilder

def model():
    m = ModelBuilder("pair", title="two carts", source="textbook")
    x, dx = m.coordinate("x", "m", "driven", bound=1, rate_bound=1)
    y, dy = m.coordinate("y", "m", "free", bound=1000, rate_bound=1000)
    m1, m2 = m.parameter("m1", "kg", "driven"), m.parameter("m2", "kg", "free")
    c = m.parameter("c", "N/m", "spring between them")
    m.actuator("u", "N", "force", on={"x": 1})
    return m.build(
        kinetic_energy=(m1 * dx**2 + m2 * dy**2) / 2, potential_energy=c * (x - y) ** 2 / 2
    )
"""
SET = """
title = "t"
source = "s"
[parameters]
m1 = "1 kg"
m2 = "1 kg"
c = "10 N/m"
[gains]
sigma = "5 1/s"
eta = "0.001 m/s^2"
kappa = "5 kg^2/s"
epsilon = "1 m^2/s^3"
k1 = "1e-5 kg^2/s^2"
k2 = "2 1/s"
bound_initial = "0.01 N"
[target]
sample_time = "1 ms"
torque_limit = "50 N"
singular_threshold = "0.001 1/kg"
"""
POLES = 'extends = "bare"\ntitle = "t"\nsource = "s"\n[gains]\nzero_dynamics_poles = [-2, -2, -2]\n'


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sets") / "pair"
    folder.mkdir()
    (folder / "spec.py").write_text(SPEC)
    (folder / "bare.toml").write_text(SET)
    (folder / "good.toml").write_text(POLES)
    return folder


def test_a_set_without_gains_is_left_out_and_named_with_the_command_that_helps(plant):
    source = find_model(str(plant))
    found = complete_sets(lowered_model(source), source)
    assert [s.name for s in found.sets] == ["good"]
    (line,) = found.notes("pair")
    assert line.startswith("set bare is left out: missing weight_x, rate_x, rate_y")
    assert line.endswith("pfaffian design pair --set bare finds gains")
    with pytest.raises(InputError, match="missing weight_x"):
        complete_sets(lowered_model(source), source, ["bare"])
    with pytest.raises(InputError, match="no parameter set nowhere"):
        complete_sets(lowered_model(source), source, ["nowhere"])


def test_a_set_that_is_wrong_is_refused_and_not_left_out(plant):
    (plant / "wrong.toml").write_text(POLES.replace("-2, -2, -2", "-2"))
    source = find_model(str(plant))
    try:
        with pytest.raises(InputError, match="1 poles"):
            complete_sets(lowered_model(source), source)
    finally:
        (plant / "wrong.toml").unlink()


@pytest.mark.target
@pytest.mark.parametrize("bake", [False, True], ids=["all sets", "one folded in"])
def test_verify_takes_the_complete_sets_and_a_folder_with_one_folded_in(
    plant, tmp_path, capsys, bake
):
    generate_files(str(plant), None, None, tmp_path / "out", False, Extras(bake=bake), True)
    printed = json.loads(capsys.readouterr().out)
    assert printed["sets"] == ["good"]
    assert list(printed["sets_left_out"]) == ["bare"]
    found = verification(str(plant), 60, 60, tmp_path / "out")
    assert found["passed"]
    assert found["sets"] == ["good"]
    assert list(found["sets_left_out"]) == ([] if bake else ["bare"])
    assert found["target_mismatches"] == 0
    near = [f["worst_scaled_ulp_near_sets"] for f in found["functions"]]
    assert all(
        0.0 <= n <= f["worst_scaled_ulp"] for n, f in zip(near, found["functions"], strict=True)
    )
    assert max(near) > 0.0


def test_a_matrix_is_positive_definite_semidefinite_or_neither():
    c = math.cos(math.pi / 2)
    assert definiteness_of([[2.0, 1.0], [1.0, 2.0]]) is Definiteness.POSITIVE
    assert definiteness_of([[1e-19, 0.0], [0.0, 1e4]]) is Definiteness.POSITIVE
    assert definiteness_of([[1.0, 1.0], [1.0, 1.0]]) is Definiteness.SEMI
    assert definiteness_of([[1.0, 0.0], [0.0, 0.0]]) is Definiteness.SEMI
    assert (
        definiteness_of([[3.0, c, 0.0], [c, 0.0, 0.0], [0.0, 0.0, 1.0]])
        is not Definiteness.POSITIVE
    )
    assert definiteness_of([[1.0, 2.0], [2.0, 1.0]]) is Definiteness.NONE
    assert definiteness_of([[1.0, 0.0], [0.0, -1.0]]) is Definiteness.NONE
    assert definiteness_of([[1.0, 0.5], [0.5, 0.0]]) is Definiteness.NONE
    assert definiteness_of([[math.nan, 0.0], [0.0, 1.0]]) is Definiteness.NONE


def test_positive_definiteness_is_judged_within_the_bounds():
    from dataclasses import replace

    model = lowered_model(find_model("furuta"))
    setpoint = {c.name: 0.25 for c in model.coordinates}
    narrow = replace(model, coordinates=tuple(replace(c, bound=1.2) for c in model.coordinates))
    for given, most in ((model, math.pi), (narrow, 1.2)):
        points = [p["alpha"] for p in points_within_bounds(given, setpoint)]
        assert points[0] == 0.25
        assert max(points) == pytest.approx(most)
        assert min(points) == pytest.approx(-most)
        assert 0.0 in points
