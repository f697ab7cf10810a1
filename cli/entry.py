"""Where the process begins: the command runs in a child, and this one ends it when told to.

What computes may sit in C for seconds, swallow an exception or be in the midst of an import; this
process only waits, so a signal always finds it ready. It kills the command with all its children,
removes what they left half-written, and ends with 128 + the signal's number. Once the command has
put its files in place, an interrupt comes too late: the command is left to end on its own.

Only what starts fast is imported here.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
import time

TYPE_CHECKING = False  # as `typing` has it, without the time it takes to import
if TYPE_CHECKING:
    from typing import NoReturn

_TOLD = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if hasattr(os, "fork") else ()
#: As in `pfaffian.runtime.base.files`, which takes too long to import.
_RUN_FOLDER, _JOURNAL, _TEMPORARY, _MADE, _COMMITTED = "PFAFFIAN_RUN", "journal", b"t", b"d", b"c"
#: How long a command may take, in seconds, to put its files in place and to end after that.
_PATIENCE = 1.0
_PAUSE = 0.005
_SUBREAPER, _DEATH_SIGNAL = 36, 1  # of Linux's prctl


def main() -> NoReturn:
    """Run the command line in a child process and watch over it."""
    _open_standard_streams()
    if not _TOLD:
        _run_command()
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    watched = {*_TOLD, signal.SIGCHLD}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, watched)
    folder, me = _run_folder(), os.getpid()
    child = os.fork()
    if child:
        _prctl(_SUBREAPER, 1)
        os._exit(_watched(child, watched, folder))
    _prctl(_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != me:
        os._exit(128 + signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to both: the watcher acts
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_SETMASK, before - watched)
    if folder:
        os.environ |= {_RUN_FOLDER: folder, "TMPDIR": folder}
    _run_command()


def _run_command() -> NoReturn:
    from pfaffian.cli.main import main as command

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # where it has no sign for a letter
    command()


def _open_standard_streams() -> None:
    """Let closed standard streams lead nowhere: the next file opened would take their place."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: this one
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, "r" if number == 0 else "w"))


def _prctl(option: int, value: int) -> None:
    """Ask Linux for something that other systems do without."""
    import ctypes

    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(option, value, 0, 0, 0)


def _run_folder() -> str:
    """Return a new folder for the command's temporary files; empty where none can be made."""
    for place in (*map(os.environ.get, ("TMPDIR", "TEMP", "TMP")), "/tmp", "/var/tmp"):
        folder = os.path.join(os.path.abspath(place or "/tmp"), f"pfaffian-{os.urandom(6).hex()}")
        try:
            os.mkdir(folder, 0o700)
        except OSError:
            continue
        return folder
    return ""


def _watched(child: int, watched: set[signal.Signals], folder: str) -> int:
    """Wait for the command or a signal; return the exit code when nothing of it is left."""
    told = status = None
    while status is None and told is None:
        received = signal.sigwait(watched)
        told = received if received in _TOLD else None
        status = _ended(child)
    written = False
    if told and status is None:
        _hold(folder)  # from here on no file takes its place
        written = any(what == _COMMITTED for what, _ in _announced(folder))
        status = _wait(child) if written else None
    _end_descendants(child)
    _clear(folder)
    if told and (status is None or os.WIFSIGNALED(status)):
        _say("\x1b[?25h\n" if os.isatty(2) else "")  # a progress bar hides the cursor
        _say(f"interrupted: {'its files had been' if written else 'nothing was'} written\n")
        return 128 + told
    return _exit_code(status or 0)


def _exit_code(status: int) -> int:
    if os.WIFEXITED(status):
        return os.WEXITSTATUS(status)
    number = os.WTERMSIG(status)
    _say(f"error: the command was ended by {signal.Signals(number).name}\n")
    return 128 + number


def _say(text: str) -> None:
    with contextlib.suppress(OSError):
        os.write(2, text.encode())


def _ended(child: int) -> int | None:
    """Take all children that have ended off the system's list; return the status of `child`."""
    found = None
    with contextlib.suppress(ChildProcessError):
        while (answer := os.waitpid(-1, os.WNOHANG))[0]:
            found = answer[1] if answer[0] == child else found
    return found


def _wait(child: int) -> int | None:
    """Return the status of `child`, or nothing where it has not ended in time."""
    until = time.monotonic() + _PATIENCE
    while (status := _ended(child)) is None and time.monotonic() < until:
        time.sleep(_PAUSE)
    return status


def _hold(folder: str) -> None:
    """Take, for good, the lock that a command holds while its files take their places."""
    import fcntl

    with contextlib.suppress(OSError):
        journal = os.open(f"{folder}/{_JOURNAL}", os.O_RDWR | os.O_CREAT, 0o600)
        until = time.monotonic() + _PATIENCE
        while time.monotonic() < until:
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(journal, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            time.sleep(_PAUSE)


def _end_descendants(child: int) -> None:
    """Kill whatever is left of the command, and wait until it is gone."""
    until = time.monotonic() + _PATIENCE
    while time.monotonic() < until:
        try:
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        except ChildProcessError:
            return
        for pid in _descendants() or {child}:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(_PAUSE)


def _descendants() -> set[int]:
    """Return the processes below this one; none where the system does not list them in /proc."""
    parents: dict[int, int] = {}
    with contextlib.suppress(OSError):
        for name in filter(str.isdigit, os.listdir("/proc")):
            with contextlib.suppress(OSError), open(f"/proc/{name}/stat", "rb") as file:
                parents[int(name)] = int(file.read().rpartition(b")")[2].split()[1])
    below: set[int] = set()
    found = {os.getpid()}
    while found:
        found = {pid for pid, parent in parents.items() if parent in found}
        below |= found
    return below


def _announced(folder: str) -> list[tuple[bytes, bytes]]:
    """Return what the command has announced: what it is, and its path."""
    try:
        with open(f"{folder}/{_JOURNAL}", "rb") as file:
            return [(line[:1], line[1:]) for line in file.read().split(b"\0")[:-1]]
    except OSError:
        return []


def _clear(folder: str) -> None:
    """Remove what the command left half-written, folders that stayed empty and its own folder."""
    if not folder:
        return
    for what, path in reversed(_announced(folder)):
        if what == _TEMPORARY:
            _remove(os.fsdecode(path))
        elif what == _MADE:
            with contextlib.suppress(OSError):
                os.rmdir(path)
    _remove(f"{folder}/{_JOURNAL}")
    with contextlib.suppress(OSError):
        os.rmdir(folder)
        return
    _remove(folder)


def _remove(path: str) -> None:
    with contextlib.suppress(FileNotFoundError):
        try:
            os.unlink(path)
        except OSError:
            import shutil

            shutil.rmtree(path, ignore_errors=True)


if __name__ == "__main__":
    main()
