"""Unknown names, unwritable outputs, foreign folders, missing tools: each refused.

Each message says what, where and what to do; the exit code is 2, or 3 for a missing tool; a refused
call leaves the disk as it was. Parameter sets, scenarios and models have files of tests of
their own.
"""

from __future__ import annotations

import errno
import importlib.util
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pfaffian.derive import writer
from pfaffian.runtime.code.generated_model import open_generated
from pfaffian.runtime.contract.manifest import ABI_VERSION

#: A call that names what does not exist, and what the message must say.
UNKNOWN = {
    "a model": ("generate pendubox", "unknown model pendubox", "did you mean pendubot?"),
    "a model to derive": ("derive triple_pendulum", "unknown model triple_pendulum", "pendubot"),
    "a model to verify": ("verify triple_pendulum", "unknown model triple_pendulum", "pendubot"),
    "a model to run": ("run triple_pendulum -o made", "unknown model triple_pendulum", "pendubot"),
    "a model to build": ("build pendubox", "no generated model pendubox", "generate it first"),
    "a set": ("generate pendubot --set simm", "no parameter set simm", "did you mean sim?"),
    "a set to derive": ("derive pendubot --set rigg", "no parameter set rigg", "mean rig?"),
    "a scenario": ("simulate section-5.1-papr", "unknown scenario", "did you mean section-5.1-"),
    "a scenario to pil": ("pil nowhere.toml", "unknown scenario nowhere.toml", "known: "),
    "an emulator": ("pil section-5.1-paper --emulator bochs", "unknown emulator bochs", "unicorn"),
    "a target": ("build pendubot --target arm", "unknown target arm", "known targets: host"),
    "a toolchain": ("build pendubot --toolchain tcc", "unknown toolchain tcc", "auto, zig or gcc"),
    "a format": ("derive pendubot --format pdf", "--format pdf is unknown", "text, markdown or"),
    "a generated folder": (
        "simulate section-5.1-paper --generated nowhere",
        "no generated model nowhere",
        "generate it first",
    ),
    "one set too many": (
        "generate pendubot --set sim --params mine.toml",
        "--set and --params are both given",
        "give one of them",
    ),
}
#: A call the parser refuses: its words.
MISUSED = {
    "no samples": ("verify pendubot --samples 0", "--samples"),
    "negative samples": ("verify pendubot --target-samples=-1", "--target-samples"),
    "samples in words": ("run pendubot --samples many", "--samples"),
    "an unknown option": ("generate pendubot --fast", "--fast"),
    "an unknown command": ("simulate-it section-5.1-paper", "simulate-it"),
    "no model": ("generate", "model"),
}


@pytest.mark.parametrize("what", UNKNOWN)
def test_an_unknown_name_is_refused_with_the_known_ones(what, refused):
    call, *says = UNKNOWN[what]
    refused(*call.split(), says=tuple(says))


@pytest.mark.parametrize("what", MISUSED)
def test_a_misused_option_is_named_also_in_json(what, run, workspace):
    call, name = MISUSED[what]
    plain, script = run(*call.split()), run(*call.split(), "--json")
    assert (plain.code, script.code) == (2, 2)
    assert plain.out == ""
    assert name in plain.err
    assert set(script.document()) == {"error"}
    assert name in script.document()["error"]["message"]
    assert "--help" in script.document()["error"]["remedy"]
    assert list(workspace.iterdir()) == []


# Where nothing can be written ------------------------------------------------------------------


def test_an_output_folder_that_is_a_file_or_lies_below_one_is_refused(workspace, refused):
    (workspace / "notes.txt").write_text("mine")
    for folder in ("notes.txt", "notes.txt/made", "notes.txt/deep/made"):
        says = ("notes.txt: is a file, not a folder", "-o")
        refused("generate", "pendubot", "-o", folder, says=says)
    says = ("-o notes.txt/image: notes.txt is a file, not a folder",)
    refused("build", "pendubot", "--target", "host", "-o", "notes.txt/image", says=says)
    for call in ("run pendubot", "reproduce figure-7", "build pendubot"):
        says = ("-o notes.txt/made: notes.txt is a file, not a folder", "another folder")
        refused(*call.split(), "-o", "notes.txt/made", says=says)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a file system of the kernel")
def test_an_output_folder_the_kernel_refuses_is_named(refused):
    refused(
        "generate", "pendubot", "-o", "/proc/made", says=("/proc/made: cannot be written", "-o")
    )


def _fail(code: int) -> Callable[..., Any]:
    def call(*_: object, **__: object) -> Any:
        raise OSError(code, os.strerror(code))

    return call


def _closed(path: Path) -> bool:
    if path.name == "made":
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    return os.path.lexists(path)


@pytest.mark.parametrize(
    ("owner", "name", "stand_in", "reason"),
    [
        (os, "access", lambda *_, **__: False, "Permission denied"),
        (Path, "mkdir", _fail(errno.EROFS), "Read-only file system"),
        (os, "fsync", _fail(errno.ENOSPC), "No space left on device"),
        (writer, "_exchange", _fail(errno.EBUSY), "Device or resource busy"),
        (Path, "exists", _closed, "Permission denied"),
    ],
    ids=["no rights", "read-only", "disk full", "busy", "a folder above that is closed"],
)
def test_a_folder_that_cannot_be_written_is_refused_and_nothing_is_left_behind(
    owner, name, stand_in, reason, monkeypatch, refused
):
    monkeypatch.setattr(owner, name, stand_in)
    says = (f": cannot be written ({reason})", "choose another folder with -o, or mend its rights")
    refused("generate", "pendubot", "--set", "sim", "-o", "made", says=says)


@pytest.mark.parametrize("full", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_leaves_the_old_generation_whole(full, workspace, monkeypatch, run, refused):
    assert run("generate", "pendubot", "--set", "sim", "-o", "made").code == 0
    (workspace / "made" / "notes.txt").write_text("mine")
    monkeypatch.setattr(os, "fsync", _fail(full))
    refused("generate", "pendubot", "--set", "rig", "-o", "made", says=("cannot be written",))


def test_a_folder_with_files_of_somebody_else_is_left_alone(workspace, refused):
    (workspace / "home").mkdir()
    (workspace / "home" / "thesis.tex").write_text("years of work")
    says = ("home: is not empty and holds no generated model", "an empty or new folder with -o")
    refused("generate", "pendubot", "-o", "home", says=says)


def test_an_edited_manifest_does_not_make_the_writer_delete_beyond_its_folder(workspace, run):
    (workspace / "thesis.tex").write_text("years of work")
    (workspace / "made").mkdir()
    (workspace / "made" / "old.c").write_text("listed, so ours to remove")
    outside = ["../thesis.tex", str(workspace / "thesis.tex"), ".", "c/../../thesis.tex", "old.c"]
    listed = ", ".join(f'"{p}"' for p in outside)
    (workspace / "made" / "manifest.json").write_text(f'{{"files": [{listed}]}}')
    assert run("generate", "pendubot", "--set", "sim", "-o", "made").code == 0
    assert (workspace / "thesis.tex").read_text() == "years of work"
    assert not (workspace / "made" / "old.c").exists()


# Missing tools ---------------------------------------------------------------------------------


@pytest.fixture
def no_compiler(monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(shutil, "which", lambda *_, **__: None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *_: None)


@pytest.mark.usefixtures("no_compiler")
@pytest.mark.parametrize(
    ("call", "says"),
    [
        (
            "build pendubot --target host",
            ("no C compiler found for the host", "apt-get install gcc"),
        ),
        ("build pendubot --target host --toolchain gcc", ("no gcc found", "apt-get install gcc")),
        ("build pendubot --target host --toolchain zig", ("no zig found", "pip install ziglang")),
        (
            "build pendubot",
            ("no compiler found for target ppc750", "pip install 'pfaffian[target]'"),
        ),
        ("build pendubot --toolchain gcc", ("PowerPC", "apt-get install gcc-powerpc-linux-gnu")),
        ("simulate section-5.1-paper", ("no C compiler found", "apt-get install gcc")),
        ("verify pendubot --samples 1", ("no C compiler found", "pip install ziglang")),
    ],
)
def test_a_missing_compiler_is_exit_3_with_its_name_and_how_to_get_it(call, says, refused):
    refused(*call.split(), says=says, code=3)


def test_the_compiler_in_cc_is_used_and_a_wrong_one_passed_over(monkeypatch, run):
    monkeypatch.setenv("CC", "no-such-compiler -m64")
    assert "gcc" in run("build", "pendubot", "--target", "host", "--json").document()["compiler"]


@pytest.mark.target
@pytest.mark.parametrize("call", ["pil section-5.1-paper", "build pendubot"])
def test_a_missing_emulator_is_exit_3_with_its_name_and_how_to_get_it(call, monkeypatch, refused):
    monkeypatch.setitem(sys.modules, "unicorn", None)
    says = ("no PowerPC emulator found", "unicorn", "pip install 'pfaffian[target]'")
    refused(*call.split(), says=says, code=3)


# Generated code that is not whole --------------------------------------------------------------


@pytest.fixture
def copied(workspace):
    source = open_generated("pendubot").path
    return Path(shutil.copytree(source, workspace / "made", ignore=lambda *_: ["__pycache__"]))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", ("made/manifest.json: is not a manifest of this version", "regenerate")),
        ("[]", ("made/manifest.json: is not a manifest of this version", "regenerate")),
        ("{}", ("made/manifest.json: is not a manifest of this version", "regenerate")),
        ("\0\1\2", ("made/manifest.json: is not a manifest of this version", "regenerate")),
    ],
    ids=["cut off", "a list", "empty", "binary"],
)
def test_a_malformed_manifest_is_refused(text, says, copied, refused):
    (copied / "manifest.json").write_text(text)
    refused("simulate", "section-5.1-paper", "--generated", "made", says=says)


def test_generated_code_of_another_abi_is_refused_by_number(copied, refused):
    manifest = copied / "manifest.json"
    manifest.write_text(manifest.read_text().replace(f'"abi": {ABI_VERSION},', '"abi": 99,'))
    for call in ("simulate section-5.1-paper", "verify pendubot", "build pendubot"):
        needs = f"made/manifest.json: ABI 99, this runtime needs {ABI_VERSION}"
        says = (needs, "regenerate the model")
        refused(*call.split(), "--generated", "made", says=says)


def test_a_lost_generated_file_is_named(copied, refused):
    (copied / "c" / "pendubot.c").unlink()
    says = ("made/c/pendubot.c: No such file", "check the path")
    refused("build", "pendubot", "--generated", "made", "--target", "host", says=says)
    (copied / "pendubot.py").unlink()
    says = ("made/pendubot.py: is missing", "regenerate the model")
    refused("simulate", "section-5.1-paper", "--generated", "made", says=says)
