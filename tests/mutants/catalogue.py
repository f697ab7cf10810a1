"""The planted faults: read from the lists by area, planted in a tree, taken out again."""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
LISTS = HERE / "faults"
#: The areas in the order of the pipeline: one list each.
AREAS = (
    *("derivation", "law", "lowering", "optimiser", "emission", "verify", "certificate", "design"),
    *("sets", "controller", "twin", "plan", "reproduction", "runtime", "command-line"),
)
_KEYS = {"what", "file", "find", "replace", "tests", "regenerate", "equivalent", "quick", "also"}


@dataclass(frozen=True)
class Fault:
    """One single fault.

    `what` says what is wrong with it planted; `find` stands exactly once in `file` and becomes
    `replace`; `tests` (FILE::TEST below tests/) must fail then. The models of `regenerate` are
    generated anew first: a drift check alone is no proof. `equivalent` explains a fault that
    changes nothing a test could see. `quick` ones may run in the short form. `also` are further
    edits (file, find, replace), where one mistake stands in two places.
    """

    area: str
    what: str
    file: str
    find: str
    replace: str
    tests: tuple[str, ...]
    regenerate: tuple[str, ...] = ()
    equivalent: str = ""
    quick: bool = False
    also: tuple[tuple[str, str, str], ...] = ()

    @property
    def edits(self) -> tuple[tuple[str, str, str], ...]:
        """Return every edit as (file, find, replace)."""
        return ((self.file, self.find, self.replace), *self.also)

    def digest(self) -> str:
        """Return what tells this fault from any other, and from its former wording."""
        return hashlib.sha256(repr(sorted(asdict(self).items())).encode()).hexdigest()


def read_faults(folder: Path = LISTS) -> tuple[Fault, ...]:
    """Return the faults of every list, in the order of `AREAS`; raise `ValueError` on a bad one."""
    faults = []
    strangers = sorted(p.name for p in folder.glob("*.toml") if p.stem not in AREAS)
    if strangers:
        raise ValueError(f"{folder}: no area is called {', '.join(strangers)}")
    for area in AREAS:
        path = folder / f"{area}.toml"
        if path.is_file():
            rows = tomllib.loads(path.read_text(encoding="utf-8"))["fault"]
            faults += [_fault(area, row) for row in rows]
    names = [f.what for f in faults]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise ValueError(f"two faults are called {twice[0]!r}")
    return tuple(faults)


def _fault(area: str, row: dict[str, Any]) -> Fault:
    about = f"{area}: {row.get('what', row)}"
    if unknown := set(row) - _KEYS:
        raise ValueError(f"{about}: unknown keys {sorted(unknown)}")
    if missing := {"what", "file", "find", "replace", "tests"} - set(row):
        raise ValueError(f"{about}: without {sorted(missing)}")
    if not row["tests"] or row["find"] == row["replace"]:
        raise ValueError(f"{about}: no test, or no fault")
    lists = {k: tuple(row[k]) for k in ("tests", "regenerate") if k in row}
    also = tuple((e["file"], e["find"], e["replace"]) for e in row.get("also", ()))
    return Fault(area, **{**row, **lists, "also": also})


def problem(fault: Fault, root: Path = ROOT) -> str:
    """Return why `fault` cannot be planted in the tree at `root`, or nothing."""
    for file, find, _ in fault.edits:
        path = root / file
        if not path.is_file():
            return f"{fault.area}: {fault.what}: there is no {file}"
        count = path.read_text(encoding="utf-8").count(find)
        if count != 1:
            return f"{fault.area}: {fault.what}: its text stands {count} times in {file}"
    for test in fault.tests:
        name, _, function = test.partition("::")
        path = root / "tests" / name
        bare = function.partition("[")[0]
        if not path.is_file() or f"def {bare}(" not in path.read_text(encoding="utf-8"):
            return f"{fault.area}: {fault.what}: there is no test {test}"
    return ""


def plant(fault: Fault, root: Path, moment: int) -> list[Callable[[], None]]:
    """Plant `fault` in the tree at `root`; return what takes each edit out again, the last first.

    `moment` (seconds) becomes the files' time: it must be another one for each planting, for
    compiled modules and Makefiles go by it.
    """
    if found := problem(fault, root):
        raise ValueError(found)
    return [_edited(root / f, old, new, moment) for f, old, new in fault.edits][::-1]


def _edited(path: Path, old: str, new: str, moment: int) -> Callable[[], None]:
    former, times = path.read_bytes(), path.stat()

    def restore() -> None:
        path.write_bytes(former)
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))

    path.write_bytes(former.decode("utf-8").replace(old, new).encode("utf-8"))
    os.utime(path, (moment, moment))
    return restore


def tree_digest(files: Iterable[Path], root: Path) -> str:
    """Return a digest over the names and contents of `files`, below `root`."""
    total = hashlib.sha256()
    for path in sorted(files):
        total.update(f"{path.relative_to(root)}\0".encode())
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()
