"""The one writer: a generation reaches the disk whole, or not at all.

The new folder is built beside the old one and the two are exchanged in one system call, so a kill
at any moment leaves either the old files or the new ones, never a mixture.
"""

from __future__ import annotations

import ctypes
import difflib
import errno
import glob
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pfaffian.derive.generation import Generation
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.files import announced, committing, make_folder
from pfaffian.runtime.contract.manifest import MANIFEST_NAME

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2


def write_generation(generation: Generation, folder: Path) -> tuple[str, ...]:
    """Put `generation` into `folder` and return the paths whose bytes changed.

    Files of the user's own in `folder` are kept. Raises `InputError` where the folder cannot be
    written, or holds files but no generation.
    """
    folder = Path(os.path.realpath(folder))
    check_target(folder)
    try:
        make_folder(folder.parent)
        with _alone(folder.parent) as alone:
            if alone:
                _clear_abandoned(folder)
            return _replace(generation, folder)
    except OSError as error:
        raise _unwritable(folder, error) from error


def _replace(generation: Generation, folder: Path) -> tuple[str, ...]:
    old = _generated_files(folder)
    changed = tuple(
        path for path, text in generation.files if _bytes_of(folder / path) != text.encode("utf-8")
    )
    removed = tuple(sorted(old - {path for path, _ in generation.files}))
    if not changed and not removed:
        return ()
    staging = announced(folder.parent, _staging_prefix(folder))
    try:
        staging.mkdir()
        _fill(staging, generation, folder, removed)
        with committing():
            _exchange(staging, folder)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return tuple(sorted({*changed, *removed}))


def _staging_prefix(folder: Path) -> str:
    return f".{folder.name}-pfaffian-"


def _clear_abandoned(folder: Path) -> None:
    """Remove what killed runs have left beside `folder`; nobody else is writing now."""
    for path in folder.parent.glob(f"{glob.escape(_staging_prefix(folder))}????????"):
        shutil.rmtree(path, ignore_errors=True)


@contextmanager
def _alone(parent: Path) -> Iterator[bool]:
    """Hold the lock of `parent`, so that no two writers copy each other's files.

    The system gives it back when the process ends, however it ends. The value is whether there is
    such a lock here.
    """
    handle = None
    try:
        import fcntl

        handle = os.open(parent, os.O_RDONLY)
        fcntl.flock(handle, fcntl.LOCK_EX)
    except (ImportError, OSError):
        locked = False
    else:
        locked = True
    try:
        yield locked
    finally:
        if handle is not None:
            os.close(handle)


def drift(generation: Generation, folder: Path) -> str:
    """Return a unified diff from the files in `folder` to `generation`; empty where none."""
    wanted = dict(generation.files)
    lines: list[str] = []
    for path in sorted({*wanted, *_generated_files(folder)}):
        stored = _bytes_of(folder / path)
        before = stored.decode("utf-8", "replace") if stored is not None else ""
        after = wanted.get(path, "")
        if stored == after.encode("utf-8"):
            continue
        lines += difflib.unified_diff(
            before.splitlines(keepends=True),
            after.splitlines(keepends=True),
            f"{folder.name}/{path}",
            f"regenerated/{path}",
        )
    return "".join(line if line.endswith("\n") else f"{line}\n" for line in lines)


def check_target(folder: Path) -> None:
    """Raise `InputError` where no generation can be put into `folder`."""
    try:
        _check_place(Path(os.path.realpath(folder)))
    except OSError as error:  # a folder above may not even be looked into
        raise _unwritable(folder, error) from error


def _check_place(folder: Path) -> None:
    place = folder if folder.exists() else _nearest(folder)
    if not place.is_dir():
        raise InputError(f"{place}: is a file, not a folder", remedy="name another folder with -o")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / MANIFEST_NAME).is_file():
        raise InputError(
            f"{folder}: is not empty and holds no generated model",
            remedy="name an empty or new folder with -o, so that none of your files is touched",
        )
    parent = folder if folder.is_dir() else _nearest(folder)
    for place in {parent, _nearest(folder)}:
        if not os.access(place, os.W_OK | os.X_OK):
            raise _unwritable(place, OSError(errno.EACCES, os.strerror(errno.EACCES)))


def _nearest(folder: Path) -> Path:
    """Return the nearest folder above `folder` that exists."""
    above = folder.parent
    while not above.exists():
        above = above.parent
    return above


def _unwritable(folder: Path, error: OSError) -> InputError:
    return InputError(
        f"{folder}: cannot be written ({error.strerror or error})",
        remedy="choose another folder with -o, or mend its rights",
    )


def _generated_files(folder: Path) -> set[str]:
    """Return the paths that the manifest in `folder` lists, itself included.

    A path that leads out of the folder is none of ours, whatever an edited manifest says.
    """
    import json

    try:
        document = json.loads((folder / MANIFEST_NAME).read_text(encoding="utf-8"))
        listed = {Path(str(p)) for p in document["files"]}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return set()
    ours = {p.as_posix() for p in listed if p.name and not p.is_absolute() and ".." not in p.parts}
    return ours | {MANIFEST_NAME}


def _bytes_of(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _fill(staging: Path, generation: Generation, folder: Path, removed: tuple[str, ...]) -> None:
    """Build the new folder; unchanged and foreign files are hard links and keep their times."""
    staging.chmod(folder.stat().st_mode if folder.exists() else 0o777 & ~_umask())
    if folder.exists():
        shutil.copytree(folder, staging, copy_function=_link, symlinks=True, dirs_exist_ok=True)
    for path in removed:
        (staging / path).unlink(missing_ok=True)
    for path, text in generation.files:
        target = staging / path
        content = text.encode("utf-8")
        if _bytes_of(target) == content:
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        target.unlink(missing_ok=True)
        with target.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())


def _link(source: str, target: str) -> str:
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError:  # a file system without hard links
        shutil.copy2(source, target, follow_symlinks=False)
    return target


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _exchange(staging: Path, folder: Path) -> None:
    """Let `staging` take the place of `folder`; the old content is then in `staging`."""
    if not folder.exists():
        staging.rename(folder)
        return
    libc = ctypes.CDLL(None, use_errno=True)
    renameat2 = getattr(libc, "renameat2", None)
    if renameat2 is not None:
        done = renameat2(
            _AT_FDCWD, os.fsencode(staging), _AT_FDCWD, os.fsencode(folder), _RENAME_EXCHANGE
        )
        if done == 0:
            return
        if ctypes.get_errno() not in (errno.EINVAL, errno.ENOSYS):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    # No atomic exchange here (another system or file system): two renames, the shortest window.
    aside = staging.with_name(f"{staging.name}-old")
    folder.rename(aside)
    staging.rename(folder)
    aside.rename(staging)
