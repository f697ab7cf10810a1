"""The C of the twin: without a warning for every model, and safe on whatever is commanded."""

import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from pfaffian.runtime.code.generated_model import generated_models, open_generated
from pfaffian.runtime.code.sensing import sensing_sources
from pfaffian.runtime.machine.toolchain import COMMON_FLAGS
from pfaffian.runtime.twin import balance_unit, fly_twin, plant_model, read_twin
from pfaffian.runtime.twin.rig import Rigs
from pfaffian.runtime.twin.settings import Disturbance, Drive, Push
from support_twin import model, twin

SOURCE = sensing_sources()[0].parent / "pf_twin.c"
WARNINGS = (
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow"),
    *("-Wdouble-promotion", "-Wfloat-equal", "-Wstrict-prototypes", "-Wmissing-prototypes"),
    "-Werror",
)
COMPILERS = [
    pytest.param(
        ("gcc",), id="gcc", marks=pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
    ),
    pytest.param(
        (sys.executable, "-m", "ziglang", "cc"),
        id="zig",
        marks=pytest.mark.skipif(not find_spec("ziglang"), reason="needs the package ziglang"),
    ),
]


@pytest.mark.parametrize("command", COMPILERS)
@pytest.mark.parametrize("name", generated_models())
def test_the_loop_compiles_with_every_model_without_a_warning(name, command, tmp_path):
    include = open_generated(name).path / "c"
    done = subprocess.run(
        [*command, *COMMON_FLAGS, *WARNINGS, f"-I{include}", "-c", SOURCE, "-o", "out"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_any_command_at_all_leaves_drives_and_rigs_finite():
    """Commands are random bits: numbers of every size, infinities and NaN."""
    drive = Drive(2.0, 5e-4, 1e-3, 1e-3, 500.0, 10)
    scenario = twin(
        1.0,
        rigs=50,
        drives={"tau": drive},
        disturbances=(Disturbance("q2", "sine", 1e-3, frequency=40.0),),
        pushes=(Push("q1", 0.01, impulse=1e-3),),
    )
    for of in (scenario, replace(scenario, drives={})):
        rigs, rng = Rigs(of, model()), np.random.default_rng(0)
        count = np.full(50, 4, np.uint32)
        for k in range(300):
            bits = rng.integers(0, 2**64, (50, 1), np.uint64, endpoint=False)
            command = bits.view(np.float64)
            command[:3, 0] = np.inf, -np.inf, np.nan
            rigs.advance(np.full(50, 4 * k, np.uint32), count, command)
            assert np.isfinite(rigs.truth).all()
        assert np.isfinite(rigs.applied).all()
    assert (np.abs(rigs.truth) <= 1e6).all()


@pytest.mark.skipif(
    not (shutil.which("gcc") and find_spec("ziglang")), reason="needs gcc and the package ziglang"
)
def test_two_compilers_give_a_flight_the_same_bits():
    scenario = read_twin("rig-pushed-twin")
    scenario = replace(scenario, rigs=4, base=replace(scenario.base, steps=500))
    digests = {
        fly_twin(scenario, balance_unit(scenario, plant), model=plant).sha256()
        for plant in (plant_model(scenario.base.folder, name) for name in ("gcc", "zig"))
    }
    assert len(digests) == 1
