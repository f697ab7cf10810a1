"""A content-addressed cache of stage results in the user's cache folder.

The key of an entry is a digest of everything the result depends on, so an entry is never stale;
losing the folder costs time, nothing else. `PFAFFIAN_CACHE` moves it, `PFAFFIAN_CACHE=off` turns
it off.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path

import platformdirs
from pfaffian.runtime.base.files import write_whole


def cache_folder() -> Path | None:
    """Return the cache folder, or None where the cache is turned off."""
    chosen = os.environ.get("PFAFFIAN_CACHE", "")
    if chosen == "off":
        return None
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("pfaffian"))


def digest(*parts: bytes) -> str:
    """Return one SHA-256 over `parts`, each with its length so that they cannot run together."""
    total = hashlib.sha256()
    for part in parts:
        total.update(len(part).to_bytes(8, "big"))
        total.update(part)
    return total.hexdigest()


def cached(stage: str, key: str, compute: Callable[[], bytes]) -> bytes:
    """Return the stored result of `stage` for `key`, or compute and store it.

    A folder that cannot be written is passed over: the result is computed each time.
    """
    known = stored(stage, key)
    if known is not None:
        return known
    body = compute()
    folder = cache_folder()
    if folder is not None:
        _store(folder / stage / key, body + hashlib.sha256(body).digest())
    return body


def stored(stage: str, key: str) -> bytes | None:
    """Return the stored result of `stage` for `key`, or nothing where there is none."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        content = (folder / stage / key).read_bytes()
    except OSError:
        return None
    body, seal = content[:-32], content[-32:]
    return body if hashlib.sha256(body).digest() == seal else None


def _store(entry: Path, content: bytes) -> None:
    try:
        entry.parent.mkdir(parents=True, exist_ok=True)
        write_whole(entry, content)
    except OSError:
        return
