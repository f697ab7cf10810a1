"""A generation that is killed leaves the old files whole or the new ones, at whatever moment."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import tree
from pfaffian.derive.generation import Generation
from pfaffian.derive.writer import write_generation

#: Forks a writer for each k and kills it with SIGKILL at the k-th operation on the file system
#: (every `open`, link, rename, mkdir, remove ... that Python audits), until one gets through.
#: Between two of them the folder must not change, so this is every moment there is.
KILLER = r"""
import itertools, json, os, shutil, signal, sys
from pathlib import Path
from conftest import tree
from pfaffian.derive.generation import Generation
from pfaffian.derive.writer import write_generation

work, first = Path(sys.argv[1]), sys.argv[2] == "first"
old, new = (Generation("m", tuple(map(tuple, f))) for f in json.loads(sys.stdin.read()))
folder = work / "made"

def prepare():
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    if not first:
        write_generation(old, folder)
        (folder / "notes.txt").write_text("mine")

def killed_at(k):
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    count = itertools.count()
    def hook(event, _):
        if event.partition(".")[0] in ("open", "os", "shutil", "tempfile", "ctypes"):
            if next(count) == k:
                os.kill(os.getpid(), signal.SIGKILL)
    sys.addaudithook(hook)
    write_generation(new, folder)
    os._exit(0)

prepare()
before = tree(work)
write_generation(new, folder)
after = tree(work)
outcomes = []
for k in itertools.count():
    prepare()
    if not killed_at(k):
        break
    found = tree(work)
    there = {p: c for p, c in found.items() if p.partition("/")[0] == "made"}
    state = "old" if there == before else "new" if there == after else "neither"
    write_generation(new, folder)  # the next run, beside what the killed one left
    there = {p: c for p, c in tree(work).items() if p.partition("/")[0] == "made"}
    clean = there == after and os.listdir(work) == ["made"]
    outcomes.append([state, "new" if clean else "broken"])
print(json.dumps(outcomes))
"""
#: Runs the command line, and stops for good at the first file it has written.
STOPPED = """
import os, signal, time
from pfaffian.cli.main import main
def fsync(_):
    print("writing", flush=True)
    while True:  # a pause would miss a signal that came before it
        time.sleep(0.05)
os.fsync = fsync
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
main()
"""


def generation(**files: str) -> Generation:
    """Return a small generation; every write is synced, and a kill is tried at each."""
    named = {name.replace("__", "/").replace("_", "."): text for name, text in files.items()}
    named["manifest.json"] = json.dumps({"files": dict.fromkeys(named, "")})
    return Generation("m", tuple(sorted(named.items())))


@pytest.fixture(scope="module")
def generations():
    old = generation(m_py="old", c__m_c="old", c__m_h="kept", c__gone_c="old", only__old_c="old")
    new = generation(m_py="new", c__m_c="new, and longer", c__m_h="kept", c__more__new_c="new")
    return old, new


@pytest.mark.parametrize("start", ["first", "second"])
def test_a_generation_killed_at_any_moment_leaves_all_old_or_all_new_files(
    start, generations, tmp_path
):
    document = json.dumps([g.files for g in generations])
    done = subprocess.run(
        [sys.executable, "-c", KILLER, str(tmp_path / "work"), start],
        input=document,
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    outcomes = json.loads(done.stdout)
    states = [state for state, _ in outcomes]
    assert len(states) > 30  # so it was killed at many moments, most of them in the midst
    assert states == sorted(states, reverse=True)  # old until the exchange, new from there on
    assert {"old"} <= set(states) <= {"old", "new"}
    assert {after for _, after in outcomes} == {"new"}
    if start == "second":
        assert "new" in states  # it was killed after the exchange as well, while clearing up


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_process_ended_from_outside_leaves_the_old_generation_whole(how, workspace, run):
    assert run("generate", "pendubot", "--set", "sim", "-o", "made").code == 0
    before = tree(workspace / "made")
    arguments = ("generate", "pendubot", "--set", "rig", "-o", "made")
    process = subprocess.Popen(
        [sys.executable, "-c", STOPPED, *arguments], stdout=-1, stderr=-1, text=True
    )
    assert process.stdout.readline() == "writing\n"
    process.send_signal(how)
    _, said = process.communicate(timeout=60)
    assert process.returncode in (-how, 128 + how)
    assert "Traceback" not in said
    assert tree(workspace / "made") == before
    left = [p.name for p in workspace.iterdir() if p.name != "made"]
    assert len(left) == (0 if how == signal.SIGINT else 1)  # what could clear up did
    assert run(*arguments).code == 0
    assert run(*arguments, "--check").code == 0
    assert [p.name for p in workspace.iterdir()] == ["made"]  # and the next run did it then


def test_clearing_up_spares_what_only_looks_alike(generations, workspace):
    alike = [".made-pfaffian-notes", ".made-12345678", ".other-pfaffian-12345678"]
    for name in [*alike, ".made-pfaffian-12345678"]:
        (workspace / name).mkdir()
    write_generation(generations[0], workspace / "made")
    assert sorted(p.name for p in workspace.iterdir()) == sorted([*alike, "made"])


def test_without_an_exchange_of_the_system_the_folders_are_renamed(
    generations, workspace, monkeypatch
):
    folder = workspace / "made"
    write_generation(generations[0], folder)
    (folder / "notes.txt").write_text("mine")
    monkeypatch.setattr("ctypes.CDLL", lambda *_, **__: object())
    changed = write_generation(generations[1], folder)
    assert "manifest.json" in changed
    wanted = {path: text.encode() for path, text in generations[1].files}
    there = {p: c for p, c in tree(workspace).items() if c != "a folder"}
    assert there == {f"made/{p}": c for p, c in {**wanted, "notes.txt": b"mine"}.items()}


def test_many_writers_at_once_leave_one_whole_generation(generations, workspace):
    """Four processes write into one folder; whichever comes last, nothing is mixed."""
    script = """
import json, sys
from pathlib import Path
from pfaffian.derive.generation import Generation
from pfaffian.derive.writer import write_generation
both = [Generation("m", tuple(map(tuple, f))) for f in json.loads(sys.stdin.read())]
for k in range(20):
    write_generation(both[(k + int(sys.argv[1])) % 2], Path("made"))
"""
    document = json.dumps([g.files for g in generations])
    writers = [
        subprocess.Popen([sys.executable, "-c", script, str(n)], stdin=-1, stderr=-1, text=True)
        for n in range(4)
    ]
    for writer in writers:
        writer.stdin.write(document)
        writer.stdin.close()
    for writer in writers:
        assert writer.wait(timeout=120) == 0, writer.stderr.read()
        writer.stderr.close()
    there = {p: c for p, c in tree(workspace / "made").items() if c != "a folder"}
    assert there in [{path: text.encode() for path, text in g.files} for g in generations]
    assert [p.name for p in workspace.iterdir()] == ["made"]
