"""`generate --precision single`: nothing of double is left, and what is left is verified.

The Pendubot stands for one actuator, the PVTOL aircraft for two.
"""

from __future__ import annotations

import ctypes
import json
import math
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.emit.precision import (
    LARGEST_SINGLE,
    LEAST_SINGLE,
    SINGLE,
    single_at_least,
    single_at_most,
    single_literal,
)
from pfaffian.derive.generation import generate
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model, single_elementary
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.verify.compare import FUNCTIONS, LIMIT_ULP, verify
from pfaffian.derive.verify.subjects import CompiledUnderTest
from pfaffian.derive.verify.ulp_unit import SINGLE_UNIT
from pfaffian.derive.writer import write_generation
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.firmware import build_controller
from pfaffian.runtime.code.generated_model import (
    fill_records,
    host_model,
    open_generated,
    ppc750_model,
    twice_rounding_model,
)
from pfaffian.runtime.flight.closed_loop import differing_bits, fly
from pfaffian.runtime.flight.metrics import tracking_metrics
from pfaffian.runtime.flight.scenario import read_scenario
from pfaffian.runtime.machine.emulator import Ppc750Machine
from pfaffian.runtime.machine.toolchain import GCC_PPC

MODELS = ("pendubot", "pvtol")
FLIGHTS = {"pendubot": "section-5.1-designed", "pvtol": "pvtol-hover"}
OK, SATURATED, NEAR_SINGULAR, BAD_INPUT, BAD_PARAMETER, NUMERIC, NOT_READY = range(7)
REFUSED = (BAD_INPUT, BAD_PARAMETER, NUMERIC, NOT_READY)
HARNESS = Path(str(files("pfaffian.runtime").joinpath("c/pf_harness.c")))
WARNINGS = (
    *("-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno", "-Wall", "-Wextra", "-Wpedantic"),
    *("-Wdouble-promotion", "-Wfloat-conversion", "-Wconversion", "-Wfloat-equal", "-Werror"),
)
ZIG = (sys.executable, "-m", "ziglang", "cc")
ZIG_PPC = (*ZIG, "-target", "powerpc-freestanding-eabihf", "-fno-sanitize=all")
PPC = ("-mcpu=750", "-ffreestanding")
needs_gcc = pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
needs_zig = pytest.mark.skipif(not find_spec("ziglang"), reason="needs the package ziglang")
COMPILERS = [
    pytest.param(("gcc",), id="gcc", marks=needs_gcc),
    pytest.param(ZIG, id="zig", marks=needs_zig),
    pytest.param((*ZIG_PPC, *PPC), id="zig-ppc750", marks=[needs_zig, pytest.mark.target]),
    pytest.param(
        (GCC_PPC, *PPC),
        id="gcc-ppc750",
        marks=[pytest.mark.skipif(not shutil.which(GCC_PPC), reason=f"needs {GCC_PPC}")],
    ),
]


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("single")
    for name in MODELS:
        source = find_model(name)
        model = lowered_model(source)
        emission = Emission(
            model,
            library_sets(model, source),
            precision=SINGLE,
            single=single_elementary(),
        )
        write_generation(generate(emission), root / name)
    return {name: open_generated(str(root / name)) for name in MODELS}


@pytest.fixture(scope="module")
def hosts(folders):
    return {name: host_model(folder) for name, folder in folders.items()}


# ---- literals and bounds


def wide_values(count):
    rng = np.random.default_rng(31)
    sizes = np.exp2(rng.uniform(-126.0, 127.9, count))
    decimal = np.round(rng.uniform(-10.0, 10.0, count), 4)
    edges = [0.0, 1.0, -1.0, 0.1, 1 / 3, LEAST_SINGLE, LARGEST_SINGLE, math.pi, 16777217.0]
    return [*edges, *(sizes * rng.choice([-1.0, 1.0], count)), *decimal]


@needs_gcc
def test_literals_read_back_to_the_value_rounded_once(tmp_path):
    values = wide_values(3000)
    texts = [single_literal(v) for v in values]
    source = "const float table[] = {" + ",\n".join(texts) + "};\n"
    (tmp_path / "table.c").write_text(source, encoding="utf-8")
    done = subprocess.run(
        ["gcc", "-shared", "-fPIC", *WARNINGS, "table.c", "-o", "table.so"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    table = (ctypes.c_float * len(values)).in_dll(ctypes.CDLL(str(tmp_path / "table.so")), "table")
    read = np.array(table, np.float32)
    assert (read.view(np.uint32) == np.array(values).astype(np.float32).view(np.uint32)).all()
    assert single_literal(0.1) == "0.1f"


@pytest.mark.parametrize("value", [1e-50, -1e-39, 3.5e38, 1e300, math.inf, math.nan])
def test_a_constant_single_cannot_hold_is_refused(value):
    with pytest.raises(InputError, match="single precision"):
        single_literal(value)


def test_bounds_are_rounded_inwards_by_less_than_one_place():
    for value in [*wide_values(2000), 0.0, -0.0, 1e-6, 1e-9]:
        above, below = single_at_least(value), single_at_most(value)
        assert below <= value <= above
        assert np.float32(above) == above
        assert np.float32(below) == below
        if LEAST_SINGLE <= abs(value) < LARGEST_SINGLE:
            assert np.nextafter(np.float32(below), np.float32(math.inf)) >= above
    assert single_at_most(math.inf) == LARGEST_SINGLE
    assert single_at_least(-math.inf) == -LARGEST_SINGLE
    assert single_at_least(1e-50) == LEAST_SINGLE  # not a subnormal with few digits
    assert math.copysign(1.0, single_at_least(0.0)) == 1.0


def test_no_single_passes_a_bound_that_the_double_would_fail(folders, hosts):
    """Each bound of each parameter, with the singles around it."""
    source = find_model("pendubot")
    declared = lowered_model(source).parameters
    host = hosts["pendubot"]
    base = folders["pendubot"].parameters("sim-designed")
    status = np.zeros(1, np.int32)
    passed = 0
    for p in declared:
        if p.name not in host.records("params").dtype.names:
            continue
        for bound in (p.lower, p.upper):
            near = np.float32(bound)
            for value in (np.nextafter(near, s) for s in np.float32([-math.inf, math.inf])):
                params = fill_records(host.records("params"), base | {p.name: value})
                host.init(host.records("state"), params, status)
                if status[0] == OK:
                    above = value > p.lower if p.lower_open else value >= p.lower
                    assert above
                    assert value <= p.upper, p.name
                    passed += 1
    assert passed > 30


def test_a_set_that_single_would_carry_over_a_bound_is_refused():
    source = find_model("pendubot")
    model = lowered_model(source)
    given = library_sets(model, source)[0]
    for name, value in (("sample_time", 1e-6), ("kappa", 1e-45)):
        values = tuple((n, value if n == name else v) for n, v in given.values)
        changed = replace(given, values=values)
        Emission(model, (changed,))  # in double it may stay
        with pytest.raises(InputError, match=f"{name}.*single precision"):
            Emission(model, (changed,), precision=SINGLE, single=single_elementary())


# ---- the sources


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("compiler", COMPILERS)
def test_no_conversion_from_or_to_double_is_left(compiler, name, folders, tmp_path):
    c = folders[name].path / "c"
    for path in [*sorted(c.glob("*.c")), HARNESS]:
        command = [*compiler, *WARNINGS, f"-I{c}", "-c", str(path), "-o", "one.o"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", MODELS)
def test_the_sources_name_no_double_and_no_literal_of_it(name, folders):
    for path in sorted((folders[name].path / "c").glob("*.[ch]")):
        code = re.sub(r"/\*.*?\*/", " ", path.read_text(encoding="utf-8"), flags=re.DOTALL)
        assert not re.search(r"\bdouble\b|\bpf_(?:fma|abs|sin|cos|sqrt|atan|exp)\b", code), path
        decimal = r"(?<![\w.])(?:\d+\.\d*|\.\d+|\d+(?=[eE]))(?:[eE][+-]?\d+)?"
        hexadecimal = r"(?<![\w.])0x[\da-fA-F.]+p[+-]?\d+"
        for literal in re.finditer(f"(?:{hexadecimal}|{decimal})(f?)", code):
            assert literal.group(1) == "f", f"{path.name}: {literal.group()}"


def test_the_guard_of_the_length_of_bhat_is_a_single(folders):
    """2^-500 would be zero, and the torque not finite at engagement, where bhat = 0."""
    assert f"pf_maxf({single_literal(2.0**-60)}" in (
        folders["pvtol"].path / "c" / "pvtol.c"
    ).read_text(encoding="utf-8")


def test_the_folder_says_what_it_holds(folders):
    for name, folder in folders.items():
        manifest = json.loads((folder.path / "manifest.json").read_text(encoding="utf-8"))
        assert manifest["precision"] == "single"
        members = [f.type for s in folder.manifest.structures.values() for f in s.fields]
        assert set(members) == {"float", "uint32_t"}
        module = folder.python_module()
        assert "this module computes in double" in module.__doc__, name


# ---- the values


@pytest.mark.target
@pytest.mark.parametrize("name", MODELS)
def test_every_function_is_within_the_limit_and_the_target_has_the_same_bits(name, folders, hosts):
    source = find_model(name)
    model = lowered_model(source)
    sets = [s.as_dict() for s in library_sets(model, source)]
    subjects = [CompiledUnderTest(hosts[name], "c-host")]
    target = CompiledUnderTest(ppc750_model(folders[name]), "c-ppc750")
    found = verify(
        *(derivation_of(source), model, sets, subjects, target, 1500, 1500),
        unit=SINGLE_UNIT,
        witness=CompiledUnderTest(twice_rounding_model(folders[name]), "c-host-rounding-twice"),
    )
    assert found.passed
    assert found.emulator_roundings <= 3
    assert 0.3 < found.worst_scaled_ulp <= LIMIT_ULP
    assert found.target_mismatches == 0
    assert found.undecided <= 10
    assert found.precision == "single"
    assert {r.function for r in found.functions} == {n for n in FUNCTIONS if model.has_program(n)}
    # Whatever is drawn near the sets fits; of the whole domain, most of it does.
    assert found.beyond_near == 0
    assert found.beyond < 3000


@pytest.mark.target
def test_bits_that_differ_by_the_emulators_second_rounding_alone_are_counted_apart(folders, hosts):
    source = find_model("pendubot")
    model = lowered_model(source)
    sets = [s.as_dict() for s in library_sets(model, source)]
    witness = CompiledUnderTest(twice_rounding_model(folders["pendubot"]), "c-host-rounding-twice")

    class Emulator(CompiledUnderTest):
        """Has the witness's bits, with one changed in one sample; a second changed is a fault."""

        def evaluate(self, function, values):
            outputs = witness.evaluate(function, values)
            if function == "step":
                outputs["tau"].view(np.uint64)[3] ^= np.uint64(1 << 40)
            return outputs

    class Host(CompiledUnderTest):
        def evaluate(self, function, values):
            outputs = super().evaluate(function, values)
            if function == "step":
                outputs["tau"].view(np.uint64)[[3, 5]] ^= np.uint64(1 << 30)
            return outputs

    host, there = Host(hosts["pendubot"], "c-host"), Emulator(hosts["pendubot"], "c-emulator")
    found = verify(
        *(derivation_of(source), model, sets, [host], there, 40, 40),
        unit=SINGLE_UNIT,
        witness=witness,
    )
    assert found.emulator_roundings == 1  # sample 5 has the witness's bits
    assert found.target_mismatches == 1  # sample 3 has nobody's


_BATCH = """
#include <stdint.h>
uint32_t batch(uint32_t n, const float *a, const float *b, const float *c, float *y);
uint32_t batch(uint32_t n, const float *a, const float *b, const float *c, float *y)
{
    for (uint32_t i = 0; i < n; i++) { y[i] = __builtin_fmaf(a[i], b[i], c[i]); }
    return 0;
}
"""


@needs_zig
@pytest.mark.target
def test_the_emulator_rounds_a_multiply_add_of_singles_twice(tmp_path):
    """24929 * 673 + 2^-40 lies just above the middle of two singles; in double it is the middle.

    Fails once the emulator is right: then the witness of the verification can go.
    """
    (tmp_path / "batch.c").write_text(_BATCH, encoding="utf-8")
    link = ("-nostdlib", "-static", "-Wl,-e,batch", "-Wl,--image-base=0x10000", "-o", "batch.elf")
    command = [*ZIG_PPC, *PPC, "-O2", "-ffp-contract=off", "-fno-math-errno", "batch.c", *link]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    machine = Ppc750Machine((tmp_path / "batch.elf").read_bytes())
    terms = [np.array([v], ">f4") for v in (24929.0, 673.0, 2.0**-40)]
    result = np.zeros(1, ">f4")
    machine.call("batch", 1, *terms, result)
    assert result[0] == 16777216.0  # rounded once it is 16777218


SLIPS = {
    "a constant of half the digits": ("3.1415927f", "3.1414f"),
    "a lost term": ("layer + kappa", "layer"),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_in_single_is_caught(slip, folders, tmp_path):
    right, wrong = SLIPS[slip]
    shutil.copytree(folders["pendubot"].path, tmp_path / "pendubot")
    path = tmp_path / "pendubot" / "c" / "pendubot.c"
    text = path.read_text(encoding="utf-8")
    assert right in text
    path.write_text(text.replace(right, wrong), encoding="utf-8")
    source = find_model("pendubot")
    model = lowered_model(source)
    sets = [s.as_dict() for s in library_sets(model, source)]
    subject = CompiledUnderTest(host_model(open_generated(str(tmp_path / "pendubot"))), "c-host")
    found = verify(derivation_of(source), model, sets, [subject], None, 600, 0, unit=SINGLE_UNIT)
    assert not found.passed


# ---- the flight


@pytest.mark.target
@pytest.mark.parametrize("name", MODELS)
def test_a_flight_has_the_same_bits_on_host_and_target_and_flies_as_double_does(
    name, folders, hosts
):
    scenario = read_scenario(FLIGHTS[name], folders[name].path)
    here = fly(scenario, hosts[name], hosts[name], "host")
    there = fly(scenario, ppc750_model(folders[name]), hosts[name], "pil-unicorn")
    assert differing_bits(here, there) == 0
    assert here.sha256() == there.sha256()
    assert here.output.dtype[0] == np.float32
    double = read_scenario(FLIGHTS[name])
    exact_plant = host_model(double.folder)
    wanted = tracking_metrics(fly(double, exact_plant, exact_plant, "host"))
    mixed = fly(scenario, hosts[name], exact_plant, "host")  # what a real plant would see
    for flight, tolerance in ((here, 0.03), (mixed, 0.03)):
        found = tracking_metrics(flight)
        for key, value in wanted.items():
            if key.startswith("iae") and value > 1e-3:
                assert found[key] == pytest.approx(value, rel=tolerance), key


@pytest.mark.target
def test_a_single_step_is_built_without_the_functions_of_double(folders):
    image, report = build_controller(folders["pendubot"], "ppc750")
    assert b"pf_sincosf" in image
    assert b"pf_elementary_inline" not in image
    assert report["instructions_per_step"] > 0


# ---- safety


def wild(rng, records):
    """Return `records` with members of any bits, special values, or sizes of any magnitude."""
    count, spoiled = len(records), records.copy()
    share = rng.choice([0.0, 0.02, 0.1, 0.4, 1.0], count)
    special = np.float32([0.0, -0.0, 1e-45, 1e-38, 3.4e38, -3.4e38, np.inf, -np.inf, np.nan, 1e19])
    for name in records.dtype.names:
        bits = rng.integers(0, 2**32, count, dtype=np.uint64).astype(np.uint32)
        if records.dtype[name].kind == "u":
            value = bits
        else:
            sizes = np.exp(rng.uniform(-80.0, 80.0, count)) * rng.choice([-1.0, 1.0], count)
            kinds = [bits.view(np.float32), rng.choice(special, count), sizes.astype(np.float32)]
            value = np.choose(rng.integers(0, 3, count), kinds)
        spoiled[name] = np.where(rng.random(count) < share, value, records[name])
    return spoiled


def bits_of(records):
    return np.stack([np.ascontiguousarray(records[n]).view(np.uint32) for n in records.dtype.names])


def is_finite(records):
    return np.all([np.isfinite(records[n]) for n in records.dtype.names], axis=0)


@pytest.mark.parametrize("name", MODELS)
def test_whatever_comes_in_the_torque_is_finite_and_within_its_limit(name, folders, hosts):
    rng, count, host = np.random.default_rng(32), 200_000, hosts[name]
    manifest = folders[name].manifest
    values = next(iter(manifest.parameter_sets.values()))
    params = fill_records(host.records("params", count), dict(values))
    state, measured = host.records("state", count), host.records("input", count)
    host.init(state, params, np.zeros(count, np.int32))
    for n in measured.dtype.names:
        measured[n] = rng.normal(0.0, 3.0, count)
    state, params, measured = (wild(rng, r) for r in (state, params, measured))
    after, output, status = state.copy(), host.records("output", count), np.zeros(count, np.int32)
    for n in output.dtype.names:
        output[n] = np.nan
    host.step(after, params, measured, output, status)
    assert np.isin(status, range(7)).all()
    assert is_finite(output).all()
    refused = np.isin(status, REFUSED)
    for actuator, limit in zip(manifest.actuators, manifest.limits, strict=True):
        assert (np.abs(output[actuator][~refused]) <= params[limit][~refused]).all()
    assert not bits_of(output)[:, refused].any()
    assert (bits_of(after)[:, refused] == bits_of(state)[:, refused]).all()
    assert is_finite(after)[is_finite(state)].all()
    assert (np.bincount(status, minlength=6) > 100).all()  # every way out is tried


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e38])
def test_a_measurement_that_is_none_is_refused_and_the_state_kept(name, value, folders, hosts):
    host = hosts[name]
    values = next(iter(folders[name].manifest.parameter_sets.values()))
    params, status = fill_records(host.records("params"), dict(values)), np.zeros(1, np.int32)
    for member in host.records("input").dtype.names:
        state, measured = host.records("state"), host.records("input")
        host.init(state, params, status)
        assert status[0] == OK
        before, output = state.copy(), host.records("output")
        measured[member] = value
        host.step(state, params, measured, output, status)
        assert status[0] == BAD_INPUT
        assert not bits_of(output).any()
        assert (bits_of(state) == bits_of(before)).all()


# ---- the command line


def test_the_command_writes_a_folder_of_its_own_and_checks_it(run, workspace):
    assert run("generate", "pendubot").code == 0
    made = run("generate", "pendubot", "--precision", "single", "--json")
    assert made.code == 0
    assert made.document()["folder"] == "generated/pendubot_single"
    assert made.document()["precision"] == "single"
    assert run("generate", "pendubot", "--precision", "single", "--check").code == 0
    assert run("generate", "pendubot", "--check").code == 0
    double = json.loads(Path("generated/pendubot/manifest.json").read_text(encoding="utf-8"))
    assert double["precision"] == "double"
    text = Path("generated/pendubot_single/c/pendubot.c").read_text(encoding="utf-8")
    assert "`pfaffian generate pendubot --precision single`" in text


def test_a_second_generation_in_single_imports_nothing_heavy(workspace, monkeypatch):
    monkeypatch.delenv("PFAFFIAN_CACHE", raising=False)
    lowered_model(find_model("pendubot"))
    single_elementary()  # both are in the cache now
    listing = (
        "import sys; from pfaffian.cli.main import app; "
        "app(sys.argv[1:], standalone_mode=False); "
        "print(*(m for m in sys.modules if '.' not in m), file=sys.stderr)"
    )
    arguments = ("generate", "pendubot", "--precision", "single", "-o", "made")
    done = subprocess.run(
        [sys.executable, "-c", listing, *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    heavy = {"sympy", "casadi", "mpmath", "numpy", "scipy", "matplotlib", "pint"}
    assert not heavy & set(done.stderr.split())


@pytest.mark.target
def test_a_flight_on_the_emulator_counts_the_emulators_roundings_apart(run, folders):
    arguments = ("pil", "rig-balance", "--generated", folders["pendubot"].path, "--json")
    flown = run(*arguments).document()
    assert flown["differing_bits"] == 0
    same = flown["trajectory_sha256"] == flown["host_trajectory_sha256"]
    assert same == (flown["emulator_bits"] == 0)


def test_an_unknown_precision_is_refused(refused):
    refused("generate", "pendubot", "--precision", "half", says=("half", "double, single"))


@pytest.mark.target
def test_verify_takes_the_precision_from_the_folder(run, folders):
    arguments = ("--samples", 50, "--generated", folders["pendubot"].path)
    found = run("verify", "pendubot", *arguments, "--json").document()
    assert found["precision"] == "single"
    assert {f["language"] for f in found["functions"]} == {"c-host", "c-ppc750"}
    said = run("verify", "pendubot", *arguments).out
    assert "in ulp of single" in said
    assert "draws were given up" in said
