"""The C of the sensing module: without a warning, freestanding, safe on garbage."""

import io
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec

import pytest
from pfaffian.runtime.code.sensing import sensing_sources
from pfaffian.runtime.machine.target_files import read_target
from pfaffian.runtime.machine.toolchain import COMMON_FLAGS, GCC_PPC

WARNINGS = (
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow"),
    *("-Wdouble-promotion", "-Wfloat-equal", "-Werror"),
)
OF_C = ("-Wstrict-prototypes", "-Wmissing-prototypes")
SOURCES = sensing_sources()
FOLDER = SOURCES[0].parent
ZIG = (sys.executable, "-m", "ziglang", "cc")
needs_gcc = pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
needs_zig = pytest.mark.skipif(not find_spec("ziglang"), reason="needs the package ziglang")
needs_gcc_ppc = pytest.mark.skipif(not shutil.which(GCC_PPC), reason=f"needs {GCC_PPC}")
COMPILERS = [
    pytest.param(("gcc",), id="gcc", marks=needs_gcc),
    pytest.param(ZIG, id="zig", marks=needs_zig),
]
PPC750 = {t.name: t.flags for t in read_target("ppc750").toolchains}
TARGETS = [
    pytest.param((GCC_PPC, *PPC750["gcc"]), id="gcc", marks=needs_gcc_ppc),
    pytest.param((*ZIG, *PPC750["zig"]), id="zig", marks=needs_zig),
]


def compiled(command, folder):
    done = subprocess.run(
        [*map(str, command), "-o", "out"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return folder / "out"


@pytest.mark.parametrize("command", [*COMPILERS, *TARGETS])
def test_sources_compile_without_a_warning(command, tmp_path):
    flags = [f for f in (*command, *COMMON_FLAGS) if not f.startswith(("-nostdlib", "-static"))]
    for source in SOURCES:
        compiled([*flags, *WARNINGS, *OF_C, "-c", source], tmp_path)


@needs_gcc
@pytest.mark.parametrize("language", ["c", "cpp"])
def test_header_compiles_alone(language, tmp_path):
    if language == "cpp" and not shutil.which("g++"):
        pytest.skip("needs g++")
    alone = tmp_path / f"alone.{language}"
    alone.write_text('#include "pf_sensing.h"\n#include "pf_sensing.h"\n', encoding="utf-8")
    command = ("gcc", "-std=c99", *OF_C) if language == "c" else ("g++", "-std=c++11")
    compiled([*command, *WARNINGS, f"-I{FOLDER}", "-c", alone], tmp_path)


@pytest.mark.target
@pytest.mark.parametrize("command", TARGETS)
def test_powerpc_object_needs_no_library_and_holds_no_writable_data(command, tmp_path):
    from elftools.elf.elffile import ELFFile

    flags = [f for f in (*command, *COMMON_FLAGS) if not f.startswith(("-nostdlib", "-static"))]
    elf = ELFFile(io.BytesIO(compiled([*flags, "-c", SOURCES[0]], tmp_path).read_bytes()))
    symbols = list(elf.get_section_by_name(".symtab").iter_symbols())
    assert not [s.name for s in symbols if s["st_shndx"] == "SHN_UNDEF" and s.name]
    seen = {s.name for s in symbols if s["st_info"]["bind"] == "STB_GLOBAL"}
    names = ("init", "retune", "step", "rezero", "may_rezero")
    assert seen == {f"pf_sensing_{n}" for n in names}
    assert not [s.name for s in elf.iter_sections() if s["sh_flags"] & 3 == 3 and s["sh_size"]]


def test_only_freestanding_headers_are_included():
    text = "".join(p.read_text(encoding="utf-8") for p in (*SOURCES, FOLDER / "pf_sensing.h"))
    text += (FOLDER / "pf_arithmetic.h").read_text(encoding="utf-8")
    assert set(re.findall(r"#\s*include\s*<([^>]+)>", text)) == {"stdint.h"}


_GARBAGE = """
#include "pf_sensing.h"

static uint32_t seed = 1U;

static uint32_t any(void)
{
    seed = seed * 1664525U + 1013904223U;
    return (seed >> 16) | (seed << 16);
}

static double any_double(void)
{
    union { uint64_t bits; double value; } of;

    of.bits = ((uint64_t)any() << 32) | any();
    return ((any() & 3U) == 0U) ? of.value : (double)any() / (double)(1U + (any() >> 9));
}

int main(void)
{
    static const uint32_t widths[] = { 8U, 16U, 24U, 32U };
    uint32_t i, k, good = 0U;

    for (i = 0U; i < 20000U; ++i) {
        pf_sensing_params_t p = { 5000.0, 0.0, 1e-3, 300.0, 0.7, 0U, 32U, 0U, 100U, 8U, 1 };
        pf_sensing_state_t state;
        pf_sensing_output_t out;

        p.counter_bits = widths[any() & 3U];
        p.largest_jump = any() >> (8U + (any() & 15U));
        p.longest_gap = any() >> (26U + (any() & 3U));
        p.estimator = any() & 1U;
        p.direction = ((any() & 1U) == 0U) ? 1 : -1;
        switch (any() & 15U) {
        case 0U: p.counts_per_turn = any_double(); break;
        case 1U: p.offset = any_double(); break;
        case 2U: p.sample_time = any_double(); break;
        case 3U: p.bandwidth = any_double(); break;
        case 4U: p.damping = any_double(); break;
        case 5U: p.estimator = any(); break;
        case 6U: p.counter_bits = any(); break;
        case 7U: p.counter_zero = any(); break;
        case 8U: p.direction = (int32_t)(any() >> 1); break;
        default: break;
        }
        good += (pf_sensing_init(&state, &p) == PF_SENSING_OK) ? 1U : 0U;
        for (k = 0U; k < 200U; ++k) {
            pf_sensing_input_t in;

            in.raw = ((any() & 7U) == 0U) ? any() : state.raw + (any() & 255U) - 128U;
            in.valid = any() & 3U;
            (void)pf_sensing_step(&state, &in, &out);
            if (!((out.velocity - out.velocity) >= 0.0) || !((out.angle - out.angle) >= 0.0)) {
                return 1;
            }
        }
    }
    return (good > 4000U) ? 0 : 2;
}
"""


@needs_gcc
def test_sanitizers_find_nothing_on_garbage(tmp_path):
    main = tmp_path / "main.c"
    main.write_text(_GARBAGE, encoding="utf-8")
    kinds = "address,undefined,float-divide-by-zero,float-cast-overflow"
    command = ["gcc", "-std=c99", "-O1", "-g", "-ffp-contract=off", f"-fsanitize={kinds}"]
    command += ["-fno-sanitize-recover=all", f"-I{FOLDER}", main, SOURCES[0]]
    try:
        program = compiled(command, tmp_path)
    except AssertionError as error:
        if "cannot find" in str(error):
            pytest.skip("this gcc has no sanitizers")
        raise
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr or f"exit code {done.returncode}"
