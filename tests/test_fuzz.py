"""libFuzzer finds no input that gets a torque out that is not finite, not limited or not allowed.

It attacks the law's step, the supervisor and the complete control step, each for
PFAFFIAN_FUZZ_SECONDS; `make fuzz TIME=600` sets it, and writes what it found into a folder of its
own. The committed corpora are replayed by any compiler.
"""

import os
import re
import shutil
import subprocess
from dataclasses import dataclass

import pytest
from conftest import REPOSITORY
from pfaffian.runtime.code.generated_model import open_generated
from pfaffian.runtime.machine.sources import runtime_c

SECONDS = int(os.environ.get("PFAFFIAN_FUZZ_SECONDS", "3"))
TESTS = REPOSITORY / "tests"
FOLDER = open_generated("pendubot")
SANITIZED = ["-fsanitize=fuzzer,address,undefined", "-fno-sanitize-recover=all"]


@dataclass(frozen=True)
class Target:
    """A harness, what is compiled beside it, and the committed inputs of its own."""

    harness: str
    sources: tuple[str, ...]
    corpus: str
    names: tuple[str, ...] = ()
    longest: int = 1024


_TORQUE = ("-DPF_TORQUE=tau", "-DPF_LIMIT=torque_limit")
TARGETS = {
    "step": Target(
        "fuzz_step.c",
        ("pendubot.c", "pendubot_params.c", "pf_elementary.c"),
        "fuzz_corpus",
        (*_TORQUE, "-DPF_SET=pendubot_params_rig"),
        512,
    ),
    "supervisor": Target("fuzz_supervisor.c", (), "fuzz_corpus_supervisor"),
    "control": Target(
        "fuzz_control.c",
        (
            *(f"pendubot{part}.c" for part in ("", "_swing_up", "_follow", "_plan")),
            "pendubot_control_params.c",
            *(f"pf_{part}.c" for part in ("sensing", "supervisor", "elementary")),
        ),
        "fuzz_corpus_control",
        (
            *_TORQUE,
            '-DPF_CONTROL_SOURCE="pendubot_control.c"',
            "-DPF_CONTROL_SET=pendubot_control_rig",
            "-DPF_CONTROL_CHECKSUM=pendubot_control_checksum",
        ),
    ),
}


def needs(name):
    return pytest.mark.skipif(
        not shutil.which(name), reason=f"needs {name}: apt-get install {name} libclang-rt-14-dev"
    )


def build(target, compiler, flags, folder, spoil=None):
    """Build a target in `folder`; `spoil` is (file, before, after), a fault to be planted."""
    c = folder / "c"
    shutil.copytree(FOLDER.path / "c", c)
    for path in runtime_c().glob("pf_s*.[ch]"):
        shutil.copy(path, c)
    if spoil:
        path, old, new = c / spoil[0], spoil[1], spoil[2]
        assert path.read_text().count(old) == 1
        path.write_text(path.read_text().replace(old, new))
    sources = [TESTS / target.harness, *(c / name for name in target.sources)]
    if "fuzzer" not in flags[0]:
        sources.append(TESTS / "fuzz_replay.c")
    command = [compiler, "-std=c99", "-O1", "-g", "-ffp-contract=off", "-fno-math-errno"]
    command += [*flags, *target.names, f"-I{c}", *map(str, sources), "-o", "attack", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode and "libclang_rt" in done.stderr:
        pytest.skip("needs clang's sanitizers: apt-get install libclang-rt-14-dev")
    assert done.returncode == 0, done.stderr


def attack(target, folder, seconds):
    (folder / "found").mkdir(exist_ok=True)
    command = ["./attack", f"-max_len={target.longest}", "-seed=1", f"-max_total_time={seconds}"]
    done = subprocess.run(
        [*command, "found", str(TESTS / target.corpus)],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stderr


@needs("clang")
@pytest.mark.parametrize("name", TARGETS)
def test_the_fuzzer_finds_nothing(name, tmp_path):
    build(TARGETS[name], "clang", SANITIZED, tmp_path)
    code, said = attack(TARGETS[name], tmp_path, SECONDS)
    assert code == 0, said[-4000:]
    runs = int(re.search(r"Done (\d+) runs", said)[1])
    print(f"\nfuzzer on {name}: {runs} executions in {SECONDS} s, no finding")
    assert runs > 0


#: What is attacked, and what is planted: file, before, after.
FAULTS = {
    "a limit that is not checked": (
        "step",
        ("pendubot.c", "if (!(params->torque_limit > 0.0))", "if (0)"),
    ),
    "a result that is not checked": (
        "step",
        (
            "pendubot.c",
            "if (!(finite < 1.0)) {\n        return rejected",
            "if (0) {\n        return rejected",
        ),
    ),
    "a saturation left out": (
        "step",
        (
            "pendubot.c",
            "? ((torque_slewed < 0.0) ?",
            "&& 0 ? ((torque_slewed < 0.0) ?",
        ),
    ),
    "a fault that is not latched": (
        "supervisor",
        ("pf_supervisor.c", "(input->command == (uint32_t)PF_COMMAND_RESET) &&", "1 &&"),
    ),
    "a mode that is believed": (
        "supervisor",
        ("pf_supervisor.c", "        && (state->mode <= (uint32_t)PF_MODE_FAULT)\n", ""),
    ),
    "a memory that is believed": (
        "control",
        ("pendubot_control.c", "is_whole = memory_checksum(state) == state->seal", "is_whole = 1"),
    ),
    "a command without its limit": (
        "control",
        (
            "pendubot_control.c",
            "pf_slewed(demand.tau, state->tau_applied,\n"
            "            params->law.slew_limit * params->law.sample_time,"
            " params->law.torque_limit)",
            "demand.tau",
        ),
    ),
    "a checksum that is not looked at": (
        "control",
        ("pendubot_control.c", "if (seen != params->checksum) {", "if (0) {"),
    ),
}


@needs("clang")
@pytest.mark.parametrize("fault", FAULTS)
def test_the_fuzzer_finds_a_planted_fault(fault, tmp_path):
    name, spoil = FAULTS[fault]
    build(TARGETS[name], "clang", SANITIZED, tmp_path, spoil)
    code, said = attack(TARGETS[name], tmp_path, 60)
    assert code != 0
    assert "ERROR: libFuzzer: deadly signal" in said or "runtime error" in said


@needs("gcc")
@pytest.mark.parametrize("name", TARGETS)
def test_the_corpus_is_small_and_every_input_of_it_is_answered(name, tmp_path):
    inputs = sorted((TESTS / TARGETS[name].corpus).iterdir())
    assert 10 < len(inputs) < 200
    assert sum(p.stat().st_size for p in inputs) < 64_000
    build(TARGETS[name], "gcc", ["-fsanitize=undefined", "-fno-sanitize-recover=all"], tmp_path)
    done = subprocess.run(
        ["./attack", *map(str, inputs)], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{len(inputs)} inputs\n"
