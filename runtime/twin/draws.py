"""Random numbers of the twin: every rig and every purpose has a stream of its own.

A rig therefore draws the same numbers whatever flies beside it and whatever else is random. Only
uniform doubles of PCG64 are used: NumPy's other distributions call the C library.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from pfaffian.runtime.base.arrays import Array

_BLOCK = 256


class Purpose(IntEnum):
    """What a stream is for; the number is part of its seed."""

    PLANT = 0
    START = 1
    DELAY = 2
    OFFSET = 3
    JITTER = 4
    MISSED = 5
    NOISE = 6
    DROPOUT = 7


def streams(seed: int, rigs: range, purpose: Purpose) -> list[np.random.Generator]:
    """Return a generator of each rig in `rigs` for `purpose`."""
    return [np.random.Generator(np.random.PCG64([seed, r, int(purpose)])) for r in rigs]


def uniform(seed: int, rigs: range, purpose: Purpose, count: int) -> Array:
    """Return the first `count` numbers from [0, 1) of each rig's stream, shape (N, count)."""
    drawn = [g.random(count) for g in streams(seed, rigs, purpose)]
    return np.array(drawn).reshape(len(rigs), count)


def whole(draws: Array, largest: Array | int) -> Array:
    """Return whole numbers, int64 from -`largest` to `largest`, from draws of [0, 1)."""
    return np.asarray(np.floor(draws * (2 * largest + 1)).astype(np.int64) - largest)


class Blocks:
    """A stream of each rig that gives n numbers a period, drawn some hundred periods at a time."""

    def __init__(self, seed: int, rigs: range, purpose: Purpose, width: int) -> None:
        """Start the streams; `width` numbers are taken a period."""
        self._streams = streams(seed, rigs, purpose)
        self._shape = (_BLOCK, width)
        self._block: Array = np.empty((0,))
        self._next = _BLOCK

    def take(self) -> Array:
        """Return the numbers of the next period, shape (N, width)."""
        if self._next == _BLOCK:
            drawn = [g.random(self._shape) for g in self._streams]
            self._block = np.ascontiguousarray(np.stack(drawn, 1))
            self._next = 0
        self._next += 1
        return np.asarray(self._block[self._next - 1])
