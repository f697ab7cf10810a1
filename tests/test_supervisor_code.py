"""The C of the supervisor: without a warning, freestanding, safe on garbage."""

import io
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec

import pytest
from pfaffian.runtime.code.supervision import supervisor_sources
from pfaffian.runtime.machine.target_files import read_target
from pfaffian.runtime.machine.toolchain import COMMON_FLAGS, GCC_PPC

WARNINGS = (
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow"),
    *("-Wdouble-promotion", "-Wfloat-equal", "-Werror"),
)
OF_C = ("-Wstrict-prototypes", "-Wmissing-prototypes")
SOURCES = supervisor_sources()
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
    alone.write_text('#include "pf_supervisor.h"\n#include "pf_supervisor.h"\n', encoding="utf-8")
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
    declared = re.findall(r"\b(pf_\w+)\(", (FOLDER / "pf_supervisor.h").read_text(encoding="utf-8"))
    assert seen == set(declared)
    assert not [s.name for s in elf.iter_sections() if s["sh_flags"] & 3 == 3 and s["sh_size"]]


def test_only_freestanding_headers_are_included():
    text = "".join(p.read_text(encoding="utf-8") for p in (*SOURCES, FOLDER / "pf_supervisor.h"))
    assert set(re.findall(r"#\s*include\s*<([^>]+)>", text)) == {"stdint.h", "float.h"}


_GARBAGE = """
#include "pf_supervisor.h"

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

static void fill(uint32_t *words, uint32_t count)
{
    while (count > 0U) {
        count -= 1U;
        words[count] = any();
    }
}

static int is_valid(const pf_supervisor_output_t *out)
{
    const int active = (out->mode == PF_MODE_SWING_UP) || (out->mode == PF_MODE_BALANCE);

    return (out->mode <= PF_MODE_FAULT) && (out->fault <= PF_FAULT_PARAMETER_FIXED)
        && (out->reason <= PF_REASON_REZERO_REFUSED) && (out->torque_allowed == (active ? 1U : 0U));
}

int main(void)
{
    union { pf_supervisor_state_t of; uint32_t words[sizeof(pf_supervisor_state_t) / 4]; } state;
    union { pf_supervisor_params_t of; uint32_t words[sizeof(pf_supervisor_params_t) / 4]; } p;
    union { pf_supervisor_input_t of; uint32_t words[sizeof(pf_supervisor_input_t) / 4]; } in;
    pf_supervisor_output_t out;
    pf_transition_t entry;
    uint32_t i, k, active = 0U;

    for (i = 0U; i < 4000U; ++i) {
        fill(p.words, sizeof(p) / 4);
        if ((i & 7U) != 0U) {
            for (k = 0U; k < PF_MEASURES; ++k) {
                p.of.capture_limit[k] = 1.0;
                p.of.release_limit[k] = 2.0;
            }
            p.of.sample_time = 1e-3;
            p.of.shortest_period = 0.0;
            p.of.longest_period = 1000.0;
            p.of.watchdog_time = 0.0;
            p.of.swing_up_timeout = ((i & 1U) == 0U) ? 0.0 : 0.02;
            p.of.capture_periods = 1U + (any() & 3U);
            p.of.release_periods = 1U + (any() & 3U);
            p.of.attempts &= 3U;
        }
        if ((i & 3U) == 0U) {
            fill(state.words, sizeof(state) / 4);
        } else {
            (void)pf_supervisor_init(&state.of, &p.of);
        }
        for (k = 0U; k < 200U; ++k) {
            fill(in.words, sizeof(in) / 4);
            if ((any() & 31U) != 0U) {
                in.of.checks = 0U;
                in.of.position &= ~PF_POSITION_UNREAD;
                in.of.measures = 1U + (any() & 7U);
                in.of.elapsed = 1e-3;
                in.of.measure[0] = (double)(any() & 3U);
                in.of.command = ((any() & 15U) == 0U) ? any() & 3U : PF_COMMAND_START;
            }
            pf_supervisor_step(&state.of, &p.of, &in.of, &out);
            active += out.torque_allowed;
            if (!is_valid(&out)) {
                return 1;
            }
            if ((any() & 63U) == 0U) {
                pf_supervisor_trip(&state.of, (pf_fault_t)(any() & 15U), &out);
                if (!is_valid(&out) || (out.torque_allowed != 0U)) {
                    return 2;
                }
            }
            (void)pf_supervisor_log_read(&state.of, any(), &entry);
            (void)pf_nearest_turn(any_double(), any_double());
            if (!(pf_slewed(any_double(), any_double(), any_double(), 1.0) <= 1.0)) {
                return 3;
            }
        }
    }
    return (active > 10000U) ? 0 : 4;
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
