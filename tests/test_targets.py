"""Targets are data: each file builds, for the machine it names, and a new target is a new file."""

import io
import os
import re
import shutil
import subprocess
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from pfaffian.runtime.base.errors import CheckError, InputError, MissingToolError
from pfaffian.runtime.code.firmware import build_controller
from pfaffian.runtime.code.generated_model import emulated_model, host_model, open_generated
from pfaffian.runtime.machine import toolchain
from pfaffian.runtime.machine.sources import runtime_c
from pfaffian.runtime.machine.stack import stack_bound
from pfaffian.runtime.machine.target_files import read_target, target_paths
from pfaffian.runtime.machine.toolchain import find_target
from test_same_bits import stepped

FOLDER = open_generated("pendubot")
NAMES = ("ppc750", "7447a", "e500mc", "e600", "ppc64le", "cortex-m7", "x86-64")
MINE = """
title = "a board of mine"
byte_order = "big"
bits = 32
machine = "EM_PPC"
unicorn = "ppc32:750GX_V1_2"
[toolchain.zig]
flags = ["-target", "powerpc-freestanding-eabihf", "-mcpu=750", "-ffreestanding", "-fno-builtin",
    "-fno-sanitize=all"]
link = ["-nostdlib", "-static", "-Wl,--image-base=0x10000"]
"""
needs_zig = pytest.mark.skipif(
    not find_spec("ziglang"), reason="needs the package ziglang: pip install 'pfaffian[target]'"
)
needs_unicorn = pytest.mark.skipif(
    not find_spec("unicorn"), reason="needs the package unicorn: pip install 'pfaffian[target]'"
)


def each():
    """Every target with each of its compilers; what is not installed is skipped by name."""
    for name in target_paths():
        for tool in read_target(name).toolchains:
            missing = not (find_spec("ziglang") if not tool.command else shutil.which(tool.command))
            why = f"needs {tool.command or 'ziglang'}: apt-get install {tool.package}"
            yield pytest.param(
                name,
                tool.name,
                id=f"{name}-{tool.name}",
                marks=pytest.mark.skipif(missing, reason=why),
            )


EACH = list(each())


def test_the_targets_of_the_plan_are_there():
    assert set(NAMES) == set(target_paths())


@pytest.mark.parametrize(("name", "tool"), EACH)
def test_a_target_builds_for_the_machine_it_names(name, tool):
    from elftools.elf.elffile import ELFFile

    described = read_target(name)
    image, report = build_controller(FOLDER, name, tool)
    elf = ELFFile(io.BytesIO(image))
    order = "<" if elf.little_endian else ">"
    assert (elf["e_machine"], elf.elfclass, order) == (
        *(described.machine, described.bits),
        described.byte_order,
    )
    table = list(elf.get_section_by_name(".symtab").iter_symbols())
    undefined = {s.name for s in table if s.name and s["st_shndx"] == "SHN_UNDEF"}
    assert {f"{FOLDER.manifest.model}_{f}" for f in ("init", "step")} <= {s.name for s in table}
    assert not undefined  # no fma, no sqrt, no helper of the compiler's
    assert 1000 < report["text_bytes"] < 20_000
    assert 0 <= report["stack_bound_bytes"] < 1024
    if described.unicorn and find_spec("unicorn"):
        assert report["stack_bytes"] == report["stack_bound_bytes"]  # step is a leaf
        assert report["instructions_per_step"] > FOLDER.manifest.operations["step"]
    else:
        assert report["stack_bytes"] is None


@needs_unicorn
@pytest.mark.target
@pytest.mark.parametrize(("name", "tool"), [p for p in EACH if read_target(p.values[0]).unicorn])
def test_a_target_that_is_emulated_computes_the_bits_of_the_host(name, tool):
    wanted = stepped(host_model(FOLDER))
    found = stepped(emulated_model(FOLDER, find_target(name, tool)))
    for one, other in zip(wanted, found, strict=True):
        assert (one == other).all()


@needs_zig
@needs_unicorn
@pytest.mark.target
def test_a_new_target_is_a_new_file(workspace, run):
    (workspace / "mine.toml").write_text(MINE)
    report = run("build", "pendubot", "--target", "mine.toml", "-o", "made", "--json").document()
    assert report["target"] == "mine"
    assert report["instructions_per_step"] == pytest.approx(
        build_controller(FOLDER, "ppc750", "zig")[1]["instructions_per_step"]
    )
    assert (workspace / "made" / "pendubot-mine.elf").read_bytes().startswith(b"\x7fELF")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('title = "a board of mine"\n', "", ("has no title", "needs title")),
        ("bits = 32", "bits = 16", ("bits is 16", "32 or 64")),
        ("bits = 32", "bits = true", ("bits is True", "32 or 64")),
        ("bits = 32", "bits = 32\nred_zone = -1", ("red_zone is -1", "0 to 4096")),
        ('"big"', '"middle"', ("byte_order is middle", "big or little")),
        ("bits", "bit", ("has no bits", "needs bits")),
        ('machine = "EM_PPC"', 'machine = ""', ("machine is ''", "write a text")),
        ('machine = "EM_PPC"', 'machine = "EM_PPC"\ncpu = 1', ("unknown key cpu", "known")),
        ("[toolchain.zig]", "[toolchain.tcc]", ("[toolchain.tcc] is no toolchain", "zig, gcc")),
        ("[toolchain.zig]", "[toolchain.gcc]", ("has no command", "needs command")),
        ("flags = [", "flags = [3, ", ("flags is [3", "list of texts")),
        ("bits = 32", "bits = [", ("not valid TOML", "mend the line")),
        ("ppc32:750GX_V1_2", "vax:780", ("vax:780 names no family", "ppc32:PROCESSOR")),
        ("ppc32:750GX_V1_2", "ppc32:999", ("ppc32:999 names no processor", "UC_CPU_PPC32_")),
        ("EM_PPC", "EM_MIPS", ("make an image for", "EM_MIPS", "mend flags")),
        ('"big"', '"little"', ("make an image for", "the target's file says", "mend flags")),
    ],
)
@needs_zig
@needs_unicorn
def test_a_bad_target_file_is_refused_by_name(workspace, refused, old, new, says):
    assert old in MINE
    (workspace / "mine.toml").write_text(MINE.replace(old, new, 1))
    refused("build", "pendubot", "--target", "mine.toml", says=("mine", *says))


def test_a_target_without_a_toolchain_is_refused(workspace, refused):
    (workspace / "mine.toml").write_text(
        MINE.split("[toolchain", maxsplit=1)[0] + "toolchain = 3\n"
    )
    refused("build", "pendubot", "--target", "mine.toml", says=("has no toolchain",))


def test_unknown_targets_and_toolchains_are_refused(refused):
    refused("build", "pendubot", "--target", "vax", says=("unknown target vax", "host, 7447a"))
    refused("build", "pendubot", "--target", "no.toml", says=("no.toml: cannot be read",))
    refused("build", "pendubot", "--toolchain", "tcc", says=("unknown toolchain tcc", "zig or gcc"))
    with pytest.raises(InputError, match="has no toolchain gcc"):
        _without_gcc(find_target)


def _without_gcc(find):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mine.toml"
        path.write_text(MINE)
        find(str(path), "gcc")


@pytest.mark.parametrize("name", NAMES)
def test_missing_compilers_are_named_with_how_to_get_them(monkeypatch, refused, name):
    monkeypatch.setattr(toolchain.shutil, "which", lambda _: None)
    monkeypatch.setattr(toolchain.importlib.util, "find_spec", lambda _: None)
    packages = {t.name: t.package for t in read_target(name).toolchains}
    refused(
        "build", "pendubot", "--target", name, says=("pfaffian[target]", packages["gcc"]), code=3
    )
    with pytest.raises(MissingToolError, match=packages["gcc"]):
        find_target(name, "gcc")


def test_targets_are_listed(run):
    rows = run("targets", "--json").document()["targets"]
    assert {r["name"] for r in rows} == set(NAMES)
    assert "PowerPC 750" in run("targets").out


@pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
def test_the_stack_bound_follows_calls_and_refuses_recursion(tmp_path):
    (tmp_path / "one.c").write_text(
        "int far(int *); int near(int *);\n"
        "int top(void) { volatile int a[16]; a[0] = 1; return near((int *)a); }\n"
    )
    (tmp_path / "two.c").write_text(
        "int far(int *); int near(int *p)\n"
        "{ volatile int a[64]; a[0] = 1; return far((int *)a) + *p; }\n"
        "int again(int n) { return n ? again(n - 1) * n + 1 : 0; }\n"
    )
    target = toolchain.Target("host", ("gcc",), ("-O0",), "=")
    sources = [tmp_path / "one.c", tmp_path / "two.c"]
    bound = stack_bound(target, sources, tmp_path, "top")
    assert 16 * 4 + 64 * 4 <= bound < 1000
    assert bound > stack_bound(target, sources, tmp_path, "near") > 64 * 4
    (tmp_path / "three.c").write_text(
        "int even(int n); int odd(int n) { return n ? even(n - 1) : 0; }\n"
    )
    (tmp_path / "two.c").write_text(
        "int odd(int n); int even(int n) { return n ? odd(n - 1) : 1; }\n"
    )
    with pytest.raises(CheckError, match="calls itself"):
        stack_bound(target, [tmp_path / "two.c", tmp_path / "three.c"], tmp_path, "even")


# The emitted Makefile and CMake files ------------------------------------------------------------


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    from pfaffian.cli.code.generate import generate_files
    from pfaffian.derive.generate_model import Extras

    folder = tmp_path_factory.mktemp("firmware") / "pendubot"
    generate_files("pendubot", None, None, folder, False, Extras(), True)
    return folder / "c"


def shell(command, folder):
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def library_machines(path):
    """Return (machine, names) of the objects in an archive, as the ELF headers say."""
    from elftools.elf.elffile import ELFFile

    data, at, machines = path.read_bytes(), 8, set()
    while at < len(data):
        size = int(data[at + 48 : at + 58])
        body = data[at + 60 : at + 60 + size]
        if body.startswith(b"\x7fELF"):
            machines.add(ELFFile(io.BytesIO(body))["e_machine"])
        at += 60 + size + size % 2
    return machines


GCC = [
    pytest.param(
        name,
        marks=pytest.mark.skipif(
            not shutil.which(tool.command),
            reason=f"needs {tool.command}: apt-get install {tool.package}",
        ),
    )
    for name in target_paths()
    for tool in read_target(name).toolchains
    if tool.name == "gcc"
]
needs_make = pytest.mark.skipif(not shutil.which("make"), reason="needs make: apt-get install make")
needs_cmake = pytest.mark.skipif(
    not shutil.which("cmake"), reason="needs cmake: apt-get install cmake"
)


@needs_make
@pytest.mark.parametrize("name", ["host", *GCC])
def test_the_emitted_makefile_builds_the_library_without_a_warning(made, name):
    code, said = shell(["make", f"TARGET={name}"], made)
    assert code == 0, said
    assert "warning" not in said
    machines = library_machines(made / "build" / name / "libpendubot.a")
    if name != "host":
        assert machines == {read_target(name).machine}


@needs_make
def test_the_emitted_makefile_refuses_an_unknown_target_and_takes_one_of_ones_own(made):
    code, said = shell(["make", "TARGET=vax"], made)
    assert code != 0
    assert "unknown TARGET vax; known: host 7447a" in said
    mine = ["TARGET=mine", "CC=my-gcc", "AR=my-ar", "TARGET_FLAGS=-mcpu=mine"]
    code, said = shell(["make", "-n", *mine], made)
    assert code == 0
    assert "my-gcc -std=c99" in said
    assert "-mcpu=mine" in said


@needs_make
def test_the_emitted_makefile_rebuilds_what_a_change_concerns(made, tmp_path):
    """A header, a flag, another RUNTIME: none of them was noticed, or all was made each time."""
    c, runtime = tmp_path / "c", tmp_path / "runtime"
    shutil.copytree(made, c, ignore=shutil.ignore_patterns("build"))
    shutil.copytree(runtime_c(), runtime)

    def made_again(*words):
        code, said = shell(["make", *words], c)
        assert code == 0, said
        return sorted(set(re.findall(r" -c (?:\S*/)?(\w+)\.c ", said))), "rcsD" in said

    def touch(path):
        for known in (*c.rglob("*"), *runtime.rglob("*")):
            os.utime(known, (1e9, 1e9))
        os.utime(path, (1e9 + 2.0, 1e9 + 2.0))

    everything = made_again()[0]
    assert {"pendubot", "pendubot_plant", "pf_elementary"} <= set(everything)
    assert made_again() == ([], False)
    touch(c / "pendubot_swing_up.h")
    assert made_again() == (["pendubot_swing_up"], True)
    touch(c / "pendubot_plant.c")
    assert made_again()[0] == ["pendubot_plant"]
    assert made_again("CFLAGS=-DWHAT='\"it is\"'")[0] == everything
    assert made_again("CFLAGS=-DWHAT='\"it is\"'") == ([], False)
    assert made_again()[0] == everything
    whole = made_again(f"RUNTIME={runtime}")[0]
    assert {"pf_sensing", "pf_supervisor", "pendubot_control"} < set(whole)
    members = shell(["ar", "t", "build/host/libpendubot.a"], c)[1]
    assert "pf_sensing.o" in members
    touch(runtime / "pf_sensing.h")
    assert made_again(f"RUNTIME={runtime}")[0] == [
        "pendubot_control",
        "pendubot_control_params",
        "pf_sensing",
    ]
    assert made_again(f"RUNTIME={runtime_c()}")[0] == whole, "those of another folder"
    assert made_again()[1]
    assert "pf_sensing.o" not in shell(["ar", "t", "build/host/libpendubot.a"], c)[1]


@needs_make
@needs_cmake
def test_the_complete_controller_is_built_with_the_runtime_beside_it(made, tmp_path):
    runtime = Path(str(files("pfaffian.runtime"))) / "c"
    code, said = shell(["make", "TARGET=host", "CFLAGS=-DWHOLE", f"RUNTIME={runtime}", "-B"], made)
    assert code == 0, said
    assert "warning" not in said
    for name in ("pendubot_control.c", "pf_supervisor.c"):
        assert name in said
    chosen = f"-DPF_RUNTIME={runtime}"
    code, said = shell(["cmake", "-S", ".", "-B", tmp_path, chosen], made)
    assert code == 0, said
    code, said = shell(["cmake", "--build", tmp_path, "--verbose"], made)
    assert code == 0, said
    assert "pf_supervisor.c" in said


@needs_cmake
@pytest.mark.parametrize("name", ["host", *GCC])
def test_the_emitted_cmake_files_build_the_library_without_a_warning(made, tmp_path, name):
    chosen = ["-DCMAKE_TOOLCHAIN_FILE=toolchain.cmake", f"-DPF_TARGET={name}"]
    code, said = shell(
        ["cmake", "-S", ".", "-B", tmp_path, *([] if name == "host" else chosen)], made
    )
    assert code == 0, said
    code, said = shell(["cmake", "--build", tmp_path, "--verbose"], made)
    assert code == 0, said
    assert "warning:" not in said
    assert "-ffp-contract=off" in said
    if name != "host":
        assert library_machines(tmp_path / "libpendubot.a") == {read_target(name).machine}


@needs_cmake
def test_the_emitted_toolchain_file_refuses_an_unknown_target(made, tmp_path):
    chosen = ["-DCMAKE_TOOLCHAIN_FILE=toolchain.cmake", "-DPF_TARGET=vax"]
    code, said = shell(["cmake", "-S", ".", "-B", tmp_path, *chosen], made)
    assert code != 0
    assert 'PF_TARGET is "vax"; known: 7447a' in said


@needs_make
@needs_cmake
def test_the_build_files_keep_the_flags_that_the_bits_depend_on(made):
    for name in ("Makefile", "CMakeLists.txt"):
        text = (made / name).read_text()
        for flag in ("-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno"):
            assert flag in text
    assert np.all([p.name in (made / "Makefile").read_text() for p in made.glob("*.c")])
