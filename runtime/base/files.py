"""Outputs: judged before the work, written whole or not at all, and cleared up after a kill.

A command runs under a process that watches over it (`pfaffian.cli.entry`) and shares the folder in
`PFAFFIAN_RUN` with it. What is being written is announced there first, so that the watcher can
remove what a killed command has left; while files change their names, `committing` is held.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from pfaffian.runtime.base.errors import InputError

#: The environment's name of the folder that a command shares with its watcher.
RUN_FOLDER = "PFAFFIAN_RUN"
#: The announcements in it: a letter and a path each, `MADE` of a folder, `TEMPORARY` of the rest;
#: `COMMITTED` has no path.
JOURNAL, TEMPORARY, MADE, COMMITTED = "journal", b"t", b"d", b"c"


def check_output(
    path: Path | None, option: str, suffix: str = "", *, force: bool | None = None
) -> None:
    """Raise `InputError` naming `option` where no file can be written to `path`.

    With `force` false a file that exists is left alone; with None it is replaced without asking.
    A `path` of None was not asked for.
    """
    if path is None:
        return
    if suffix and path.suffix != suffix:
        raise InputError(f"{option} {path}: is no {suffix} file", remedy=f"name it *{suffix}")
    try:
        if path.is_dir():
            raise InputError(f"{option} {path}: is a folder", remedy="name a file")
        if path.exists() and not path.is_file():
            raise InputError(f"{option} {path}: is no regular file", remedy="name a file")
        if path.exists() and force is False:
            raise InputError(
                f"{option} {path}: exists already", remedy="name another file, or add --force"
            )
        if not path.parent.exists():
            raise InputError(
                f"{option} {path}: there is no folder {path.parent}", remedy="make it first"
            )
        _try(path, option, path.resolve().parent, path.name)
    except (OSError, ValueError, RuntimeError) as error:
        raise unwritable(path, error, option) from error


def check_output_folder(folder: Path | None, option: str) -> None:
    """Raise `InputError` naming `option` where no files can be written into `folder`.

    It may be missing, and folders above it. A `folder` of None was not asked for.
    """
    if folder is None:
        return
    try:
        place = Path(os.path.realpath(folder))
        while not place.exists() and place != place.parent:
            place = place.parent
        if not place.is_dir():
            what = "is a file, not a folder" if place.is_file() else "is no folder"
            raise InputError(
                f"{option} {folder}: {place.name} {what}", remedy="name another folder"
            )
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            os.lstat(folder)  # its name may be too long
        _try(folder, option, place)
    except (OSError, ValueError, RuntimeError) as error:
        raise unwritable(folder, error, option) from error


def _try(path: Path, option: str, folder: Path, name: str = "pfaffian") -> None:
    """Make a file in `folder` and remove it: what the system says of rights is not all."""
    if not folder.is_dir():
        raise InputError(f"{option} {path}: {folder} is no folder", remedy="name another place")
    if not os.access(folder, os.W_OK | os.X_OK):
        read_only = bool(os.statvfs(folder).f_flag & os.ST_RDONLY)
        code = errno.EROFS if read_only else errno.EACCES
        raise OSError(code, os.strerror(code))
    probe = announced(folder, f".{name}-")
    probe.touch(exist_ok=False)
    probe.unlink()


def unwritable(path: Path, error: Exception, option: str = "-o") -> InputError:
    """Return the error that says why `path`, which `option` names, cannot be written."""
    said = getattr(error, "strerror", None) or str(error)
    return InputError(
        f"{option} {path}: cannot be written ({said})",
        remedy="name another place, or mend its rights or its disk",
    )


def write_outputs(contents: Mapping[Path, bytes], option: str = "-o") -> None:
    """Write every file of `contents`, or none; missing folders are made.

    Raises `InputError` naming `option` and the file that could not be written.
    """
    ready: list[tuple[Path, Path]] = []
    path = next(iter(contents), Path())
    try:
        for path, content in contents.items():
            target = Path(os.path.realpath(path))
            make_folder(target.parent)
            ready.append((_written_beside(target, content), target))
        with committing():
            for temporary, path in ready:
                temporary.replace(path)
    except OSError as error:
        raise unwritable(path, error, option) from error
    finally:
        for temporary, _ in ready:
            temporary.unlink(missing_ok=True)


def write_whole(path: Path, content: bytes) -> None:
    """Write `content` beside `path` and move it there, so that nobody sees half a file.

    Raises `OSError`; for files that a user named see `write_outputs`.
    """
    temporary = _written_beside(path, content)
    try:
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def _written_beside(path: Path, content: bytes) -> Path:
    temporary = announced(path.parent, f".{path.name}-")
    try:
        with temporary.open("xb") as file:
            file.write(content)
        temporary.chmod(0o644)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    return temporary


def announced(folder: Path, prefix: str) -> Path:
    """Return a new name in `folder`, announced to the watcher before anything bears it."""
    path = folder / f"{prefix}{os.urandom(4).hex()}"
    _announce(TEMPORARY, path)
    return path


def make_folder(folder: Path) -> None:
    """Make `folder` and those above it; the watcher removes those that stay empty."""
    missing = []
    while not folder.exists():
        missing.append(folder)
        folder = folder.parent
    for place in reversed(missing):
        _announce(MADE, place)
        place.mkdir(exist_ok=True)


def _announce(what: bytes, path: Path | None = None) -> None:
    run = os.environ.get(RUN_FOLDER)
    if not run:
        return
    line = what + (os.fsencode(os.path.abspath(path)) if path else b"") + b"\0"  # noqa: PTH100
    with contextlib.suppress(OSError), (Path(run) / JOURNAL).open("ab", buffering=0) as journal:
        journal.write(line)


_held: list[None] = []  # one entry for each `committing` that is open


@contextlib.contextmanager
def committing() -> Iterator[None]:
    """Hold the watcher back while finished files take their places: all of them, or none."""
    run = os.environ.get(RUN_FOLDER)
    with contextlib.ExitStack() as lock:
        if run and not _held:
            with contextlib.suppress(ImportError, OSError):
                import fcntl

                journal = lock.enter_context((Path(run) / JOURNAL).open("ab"))
                fcntl.flock(journal, fcntl.LOCK_EX)
        _held.append(None)
        try:
            yield
            if len(_held) == 1:
                _announce(COMMITTED)
        finally:
            _held.pop()
