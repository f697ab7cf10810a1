"""libFuzzer finds no input that gets a torque out of the step that is not finite or not limited.

PFAFFIAN_FUZZ_SECONDS says how long it runs; `make fuzz TIME=600` sets it, and writes what it found
into a folder of its own. The committed corpus is replayed by any compiler.
"""

import os
import re
import shutil
import subprocess

import pytest
from conftest import REPOSITORY
from pfaffian.runtime.generated_model import open_generated

SECONDS = int(os.environ.get("PFAFFIAN_FUZZ_SECONDS", "20"))
CORPUS = REPOSITORY / "tests" / "fuzz_corpus"
HARNESS = REPOSITORY / "tests" / "fuzz_step.c"
FOLDER = open_generated("pendubot")
SANITIZED = ["-fsanitize=fuzzer,address,undefined", "-fno-sanitize-recover=all"]


def needs(name):
    return pytest.mark.skipif(
        not shutil.which(name), reason=f"needs {name}: apt-get install {name} libclang-rt-14-dev"
    )


def build(compiler, flags, folder, spoil=lambda text: text):
    c = folder / "c"
    shutil.copytree(FOLDER.path / "c", c)
    step = c / "pendubot.c"
    step.write_text(spoil(step.read_text()))
    names = ["-DPF_TORQUE=tau", "-DPF_LIMIT=torque_limit", "-DPF_SET=pendubot_params_rig"]
    sources = [HARNESS, step, c / "pendubot_params.c", c / "pf_elementary.c"]
    command = [compiler, "-std=c99", "-O1", "-g", "-ffp-contract=off", "-fno-math-errno"]
    command += [*flags, *names, f"-I{c}", *map(str, sources), "-o", "attack", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode and "libclang_rt" in done.stderr:
        pytest.skip("needs clang's sanitizers: apt-get install libclang-rt-14-dev")
    assert done.returncode == 0, done.stderr


def attack(folder, seconds, *more):
    (folder / "found").mkdir(exist_ok=True)
    command = ["./attack", "-max_len=512", "-seed=1", f"-max_total_time={seconds}", *more]
    done = subprocess.run(
        [*command, "found", str(CORPUS)], cwd=folder, capture_output=True, text=True, check=False
    )
    return done.returncode, done.stderr


@needs("clang")
def test_the_fuzzer_finds_nothing(tmp_path):
    build("clang", SANITIZED, tmp_path)
    code, said = attack(tmp_path, SECONDS)
    assert code == 0, said[-4000:]
    runs = int(re.search(r"Done (\d+) runs", said)[1])
    print(f"\nfuzzer: {runs} executions in {SECONDS} s, no finding")
    assert runs > 0


FAULTS = {
    "a limit that is not checked": ("if (!(params->torque_limit > 0.0))", "if (0)"),
    "a result that is not checked": (
        "if (!(finite < 1.0)) {\n        return rejected",
        "if (0) {\n        return rejected",
    ),
    "a saturation left out": ("? ((torque_slewed < 0.0) ?", "&& 0 ? ((torque_slewed < 0.0) ?"),
}


@needs("clang")
@pytest.mark.parametrize("fault", FAULTS)
def test_the_fuzzer_finds_a_planted_fault(fault, tmp_path):
    old, new = FAULTS[fault]

    def spoil(text):
        assert text.count(old) == 1
        return text.replace(old, new)

    build("clang", SANITIZED, tmp_path, spoil)
    code, said = attack(tmp_path, 60)
    assert code != 0
    assert "ERROR: libFuzzer: deadly signal" in said or "runtime error" in said


@needs("gcc")
def test_the_corpus_is_small_and_every_input_of_it_is_answered(tmp_path):
    inputs = sorted(CORPUS.iterdir())
    assert 10 < len(inputs) < 200
    assert sum(p.stat().st_size for p in inputs) < 64_000
    build(
        "gcc", ["-DPF_FUZZ_REPLAY", "-fsanitize=undefined", "-fno-sanitize-recover=all"], tmp_path
    )
    done = subprocess.run(
        ["./attack", *map(str, inputs)], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{len(inputs)} inputs\n"
