"""The generated C keeps its contract: clean C99, freestanding, stateless, named, bit for bit."""

import ctypes
import dataclasses
import io
import math
import re
import shutil
import subprocess
import sys
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.emit.precision import c_literal
from pfaffian.derive.generation import generate
from pfaffian.derive.pipeline import library_sets, lowered_model
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.writer import write_generation
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import unit_registry
from pfaffian.runtime.code.generated_model import GeneratedModel, open_generated
from pfaffian.runtime.contract.dtypes import layout_of
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.host import HostMachine
from pfaffian.runtime.machine.sources import controller_sources, harness_sources
from pfaffian.runtime.machine.toolchain import Target
from test_c_safety import garbage, sensible

WARNINGS = (
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow"),
    *("-Wdouble-promotion", "-Wfloat-equal", "-Wstrict-prototypes", "-Werror"),
)
C99 = ("-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno")
ZIG = (sys.executable, "-m", "ziglang", "cc")
PPC = ("-target", "powerpc-freestanding-eabihf", "-mcpu=750", "-ffreestanding", "-fno-sanitize=all")
FOLDER = open_generated("pendubot")
MANIFEST, C_FOLDER = FOLDER.manifest, FOLDER.path / "c"
HEADERS = sorted(p.name for p in C_FOLDER.glob("*.h"))
HARNESS = Path(str(files("pfaffian.runtime").joinpath("c/pf_harness.c")))
RUNTIME = HARNESS.parent
SOURCES = [
    *sorted(C_FOLDER.glob("*.c")),
    HARNESS,
    *(RUNTIME / f"pf_{n}.c" for n in ("control_harness", "sensing", "supervisor")),
]
INCLUDES = (f"-I{C_FOLDER}", f"-I{RUNTIME}")
#: What has no unit: a flag, a factor of decay, a weight between like joints.
DIMENSIONLESS = {"engaged", "leakage_decay", "kP", "lam"}
DIMENSIONLESS |= {"row_dq1", "row_dq2"}

needs_gcc = pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
needs_zig = pytest.mark.skipif(not find_spec("ziglang"), reason="needs the package ziglang")
CPU = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").is_file() else ""
needs_fma = pytest.mark.skipif(" fma " not in CPU, reason="this processor has no fma")
COMPILERS = [
    pytest.param(("gcc",), id="gcc", marks=needs_gcc),
    pytest.param(ZIG, id="zig", marks=needs_zig),
]


def run(command, cwd):
    return subprocess.run(list(command), cwd=cwd, capture_output=True, text=True, check=False)


def elf_objects(compiler, flags, folder):
    """Compile each source on its own, as zig wants it, and return the objects by name."""
    from elftools.elf.elffile import ELFFile

    found = {}
    for path in SOURCES:
        command = [*compiler, *C99, *flags, *INCLUDES, "-c", str(path), "-o", "one.o"]
        done = run(command, folder)
        assert done.returncode == 0, done.stderr
        found[path.stem] = ELFFile(io.BytesIO((folder / "one.o").read_bytes()))
    return found


def without_comments(text):
    return re.sub(r"/\*.*?\*/", " ", text, flags=re.DOTALL)


def code_files():
    paths = [*sorted(C_FOLDER.glob("*.h")), *SOURCES]
    return {p.name: without_comments(p.read_text(encoding="utf-8")) for p in paths}


@pytest.mark.parametrize("compiler", COMPILERS)
def test_sources_compile_without_a_warning(compiler, tmp_path):
    elf_objects(compiler, WARNINGS, tmp_path)


def cpp_compiler():
    return ("g++",) if shutil.which("g++") else (*ZIG[:-1], "c++")


@needs_gcc
@pytest.mark.parametrize("header", HEADERS)
def test_header_compiles_alone_as_c99_and_as_cpp11(header, tmp_path):
    text = f'#include "{header}"\n#include "{header}"\n'
    for suffix, command in (
        ("c", ("gcc", "-std=c99", *WARNINGS)),
        ("cpp", (*cpp_compiler(), "-std=c++11", *WARNINGS[:-2], "-Werror")),
    ):
        source = tmp_path / f"alone.{suffix}"
        source.write_text(text)
        done = run([*command, *INCLUDES, "-c", str(source), "-o", "alone.o"], tmp_path)
        assert done.returncode == 0, done.stderr


def test_only_freestanding_headers_are_included():
    for name, text in code_files().items():
        found = set(re.findall(r"#\s*include\s*<([^>]+)>", text))
        assert found <= {"stdint.h", "float.h"}, name


def test_no_heap_no_stdio_and_no_library_mathematics():
    library = "malloc calloc realloc free printf puts exit abort memcpy memset fabs sin cos tan "
    library += "atan atan2 sqrt exp expm1 tanh pow fmin fmax isfinite isnan setjmp goto"
    for name, text in code_files().items():
        called = set(re.findall(r"\b([A-Za-z_]\w*)\s*\(", text)) | set(
            re.findall(r"\bgoto\b", text)
        )
        assert not called & set(library.split()), name


def symbols(elf):
    table = list(elf.get_section_by_name(".symtab").iter_symbols())
    undefined = {s.name for s in table if s["st_shndx"] == "SHN_UNDEF" and s.name}
    return undefined, {s.name for s in table if s["st_shndx"] != "SHN_UNDEF" and s.name}


def writable_sections(elf):
    """Return what can be written; of constants with addresses that is the linker alone."""
    found = [s.name for s in elf.iter_sections() if s["sh_flags"] & 3 == 3 and s["sh_size"]]
    return [name for name in found if not name.startswith(".data.rel.ro")]


@needs_zig
@pytest.mark.target
def test_powerpc_objects_need_nothing_and_hold_no_writable_data(tmp_path):
    objects = elf_objects(ZIG, PPC, tmp_path)
    undefined = set().union(*(symbols(e)[0] for e in objects.values()))
    defined = set().union(*(symbols(e)[1] for e in objects.values()))
    assert undefined <= defined, undefined - defined
    for name, elf in objects.items():
        written = writable_sections(elf)
        assert not written, f"{name}: {written}"
    stems = [p.stem for p in controller_sources(FOLDER.path, MANIFEST)]
    alone = set().union(*(symbols(objects[s])[0] for s in stems))
    assert alone <= set().union(*(symbols(objects[s])[1] for s in stems))


@needs_gcc
def test_host_objects_hold_no_writable_data(tmp_path):
    for name, elf in elf_objects(("gcc",), (), tmp_path).items():
        written = writable_sections(elf)
        assert not written, f"{name}: {written}"


@needs_gcc
def test_functions_have_the_names_of_the_contract(tmp_path):
    objects = elf_objects(("gcc",), (), tmp_path)
    model = MANIFEST.model
    assert {f"{model}_init", f"{model}_step"} <= symbols(objects[model])[1]
    for name, elf in objects.items():
        prefix = (f"{model}_", "pf_")
        outside = [
            s.name
            for s in elf.get_section_by_name(".symtab").iter_symbols()
            if s["st_info"]["bind"] == "STB_GLOBAL" and not s.name.startswith(prefix)
        ]
        assert set(outside) <= {"fma", "_GLOBAL_OFFSET_TABLE_"}, name


@pytest.mark.parametrize("compiler", COMPILERS)
def test_harness_refuses_code_of_another_abi(compiler, tmp_path):
    shutil.copytree(C_FOLDER, tmp_path / "c")
    header = tmp_path / "c" / f"{MANIFEST.model}.h"
    text = header.read_text(encoding="utf-8")
    guard = f"#define PF_ABI_VERSION {MANIFEST.abi}\n"
    assert guard in text
    command = [*compiler, *C99, "-Ic", "-c", str(HARNESS), "-o", "harness.o"]
    assert run(command, tmp_path).returncode == 0
    header.write_text(text.replace(guard, f"#define PF_ABI_VERSION {MANIFEST.abi + 1}\n"))
    done = run(command, tmp_path)
    assert done.returncode != 0
    assert re.search(r"error:.*regenerate", done.stderr)


def declared_structures():
    found = {}
    for path in sorted(C_FOLDER.glob(f"{MANIFEST.model}*.h")):
        text = path.read_text(encoding="utf-8")
        for body, name in re.findall(r"typedef struct \{\n(.*?)\n\} (\w+);", text, re.DOTALL):
            if name == f"{MANIFEST.model}_plan_t":
                continue  # a table of its own, which only the code reads
            rows = [
                re.fullmatch(r"    (\w+) (\w+); /\* (.*) \*/", line) for line in body.split("\n")
            ]
            assert all(rows), f"{path.name}: {name}"
            found[name] = [r.groups() for r in rows]
    return found


def test_struct_members_are_those_of_the_manifest_with_their_units():
    declared = declared_structures()
    structures = [*MANIFEST.structures.values(), *MANIFEST.control_structures.values()]
    assert set(declared) == {s.name for s in structures}
    for structure in structures:
        wanted = [
            (f.type, f.name, f"{f.description} [{f.unit}]" if f.unit else f.description)
            for f in structure.fields
        ]
        assert declared[structure.name] == wanted


def test_every_member_has_a_unit_or_is_dimensionless():
    registry = unit_registry()
    for structure in MANIFEST.structures.values():
        for f in structure.fields:
            if f.unit:
                assert registry.parse_units(f.unit) is not None
            else:
                assert f.name in DIMENSIONLESS, f"{structure.name}.{f.name}"


@needs_gcc
def test_members_lie_where_the_layout_says(tmp_path):
    members = [(s, f.name) for s in MANIFEST.structures.values() for f in s.fields]
    rows = ",\n".join(f"offsetof({s.name}, {name})" for s, name in members)
    (tmp_path / "offsets.c").write_text(
        f'#include <stddef.h>\n#include "pf_model.h"\nconst size_t offsets[] = {{{rows}}};\n'
    )
    done = run(["gcc", "-shared", "-fPIC", f"-I{C_FOLDER}", "offsets.c", "-o", "o.so"], tmp_path)
    assert done.returncode == 0, done.stderr
    library = ctypes.CDLL(str(tmp_path / "o.so"))
    offsets = list((ctypes.c_size_t * len(members)).in_dll(library, "offsets"))
    assert offsets == [layout_of(s).fields[name][1] for s, name in members]


def bits(value):
    return np.float64(value).tobytes()


@needs_gcc
def test_parameter_constants_read_back_to_the_bits_of_the_manifest(tmp_path):
    text = (C_FOLDER / f"{MANIFEST.model}_params.c").read_text(encoding="utf-8")
    sources = [str(C_FOLDER / f"{MANIFEST.model}_params.c"), f"-I{C_FOLDER}"]
    assert run(["gcc", "-shared", "-fPIC", *sources, "-o", "p.so"], tmp_path).returncode == 0
    library, names = ctypes.CDLL(str(tmp_path / "p.so")), MANIFEST.structures["params"].names()
    for set_name, values in MANIFEST.parameter_sets.items():
        constant = f"{MANIFEST.model}_params_{set_name.replace('-', '_')}"
        body = re.search(rf" {constant} = \{{\n(.*?)\n\}};", text, re.DOTALL)[1]
        written = dict(re.findall(r"\.(\w+) = ([^,]+),", body))
        assert list(written) == list(names)
        compiled = (ctypes.c_double * len(names)).in_dll(library, constant)
        for name, value in zip(names, compiled, strict=True):
            assert bits(float(written[name])) == bits(value) == bits(values[name]), name


def test_decimal_literals_are_the_shortest_that_read_back():
    generated = {n: t for n, t in code_files().items() if n != HARNESS.name}
    for name, text in generated.items():
        for literal in re.findall(r"(?<![\w.])\d+\.\d*(?:[eE][+-]?\d+)?(?![\w.])", text):
            assert c_literal(float(literal)) == literal, name


@pytest.mark.parametrize("value", [0.1, 1 / 3, 5e-324, 1e16, 1.7976931348623157e308, -0.0, 1e-6])
def test_literals_lose_nothing(value):
    assert bits(float(c_literal(value))) == bits(value)
    assert re.search(r"[.e]", c_literal(value))  # 10000000000000000 would be an integer


@pytest.mark.parametrize("part", ["", "_continuous"])
def test_comments_carry_the_equation_numbers(part):
    text = (C_FOLDER / f"{MANIFEST.model}{part}.c").read_text(encoding="utf-8")
    comments = " ".join(re.findall(r"/\*(.*?)\*/", text, re.DOTALL))
    wanted = {1, 2, 3, 4, 10, 15, 16, 17, 18, 19, 20, 21, 23, 47} | ({22} if part else {6})
    missing = {n for n in wanted if f"({n})" not in comments}
    assert not missing


def test_every_file_says_what_it_was_made_from_and_neither_when_nor_where():
    for path in sorted(C_FOLDER.iterdir()):
        head = path.read_text(encoding="utf-8").split("*/", 1)[0]
        for part in ("do not edit", MANIFEST.model_sha256, MANIFEST.parameters_sha256, "sympy"):
            assert part in head, path.name
        assert f"Operations a control step: {MANIFEST.operations['step']}" in head
        assert not re.search(r"\b20\d\d\b|\d\d:\d\d|/(home|root|work|tmp|usr)/", head)


BUILDS = [
    pytest.param("gcc", ("-O0",), id="gcc-O0", marks=needs_gcc),
    pytest.param("gcc", ("-O2",), id="gcc-O2", marks=needs_gcc),
    pytest.param("gcc", ("-O3",), id="gcc-O3", marks=needs_gcc),
    pytest.param("gcc", ("-O2", "-mfma"), id="gcc-fma", marks=[needs_gcc, needs_fma]),
    pytest.param("gcc", ("-O3", "-march=native"), id="gcc-native", marks=needs_gcc),
    pytest.param("zig", ("-O2",), id="zig-O2", marks=needs_zig),
    pytest.param("zig", ("-O3",), id="zig-O3", marks=needs_zig),
]


def built(compiler, flags):
    command = ("gcc",) if compiler == "gcc" else ZIG
    target = Target("host", command, ("-fPIC", "-shared", "-fno-sanitize=all"), "=")
    sources = harness_sources(FOLDER.path, MANIFEST)
    return GeneratedModel(FOLDER, HostMachine(compile_image(target, sources, C_FOLDER, flags)))


def everything(model):
    """Return the bits of all that the model computes on some thousand random samples."""
    rng = np.random.default_rng(11)
    count = 4000
    batch = sensible(FOLDER, rng, count)
    states, params, measured = (np.concatenate([b, garbage(rng, b)]) for b in batch)
    output, status = model.records("output", 2 * count), np.zeros(2 * count, np.int32)
    model.step(states, params, measured, output, status)
    fresh = model.records("state", 2 * count)
    init_status = np.zeros(2 * count, np.int32)
    model.init(fresh, params, init_status)
    plant = model.records("plant_params", count)
    for name in plant.dtype.names:
        known = name in params.dtype.names
        plant[name] = params[name][:count] if known else rng.normal(0.0, 1.0, count)
    motion, applied = model.records("plant_state", count), model.records("plant_input", count)
    for name in motion.dtype.names:
        motion[name] = measured[name][:count]
    applied["tau"] = rng.normal(0.0, 5.0, count)
    rate, energy = model.records("plant_rate", count), np.zeros(count)
    model.acceleration(plant, motion, applied, rate)
    model.energy(plant, motion, energy)
    inner, law = model.records("continuous_state", count), model.records("continuous_output", count)
    for name in inner.dtype.names:
        inner[name] = rng.normal(0.0, 1.0, count)
    model.continuous(inner, params[:count], measured[:count].copy(), law)
    model.plant_step(motion, plant, applied, np.full(count, 0.001), 3)
    for name in motion.dtype.names:  # of a plant gone wild: the sign of a NaN is the compiler's
        motion[name][np.isnan(motion[name])] = np.nan
    records = [states, output, fresh, rate, law, motion]
    columns = {f"{k}.{n}": r[n] for k, r in enumerate(records) for n in r.dtype.names}
    columns |= {"status": status, "init": init_status, "energy": energy}
    return {name: column.tobytes() for name, column in columns.items()}


@pytest.fixture(scope="module")
def reference():
    return everything(built("gcc" if shutil.which("gcc") else "zig", ("-O1",)))


@pytest.mark.parametrize(("compiler", "flags"), BUILDS)
def test_every_build_gives_the_same_bits(compiler, flags, reference):
    found = everything(built(compiler, flags))
    assert not [name for name in reference if reference[name] != found[name]]


@needs_gcc
@needs_fma
def test_the_comparison_would_see_a_contraction(reference):
    """The step writes its multiply-adds itself; the steps of the simulated motion do not."""
    found = everything(built("gcc", ("-std=gnu99", "-O2", "-mfma", "-ffp-contract=fast")))
    assert found["5.dq1"] != reference["5.dq1"]
    assert set(np.frombuffer(found["init"], np.int32)) == {MANIFEST.status.index("BAD_ARITHMETIC")}


@pytest.fixture(scope="module")
def emission():
    source = find_model("pendubot")
    model = lowered_model(source)
    return Emission(model, library_sets(model, source))


@needs_gcc
def test_text_of_a_set_cannot_end_a_comment(emission, tmp_path):
    evil = 'a */ int x; /* """ \\\nb ??/'
    first = dataclasses.replace(emission.sets[0], title=evil, source=evil)
    title = dataclasses.replace(emission.model, title=f"{evil} \\d")
    write_generation(generate(Emission(title, (first,))), tmp_path / "out")
    sources = [str(p) for p in (tmp_path / "out" / "c").glob("*.c")]
    done = run(["gcc", *C99, *WARNINGS, "-Iout/c", "-c", *sources], tmp_path)
    assert done.returncode == 0, done.stderr
    assert "int x" not in without_comments(
        (tmp_path / "out/c" / f"{MANIFEST.model}_params.h").read_text(encoding="utf-8")
    )
    python = ["-W", "error", "-m", "py_compile", f"out/{MANIFEST.model}.py", "out/__init__.py"]
    assert run([sys.executable, *python], tmp_path).returncode == 0


@pytest.mark.parametrize("names", [("ok",), ("t",), ("a-b", "a_b"), ("Rig", "rig")])
def test_sets_whose_constants_would_hide_a_name_are_refused(emission, names):
    sets = tuple(dataclasses.replace(emission.sets[0], name=n) for n in names)
    with pytest.raises(InputError, match=f"parameter set {names[-1]}"):
        Emission(emission.model, sets)


def test_a_parameter_without_bounds_is_still_checked_to_be_finite(emission):
    free = {"lower": -math.inf, "upper": math.inf, "lower_open": False}
    parameters = tuple(
        dataclasses.replace(p, **free) if p.name == "sigma" else p
        for p in emission.model.parameters
    )
    model = dataclasses.replace(emission.model, parameters=parameters)
    texts = dict(generate(Emission(model, emission.sets)).files)
    largest = "1.7976931348623157e+308"
    assert f"(params->sigma >= -{largest}) && (params->sigma <= {largest})" in texts["c/pendubot.c"]
    assert f"(params.sigma >= -{largest}) & (params.sigma <= {largest})" in texts["pendubot.py"]
