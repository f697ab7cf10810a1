"""Vectors from 60-digit arithmetic hold a build on any hardware: here, compilers and emulators."""

import re
import shutil
import subprocess
from importlib.resources import files
from pathlib import Path

import pytest
from pfaffian.derive.verify.vectors import COUNT, vectors
from pfaffian.runtime.code.generated_model import open_generated

FOLDER = Path(str(files("pfaffian.runtime"))) / "vectors"
HEADER = FOLDER / "pendubot_vectors.h"
PPC_GCC = "powerpc-linux-gnu-gcc"
BUILDS = {
    "host": (("gcc",), ()),
    "host with FMA": (("gcc", "-mfma"), ()),
    "host without optimisation": (("gcc", "-O0"), ()),
    "clang": (("clang",), ()),
    "PowerPC 750": ((PPC_GCC, "-mcpu=750", "-static"), ("qemu-ppc", "-cpu", "750gx")),
}
EACH = [
    pytest.param(
        name,
        marks=pytest.mark.skipif(
            not all(shutil.which(c) for c in (command[0], *runner[:1])),
            reason=f"needs {' and '.join((command[0], *runner[:1]))}",
        ),
    )
    for name, (command, runner) in BUILDS.items()
]


def check(name, folder, spoil=lambda text: text):
    """Build and run the check; return its exit code and what it printed."""
    command, runner = BUILDS[name]
    c = folder / "c"
    shutil.copytree(open_generated("pendubot").path / "c", c)
    step = c / "pendubot.c"
    step.write_text(spoil(step.read_text()))
    names = ["-DPF_VECTORS_MAIN", '-DPF_VECTORS="pendubot_vectors.h"', f"-I{FOLDER}", f"-I{c}"]
    sources = [FOLDER / "check_vectors.c", step, c / "pendubot_params.c", c / "pf_elementary.c"]
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]
    flags += ["-fno-math-errno", *command[1:]]
    build = [command[0], *flags, *names, *map(str, sources), "-o", "check", "-lm"]
    done = subprocess.run(build, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    ran = subprocess.run(
        [*runner, "./check"], cwd=folder, capture_output=True, text=True, check=False
    )
    return ran.returncode, ran.stdout


@pytest.fixture(scope="module")
def host_says(tmp_path_factory):
    if not shutil.which("gcc"):
        pytest.skip("needs gcc")
    return check("host", tmp_path_factory.mktemp("host"))[1]


@pytest.mark.parametrize("name", EACH)
def test_a_build_passes_and_has_the_digest_of_every_build(name, tmp_path, host_says):
    code, said = check(name, tmp_path)
    assert code == 0, said
    assert said.startswith(f"0 of {COUNT} vectors failed")
    assert float(re.search(r"worst ([\d.]+) of", said)[1]) < 0.5
    assert said == host_says


@pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("pf_fma(adb_squared", "nothing"),
        ("const double adb = (state->theta2_lam - m12)", "const double adb = (m12 - m12)"),
        ("params->sigma, pf_atan_inline(s)", "params->sigma * (1.0 + 1e-14), pf_atan_inline(s)"),
    ],
    ids=["unchanged", "another law", "a digit lost"],
)
def test_a_wrong_build_fails(old, new, tmp_path):
    code, said = check("host", tmp_path, lambda text: text.replace(old, new))
    assert (code == 0) == (new == "nothing"), said


def test_the_committed_vectors_are_what_the_oracle_says_now():
    assert vectors("pendubot") == HEADER.read_text()


def test_vectors_reach_every_set_and_way_through_the_step():
    text = HEADER.read_text()
    sets = open_generated("pendubot").manifest.parameter_sets
    for name in sets:
        assert text.count(f"&pendubot_params_{name.replace('-', '_')},") == COUNT // len(sets)
    assert text.count("{ 0x1.0000000000000p+0, ") > 5  # engaged
    assert text.count("{ 0x0.0p+0, ") > 5  # and not
    assert len(text) < 64_000
    assert re.search(r"SHA-256 (\w+)", text)[1] == open_generated("pendubot").manifest.model_sha256
