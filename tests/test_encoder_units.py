"""Encoders of a complete controller: what a count is worth, in the unit of its coordinate."""

from __future__ import annotations

import math
import shutil

import pytest
from pfaffian.derive.pipeline import library_sets, lowered_model
from pfaffian.derive.sets.controller_set import read_control
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.controller import host_control
from pfaffian.runtime.code.generated_model import open_generated

SOURCE = find_model("cart_pole")
CART = """[encoder.x]
quantum = "0.1 mm"
offset = "2 cm"
largest_jump = 100000
[encoder.theta]
counts_per_turn = 4096
"""


def _read(text, folder):
    model = lowered_model(SOURCE)
    law = library_sets(model, SOURCE)[0].as_dict()
    path = folder / "barto.toml"
    path.write_text(text, encoding="utf-8")
    return read_control(path, model, law, ()).encoders


def test_a_cart_counts_in_metres_and_a_pole_in_turns(workspace):
    found = _read(CART, workspace)
    assert 2.0 * math.pi / found["x"]["counts_per_turn"] == pytest.approx(1e-4, rel=1e-15)
    assert found["x"]["offset"] == pytest.approx(0.02, rel=1e-15)
    assert found["theta"]["counts_per_turn"] == 4096.0


def test_an_angle_may_have_a_quantum_too(workspace):
    text = CART.replace("counts_per_turn = 4096", 'quantum = "0.09 deg"')
    assert _read(text, workspace)["theta"]["counts_per_turn"] == pytest.approx(4000.0, rel=1e-15)


REFUSED = {
    "both": ('"0.1 mm"', '"0.1 mm"\ncounts_per_turn = 9', "encoder.x: quantum and counts_per_turn"),
    "neither": ('quantum = "0.1 mm"\n', "", "encoder.x: an encoder in m has no turns"),
    "turns of a metre": (
        'quantum = "0.1 mm"',
        "counts_per_turn = 50000",
        "encoder.x: an encoder in m has no turns",
    ),
    "another unit": ('"0.1 mm"', '"0.1 mrad"', "encoder.x.quantum: mrad has dimension"),
    "no unit": ('"0.1 mm"', "1e-4", "encoder.x.quantum: 0.0001 has no unit"),
    "nothing": ('"0.1 mm"', '"0 mm"', "encoder.x.quantum = 0 m is out of its bounds"),
    "backwards": ('"0.1 mm"', '"-0.1 mm"', "encoder.x.quantum = -0.0001 m is out of its bounds"),
    "too coarse": ('"0.1 mm"', '"2 m"', "encoder.x.quantum = 2 m is out of its bounds"),
    "an offset in radians": ('"2 cm"', '"0.02 rad"', "encoder.x.offset: rad has dimension"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_quantum_that_cannot_be_is_refused_with_file_and_key(what, workspace):
    right, wrong, says = REFUSED[what]
    assert CART.count(right) == 1
    with pytest.raises(InputError) as error:
        _read(CART.replace(right, wrong), workspace)
    assert f"barto.toml: {says}" in error.value.message
    assert error.value.remedy


def test_the_generated_controller_reads_the_cart_in_metres(workspace, run):
    plant = workspace / "cart_pole"
    shutil.copytree(SOURCE.path, plant, ignore=lambda *_: ["__pycache__"])
    (plant / "control").mkdir()
    (plant / "control" / "barto.toml").write_text(CART, encoding="utf-8")
    assert run("generate", "./cart_pole", "-o", "out").code == 0
    module = host_control(open_generated("out"))
    params = module.params("barto")
    state, status = module.init(params)
    assert status[0] == 0
    given, output = (module.records(f"control_{role}") for role in ("input", "output"))
    given["elapsed"], given["x_valid"], given["theta_valid"] = 1e-3, 1, 1
    given["x_raw"], given["theta_raw"], given["frame"], given["heartbeat"] = 5000, 1024, 1, 1
    module.step(state, params, given, output)
    assert output["x"][0] == pytest.approx(0.02 + 5000 * 1e-4, rel=1e-15)
    assert output["theta"][0] == pytest.approx(math.pi / 2.0, rel=1e-15)
