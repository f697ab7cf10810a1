"""Real processes of the command line: started, waited for, told to end; nothing may be left."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

#: On a machine that is busy with other things everything takes longer; nothing takes this long.
PATIENCE = 120.0
_MARK = "PFAFFIAN_TEST_MARK"


@dataclass(frozen=True)
class Started:
    """A process with a mark in its environment, which all its children inherit."""

    process: subprocess.Popen[str]
    mark: str
    temporary: Path

    def below(self) -> dict[int, str]:
        """Return the command lines of all living processes that bear the mark, itself included."""
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                if self.mark.encode() in (folder / "environ").read_bytes():
                    words = (folder / "cmdline").read_bytes().replace(b"\0", b" ")
                    found[int(folder.name)] = words.decode(errors="replace")
            except OSError:
                continue
        return found

    def wait_until(self, holds: Callable[[], bool]) -> bool:
        """Wait until `holds` does; return whether it did before the process ended by itself."""
        until = time.monotonic() + PATIENCE
        while not holds():
            if self.process.poll() is not None:
                return False
            assert time.monotonic() < until, f"never came: {self.below()}"
            time.sleep(0.005)
        return True

    def is_watched(self) -> bool:
        """Return whether the command runs in its child: from there on a signal is waited for."""
        return len(self.below()) > 1


def start(
    arguments: Sequence[object], workspace: Path, script: str = "", **environment: str
) -> Started:
    """Start the command line, or `script`, with temporary files of its own beside `workspace`."""
    mark = uuid.uuid4().hex
    temporary = workspace.parent / f"temporary-{mark}"
    temporary.mkdir()
    how = ["-c", script] if script else ["-m", "pfaffian.cli.entry"]
    process = subprocess.Popen(
        [sys.executable, *how, *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=workspace,
        env={**os.environ, "TMPDIR": str(temporary), _MARK: mark, **environment},
    )
    return Started(process, mark, temporary)


def check_ended(started: Started, workspace: Path, code: int, silent: bool = True) -> str:
    """Check that the process ends with `code` and leaves nothing; return what it said.

    Two seconds are the promise, on a machine that does nothing else.
    """
    out, err = started.process.communicate(timeout=PATIENCE)
    assert started.process.returncode == code, err
    assert started.below() == {}, "a child was left"
    assert list(workspace.iterdir()) == [], "something was written"
    assert list(started.temporary.iterdir()) == [], "temporary files were left"
    assert "Traceback" not in err
    assert out == "" or not silent
    return err
