"""Arithmetic that is not IEEE 754's is refused: by the compiler where it tells, else by init."""

import ctypes
import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from conftest import REPOSITORY
from pfaffian.runtime.code.generated_model import open_generated
from pfaffian.runtime.code.supervision import host_supervisor
from pfaffian.runtime.machine.sources import control_sources, runtime_c
from pfaffian.runtime.machine.target_files import read_target
from pfaffian.runtime.machine.toolchain import GCC_PPC, processor_has_fma

FOLDER = open_generated("pendubot")
C, RUNTIME = FOLDER.path / "c", runtime_c()
ZIG = (sys.executable, "-m", "ziglang", "cc")
PPC = tuple(f for f in next(t for t in read_target("ppc750").toolchains if t.name == "zig").flags)
COMPILERS = {
    "gcc": ("gcc",),
    "clang": ("clang",),
    "zig": ZIG,
    "gcc-ppc750": (GCC_PPC, "-mcpu=750"),
    "zig-ppc750": (*ZIG, *(f for f in PPC if not f.startswith(("-nostdlib", "-static", "-Wl")))),
}
#: What no compiler may be told, and those that say so to the file that they compile.
TELLING = {
    "-ffast-math": tuple(COMPILERS),
    "-ffinite-math-only": tuple(COMPILERS),
    "-funsafe-math-optimizations": ("gcc", "gcc-ppc750"),
    "-fassociative-math -fno-signed-zeros -fno-trapping-math": ("gcc", "gcc-ppc750"),
    "-freciprocal-math": ("gcc", "gcc-ppc750"),
    "-fno-signed-zeros": ("gcc", "gcc-ppc750"),
    "-fsingle-precision-constant": ("gcc", "gcc-ppc750"),
    "-mfpmath=both": ("gcc",),
    "-m32 -mno-sse -mfpmath=387": ("gcc", "clang"),
    "-std=c99 -ffp-contract=fast": ("gcc", "gcc-ppc750"),
}
#: The others: init finds out. A contraction needs a processor that can.
SILENT = {
    "-funsafe-math-optimizations": ("clang", "zig"),
    "-fassociative-math -fno-signed-zeros -fno-trapping-math": ("clang", "zig"),
    "-freciprocal-math": ("clang", "zig"),
    "-fno-signed-zeros": ("clang", "zig"),
    "-fno-honor-nans": ("clang",),
    "-std=gnu99 -mfma -ffp-contract=fast": ("gcc", "clang", "zig"),
    "-mfma -ffp-contract=on": ("clang", "zig"),
}
#: zig compiles from scratch for seconds each: `make prove` takes all of its cases.
ALL = os.environ.get("PFAFFIAN_PROVE_ALL")
SHORT = {
    ("zig", "-freciprocal-math"),
    ("zig", "-mfma -ffp-contract=on"),
    ("zig-ppc750", "-ffinite-math-only"),
}
GOOD = ("-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno")


def needs(name):
    command = COMPILERS[name]
    if "ziglang" in command:
        there = find_spec("ziglang") is not None
    else:
        there = shutil.which(command[0]) is not None
    return pytest.mark.skipif(not there, reason=f"needs {name}")


def cases(table):
    return [
        pytest.param(name, tuple(flags.split()), id=f"{name} {flags}", marks=needs(name))
        for flags, names in table.items()
        for name in names
        if ALL or not name.startswith("zig") or (name, flags) in SHORT
    ]


def run(command, folder):
    return subprocess.run(
        [*map(str, command)], cwd=folder, capture_output=True, text=True, check=False
    )


def computing():
    """Return every C file that computes: all but tables of constants and what only moves bytes."""
    own = [p for p in sorted(C.glob("*.c")) if not p.name.endswith("_params.c")]
    modules = [
        RUNTIME / f"pf_{n}.c" for n in ("sensing", "supervisor", "twin", "harness", "flight")
    ]
    return [*own, *modules]


@pytest.mark.parametrize(("name", "flags"), cases(TELLING))
def test_a_compiler_that_tells_is_refused_in_every_file_that_computes(name, flags, tmp_path):
    command = (*COMPILERS[name], *GOOD, *flags, "-ffreestanding", f"-I{C}", f"-I{RUNTIME}")
    whole = flags == ("-ffinite-math-only",) and name.startswith("gcc")
    for source in computing() if whole else computing()[:1]:
        done = run((*command, "-fsyntax-only", source), tmp_path)
        assert done.returncode != 0, source.name
        assert re.search(r"pf_arithmetic\.h:\d+:\d+: error", done.stderr), done.stderr


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=needs(n)) for n in ("gcc", "clang", "gcc-ppc750")]
)
def test_every_file_that_computes_is_compiled_with_the_flags_that_are_asked_for(name, tmp_path):
    command = (*COMPILERS[name], *GOOD, "-ffreestanding", f"-I{C}", f"-I{RUNTIME}")
    for source in computing():
        done = run((*command, "-fsyntax-only", source), tmp_path)
        assert done.returncode == 0, done.stderr


def test_every_generated_file_that_computes_looks_at_the_flags():
    """Of all ten models: in each a header of arithmetic is included, directly or by another."""
    for c in sorted((REPOSITORY / "generated").glob("*/c")):
        texts = {p.name: p.read_text(encoding="utf-8") for p in c.glob("*.[ch]")}

        def looks(name, seen=frozenset(), texts=texts):
            if name == "pf_arithmetic.h":
                return True
            found = re.findall(r'^#include "([^"]+)"', texts.get(name, ""), re.MULTILINE)
            return any(looks(n, seen | {name}) for n in found if n not in seen)

        names = [n for n in texts if n.endswith(".c") and not n.endswith("_params.c")]
        assert len(names) >= 4
        assert not [n for n in names if not looks(n)], c


def test_the_generated_header_is_that_of_the_runtime():
    """Either is used without the other."""
    bodies = {
        p.read_text(encoding="utf-8").split("#ifndef PF_ARITHMETIC_H", 1)[1]
        for p in (
            RUNTIME / "pf_arithmetic.h",
            *(REPOSITORY / "generated").glob("*/c/pf_arithmetic.h"),
        )
    }
    assert len(bodies) == 1


# --- What init finds -----------------------------------------------------------------------

PROGRAM = """
#include <fenv.h>
#include <stdio.h>
#include "pendubot_control.h"
static pendubot_control_state_t state;
static pendubot_control_output_t output;
static pendubot_control_input_t input;
int main(void)
{
    pf_supervisor_state_t supervisor;
    pf_sensing_state_t sensing;
    pendubot_state_t law;
    const pendubot_control_params_t *params = &pendubot_control_rig;

    BEFORE
    printf("%d %d %d %d ", (int)pendubot_init(&law, &params->law),
        (int)pf_sensing_init(&sensing, &params->q1_encoder),
        (int)pf_supervisor_init(&supervisor, &params->supervisor),
        (int)pendubot_control_init(&state, params));
    input.command = 1U;
    input.q1_valid = input.q2_valid = 1U;
    pendubot_control_step(&state, params, &input, &output);
    printf("%u %u %d\\n", (unsigned)output.mode, (unsigned)output.fault, output.tau != 0.0);
    return 0;
}
"""
#: law, sensing, supervisor, control; then mode, fault and torque of the period that follows.
HOLDS, BROKEN = [0, 0, 0, 0], [7, 6, 2, 7, 3, 14, 0]


def verdict(name, flags, folder, before="", prefix=()):
    (folder / "main.c").write_text(PROGRAM.replace("BEFORE", before))
    sources = control_sources(FOLDER.path, FOLDER.manifest)
    command = [*COMPILERS[name], *GOOD, *flags, f"-I{C}", f"-I{RUNTIME}", "main.c", *sources]
    if name.startswith("gcc-ppc"):
        command.append("-static")
    done = run([*command, "-o", "main", "-lm"], folder)
    assert done.returncode == 0, done.stderr
    done = run([*prefix, "./main"], folder)
    assert done.returncode == 0, done.stderr
    return [int(word) for word in done.stdout.split()]


@pytest.mark.parametrize(("name", "flags"), cases(SILENT))
def test_init_finds_what_its_compiler_does_not_tell(name, flags, tmp_path):
    if "-mfma" in flags and not processor_has_fma():
        pytest.skip("needs a processor with a fused multiply-add")
    assert verdict(name, flags, tmp_path) == BROKEN


@pytest.mark.parametrize("name", [pytest.param(n, marks=needs(n)) for n in ("gcc", "clang")])
@pytest.mark.parametrize("level", ["-O0", "-O3"])
def test_init_has_nothing_to_say_of_a_right_build(name, level, tmp_path):
    flags = (level, "-fno-sanitize=all", *(("-mfma",) if processor_has_fma() else ()))
    assert verdict(name, flags, tmp_path)[:4] == HOLDS


@needs("gcc-ppc750")
@pytest.mark.target
@pytest.mark.skipif(
    not shutil.which("qemu-ppc"), reason="needs qemu-ppc: apt-get install qemu-user"
)
def test_init_finds_a_contraction_on_the_target(tmp_path):
    """gcc's own default there, outside of -std=c99."""
    emulator = ("qemu-ppc", "-cpu", "750gx")
    assert verdict("gcc-ppc750", (), tmp_path, prefix=emulator)[:4] == HOLDS
    flags = ("-std=gnu99", "-ffp-contract=fast")
    assert verdict("gcc-ppc750", flags, tmp_path, prefix=emulator) == BROKEN


@needs("gcc")
@pytest.mark.parametrize("mode", ["FE_UPWARD", "FE_DOWNWARD", "FE_TOWARDZERO"])
def test_init_finds_another_rounding_of_the_processor(mode, tmp_path):
    assert verdict("gcc", (), tmp_path, f"(void)fesetround({mode});") == BROKEN


@needs("gcc")
@pytest.mark.skipif(not Path("/proc/cpuinfo").is_file(), reason="needs Linux")
@pytest.mark.parametrize("bit", ["0x8000U", "0x0040U"])
def test_init_finds_a_processor_without_subnormals(bit, tmp_path):
    """As a library that was linked with -ffast-math leaves it."""
    import platform

    if platform.machine() != "x86_64":
        pytest.skip("needs x86-64")
    before = f"__builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() | {bit});"
    assert verdict("gcc", (), tmp_path, before) == BROKEN


# --- Limiters, whatever the compiler believes ----------------------------------------------


@pytest.mark.parametrize("name", [pytest.param(n, marks=needs(n)) for n in ("gcc", "clang")])
def test_the_last_limiters_give_a_finite_value_even_where_no_nan_is_believed_in(name, tmp_path):
    """By force: with the guard removed and -ffinite-math-only, a NaN went through to the motor."""
    text = (RUNTIME / "pf_supervisor.c").read_text(encoding="utf-8")
    include = '#include "pf_arithmetic.h"\n'
    assert include in text
    forced = text.replace(include, "static int pf_arithmetic_holds(void) { return 1; }\n")
    (tmp_path / "forced.c").write_text(forced)
    flags = ("-std=c99", "-O3", "-ffinite-math-only", "-fPIC", "-shared", f"-I{RUNTIME}")
    done = run((*COMPILERS[name], *flags, "forced.c", "-o", "forced.so"), tmp_path)
    assert done.returncode == 0, done.stderr
    library = ctypes.CDLL(str(tmp_path / "forced.so"))
    limited, slewed = library.pf_limited, library.pf_slewed
    for function, count in ((limited, 2), (slewed, 4)):
        function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double] * count
    wild = (float("nan"), -float("nan"), float("inf"), -float("inf"), 1e300, 0.5)
    for value in wild:
        assert abs(limited(value, 2.0)) <= 2.0
        assert limited(0.5, value) == (0.5 if value in (0.5, 1e300) else 0.0)
        for previous in wild:
            for step in wild:
                assert abs(slewed(value, previous, step, 2.0)) <= 2.0
                assert slewed(value, previous, step, float("nan")) == 0.0
    assert limited(float("nan"), 2.0) == 0.0
    assert limited(float("inf"), 2.0) == 2.0
    assert limited(-float("inf"), 2.0) == -2.0


def test_no_bits_leave_the_last_limiters_unlimited():
    host, rng = host_supervisor(), np.random.default_rng(3)
    bits = rng.integers(0, 2**64, (4, 50_000), dtype=np.uint64)
    bits[:, rng.random(50_000) < 0.3] |= np.uint64(0x7FF0000000000000)
    value, previous, step, _ = bits.view(np.float64)
    limit = np.full(len(value), 2.0)
    for found in (host.limited(value, limit), host.slewed(value, previous, step, limit)):
        assert (np.abs(found) <= 2.0).all()
