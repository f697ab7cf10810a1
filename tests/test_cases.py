"""Plants from outside that once failed: each is generated, verified and built, or refused clearly.

They lie beside the repository, in `../shared/cases`; the README there says what each must do.
"""

import os
import shutil

import numpy as np
import pytest
from conftest import REPOSITORY

CASES = REPOSITORY.parent / "shared" / "cases"
pytestmark = pytest.mark.skipif(
    not CASES.is_dir(), reason="the cases of ../shared/cases are not beside this checkout"
)
#: Samples of each verification; the README's claim is of the default, 10,000.
SAMPLES = int(os.environ.get("PFAFFIAN_CASE_SAMPLES", "100"))
PASSING = (
    "actuator_named_p1",
    "coordinate_named_b",
    "cyclic",
    "flexible_joint",
    "gainless_set",
    "oblique_spring",
    "slider_crank",
    "spherical_pendulum",
    "task_space_arm",
    "two_carts_spring",
)


@pytest.mark.target
@pytest.mark.parametrize("name", PASSING)
def test_a_plant_that_once_failed_is_generated_verified_and_built(name, run, workspace):
    plant = str(CASES / name)
    made = run("generate", plant)
    assert made.code == 0, made.err
    found = run("verify", plant, "--samples", SAMPLES, "--target-samples", 60, "--json")
    document = found.document()
    assert found.code == 0, found.err
    assert document["worst_scaled_ulp"] <= 4.0
    assert document["target_mismatches"] == 0
    if name in ("gainless_set", "spherical_pendulum"):
        assert list(document["sets_left_out"]) == ["lab"]
        assert "pfaffian design" in made.err + made.out
    built = run("build", plant, "--target", "ppc750", "--json")
    assert built.code == 0, built.err
    assert built.document()["instructions_per_step"] > 0


def test_time_as_a_parameter_is_refused_at_its_line(refused):
    plant = CASES / "time_parameter"
    lines = (plant / "spec.py").read_text(encoding="utf-8").splitlines()
    line = next(k for k, text in enumerate(lines, 1) if '"time"' in text)
    refused("derive", str(plant), says=(f"spec.py:{line}: ", "time"))


@pytest.mark.parametrize("name", ["p1", "s", "beta", "adb", "engaged", "saturated"])
def test_a_flight_is_the_same_whatever_the_actuator_is_called(name, run, workspace):
    hashes = []
    for given in ("u", name):
        plant = workspace / given / "nm"
        shutil.copytree(CASES / "actuator_named_p1", plant)
        spec = (plant / "spec.py").read_text(encoding="utf-8").replace('"p1"', f'"{given}"')
        (plant / "spec.py").write_text(spec, encoding="utf-8")
        out = workspace / given / "out"
        assert run("generate", plant, "-o", out).code == 0
        flown = run("simulate", plant / "sc.toml", "--generated", out, "--json").document()
        assert flown["peak_torque"] <= 5.0
        hashes.append(flown["trajectory_sha256"])
    assert hashes[0] == hashes[1]


ARM = """title = "from beside the line onto it, and along it"
source = "made up"
model = "arm"
set = "lab"
duration = "6 s"

[initial]
q1 = "-0.4 rad"
q2 = "1.9 rad"
"""


def test_the_hand_of_the_arm_stays_on_its_line(workspace, run):
    """The residual decays at `approach`; from 5 s on the hand is on the line to 1e-5 m."""
    from pfaffian.runtime.code.generated_model import host_model, open_generated
    from pfaffian.runtime.flight.closed_loop import fly
    from pfaffian.runtime.flight.scenario import read_scenario

    assert run("generate", CASES / "task_space_arm", "-o", "arm").code == 0
    (workspace / "line.toml").write_text(ARM, encoding="utf-8")
    model = host_model(open_generated(str(workspace / "arm")))
    flight = fly(
        read_scenario(str(workspace / "line.toml"), workspace / "arm"), model, model, "host"
    )
    p = model.folder.parameters("lab")
    q1, q2 = flight.measured["q1"], flight.measured["q2"]
    hand = [p["l1"] * f(q1) + p["l2"] * f(q1 + q2) for f in (np.cos, np.sin)]
    c, s = np.cos(p["slope"]), np.sin(p["slope"])
    across = -s * (hand[0] - p["x0"]) + c * (hand[1] - p["y0"])
    along = c * (hand[0] - p["x0"]) + s * (hand[1] - p["y0"])
    late = slice(5000, None)
    assert np.abs(across[0]) > 1e-3
    assert np.abs(across[late]).max() < 1e-5
    assert np.ptp(along[late]) > 0.05
