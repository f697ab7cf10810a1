"""Values survive: to the bit from the parameter set into C, Python and manifest, in any unit."""

from __future__ import annotations

import ctypes
import json
import math
import struct
from pathlib import Path

import numpy as np
import pytest
from pfaffian.derive.pipeline import lowered_model, parameter_set
from pfaffian.derive.sets.raw_set import read_set
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.code.generated_model import open_generated
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.toolchain import host_target

SOURCE = find_model("pendubot")
#: Values that a careless printer or reader would spoil; k1 is the least there is.
AWKWARD = """
extends = "rig"
title = "awkward"
[parameters]
theta1 = "0.009600000000000001 kg*m^2"
theta5 = "0.03320000000000001 kg*m"
[gains]
k1 = "4.9406564584124654e-324 N^2*m^2*s^2"
eta = "2.2250738585072014e-308 rad/s^2"
sigma = "2.0000000000000004 1/s"
epsilon = "0.3333333333333333 1/s^3"
kappa = "1e-5 N*m*kg*m^2*s"
k2 = "0.30000000000000004 1/s"
bound_initial = "9999.999999999998 N*m"
[target]
torque_limit = "1e4 N*m"
sample_time = "9.765625e-4 s"
singular_threshold = "0.1 1/(kg*m^2)"
"""


def bits(value: float) -> str:
    return struct.pack(">d", value).hex()


@pytest.fixture
def awkward(workspace, run):
    (workspace / "awkward.toml").write_text(AWKWARD)
    done = run("generate", "pendubot", "--params", "awkward.toml", "-o", "made")
    assert done.code == 0, done.err
    wanted = parameter_set(lowered_model(SOURCE), SOURCE, workspace / "awkward.toml").as_dict()
    assert bits(wanted["k1"]) == "0000000000000001"
    assert bits(wanted["sigma"]) == "4000000000000001"
    return open_generated("made"), wanted


def test_a_parameter_reads_back_from_c_to_the_bit(awkward):
    code, wanted = awkward
    sources = [code.path / "c" / "pendubot_params.c"]
    image = code.path.resolve().with_name("params.so")
    image.write_bytes(compile_image(host_target(), sources, code.path / "c"))
    names = code.manifest.structures["params"].names()
    row = (ctypes.c_double * len(names)).in_dll(ctypes.CDLL(str(image)), "pendubot_params_awkward")
    assert {n: bits(v) for n, v in zip(names, row, strict=True)} == {
        n: bits(wanted[n]) for n in names
    }


def test_a_parameter_reads_back_from_python_and_the_manifest_to_the_bit(awkward):
    code, wanted = awkward
    module = code.python_module()
    written = vars(module.AWKWARD)
    assert {n: bits(v) for n, v in written.items()} == {n: bits(wanted[n]) for n in written}
    assert set(written) == set(code.manifest.structures["params"].names())
    [(name, listed)] = json.loads((code.path / "manifest.json").read_text())[
        "parameter_sets"
    ].items()
    assert name == "awkward"
    assert {n: bits(v) for n, v in listed.items()} == {n: bits(v) for n, v in wanted.items()}


#: The set `sim` as another workshop would write it.
ELSEWHERE = """
extends = "sim"
[parameters]
m1 = "90 g"
m2 = "0.00073 t"
l1 = "150 mm"
lc1 = "9 cm"
lc2 = "0.8 dm"
I1 = "73000 g*cm^2"
I2 = "1000 g*cm²"
g = "980 cm/s**2"
[gains]
lam = 225e-2
lam1 = "33 1/min"
lam2 = "700 mHz"
eta = "1 mrad/s^2"
kappa = "2 J*kg*m^2*s"
k1 = "2e4 N^2*mm^2*s^2"
k2 = "120 1/min"
bound_initial = "100 N*mm"
q1d = "90 deg"
q2d = "0 turn"
[target]
sample_time = "1 ms"
torque_limit = "0.01 kN*m"
"""


def test_a_set_in_other_units_is_the_same_to_one_ulp(workspace):
    (workspace / "elsewhere.toml").write_text(ELSEWHERE)
    model = lowered_model(SOURCE)
    raw = {
        path.stem: read_set(path, model.parameters, SOURCE.sets()).values
        for path in (SOURCE.set_path("sim"), workspace / "elsewhere.toml")
    }
    assert raw["sim"].keys() == raw["elsewhere"].keys()
    for name, value in raw["sim"].items():
        assert abs(raw["elsewhere"][name] - value) <= math.ulp(value), name
    assert raw["elsewhere"]["q1d"] == math.pi / 2


def test_a_set_in_other_units_gives_the_same_controller(workspace, run):
    (workspace / "sim.toml").write_text(ELSEWHERE)
    assert run("generate", "pendubot", "--params", "sim.toml", "-o", "made").code == 0
    here, there = open_generated("pendubot").parameters("sim"), open_generated("made")
    values = there.parameters("sim")
    assert values.keys() == here.keys()
    ulps = {n: abs(values[n] - v) / np.spacing(abs(v)) for n, v in here.items() if v}
    assert max(ulps.values()) <= 8  # a lumped parameter adds up rounded products


def test_physical_and_lumped_parameters_describe_the_same_plant(workspace):
    """The lumped values by hand: theta1 = m1 lc1^2 + m2 l1^2 + I1 and so on."""
    values = parameter_set(lowered_model(SOURCE), SOURCE, SOURCE.set_path("sim")).as_dict()
    by_hand = {
        "theta1": 0.09 * 0.09**2 + 0.73 * 0.15**2 + 0.0073,
        "theta2": 0.73 * 0.08**2 + 0.0001,
        "theta3": 0.73 * 0.15 * 0.08,
        "theta4": 0.09 * 0.09 + 0.73 * 0.15,
        "theta5": 0.73 * 0.08,
    }
    for name, value in by_hand.items():
        assert values[name] == pytest.approx(value, rel=1e-15)
    lumped = "\n".join(
        f'{n} = "{v!r} {"kg*m" if n in ("theta4", "theta5") else "kg*m^2"}"'
        for n, v in values.items()
        if n.startswith("theta")
    )
    (workspace / "lumped.toml").write_text(f'extends = "sim"\n[parameters]\n{lumped}\n')
    path = Path(workspace / "lumped.toml")
    other = parameter_set(lowered_model(SOURCE), SOURCE, path).as_dict()
    assert other == {n: v for n, v in values.items() if n in other}
    assert "m1" not in other
