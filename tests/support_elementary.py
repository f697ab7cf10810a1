"""Builds the emitted elementary functions for hosts and target, and measures their errors."""

from __future__ import annotations

import ctypes
import math
import os
import struct
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import gmpy2
import numpy as np
import numpy.typing as npt
from pfaffian.benchmarks.function import elementary_sources
from pfaffian.derive.elementary.coefficients import render_context

Array = npt.NDArray[np.float64]

#: How many points each part of a domain is measured at; `make elementary` sets it high.
POINTS = int(os.environ.get("PFAFFIAN_ELEMENTARY_POINTS", "15000"))

#: Order of the cases in the batch function below. The last takes its second argument from z.
FUNCTIONS = (
    *("sqrt", "sin", "cos", "atan", "exp", "expm1", "tanh", "sincos", "is_finite"),
    *("sqrt_software", "sincos_inline", "atan_inline"),
    *("log", "asin", "acos", "sinh", "cosh", "atan2"),
)

#: Functions that write both rows.
PAIRS = ("sincos", "sincos_inline")

SOURCES = ("pf_elementary.c", "batch.c")
BASE_FLAGS = ("-std=c99", "-ffp-contract=off", "-fno-math-errno")
WARNINGS = (
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wsign-conversion", "-Werror"),
    *("-Wdouble-promotion", "-Wfloat-equal", "-Wshadow", "-Wstrict-prototypes"),
)
ZIG = (sys.executable, "-m", "ziglang", "cc")
TARGET_FLAGS = (
    *("-target", "powerpc-freestanding-eabihf", "-mcpu=750", "-O2", "-fno-sanitize=all"),
    *("-fno-math-errno", "-ffreestanding", "-fno-builtin", "-fomit-frame-pointer"),
)

_BATCH = """
#include "pf_elementary_further.h"

#include <stdint.h>

void batch(int32_t which, int32_t count, const double *x, double *y, double *z);

void batch(int32_t which, int32_t count, const double *x, double *y, double *z)
{
    for (int32_t i = 0; i < count; i++) {
        switch (which) {
        case 0: y[i] = pf_sqrt(x[i]); break;
        case 1: y[i] = pf_sin(x[i]); break;
        case 2: y[i] = pf_cos(x[i]); break;
        case 3: y[i] = pf_atan(x[i]); break;
        case 4: y[i] = pf_exp(x[i]); break;
        case 5: y[i] = pf_expm1(x[i]); break;
        case 6: y[i] = pf_tanh(x[i]); break;
        case 7: pf_sincos(x[i], &y[i], &z[i]); break;
        case 9: y[i] = pf_sqrt_software(x[i]); break;
        case 10: pf_sincos_inline(x[i], &y[i], &z[i]); break;
        case 11: y[i] = pf_atan_inline(x[i]); break;
        case 12: y[i] = pf_log(x[i]); break;
        case 13: y[i] = pf_asin(x[i]); break;
        case 14: y[i] = pf_acos(x[i]); break;
        case 15: y[i] = pf_sinh(x[i]); break;
        case 16: y[i] = pf_cosh(x[i]); break;
        case 17: y[i] = pf_atan2(x[i], z[i]); break;
        default: y[i] = pf_is_finite(x[i]) ? 1.0 : 0.0; break;
        }
    }
}
"""

#: Maps a function name and its arguments to the results; two rows from sincos, and into atan2.
Evaluate = Callable[[str, Array], Array]


def render(directory: Path) -> Path:
    """Write header, source and the batch driver into `directory`, and return it."""
    directory.mkdir(parents=True, exist_ok=True)
    for name, text in elementary_sources(
        "/* test build */", render_context(), further=True
    ).items():
        (directory / name).write_text(text, encoding="utf-8")
    (directory / "batch.c").write_text(_BATCH, encoding="utf-8")
    return directory


def run(command: Iterable[str], directory: Path) -> None:
    """Run a compiler and fail with what it said."""
    done = subprocess.run(list(command), cwd=directory, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"


def host_build(directory: Path, name: str, compiler: tuple[str, ...], *flags: str) -> Evaluate:
    """Compile with `compiler`, link with gcc, and load the result."""
    for source in SOURCES:
        output = f"{name}_{Path(source).stem}.o"
        run((*compiler, *BASE_FLAGS, *flags, "-fPIC", "-c", source, "-o", output), directory)
    objects = [f"{name}_{Path(source).stem}.o" for source in SOURCES]
    run(("gcc", "-shared", *objects, "-o", f"{name}.so", "-lm"), directory)
    batch = ctypes.CDLL(str(directory / f"{name}.so")).batch
    batch.restype = None
    batch.argtypes = [ctypes.c_int32, ctypes.c_int32, *[ctypes.c_void_p] * 3]

    def evaluate(function: str, x: Array) -> Array:
        x, results = arguments_of(function, x)
        rows = (x.ctypes.data, results[0].ctypes.data, results[1].ctypes.data)
        batch(FUNCTIONS.index(function), x.size, *rows)
        return results if function in PAIRS else results[0]

    return evaluate


def target_build(directory: Path) -> Evaluate:
    """Compile for the PowerPC, without any library, and load the result into the emulator."""
    link = ("-nostdlib", "-static", "-Wl,-e,batch", "-Wl,--image-base=0x10000")
    command = (*ZIG, *BASE_FLAGS, *TARGET_FLAGS, *link, *SOURCES, "-o", "target.elf")
    run(command, directory)
    return _emulated(directory / "target.elf")


def _emulated(elf_path: Path) -> Evaluate:
    from elftools.elf.elffile import ELFFile
    from unicorn import UC_ARCH_PPC, UC_MODE_32, UC_MODE_BIG_ENDIAN, Uc
    from unicorn import ppc_const as ppc

    stub, stack, data, page = 0x0000_1000, 0x0080_0000, 0x0100_0000, 0x1000
    machine = Uc(UC_ARCH_PPC, UC_MODE_32 | UC_MODE_BIG_ENDIAN)
    machine.ctl_set_cpu_model(ppc.UC_CPU_PPC32_750GX_V1_2)
    with elf_path.open("rb") as stream:
        elf = ELFFile(stream)
        entry = elf.header.e_entry
        segments = [s for s in elf.iter_segments() if s.header.p_type == "PT_LOAD"]
        end = max(s.header.p_vaddr + s.header.p_memsz for s in segments)
        machine.mem_map(0x10000, -(-(end - 0x10000) // page) * page)
        for segment in segments:
            machine.mem_write(segment.header.p_vaddr, segment.data())
    machine.mem_map(stub, page)
    machine.mem_map(stack, 16 * page)
    machine.mem_map(data, 0x0100_0000)

    def evaluate(function: str, x: Array) -> Array:
        x, results = arguments_of(function, x)
        rows = [data + k * 8 * x.size for k in range(3)]
        machine.mem_write(rows[0], x.astype(">f8").tobytes())
        machine.mem_write(rows[1], results.astype(">f8").tobytes())
        machine.reg_write(ppc.UC_PPC_REG_MSR, 0x2000)
        machine.reg_write(ppc.UC_PPC_REG_1, stack + 15 * page)
        machine.reg_write(ppc.UC_PPC_REG_LR, stub)
        for register, value in enumerate((FUNCTIONS.index(function), x.size, *rows)):
            machine.reg_write(ppc.UC_PPC_REG_3 + register, value)
        machine.emu_start(entry, stub)
        raw = bytes(machine.mem_read(rows[1], 16 * x.size))
        results = np.frombuffer(raw, dtype=">f8").astype(np.float64).reshape(2, -1)
        return results if function in PAIRS else results[0]

    return evaluate


def arguments_of(function: str, x: Array) -> tuple[Array, Array]:
    """Return the first arguments, and two rows for results, the second with second arguments."""
    x = np.ascontiguousarray(x, dtype=np.float64)
    if function != "atan2":
        return x, np.zeros((2, x.size))
    return x[0].copy(), np.ascontiguousarray([np.zeros(x.shape[1]), x[1]])


def bits_of(values: Array) -> npt.NDArray[np.uint64]:
    """Return the bits of each value, which NaN and signed zeros also compare by."""
    return np.ascontiguousarray(values, dtype=np.float64).view(np.uint64)


def value_of(bits: int) -> float:
    """Return the double with these bits."""
    (value,) = struct.unpack("<d", struct.pack("<Q", bits))
    return float(value)


def ulp_errors(name: str, x: Array, y: Array) -> Array:
    """Return the error of each y as f(x), in units in the last place of the exact result."""
    errors = np.empty(y.size)
    rows = np.atleast_2d(x).T.tolist()
    with gmpy2.context(precision=200) as context:
        exact_function = getattr(context, name)
        for k, (arguments, result) in enumerate(zip(rows, y.tolist(), strict=True)):
            exact = exact_function(*map(gmpy2.mpfr, arguments))
            nearest = float(exact)
            ulp = math.ulp(nearest)
            if abs(nearest) > abs(exact) and math.frexp(nearest)[0] in (0.5, -0.5):
                ulp = max(ulp / 2, 2.0**-1074)  # the exact result lies below the power of two
            errors[k] = abs(float(result - exact)) / ulp
    return errors


def assert_within(name: str, bound: float, x: Array, y: Array) -> None:
    """Fail, naming the worst point, where an error is above `bound` ulp."""
    errors = ulp_errors(name, x, y)
    worst = int(np.argmax(np.nan_to_num(errors, nan=np.inf)))
    arguments = ", ".join(value.hex() for value in np.atleast_2d(x)[:, worst].tolist())
    report = f"{name}({arguments}) = {y[worst].hex()} is {errors[worst]:.4f} ulp off"
    assert errors[worst] <= bound, report
