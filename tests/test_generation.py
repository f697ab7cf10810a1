"""Generation gives the same bytes everywhere, says what it was made from, and notices drift."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import REPOSITORY, tree
from pfaffian.derive.pipeline import lowered_model
from pfaffian.derive.spec.library import find_model

COMMITTED = REPOSITORY / "generated" / "pendubot"
TOOLS = ("sympy", "casadi", "mpmath", "jinja2")
#: Runs the command line, then lists the modules that were imported on standard error.
LISTING = """
import sys
from pfaffian.cli.main import main
try:
    main()
finally:
    print(" ".join(m for m in sorted(sys.modules) if "." not in m), file=sys.stderr)
"""


def files(folder: Path) -> dict[str, bytes | str]:
    """Return the tree of a generation without what Python left there."""
    return {p: c for p, c in tree(folder).items() if "__pycache__" not in p}


@pytest.fixture(scope="module")
def twins(tmp_path_factory):
    """Generate the Pendubot twice from nothing: other seed, folder, user, time zone and locale."""
    processes = []
    for seed, zone, locale in (("1", "UTC", "C"), ("4242", "Asia/Tokyo", "C.UTF-8")):
        home = tmp_path_factory.mktemp(f"somebody-{seed}")
        environment = {
            "PATH": os.environ["PATH"],
            "PYTHONHASHSEED": seed,
            "PFAFFIAN_CACHE": "off",
            "HOME": str(home),
            "USER": "somebody",
            "LOGNAME": "somebody",
            "TZ": zone,
            "LC_ALL": locale,
        }
        command = [sys.executable, "-c", LISTING, "generate", "pendubot", "-o", f"made-{seed}"]
        process = subprocess.Popen(
            command, cwd=home, env=environment, text=True, stdout=-1, stderr=-1
        )
        processes.append((home / f"made-{seed}", process))
    found = []
    for folder, process in processes:
        _, said = process.communicate(timeout=300)
        assert process.returncode == 0, said
        found.append((folder, said))
    return found


def test_other_hash_seeds_folders_users_and_locales_give_the_same_bytes(twins):
    (one, _), (other, _) = twins
    assert len(files(one)) > 15
    assert files(one) == files(other)


def test_the_committed_code_is_what_is_generated_from_nothing(twins):
    assert files(twins[0][0]) == files(COMMITTED)


def test_no_date_no_path_and_no_user_gets_into_a_file(twins):
    folder = twins[0][0]
    for name, content in files(folder).items():
        if content == "a folder":
            continue
        text = content.decode("utf-8")
        assert "somebody" not in text, name
        for word in (str(folder), str(REPOSITORY), sys.prefix, "__pycache__"):
            assert word not in text, name
        assert not re.search(r"(?<![\w)/*])/(home|root|tmp|usr|opt|var|work|build)/", text), name
        assert not re.search(r"\b(19|20)\d\d-[01]\d-[0-3]\d\b|\d\d:\d\d:\d\d", text), name
        assert not re.search(r"\b(Jan|Feb|Mar|Apr|Jun|Jul|Aug|Sep|Oct|Nov|Dec)\w* \d", text), name


def test_every_source_file_says_what_it_was_made_from(twins):
    folder = twins[0][0]
    manifest = json.loads((folder / "manifest.json").read_text())
    versions = [f"{tool} {importlib.metadata.version(tool)}" for tool in TOOLS]
    sources = [p for p in folder.rglob("*") if p.suffix in (".c", ".h", ".py")]
    assert (
        len(sources) == len([f for f in manifest["files"] if f.endswith((".c", ".h", ".py"))]) > 15
    )
    for path in sources:
        header = "".join(path.read_text().splitlines(keepends=True)[:8])
        assert "do not edit" in header, path.name
        for word in (
            f"pfaffian {importlib.metadata.version('pfaffian')}",
            f"Model pendubot, SHA-256 {manifest['model_sha256']}",
            f"Parameters, SHA-256 {manifest['parameters_sha256']}",
            f"Operations a control step: {manifest['operations']['step']}\n",
            f"ABI {manifest['abi']}",
            *versions,
        ):
            assert word in header, f"{path.name}: {word}"
    assert manifest["tools"] == {tool: importlib.metadata.version(tool) for tool in TOOLS}
    step = lowered_model(find_model("pendubot")).program("step")
    work = [i for i in step.instructions if i.op not in ("input", "const")]
    assert manifest["operations"]["step"] == len(work) > 50


def test_the_manifest_has_the_digest_of_every_other_file(twins):
    content = {p: c for p, c in files(twins[0][0]).items() if isinstance(c, bytes)}
    manifest = json.loads(content.pop("manifest.json"))
    assert manifest["files"] == {p: hashlib.sha256(c).hexdigest() for p, c in content.items()}


def test_a_parameter_change_derives_nothing_and_imports_neither_sympy_nor_casadi(
    twins, tmp_path, monkeypatch
):
    monkeypatch.delenv("PFAFFIAN_CACHE", raising=False)
    lowered_model(find_model("pendubot"))  # both stages are in the cache now
    (tmp_path / "mine.toml").write_text('extends = "sim"\n[gains]\nsigma = "3.25 1/s"\n')
    arguments = ("generate", "pendubot", "--params", "mine.toml", "-o", "made")
    command = [sys.executable, "-c", LISTING, *arguments]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    warm, cold = set(done.stderr.split()), set(twins[0][1].split())
    heavy = {"sympy", "casadi", "mpmath", "numpy", "scipy", "matplotlib", "pint"}
    assert {"sympy", "casadi"} <= cold  # so the listing does show them
    assert not heavy & warm
    assert ".sigma = 3.25," in (tmp_path / "made" / "c" / "pendubot_params.c").read_text()


def test_a_parameter_change_touches_values_and_headers_alone(workspace, run):
    (workspace / "mine.toml").write_text('extends = "sim"\n[gains]\nsigma = "3.25 1/s"\n')
    sets = {"one": ("--set", "sim"), "other": ("--params", "mine.toml")}
    models = {
        name: run("generate", "pendubot", *which, "-o", name, "--json").document()["model_sha256"]
        for name, which in sets.items()
    }
    assert models["one"] == models["other"]
    one, other = files(workspace / "one"), files(workspace / "other")
    assert one.keys() == other.keys()
    headless = {
        p: c.decode().split("Operations a control step", 1)[-1]
        for p, c in one.items()
        if isinstance(c, bytes)
    }
    changed = {p for p, c in headless.items() if not other[p].decode().endswith(c)}
    values = {f"c/pendubot_params.{kind}" for kind in "ch"}
    assert changed == {"manifest.json", "pendubot.py", *values}


# Drift -----------------------------------------------------------------------------------------


@pytest.fixture
def made(workspace, run):
    assert run("generate", "pendubot", "-o", "made").code == 0
    return workspace / "made"


def test_the_committed_code_has_not_drifted(run, workspace):
    outcome = run("generate", "pendubot", "--check", "-o", COMMITTED)
    assert outcome.code == 0, outcome.out
    assert outcome.out == f"{COMMITTED} is what pfaffian generates now\n"
    assert list(workspace.iterdir()) == []


def test_one_edited_byte_is_drift_shown_as_a_unified_diff(made, run):
    path = made / "c" / "pendubot.c"
    right = path.read_text()
    path.write_text(right.replace("offset + s", "offset - s", 1))
    before = tree(made.parent)
    outcome = run("generate", "pendubot", "--check", "-o", "made")
    assert outcome.code == 1
    assert outcome.out.startswith("--- made/c/pendubot.c\n+++ regenerated/c/pendubot.c\n@@ -")
    lines = outcome.out.splitlines()
    [was] = [x for x in lines if x.startswith("-") and not x.startswith("---")]
    [now] = [x for x in lines if x.startswith("+") and not x.startswith("+++")]
    assert ("offset - s" in was, "offset + s" in now) == (True, True)
    assert "made has drifted" in outcome.err
    assert "pfaffian generate pendubot -o made" in outcome.err
    assert tree(made.parent) == before
    script = run("generate", "pendubot", "--check", "-o", "made", "--json")
    document = script.document()
    assert (script.code, document["drift"], document["diff"]) == (1, True, outcome.out)
    assert document["error"]["exit_code"] == 1
    assert run("generate", "pendubot", "-o", "made").code == 0
    assert path.read_text() == right


@pytest.mark.parametrize(
    ("edit", "shown"),
    [
        (lambda p: (p / "c/pendubot.h").unlink(), "+++ regenerated/c/pendubot.h"),
        (lambda p: (p / "derivation.md").open("a").write("mine"), "-mine\n"),
        (lambda p: (p / "pendubot.py").write_bytes(b"\xff\xfe"), "--- made/pendubot.py"),
        (lambda p: (p / "manifest.json").write_text("{}"), "+++ regenerated/manifest.json"),
    ],
    ids=["a lost file", "a longer file", "a binary file", "another manifest"],
)
def test_any_other_difference_is_drift_too(edit, shown, made, run):
    edit(made)
    outcome = run("generate", "pendubot", "--check", "-o", "made")
    assert outcome.code == 1
    assert shown in outcome.out


def test_a_set_or_a_model_that_changed_is_drift(made, run):
    assert run("generate", "pendubot", "--check", "-o", "made").code == 0
    assert run("generate", "pendubot", "--set", "sim", "--check", "-o", "made").code == 1


def test_nothing_is_there_is_drift_and_stays_so(run, workspace):
    assert run("generate", "pendubot", "--check", "-o", "nowhere").code == 1
    assert list(workspace.iterdir()) == []


# What a second generation leaves alone ---------------------------------------------------------


def test_files_that_do_not_change_keep_their_times(made, run):
    old = {p: p.stat() for p in made.rglob("*") if p.is_file()}
    for path in old:
        os.utime(path, (1_000_000_000, 1_000_000_000))
    document = run("generate", "pendubot", "-o", "made", "--json").document()
    assert document["changed"] == []
    assert {p.stat().st_mtime for p in old} == {1_000_000_000}
    document = run("generate", "pendubot", "--set", "sim", "-o", "made", "--json").document()
    changed = {made / p for p in document["changed"]}
    assert made / "c" / "pendubot_params.c" in changed
    assert made / "derivation.md" not in changed
    gone = [p for p in old if not p.exists()]  # plan and complete controller are of another set
    assert {p.stem for p in gone} == {
        f"pendubot_{n}" for n in ("follow", "plan", "control", "control_params")
    }
    for path in set(old) - set(gone):
        assert (path.stat().st_mtime == 1_000_000_000) == (path not in changed), path


def test_foreign_files_are_kept_and_files_no_longer_generated_are_removed(made, run):
    (made / "notes.txt").write_text("mine")
    (made / "c" / "board.c").write_text("mine too")
    (made / "docs").mkdir()
    (made / "link").symlink_to("notes.txt")
    manifest = json.loads((made / "manifest.json").read_text())
    manifest["files"]["c/pendubot_old.c"] = "0" * 64
    (made / "manifest.json").write_text(json.dumps(manifest))
    (made / "c" / "pendubot_old.c").write_text("of an older version")
    document = run("generate", "pendubot", "--set", "rig", "-o", "made", "--json").document()
    assert "c/pendubot_old.c" in document["changed"]
    assert not (made / "c" / "pendubot_old.c").exists()
    assert (made / "notes.txt").read_text() == "mine"
    assert (made / "c" / "board.c").read_text() == "mine too"
    assert (made / "docs").is_dir()
    assert (made / "link").readlink() == Path("notes.txt")
    assert [p.name for p in made.parent.iterdir()] == ["made"]


def test_a_file_system_without_hard_links_is_served_too(made, run, monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    (made / "notes.txt").write_text("mine")
    monkeypatch.setattr(os, "link", refuse)
    assert run("generate", "pendubot", "--set", "sim", "-o", "made").code == 0
    assert (made / "notes.txt").read_text() == "mine"
    assert run("generate", "pendubot", "--set", "sim", "--check", "-o", "made").code == 0
