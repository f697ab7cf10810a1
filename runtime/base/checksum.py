"""The checksum of a parameter block, as runtime/c/pf_supervisor.c computes it."""

from __future__ import annotations

import struct
from collections.abc import Iterable

#: Fowler, Noll and Vo's constants for 32 bits; here a word at a time, and each sum is folded.
SEED = 2166136261
_PRIME = 16777619


def with_word(checksum: int, word: int) -> int:
    """Return `checksum` after another 32-bit word: FNV-1a, then its upper bits onto the lower."""
    mixed = ((checksum ^ (word & 0xFFFFFFFF)) * _PRIME) & 0xFFFFFFFF
    return mixed ^ (mixed >> 15)


def with_double(checksum: int, value: float) -> int:
    """Return `checksum` after the bits of `value`, the high word first."""
    high, low = struct.unpack(">II", struct.pack(">d", value))
    return with_word(with_word(checksum, high), low)


def checksum_of(values: Iterable[float | int]) -> int:
    """Return the checksum of `values`: an int counts as one word, a float as two."""
    checksum = SEED
    for value in values:
        add = with_word if isinstance(value, int) else with_double
        checksum = add(checksum, value)  # type: ignore[arg-type]
    return checksum
