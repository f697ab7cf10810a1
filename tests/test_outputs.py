"""Where results go: judged before the work, whole or not at all, and full or closed streams."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from pfaffian.cli import output
from pfaffian.runtime.base import cache, files
from pfaffian.runtime.base.errors import InputError

#: Every option that writes a file, with its suffix; "" takes any.
FILES = {
    "campaign section-6-rigs -o": ".csv",
    "design pendubot --set sim --poles -6,-6,-6 -o": ".toml",
    "design pendubot --set sim --plot": ".svg",
    "plan pendubot --set rig -o": ".json",
    "plan pendubot --set rig --plot": ".svg",
    "bench sensing --plot": ".svg",
}
#: Every option that writes into a folder.
FOLDERS = ("generate pendubot -o", "build pendubot -o", "run pendubot -o", "reproduce all -o")


@pytest.fixture
def idle(monkeypatch):
    """Fail where a command says that it has begun to work."""

    def begun(text: str) -> None:
        pytest.fail(f"the work began: {text}")

    monkeypatch.setattr(output, "note", begun)
    monkeypatch.setattr(output, "progress", begun)


@pytest.mark.parametrize("call", FILES)
def test_a_file_that_cannot_be_written_is_refused_before_the_work(call, refused, workspace, idle):
    suffix = FILES[call]
    (workspace / f"folder{suffix}").mkdir()
    (workspace / "notes.txt").write_text("mine")
    (workspace / f"loop{suffix}").symlink_to(f"loop{suffix}")
    (workspace / f"device{suffix}").symlink_to("/dev/null")
    for name, says in {
        f"nowhere/made{suffix}": "there is no folder nowhere",
        f"folder{suffix}": "is a folder",
        f"notes.txt/made{suffix}": "is no folder",
        f"device{suffix}": "is no regular file",
        f"{'long' * 80}{suffix}": "cannot be written (File name too long)",
        f"/proc/made{suffix}": "cannot be written",
    }.items():
        option = call.split()[-1]
        refused(*call.split(), name, says=(f"{option} {name}: ", says))


@pytest.mark.parametrize("call", FOLDERS)
def test_a_folder_that_cannot_be_written_is_refused_before_the_work(
    call, refused, workspace, idle, monkeypatch
):
    (workspace / "notes.txt").write_text("mine")
    for name in ("notes.txt", "notes.txt/deep"):
        refused(*call.split(), name, says=("notes.txt", "is a file, not a folder", "-o"))
    refused(*call.split(), "long" * 80, says=("cannot be written (File name too long)",))
    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    refused(*call.split(), "made", says=("cannot be written (Permission denied)",))


def test_a_disk_that_fills_up_leaves_nothing_of_several_files(workspace, monkeypatch):
    (workspace / "b.svg").write_bytes(b"old")
    written = files._written_beside

    def full(path: Path, content: bytes) -> Path:
        if path.name == "b.svg":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return written(path, content)

    monkeypatch.setattr(files, "_written_beside", full)
    with pytest.raises(InputError, match=r"-o b.svg: cannot be written \(No space left"):
        files.write_outputs({Path("a.toml"): b"new", Path("b.svg"): b"new"})
    assert {p.name: p.read_bytes() for p in workspace.iterdir()} == {"b.svg": b"old"}


def test_a_link_is_followed_and_stays_a_link(workspace):
    (workspace / "real.csv").write_bytes(b"old")
    (workspace / "made.csv").symlink_to("real.csv")
    files.write_outputs({Path("made.csv"): b"new"})
    assert (workspace / "made.csv").is_symlink()
    assert (workspace / "real.csv").read_bytes() == b"new"


@pytest.mark.parametrize("errno_", [errno.ENOSPC, errno.EROFS, errno.EDQUOT, errno.EIO])
def test_a_cache_that_cannot_be_written_is_passed_over(errno_, workspace, monkeypatch):
    monkeypatch.setenv("PFAFFIAN_CACHE", str(workspace / "cache"))

    def refuse(*_, **__):
        raise OSError(errno_, os.strerror(errno_))

    monkeypatch.setattr(Path, "open", refuse)
    assert cache.cached("stage", "key", lambda: b"result") == b"result"
    monkeypatch.undo()
    assert not [p for p in workspace.rglob("*") if p.is_file()]


@pytest.mark.parametrize("place", ["notes.txt", "/proc/none", "x" * 5000, "loop"])
def test_a_cache_that_is_no_folder_is_passed_over_by_a_whole_command(place, workspace):
    (workspace / "notes.txt").write_text("mine")
    (workspace / "loop").symlink_to("loop")
    done = _process("build", "pendubot", "--target", "host", cwd=workspace, cache=place)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert (workspace / "notes.txt").read_text() == "mine"


def _process(*arguments, cache="", **options):
    environment = {**os.environ, **({"PFAFFIAN_CACHE": cache} if cache else {})}
    return subprocess.run(
        [sys.executable, "-m", "pfaffian.cli.entry", *arguments],
        **{"stdout": -1, "stderr": -1, "text": True, **options},
        check=False,
        timeout=300,
        env=environment,
    )


# Standard output and standard error ------------------------------------------------------------

PRINTING = ("models", "models --json", "--help")
FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
@pytest.mark.parametrize("call", [*PRINTING, "derive nothing --json"])
def test_a_full_standard_output_is_said_and_is_exit_2(call, workspace):
    with FULL.open("w") as full:
        done = _process(*call.split(), stdout=full, cwd=workspace)
    assert done.returncode == 2
    assert "error: " in done.stderr
    assert "No space left on device" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
def test_a_full_or_closed_standard_error_changes_nothing(workspace):
    call = "generate pendubot --check -o nothing"  # says what it does, and that it differs
    plain = _process(*call.split(), cwd=workspace)
    with FULL.open("w") as full:
        done = _process(*call.split(), stderr=full, cwd=workspace)
    closed = _shell(f"{_words(call)} 2>&-", workspace)
    assert done.returncode == closed.returncode == plain.returncode == 1
    assert done.stdout == closed.stdout == plain.stdout != ""


def _words(call: str) -> str:
    return f"{sys.executable} -m pfaffian.cli.entry {call}"


def _shell(command: str, workspace: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", "-c", command],
        cwd=workspace,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


@pytest.mark.parametrize("call", PRINTING)
def test_a_closed_standard_output_is_no_error(call, workspace):
    done = _shell(f"{_words(call)} >&-", workspace)
    assert (done.returncode, done.stdout) == (0, "")
    assert "Traceback" not in done.stderr


def test_what_is_written_with_a_closed_standard_output_is_whole(workspace, run):
    assert _shell(f"{_words('generate pendubot -o made')} >&-", workspace).returncode == 0
    assert run("generate", "pendubot", "-o", "made", "--check").code == 0


@pytest.mark.parametrize("call", PRINTING)
def test_a_reader_that_goes_away_ends_the_command_as_SIGPIPE_would(call, workspace):  # noqa: N802
    there, here = os.pipe()
    os.close(there)
    with os.fdopen(here, "w") as pipe:
        done = _process(*call.split(), stdout=pipe, cwd=workspace)
    assert done.returncode == 141
    assert "Traceback" not in done.stderr
    assert "Broken" not in done.stderr


def test_letters_that_the_encoding_lacks_are_escaped(workspace, monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    (workspace / "wörter").mkdir()
    done = _process("derive", "wörter", "--json", cwd=workspace)
    assert done.returncode == 2
    assert "w\\xf6rter" in done.stderr
    assert "Traceback" not in done.stderr
