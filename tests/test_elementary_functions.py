"""The emitted elementary functions: errors, special values, and the same bits everywhere."""

from __future__ import annotations

import dataclasses
import math
import os
import subprocess
import sys
from pathlib import Path

import mpmath
import numpy as np
import pytest
from pfaffian.derive.elementary.coefficients import (
    QUIET_NAN_BITS,
    SINCOS_MAX,
    ULP_BOUNDS,
    elementary_coefficients,
    render_context,
)
from pfaffian.derive.elementary.further import further_coefficients
from pfaffian.derive.elementary.tables import ATAN_ROWS, atan_edges
from pfaffian.runtime.machine.toolchain import processor_has_fma
from support_elementary import (
    BASE_FLAGS,
    FUNCTIONS,
    POINTS,
    TARGET_FLAGS,
    WARNINGS,
    ZIG,
    Array,
    Evaluate,
    assert_within,
    bits_of,
    host_build,
    render,
    run,
    target_build,
    value_of,
)

HALF_PI = math.pi / 2
SMALLEST = 5e-324
#: The largest x whose sinh and cosh are finite.
LAST_SINH = float.fromhex("0x1.633ce8fb9f87dp+9")
INF = math.inf
NAN = value_of(QUIET_NAN_BITS)


def spread(rng: np.random.Generator, low: float, high: float, count: int) -> Array:
    """Both signs, sizes from 2^low to 2^high, evenly spread over the exponents."""
    sizes: Array = np.exp2(rng.uniform(low, high, count))
    signs: Array = rng.choice(np.array([-1.0, 1.0]), count)
    return sizes * signs


def beside(points: list[float], rng: np.random.Generator, count: int = 300) -> Array:
    """The points, their closest neighbours, and others close by; both signs."""
    centre = np.array(points)
    near = [centre, np.nextafter(centre, INF), np.nextafter(centre, -INF)]
    near += [
        centre * (1.0 + s * np.exp2(rng.uniform(-50, -8))) for s in (-1, 1) for _ in range(count)
    ]
    both = np.concatenate(near)
    return np.concatenate([both, -both])


def samples(name: str) -> Array:
    """Arguments over the domain where the error bound of a function holds; two rows of atan2."""
    rng = np.random.default_rng(20240229)
    if name == "atan2":
        ranges = [(-3, 3), (-40, 40), (-480, 480), (900, 1024), (-960, -900)]
        rows = [[spread(rng, *span, POINTS // 2) for span in ranges] for _ in range(2)]
        return np.array([np.concatenate(row) for row in rows])
    n = POINTS
    everywhere = spread(rng, -1074, -20, 2_000)
    half_ln2 = math.log(2) / 2
    switches = [half_ln2 * k for k in (1.0, 3.0, 5.0, -3.0)] + [2.0**-55]
    if name in ("sin", "cos"):
        step = math.pi / 32
        wide, worst = rng.uniform(-SINCOS_MAX, SINCOS_MAX, n), rng.uniform(step, 3 * step, n)
        edges = beside([step * k for k in range(1, 65)], rng, 30)
        near = [rng.uniform(-2, 2, n), worst, HALF_PI - worst]
        parts = [wide, *near, spread(rng, -30, 16.6, n), edges]
    elif name == "atan":
        edges = [edge for row in range(ATAN_ROWS) for edge in atan_edges(row)]
        edges += [row.tangent for row in elementary_coefficients().atan_rows]
        sizes = [rng.uniform(-4, 4, n), rng.uniform(0.09, 0.14, n), spread(rng, 1, 1024, n)]
        parts = [*sizes, spread(rng, -20, 2, n), beside(edges, rng)]
    elif name == "tanh":
        edges = [*switches, 18.714973875118524, 19.06154746539849, 20.0]
        sizes = [rng.uniform(-2, 2, n), rng.uniform(0.1, 0.25, n), spread(rng, -20, 1024, n)]
        parts = [*sizes, rng.uniform(2, 20, n), beside(edges, rng)]
    elif name == "log":
        narrow = [rng.uniform(0.5, 2, n), rng.uniform(0.68, 0.76, n), rng.uniform(1.3, 1.5, n)]
        close = 1.0 + spread(rng, -52, -1, n)
        parts = [*narrow, close, np.abs(spread(rng, -1074, 1024, n)), beside([1.0, 2.0, 0.5], rng)]
        return np.abs(np.concatenate([everywhere, *parts]))
    elif name in ("asin", "acos"):
        ends = (1.0 - np.exp2(rng.uniform(-53, -1, n))) * rng.choice([-1.0, 1.0], n)
        middle = [rng.uniform(-1, 1, n), rng.uniform(0.45, 0.58, n), spread(rng, -60, 0, n)]
        x = np.concatenate([everywhere, *middle, ends, beside([0.5], rng), [-1.0]])
        return x[np.abs(x) <= 1.0]
    elif name in ("sinh", "cosh"):
        sizes = [rng.uniform(-1, 1, n), rng.uniform(0.3, 3, n), rng.uniform(-710.47, 710.47, n)]
        parts = [*sizes, spread(rng, -60, 3, n), beside([0.5, *switches], rng), [LAST_SINH]]
    else:
        narrow = [rng.uniform(-2, 2, n), rng.uniform(0.34, 0.4, n), spread(rng, -30, 9.4, n)]
        sizes = [rng.uniform(-700, 700, n), rng.uniform(-40, 40, n), rng.uniform(36, 40, n)]
        parts = [*sizes, *narrow, beside([*switches, 40.0], rng)]
    x: Array = np.concatenate([everywhere, *parts])
    return x[np.abs(x) <= {"sin": SINCOS_MAX, "cos": SINCOS_MAX}.get(name, INF)]


def mixed_arguments(count: int) -> Array:
    """Any bit patterns at all, and values the functions treat as ordinary."""
    rng = np.random.default_rng(7)
    patterns = rng.integers(0, 2**64, count, dtype=np.uint64).view(np.float64)
    special = [0.0, -0.0, INF, -INF, NAN, value_of(0x7FF0000000000001), SMALLEST, -SMALLEST]
    usual = [spread(rng, -60, 17, count), rng.uniform(-4, 4, count), rng.uniform(-745, 710, count)]
    return np.concatenate([patterns, *usual, special])


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return render(tmp_path_factory.mktemp("elementary"))


@pytest.fixture(scope="module")
def host(sources: Path) -> Evaluate:
    return host_build(sources, "host", ("gcc",), "-O2")


@pytest.mark.parametrize("name", [name for name in ULP_BOUNDS if name != "sqrt"])
def test_error_stays_below_the_stated_bound(host: Evaluate, name: str) -> None:
    x = samples(name)
    assert_within(name, ULP_BOUNDS[name], x, host(name, x))


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_every_multiple_of_half_pi_in_range(host: Evaluate, name: str) -> None:
    with mpmath.workdps(40):
        count = int(SINCOS_MAX / HALF_PI)
        x = np.array([float(k * (mpmath.pi / 2)) for k in range(1, count + 1)])
    y = host(name, x)
    assert_within(name, ULP_BOUNDS[name], x, y)
    step = np.nextafter(x[::7], INF)
    assert_within(name, ULP_BOUNDS[name], step, host(name, step))
    middle = x[::5] - math.pi / 4
    assert_within(name, ULP_BOUNDS[name], middle, host(name, middle))


@pytest.mark.parametrize("name", ["exp", "expm1"])
def test_both_ends_of_the_exponentials(host: Evaluate, name: str) -> None:
    rng = np.random.default_rng(3)
    last = elementary_coefficients().exp_overflow
    x = np.concatenate([rng.uniform(700, last, 2_000), rng.uniform(-745, -700, 2_000), [last]])
    assert_within(name, 1.0, x, host(name, x))
    beyond = np.array([math.nextafter(last, INF), 710.0, 1e4, 1e308, INF])
    assert np.all(host(name, beyond) == INF)
    limit = {"exp": 0.0, "expm1": -1.0}[name]
    assert np.all(bits_of(host(name, -beyond - 37.0)) == bits_of(np.array(limit)))
    lowest = elementary_coefficients().exp_underflow
    assert host("exp", np.array([lowest, math.nextafter(lowest, -INF)])).tolist() == [SMALLEST, 0.0]


def assert_correctly_rounded(host: Evaluate, x: Array) -> None:
    """The processor's square root (NumPy's, and ours on a host) agrees with the software."""
    assert np.array_equal(bits_of(host("sqrt", x)), bits_of(np.sqrt(x)))
    assert np.array_equal(bits_of(host("sqrt_software", x)), bits_of(np.sqrt(x)))


def test_software_and_hardware_square_root_agree_on_any_bits(host: Evaluate) -> None:
    rng = np.random.default_rng(11)
    for _ in range(8):
        x = rng.integers(0, 2**64, 250_000, dtype=np.uint64).view(np.float64)
        assert np.array_equal(bits_of(host("sqrt", x)), bits_of(host("sqrt_software", x)))
        assert_correctly_rounded(host, np.abs(x[~np.isnan(x)]))


def test_square_root_is_correctly_rounded(host: Evaluate) -> None:
    rng = np.random.default_rng(5)
    low = rng.integers(1, 2**52, 100_000, dtype=np.uint64).view(np.float64)  # subnormals
    sizes = [np.abs(spread(rng, -1074, 1024, 300_000)), rng.uniform(1, 4, 600_000)]
    edges = np.array([2.0**k for k in range(-1074, 1024)])
    sides = [np.nextafter(edges, 0), np.nextafter(edges, INF)]
    x = np.concatenate([low, *sizes, edges, *sides, np.arange(10_000.0) ** 2])
    assert_correctly_rounded(host, x)
    few = x[::50]
    exact = np.array([math.sqrt(value) for value in few.tolist()])
    assert np.array_equal(bits_of(host("sqrt", few)), bits_of(exact))


def test_square_root_next_to_midpoints(host: Evaluate) -> None:
    """All arguments whose root lies within 2^-94 of halfway between two doubles.

    The emitted code finds the root of 1 <= m < 4 to 2^-99 before the last rounding, so that with
    these right, all are. Halfway points are N 2^-53 with N odd. Such a root lies next to one when
    N^2 = M 2^power + remainder with M of 53 bits and a small remainder, 1 modulo 8 like every odd
    square; N is found from the remainder bit by bit.
    """
    hard = []
    for remainder in range(1 - 8 * 2000, 8 * 2000, 8):
        for power in (54, 55):
            root = 1
            for bit in range(3, power):
                if (root * root - remainder) % 2 ** (bit + 1):
                    root += 2 ** (bit - 1)
            half = 2 ** (power - 1)
            roots = {(s * root + t) % 2**power for s in (1, -1) for t in (0, half)}
            for n in roots:
                mantissa, rest = divmod(n * n - remainder, 2**power)
                assert rest == 0
                if 2**52 <= mantissa < 2**53:
                    hard.append(mantissa * 2.0 ** (power - 54))
    x = np.array(hard)
    assert x.size > 4_000
    assert_correctly_rounded(host, x)
    for scale in (2.0**-1074, 2.0**-700, 2.0**-180, 2.0**300, 2.0**900):
        assert_correctly_rounded(host, x * scale)


@pytest.mark.parametrize("name", ["sin", "atan", "tanh", "asin", "sinh"])
def test_odd_in_every_bit(host: Evaluate, name: str) -> None:
    """Other than zero, whose sign only the square root keeps."""
    x = mixed_arguments(30_000)
    x = x[~np.isnan(x) & (x != 0.0)]
    plus, minus = host(name, x), host(name, -x)
    number = ~np.isnan(plus)
    assert np.array_equal(bits_of(minus)[number], bits_of(-plus)[number])


def test_cosine_even_and_sincos_the_same_bits(host: Evaluate) -> None:
    x = mixed_arguments(30_000)
    sine, cosine = host("sincos", x)
    assert np.array_equal(bits_of(cosine), bits_of(host("cos", -x)))
    assert np.array_equal(bits_of(cosine), bits_of(host("cos", x)))
    assert np.array_equal(bits_of(sine), bits_of(host("sin", x)))


def test_only_one_nan_comes_out(host: Evaluate) -> None:
    x = mixed_arguments(50_000)
    turns = np.abs(x) <= SINCOS_MAX
    one = np.abs(x) <= 1.0
    domains = {"log": x >= 0, "asin": one, "acos": one}
    domains |= {"is_finite": np.full(x.shape, True), "sqrt": x >= 0, "sqrt_software": x >= 0}
    domains |= dict.fromkeys(("sin", "cos", "sincos", "sincos_inline"), turns)
    for name in FUNCTIONS[:-1]:
        y = host(name, x)
        assert np.all(bits_of(y)[np.isnan(y)] == QUIET_NAN_BITS), name
        domain = domains.get(name, ~np.isnan(x))
        assert np.array_equal(~np.isnan(y), np.broadcast_to(domain, y.shape)), name


AFTER_MAX = math.nextafter(SINCOS_MAX, INF)
ABOVE_ONE, AFTER_SINH = math.nextafter(1.0, INF), math.nextafter(LAST_SINH, INF)
SPECIAL = [
    *[("sqrt", x, y) for x, y in [(0.0, 0.0), (-0.0, -0.0), (INF, INF), (4.0, 2.0)]],
    *[("sqrt", x, NAN) for x in (-SMALLEST, -1.0, -INF, NAN)],
    *[("sin", x, x + 0.0) for x in (0.0, -0.0, SMALLEST, -SMALLEST, 1e-300)],
    *[("cos", x, 1.0) for x in (0.0, -0.0, SMALLEST, -SMALLEST, 1e-300)],
    *[(name, x, NAN) for name in ("sin", "cos") for x in (AFTER_MAX, -AFTER_MAX, INF, NAN)],
    *[("atan", x, x + 0.0) for x in (0.0, -0.0, SMALLEST, -SMALLEST, 1e-300)],
    *[("atan", x, math.copysign(HALF_PI, x)) for x in (INF, -INF, 1e308, -1e17)],
    *[("tanh", x, x + 0.0) for x in (0.0, -0.0, SMALLEST, -SMALLEST, 1e-300)],
    *[("tanh", x, math.copysign(1.0, x)) for x in (INF, -INF, 1e308, 20.0, -19.1)],
    *[("expm1", x, x + 0.0) for x in (0.0, -0.0, SMALLEST, -SMALLEST, 1e-300)],
    *[("exp", x, 1.0) for x in (0.0, -0.0, SMALLEST, -SMALLEST, 1e-300)],
    *[("exp", -INF, 0.0), ("exp", INF, INF), ("expm1", -INF, -1.0), ("expm1", INF, INF)],
    *[(name, NAN, NAN) for name in ("atan", "tanh", "exp", "expm1")],
    *[("log", x, -INF) for x in (0.0, -0.0)],
    *[("log", 1.0, 0.0), ("log", INF, INF), ("log", 2.0, math.log(2.0))],
    *[("log", x, NAN) for x in (-SMALLEST, -1.0, -INF, NAN)],
    *[(f, x, x) for f in ("asin", "sinh") for x in (0.0, -0.0, SMALLEST, -SMALLEST, 1e-300)],
    *[("asin", s, s * HALF_PI) for s in (1.0, -1.0)],
    *[("acos", 1.0, 0.0), ("acos", -1.0, math.pi), ("acos", 0.0, HALF_PI)],
    *[(f, x, NAN) for f in ("asin", "acos") for x in (ABOVE_ONE, -ABOVE_ONE, INF, -INF, NAN)],
    *[("cosh", x, 1.0) for x in (0.0, -0.0, SMALLEST, -1e-300)],
    *[(f, x, INF) for f in ("sinh", "cosh") for x in (AFTER_SINH, 711.0, 1e308, INF)],
    *[("sinh", -x, -INF) for x in (AFTER_SINH, 711.0, 1e308, INF)],
    *[("cosh", -x, INF) for x in (AFTER_SINH, INF)],
    *[(f, NAN, NAN) for f in ("sinh", "cosh")],
    *[("is_finite", x, 1.0) for x in (0.0, -0.0, SMALLEST, -1.7976931348623157e308)],
    *[("is_finite", x, 0.0) for x in (INF, -INF, NAN, -NAN)],
]


def test_special_values(host: Evaluate) -> None:
    for name, x, expected in SPECIAL:
        y = host(name, np.array([x]))
        assert bits_of(y)[0] == bits_of(np.array([expected]))[0], f"{name}({x}) = {y[0]}"


def test_special_points_of_the_angle(host: Evaluate) -> None:
    pi = math.pi
    cases = [(0.0, 1.0, 0.0), (0.0, 0.0, 0.0), (-0.0, -1.0, pi), (0.0, -0.0, 0.0)]
    cases += [(1.0, 0.0, pi / 2), (-1.0, -0.0, -pi / 2), (INF, -1.0, pi / 2), (-INF, 1.0, -pi / 2)]
    cases += [(1.0, INF, 0.0), (1.0, -INF, pi), (-1.0, -INF, -pi), (SMALLEST, 1.0, SMALLEST)]
    cases += [(INF, -INF, NAN), (NAN, 1.0, NAN), (1.0, NAN, NAN), (INF, NAN, NAN), (NAN, 0.0, NAN)]
    for y, x, angle in cases:
        result = host("atan2", np.array([[y], [x]]))
        assert bits_of(result)[0] == bits_of(np.array([angle]))[0], f"atan2({y}, {x}) = {result[0]}"


def assert_same_bits(one: Evaluate, other: Evaluate, x: Array) -> None:
    pairs = {"atan2": np.stack([x, np.roll(x, 1)])}
    for name in FUNCTIONS:
        arguments = pairs.get(name, x)
        assert np.array_equal(bits_of(one(name, arguments)), bits_of(other(name, arguments))), name


@pytest.mark.parametrize("flag", ["-O0", "-O3", "-fmath-errno", "-DPF_SQRT_BY_SOFTWARE"])
def test_same_bits_at_any_optimization(sources: Path, host: Evaluate, flag: str) -> None:
    other = host_build(sources, f"gcc{flag}", ("gcc",), flag)
    assert_same_bits(host, other, mixed_arguments(20_000))


@pytest.mark.skipif(not processor_has_fma(), reason="this processor has no x86 fused multiply-add")
def test_same_bits_with_the_processors_own_fma(sources: Path, host: Evaluate) -> None:
    other = host_build(sources, "fma", ("gcc",), "-O2", "-mfma")
    assert_same_bits(host, other, mixed_arguments(50_000))


@pytest.mark.target
def test_same_bits_from_clang(sources: Path, host: Evaluate) -> None:
    other = host_build(sources, "clang", ZIG, "-O2", "-fno-sanitize=all", "-fno-math-errno")
    assert_same_bits(host, other, mixed_arguments(50_000))


@pytest.mark.target
def test_same_bits_on_the_target(sources: Path, host: Evaluate) -> None:
    target = target_build(sources)
    assert_same_bits(host, target, mixed_arguments(30_000))
    for name in ULP_BOUNDS:
        x = samples(name)[..., ::4]
        assert np.array_equal(bits_of(host(name, x)), bits_of(target(name, x))), name
    for name, value, expected in SPECIAL:
        y = target(name, np.array([value]))
        assert bits_of(y)[0] == bits_of(np.array([expected]))[0], f"{name}({value}) = {y[0]}"


@pytest.mark.target
def test_target_code_calls_nothing(sources: Path) -> None:
    from elftools.elf.elffile import ELFFile

    run((*ZIG, *BASE_FLAGS, *TARGET_FLAGS, "-c", "pf_elementary.c", "-o", "target.o"), sources)
    with (sources / "target.o").open("rb") as stream:
        symbols = ELFFile(stream).get_section_by_name(".symtab").iter_symbols()
        undefined = [s.name for s in symbols if s.entry.st_shndx == "SHN_UNDEF" and s.name]
        writable = [s.name for s in ELFFile(stream).iter_sections() if s.name in (".data", ".bss")]
        sizes = [ELFFile(stream).get_section_by_name(name).data_size for name in writable]
    assert undefined == []
    assert sum(sizes) == 0


def test_gcc_finds_nothing_to_warn_about(sources: Path) -> None:
    run(("gcc", *BASE_FLAGS, *WARNINGS, "-O2", "-c", "pf_elementary.c", "-o", "w.o"), sources)
    run(("gcc", *BASE_FLAGS, *WARNINGS, "-O2", "-c", "batch.c", "-o", "w_further.o"), sources)


@pytest.mark.target
def test_clang_finds_nothing_to_warn_about(sources: Path) -> None:
    quiet = ("-Wno-unused-command-line-argument", "-c", "pf_elementary.c", "-o", "w_clang.o")
    run((*ZIG, *BASE_FLAGS, *TARGET_FLAGS, *WARNINGS, *quiet), sources)
    run((*ZIG, *BASE_FLAGS, *WARNINGS, "-O2", *quiet), sources)
    further = ("-Wno-unused-command-line-argument", "-c", "batch.c", "-o", "w_further.o")
    run((*ZIG, *BASE_FLAGS, *TARGET_FLAGS, *WARNINGS, *further), sources)


@pytest.mark.target
def test_header_is_also_cpp(sources: Path) -> None:
    (sources / "use.cpp").write_text(
        '#include "pf_elementary.h"\ndouble f() { return pf_sin(PF_SINCOS_MAX); }\n'
    )
    flags = ("-std=c++11", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
    run((*ZIG[:-1], "c++", *flags, "-c", "use.cpp", "-o", "use.o"), sources)


def test_reference_values_agree_with_mpmath(host: Evaluate) -> None:
    """The errors above are measured against MPFR; this ties some of them to mpmath as well."""
    for name in [name for name in ULP_BOUNDS if name != "atan2"]:
        x = np.abs(samples("exp" if name == "sqrt" else name)[2_000::211])
        for argument, result in zip(x.tolist(), host(name, x).tolist(), strict=True):
            with mpmath.workdps(60):
                exact = getattr(mpmath, name)(mpmath.mpf(argument))
                if exact > 1.7e308:
                    continue
                error = float(abs(exact - result)) / math.ulp(float(exact))
            assert error <= ULP_BOUNDS[name], f"{name}({argument!r})"


def test_formulas_are_well_below_the_rounding_errors() -> None:
    c = elementary_coefficients()
    more = further_coefficients()
    for formula in (c.sin, c.versine, c.atan, c.exp, more.log, more.asin, more.sinh, more.exp):
        assert 0.0 < formula.error < 2.0**-55.5
    exponents = 1074 + 54  # times the first part of ln 2: exact
    assert mpmath.mpf(more.log_ln2[0]).man * exponents < 2**53
    assert 0.0 < c.sqrt_seed_error < 2.0**-8  # squared three times: the rounding is left
    with mpmath.workdps(60):
        assert abs(mpmath.fsum(c.step) - mpmath.pi / 16) < mpmath.mpf(2) ** -142
    middle = mpmath.mpf(c.step[1])
    multiples = int(SINCOS_MAX / c.step[0]) + 1
    assert middle.man * multiples < 2**53


def test_coefficients_do_not_depend_on_the_integers_below_mpmath() -> None:
    code = (
        "import dataclasses, mpmath.libmp\n"
        "from pfaffian.derive.elementary.coefficients import elementary_coefficients\n"
        "print(mpmath.libmp.BACKEND, dataclasses.asdict(elementary_coefficients()))\n"
    )
    environment = {**os.environ, "MPMATH_NOGMPY": "1"}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    backend, coefficients = done.stdout.strip().split(" ", 1)
    assert backend == "python"
    assert coefficients == str(dataclasses.asdict(elementary_coefficients()))


def test_literals_read_back_to_the_same_bits() -> None:
    def pairs(node: object) -> list[tuple[str, str]]:
        if isinstance(node, dict) and set(node) == {"c", "decimal"}:
            return [(node["c"], node["decimal"])]
        children = list(node.values()) if isinstance(node, dict) else node
        return (
            [pair for child in children for pair in pairs(child)]
            if isinstance(children, list)
            else []
        )

    literals = pairs(render_context())
    assert len(literals) > 60
    for in_c, in_decimal in literals:
        assert float.fromhex(in_c) == float(in_decimal), in_c
