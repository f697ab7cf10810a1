"""What the code of a stage depends on: its entry module and all it imports, text by text.

The keys of the cache are made of it, so that no list of modules has to be kept by hand: a module
that a stage begins to use changes the stage's key by being imported.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from pathlib import Path

_IMPORT = re.compile(
    rb"^[ \t]*(?:from[ \t]+(pfaffian[\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]+)"
    rb"|import[ \t]+(pfaffian[\w.]*))",
    flags=re.MULTILINE,
)
_NAME = re.compile(rb"[A-Za-z_]\w*")


def code_of(*entries: str) -> list[bytes]:
    """Return the texts of the modules that the modules `entries` reach, themselves included.

    Sorted by module name. Imports inside functions count; imports by strings do not.
    """
    return list(_known_closure(entries).values())


@cache
def _known_closure(entries: tuple[str, ...]) -> dict[str, bytes]:
    return import_closure(entries)


def import_closure(
    entries: tuple[str, ...], read: Callable[[Path], bytes] = Path.read_bytes
) -> dict[str, bytes]:
    """Return the text of each module that `entries` reach by its name, sorted.

    Raises `ModuleNotFoundError` for an entry that is not a module.
    """
    found: dict[str, bytes] = {}
    waiting = list(entries)
    for name in entries:
        if _path(name) is None:
            raise ModuleNotFoundError(name)
    while waiting:
        name = waiting.pop()
        path = None if name in found else _path(name)
        if path is not None:
            found[name] = read(path)
            waiting += _imported(found[name])
            if "." in name:
                waiting.append(name.rpartition(".")[0])
    return dict(sorted(found.items()))


def modules_in(text: bytes) -> list[str]:
    """Return the modules of this distribution that `text` imports, sorted."""
    return sorted({name for name in _imported(text) if _path(name)})


def _imported(text: bytes) -> list[str]:
    """Return the modules that `text` may import; a name taken from a module may be one itself."""
    names = []
    for source, taken, whole in _IMPORT.findall(text):
        module = (source or whole).decode()
        names += [module, *(f"{module}.{n.decode()}" for n in _NAME.findall(taken))]
    return names


def _path(module: str) -> Path | None:
    """Return the file of a module or package of this distribution, nothing where it has none."""
    _, _, inner = module.partition(".")
    room, _, rest = inner.partition(".")
    root = _root(room) if room else None
    if root is None:
        return None
    path = root.joinpath(*rest.split(".")) if rest else root
    for file in (path.with_suffix(".py"), path / "__init__.py"):
        if file.is_file() and (rest or file.name == "__init__.py"):
            return file
    return None


@cache
def _root(room: str) -> Path | None:
    spec = find_spec(f"pfaffian.{room}")
    places = spec.submodule_search_locations if spec else None
    return Path(next(iter(places))) if places else None
