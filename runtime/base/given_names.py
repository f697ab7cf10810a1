"""The one rule by which a name of ours gives way to one that a person has given."""

from __future__ import annotations

from collections.abc import Iterable

SUFFIX = "_law"


def given_away(name: str, taken: Iterable[str]) -> str:
    """Return `name`, or where that is taken `name_law`, `name_law_law`, ..."""
    known = frozenset(taken)
    while name in known:
        name += SUFFIX
    return name
