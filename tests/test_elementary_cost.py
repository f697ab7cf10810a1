"""What the emitted elementary functions cost: instructions on the emulated 750, and what is linked.

Counts are of instructions, which the compiler and the code decide and no clock does.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from pfaffian.runtime.machine.emulator import Ppc750Machine
from pfaffian.runtime.machine.toolchain import COMMON_FLAGS, Target, ppc750_target
from support_elementary import FUNCTIONS, SOURCES, WARNINGS, Array, render, run

pytestmark = pytest.mark.target

#: Most instructions of one call, by whichever compiler, from entry to return.
LIMITS = {"sincos": 62, "sin": 62, "cos": 62, "atan": 45, "sqrt": 40}

#: Most by which two calls within the domain may differ: the branches that are left.
SPREAD = {"sincos": 0, "sin": 0, "cos": 0, "atan": 5, "sqrt": 6}

_CALLERS = """
#include "pf_elementary_inline.h"
void called(const double *x, double *y);
void called(const double *x, double *y)
{
    pf_sincos(x[0], &y[0], &y[1]);
    y[2] = pf_atan(x[1]);
    y[3] = pf_sqrt(x[2]);
}
void inlined(const double *x, double *y);
void inlined(const double *x, double *y)
{
    pf_sincos_inline(x[0], &y[0], &y[1]);
    y[2] = pf_atan_inline(x[1]);
    y[3] = pf_sqrt_inline(x[2]);
}
"""


def toolchains() -> list[str]:
    return ["zig", *(["gcc"] if shutil.which("powerpc-linux-gnu-gcc") else [])]


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = render(tmp_path_factory.mktemp("cost"))
    (folder / "callers.c").write_text(_CALLERS, encoding="utf-8")
    return folder


def image(target: Target, folder: Path, entry: str, *extra: str, names: tuple[str, ...]) -> bytes:
    flags = (*COMMON_FLAGS, *target.flags, *target.link, *extra, f"-Wl,-e,{entry}")
    run((*target.command, *flags, *names, "-o", f"{entry}.elf"), folder)
    return (folder / f"{entry}.elf").read_bytes()


def arguments(name: str) -> Array:
    rng = np.random.default_rng(1)
    x: Array = np.concatenate([rng.uniform(-7, 7, 40), [1e-9, 0.5, 1.0, -20.0, 300.0, 0.0]])
    if name == "sqrt":
        return np.abs(x)
    return x if name == "atan" else np.concatenate([x, rng.uniform(-1e5, 1e5, 20)])


@pytest.mark.parametrize("toolchain", toolchains())
def test_every_call_costs_about_the_same(sources: Path, toolchain: str) -> None:
    target = ppc750_target(toolchain)
    machine = Ppc750Machine(image(target, sources, "batch", names=SOURCES))
    for name, limit in LIMITS.items():
        counts = []
        for value in arguments(name).tolist():
            x, y, z = (np.array([v], dtype=">f8") for v in (value, 0.0, 0.0))
            which = FUNCTIONS.index(name)
            count, _ = machine.measure(
                f"pf_{name}", lambda w=which, a=(x, y, z): machine.call("batch", w, 1, *a)
            )
            counts.append(count)
        assert max(counts) <= limit, f"{name}: {counts}"
        assert max(counts) - min(counts) <= SPREAD[name], f"{name}: {counts}"


@pytest.mark.parametrize("toolchain", toolchains())
def test_inlined_costs_less_and_gives_the_same_bits(sources: Path, toolchain: str) -> None:
    target = ppc750_target(toolchain)
    names = ("pf_elementary.c", "callers.c")
    machine = Ppc750Machine(image(target, sources, "called", names=names))
    counts, results = [], []
    for function in ("called", "inlined"):
        x, y = np.array([1.0, 2.0, 3.0], dtype=">f8"), np.zeros(4, dtype=">f8")
        counts.append(
            machine.measure(function, lambda f=function, a=(x, y): machine.call(f, *a))[0]
        )
        results.append(y.tobytes())
    assert results[0] == results[1]
    assert counts[1] + 20 <= counts[0], counts


@pytest.mark.parametrize("toolchain", toolchains())
def test_linker_drops_what_nothing_calls(sources: Path, toolchain: str) -> None:
    sections = ("-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections")
    target = ppc750_target(toolchain)
    linked = image(target, sources, "pf_atan", *sections, names=("pf_elementary.c",))
    names = Ppc750Machine(linked).symbols
    ours = {name for name in names if name.startswith("pf_") and "." not in name}
    assert ours == {"pf_atan", "pf_atan_table"}


@pytest.mark.parametrize("toolchain", toolchains())
def test_inline_header_compiles_alone_without_a_warning(sources: Path, toolchain: str) -> None:
    target = ppc750_target(toolchain)
    (sources / "alone.c").write_text('#include "pf_elementary_inline.h"\n', encoding="utf-8")
    quiet = ("-Wno-unused-command-line-argument",) if toolchain == "zig" else ()
    flags = [f for f in (*COMMON_FLAGS, *target.flags) if not f.startswith("-Wl")]
    run((*target.command, *flags, *WARNINGS, *quiet, "-c", "alone.c", "-o", "alone.o"), sources)
