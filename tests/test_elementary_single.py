"""The emitted elementary functions of single precision: errors, special values, nothing of double.

A double holds the exact result to 2^-29 of a single's last place, so NumPy's functions of double,
within a few of their own last places, serve as the reference.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from pfaffian.benchmarks.function import elementary_sources
from pfaffian.derive.elementary.coefficients import SINCOS_MAX
from pfaffian.derive.elementary.further import further_coefficients_single
from pfaffian.derive.elementary.single import (
    QUIET_NAN_BITS_SINGLE,
    ULP_BOUNDS_SINGLE,
    single_coefficients,
    single_render_context,
)
from pfaffian.derive.emit.precision import SINGLE
from pfaffian.runtime.machine.emulator import Ppc750Machine
from pfaffian.runtime.machine.toolchain import processor_has_fma
from support_elementary import BASE_FLAGS, POINTS, TARGET_FLAGS, WARNINGS, ZIG, run

Singles = npt.NDArray[np.float32]
Evaluate = Callable[[str, Singles], Singles]

INF = math.inf
SMALLEST = 2.0**-149
NAMES = (
    *("sqrt", "sin", "cos", "atan", "exp", "expm1", "tanh", "is_finite"),
    *("log", "asin", "acos", "sinh", "cosh"),
)
NO_DOUBLE = ("-Wdouble-promotion", "-Wfloat-conversion", "-Werror")

_BATCH = """
#include "pf_elementary_furtherf.h"
#include <stdint.h>
uint32_t batch(uint32_t which, uint32_t count, const float *x, float *y, float *z);
uint32_t batch(uint32_t which, uint32_t count, const float *x, float *y, float *z)
{
    for (uint32_t i = 0; i < count; i++) {
        switch (which) {
        case 0: y[i] = pf_sqrtf(x[i]); break;
        case 1: pf_sincosf(x[i], &y[i], &z[i]); break;
        case 2: pf_sincosf(x[i], &z[i], &y[i]); break;
        case 3: y[i] = pf_atanf(x[i]); break;
        case 4: y[i] = pf_expf(x[i]); break;
        case 5: y[i] = pf_expm1f(x[i]); break;
        case 6: y[i] = pf_tanhf(x[i]); break;
        case 8: y[i] = pf_logf(x[i]); break;
        case 9: y[i] = pf_asinf(x[i]); break;
        case 10: y[i] = pf_acosf(x[i]); break;
        case 11: y[i] = pf_sinhf(x[i]); break;
        case 12: y[i] = pf_coshf(x[i]); break;
        default: y[i] = pf_is_finitef(x[i]) ? 1.0f : 0.0f; break;
        }
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("single")
    made = elementary_sources("/* test build */", single_render_context(), SINGLE, further=True)
    for name, text in made.items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "batch.c").write_text(_BATCH, encoding="utf-8")
    return folder


def host_build(folder: Path, name: str, *flags: str) -> Evaluate:
    shared = ("-fPIC", "-shared", "pf_elementaryf.c", "batch.c", "-o", f"{name}.so", "-lm")
    run(("gcc", *BASE_FLAGS, *flags, *shared), folder)
    batch = ctypes.CDLL(str(folder / f"{name}.so")).batch
    batch.argtypes = [ctypes.c_uint32, ctypes.c_uint32, *[ctypes.c_void_p] * 3]

    def evaluate(function: str, x: Singles) -> Singles:
        x = np.ascontiguousarray(x, dtype=np.float32)
        y, z = np.zeros_like(x), np.zeros_like(x)
        batch(NAMES.index(function), x.size, x.ctypes.data, y.ctypes.data, z.ctypes.data)
        return y

    return evaluate


@pytest.fixture(scope="module")
def host(sources: Path) -> Evaluate:
    return host_build(sources, "host", "-O2", *(("-mfma",) if processor_has_fma() else ()))


def bits_of(x: Singles) -> npt.NDArray[np.uint32]:
    return np.ascontiguousarray(x, dtype=np.float32).view(np.uint32)


def spread(rng: np.random.Generator, low: float, high: float, count: int) -> Singles:
    sizes = np.exp2(rng.uniform(low, high, count))
    return (sizes * rng.choice([-1.0, 1.0], count)).astype(np.float32)


def samples(name: str) -> Singles:
    """Arguments over the domain where the error bound of a function holds."""
    rng = np.random.default_rng(8)
    n = 20 * POINTS
    parts = [rng.uniform(-4, 4, n), spread(rng, -140, 3, n)]
    if name in ("sin", "cos"):
        zeros = np.arange(1, int(SINCOS_MAX / (math.pi / 4))) * (math.pi / 4)
        near = zeros.astype(np.float32)
        sides = [np.nextafter(near, np.float32(s)) for s in (0, INF)]
        parts += [rng.uniform(-SINCOS_MAX, SINCOS_MAX, n), near, *sides]
    elif name in ("atan", "tanh"):
        parts += [spread(rng, -3, 4, n), spread(rng, 3, 127, n), rng.uniform(0.09, 0.2, n)]
    elif name == "log":
        parts += [rng.uniform(0.5, 2, n), 1.0 + spread(rng, -24, -1, n), spread(rng, -149, 127, n)]
        whole = np.abs(np.concatenate([np.asarray(p, dtype=np.float32) for p in parts]))
        return whole[whole > 0.0]
    elif name in ("asin", "acos"):
        parts = [
            rng.uniform(-1, 1, n),
            1.0 - np.abs(spread(rng, -24, -1, n)),
            spread(rng, -60, 0, n),
        ]
        whole = np.concatenate([np.asarray(p, dtype=np.float32) for p in parts])
        return whole[np.abs(whole) <= 1.0]
    elif name in ("sinh", "cosh"):
        parts += [rng.uniform(-89.4, 89.4, n), rng.uniform(0.4, 0.7, n)]
    else:
        parts += [rng.uniform(-87, 88, n), rng.uniform(-104, -87, n), rng.uniform(-21, -15, n)]
    return np.concatenate([np.asarray(p, dtype=np.float32) for p in parts])


_NUMPY = {"atan": "arctan", "asin": "arcsin", "acos": "arccos"}


def errors(name: str, x: Singles, y: Singles) -> npt.NDArray[np.float64]:
    """Return the error of each y in units in the last place of a single."""
    reference = getattr(np, _NUMPY.get(name, name))
    exact = reference(x.astype(np.float64))
    ulp = np.maximum(np.ldexp(1.0, np.frexp(np.abs(exact))[1] - 24), SMALLEST)
    result: npt.NDArray[np.float64] = np.abs(y.astype(np.float64) - exact) / ulp
    return result


@pytest.mark.parametrize("name", [name for name in ULP_BOUNDS_SINGLE if name != "sqrt"])
def test_error_stays_below_the_stated_bound(host: Evaluate, name: str) -> None:
    x = samples(name)
    error = np.nan_to_num(errors(name, x, host(name, x)), nan=INF)
    worst = int(np.argmax(error))
    limit = ULP_BOUNDS_SINGLE[name]
    assert error[worst] <= limit, f"{name}({x[worst]!r}) is {error[worst]:.4f} ulp off"


def test_square_root_is_correctly_rounded_for_every_mantissa(host: Evaluate) -> None:
    """For all of 1 <= x < 4, where every other x has a power of four as its ratio to one."""
    x = np.arange(0x3F800000, 0x40800000, dtype=np.uint32).view(np.float32)
    assert np.array_equal(bits_of(host("sqrt", x)), bits_of(np.sqrt(x)))
    wide = np.arange(0, 0x7F800001, 1009, dtype=np.uint32).view(np.float32)
    assert np.array_equal(bits_of(host("sqrt", wide)), bits_of(np.sqrt(wide)))
    low = np.arange(0, 100_000, dtype=np.uint32).view(np.float32)
    assert np.array_equal(bits_of(host("sqrt", low)), bits_of(np.sqrt(low)))


NAN = math.nan
AFTER_MAX = float(np.nextafter(np.float32(SINCOS_MAX), np.float32(INF)))
SPECIAL = [
    *[("sqrt", x, y) for x, y in [(0.0, 0.0), (-0.0, -0.0), (INF, INF), (4.0, 2.0)]],
    *[("sqrt", x, NAN) for x in (-SMALLEST, -1.0, -INF, NAN)],
    *[(f, x, x + 0.0) for f in ("sin", "atan", "tanh", "expm1") for x in (-0.0, SMALLEST, 1e-30)],
    *[(f, x, 1.0) for f in ("cos", "exp") for x in (0.0, -0.0, SMALLEST, -1e-30)],
    *[(f, x, NAN) for f in ("sin", "cos") for x in (AFTER_MAX, -AFTER_MAX, INF, NAN)],
    *[("atan", s * x, s * math.pi / 2) for x in (INF, 3e38, 1e9) for s in (1, -1)],
    *[("tanh", s * x, s) for x in (INF, 3e38, 10.0) for s in (1, -1)],
    *[("exp", -INF, 0.0), ("exp", INF, INF), ("expm1", -INF, -1.0), ("expm1", INF, INF)],
    *[("exp", 88.8, INF), ("exp", -104.0, 0.0), ("expm1", 88.8, INF), ("expm1", -25.0, -1.0)],
    *[(name, NAN, NAN) for name in ("atan", "tanh", "exp", "expm1")],
    *[("log", 0.0, -INF), ("log", -0.0, -INF), ("log", INF, INF), ("log", 1.0, 0.0)],
    *[("log", x, NAN) for x in (-SMALLEST, -1.0, -INF, NAN)],
    *[(f, x, x) for f in ("asin", "sinh") for x in (0.0, -0.0, SMALLEST, 1e-30)],
    *[("asin", 1.0, math.pi / 2), ("acos", -1.0, math.pi), ("acos", 1.0, 0.0)],
    *[(f, x, NAN) for f in ("asin", "acos") for x in (1.0000002, -1.0000002, INF, NAN)],
    *[(f, x, INF) for f in ("sinh", "cosh") for x in (89.5, 3e38, INF)],
    *[("sinh", -INF, -INF), ("cosh", -INF, INF), ("cosh", -0.0, 1.0)],
    *[(f, NAN, NAN) for f in ("sinh", "cosh")],
    *[("is_finite", x, 1.0) for x in (0.0, SMALLEST, -3e38)],
    *[("is_finite", x, 0.0) for x in (INF, -INF, NAN)],
]


def test_special_values_and_one_nan(host: Evaluate) -> None:
    for name, value, expected in SPECIAL:
        y = host(name, np.array([value], dtype=np.float32))
        wanted = np.array([expected], dtype=np.float32)
        bits = QUIET_NAN_BITS_SINGLE if math.isnan(expected) else bits_of(wanted)[0]
        assert bits_of(y)[0] == bits, f"{name}({value}) = {y[0]}"


def any_arguments(count: int) -> Singles:
    rng = np.random.default_rng(7)
    patterns = rng.integers(0, 2**32, count, dtype=np.uint64).astype(np.uint32).view(np.float32)
    return np.concatenate([patterns, spread(rng, -30, 17, count), spread(rng, -3, 3, count)])


@pytest.mark.parametrize("flags", ["-O0", "-O3", "-O2 -mfma"])
def test_same_bits_from_every_host_build(sources: Path, host: Evaluate, flags: str) -> None:
    if "-mfma" in flags and not processor_has_fma():
        pytest.skip("this processor has no x86 fused multiply-add")
    other = host_build(sources, flags.replace(" ", ""), *flags.split())
    x = any_arguments(30_000)
    for name in NAMES:
        assert np.array_equal(bits_of(host(name, x)), bits_of(other(name, x))), name


@pytest.mark.target
def test_same_bits_on_the_target(sources: Path, host: Evaluate) -> None:
    link = ("-nostdlib", "-static", "-Wl,-e,batch", "-Wl,--image-base=0x10000")
    files = ("pf_elementaryf.c", "batch.c", "-o", "t.elf")
    run((*ZIG, *BASE_FLAGS, *TARGET_FLAGS, *link, *files), sources)
    machine = Ppc750Machine((sources / "t.elf").read_bytes())
    x = any_arguments(10_000)
    for name in NAMES:
        on_target = x.astype(">f4")
        y, z = np.zeros_like(on_target), np.zeros_like(on_target)
        machine.call("batch", NAMES.index(name), x.size, on_target, y, z)
        assert np.array_equal(bits_of(y.astype(np.float32)), bits_of(host(name, x))), name


def test_nothing_of_double_in_the_code(sources: Path) -> None:
    run(("gcc", *BASE_FLAGS, *WARNINGS, *NO_DOUBLE, "-O2", "-c", "pf_elementaryf.c"), sources)
    run(("gcc", *BASE_FLAGS, *WARNINGS, *NO_DOUBLE, "-O2", "-c", "batch.c"), sources)
    for name in ("pf_elementaryf.c", SINGLE.further_header):
        assert "double" not in (sources / name).read_text(encoding="utf-8")


@pytest.mark.target
def test_target_compiler_finds_nothing_to_warn_about(sources: Path) -> None:
    quiet = ("-Wno-unused-command-line-argument", "-c", "pf_elementaryf.c", "-o", "w.o")
    run((*ZIG, *BASE_FLAGS, *TARGET_FLAGS, *WARNINGS, *NO_DOUBLE, *quiet), sources)


def test_constants_are_singles() -> None:
    c = single_coefficients()
    values = [c.steps, *c.step, *c.half_pi, c.log2_e, *c.ln2, c.exp_overflow, c.exp_underflow]
    more = further_coefficients_single()
    values += [*more.log_ln2, *more.half_pi, more.log2_e, *more.ln2, more.sinh_overflow]
    values += [more.root_half]
    for fit in (c.sin, c.versine, c.atan, c.exp, more.log, more.asin, more.sinh, more.exp):
        values += fit.coefficients
        assert 0.0 < fit.error < 2.0**-27
    for row in c.sincos_rows:
        values += [row.offset, row.sine, row.cosine]
    for centre in c.atan_rows:
        values += [centre.tangent, centre.angle]
    assert [float(np.float32(v)) for v in values] == values
