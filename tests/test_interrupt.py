"""Every command ends at once when told to: no child, no file, no traceback; 128 + the signal."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from pfaffian.cli.bench.commands import bench_app
from pfaffian.cli.main import app
from support_processes import check_ended, start

pytestmark = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads /proc")

#: One call of each command that takes longer than the longest delay, and would write.
LONG = {
    "audit": "audit pendubot",
    "bench batch": "bench batch pendubot",
    "bench chain": "bench chain --links 2,4,6,8",
    "bench regenerate": "bench regenerate",
    "bench sensing": "bench sensing --plot made.svg",
    "bench step": "bench step",
    "build": "build pendubot -o made",
    "campaign": "campaign section-6-grid -o made.csv",
    "certify": "certify pendubot",
    "derive": "derive chain",
    "design": "design pendubot --set sim --curve --plot made.svg",
    "generate": "generate pendubot -o made",
    "models": "models",
    "pil": "pil rig-balance",
    "plan": "plan pendubot --set rig -o made.json",
    "reproduce": "reproduce figure-7 -o made",
    "run": "run pendubot -o made",
    "simulate": "simulate rig-balance",
    "targets": "targets",
    "template": "template pendubot",
    "verify": "verify pendubot",
}
#: Commands that may end, or have said all, before a later interrupt.
SHORT = ("models", "targets", "build")
#: Seconds from the first line of the program on; `make interrupts` takes many.
DELAYS = [float(d) for d in os.environ.get("PFAFFIAN_INTERRUPT_DELAYS", "0,0.4").split(",")]
#: Commands, and words of a child's command line or of standard error that show how far they are.
DEEP = {
    "workers of a campaign": ("campaign section-6-laws --jobs 2 -o made.csv", 4, ""),
    "a compiler": ("build pendubot --target host -o made", 0, "cc1 "),
    "an emulator": ("pil rig-balance --emulator qemu-user", 0, "qemu-ppc"),
}


def test_every_command_is_in_the_list():
    names = {c.name or c.callback.__name__ for c in app.registered_commands}
    names |= {f"bench {c.name}" for c in bench_app.registered_commands}
    assert names == set(LONG)


@pytest.mark.parametrize("command", LONG)
def test_an_interrupt_ends_the_command_at_once_at_whatever_moment(command, tmp_path):
    """All delays run at once, each in a folder of its own, with nothing in the cache."""
    started = []
    for k, delay in enumerate(DELAYS):
        workspace = tmp_path / f"{k}"
        workspace.mkdir()
        call = start(LONG[command].split(), workspace, PFAFFIAN_CACHE="off")
        started.append((delay, workspace, call))
    for delay, workspace, call in started:
        there = call.wait_until(call.is_watched)
        time.sleep(delay)
        if delay and (not there or call.process.poll() is not None):
            assert command in SHORT, "it ended before the interrupt"
            call.process.communicate()
            continue
        call.process.send_signal(signal.SIGINT)
        said = check_ended(call, workspace, 130, command not in SHORT)
        assert said.endswith("interrupted: nothing was written\n")


@pytest.mark.parametrize("what", DEEP)
def test_an_interrupt_reaches_every_child(what, tmp_path):
    words, count, seen = DEEP[what]
    if seen == "qemu-ppc":
        pytest.importorskip("ziglang")
        from pfaffian.runtime.base.errors import MissingToolError
        from pfaffian.runtime.machine.toolchain import program_target

        try:
            program_target("ppc750")
        except MissingToolError as error:
            pytest.skip(str(error))
    workspace = tmp_path / "work"
    workspace.mkdir()
    cache = {"PFAFFIAN_CACHE": "off"} if seen == "cc1 " else {}
    call = start(words.split(), workspace, **cache)

    def deep() -> bool:
        there = call.below()
        if count:
            return len(there) >= count
        return any(seen in line for line in there.values())

    assert call.wait_until(deep), call.process.communicate()
    call.process.send_signal(signal.SIGINT)
    check_ended(call, workspace, 130)


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGHUP])
def test_other_signals_that_end_a_program_do_so_too(how, tmp_path):
    workspace = tmp_path / "work"
    workspace.mkdir()
    call = start(["certify", "pendubot"], workspace)
    assert call.wait_until(call.is_watched)
    call.process.send_signal(how)
    check_ended(call, workspace, 128 + how)


def test_the_solver_that_swallows_interrupts_is_ended_too(tmp_path):
    """IPOPT takes an interrupt for a start that led nowhere, and the plan went on without it."""
    workspace = tmp_path / "work"
    workspace.mkdir()
    words = "plan pendubot --set rig --seeds 3 -o made.json"
    call = start(words.split(), workspace)
    # 3 starts on the coarse grid take seconds; the solver's first lines are long past then.
    assert call.wait_until(lambda: _seconds_of(call) > 2.5)
    call.process.send_signal(signal.SIGINT)
    check_ended(call, workspace, 130)


def _seconds_of(call) -> float:
    """Return the processor's time that the command has taken so far."""
    total = 0.0
    for pid in call.below():
        try:
            words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        total += (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
    return total


# What is being written -------------------------------------------------------------------------

#: Stands in for a command: BODY runs where the command would.
STAND_IN = """
import os, sys, time
from pathlib import Path
from pfaffian.cli import entry
from pfaffian.runtime.base import files

def command():
    print("ready", flush=True)
    {body}
    sys.exit(0)

entry._run_command = command
entry.main()
"""


def stand_in(body: str, workspace: Path):
    """Start a process that does `body` as a command, and wait until it has begun."""
    call = start([], workspace, STAND_IN.format(body=body.replace("\n", "\n    ")))
    assert call.process.stdout.readline() == "ready\n"
    return call


def test_what_was_half_written_is_removed(tmp_path):
    workspace = tmp_path / "work"
    workspace.mkdir()
    body = """
place = Path("deep/er")
files.make_folder(place)
files._written_beside(place / "made.csv", b"half")
staging = files.announced(Path("."), ".made-pfaffian-")
staging.mkdir()
(staging / "c").mkdir()
(staging / "c" / "made.c").write_text("half")
print("written", flush=True)
time.sleep(600)"""
    call = stand_in(body, workspace)
    assert call.process.stdout.readline() == "written\n"
    assert len(list(workspace.rglob("*"))) == 6
    call.process.send_signal(signal.SIGINT)
    check_ended(call, workspace, 130)


@pytest.mark.parametrize("after", ["", "time.sleep(600)"], ids=["ends", "hangs"])
def test_files_that_belong_together_appear_together_and_an_interrupt_is_then_too_late(
    after, tmp_path
):
    body = f"""
real = Path.replace
def slow(self, target):
    time.sleep(0.1)
    return real(self, target)
Path.replace = slow
files.write_outputs({{Path(f"made{{k}}.csv"): b"whole" for k in range(4)}})
{after}"""
    workspace = tmp_path / "work"
    workspace.mkdir()
    call = stand_in(body, workspace)
    assert call.wait_until(lambda: any(workspace.glob("made*.csv")))
    call.process.send_signal(signal.SIGINT)
    _, said = call.process.communicate(timeout=120)
    assert call.process.returncode == (130 if after else 0)
    assert ("interrupted: its files had been written" in said) is bool(after)
    assert {p.name: p.read_bytes() for p in workspace.iterdir()} == {
        f"made{k}.csv": b"whole" for k in range(4)
    }
    assert call.below() == {}


def test_a_command_whose_watcher_is_killed_ends_too(tmp_path):
    workspace = tmp_path / "work"
    workspace.mkdir()
    call = stand_in("time.sleep(600)", workspace)
    call.process.kill()
    call.process.communicate(timeout=120)
    until = time.monotonic() + 60.0
    while call.below() and time.monotonic() < until:
        time.sleep(0.01)
    assert call.below() == {}


def test_a_command_that_the_system_kills_is_said_to_be(tmp_path):
    workspace = tmp_path / "work"
    workspace.mkdir()
    call = stand_in("os.kill(os.getpid(), 9)", workspace)
    _, said = call.process.communicate(timeout=120)
    assert call.process.returncode == 137
    assert said == "error: the command was ended by SIGKILL\n"
