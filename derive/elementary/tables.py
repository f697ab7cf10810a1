"""Tables of the emitted elementary functions: where a short polynomial is worth a look-up.

A row holds a centre and what the function is there. Centres are not evenly spread: each is moved
until the values stored with it, rounded to a double, happen to be right to a small part of the
last bit. One double then does where two would be needed.
"""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mpmath
from pfaffian.derive.elementary.fit import Rounding, to_double, to_single

#: Rows of the sine table to a turn. A quarter of it is symmetric about its middle.
SINCOS_ROWS = 32

#: Rows of the arctangent table, and the rows to an octave of |x| + 1/8, which picks the row.
ATAN_ROWS, ATAN_ROWS_PER_OCTAVE = 28, 4
ATAN_OFFSET = 0.125

#: How many of the first rows of the arctangent take zero as their centre.
ATAN_ZERO_ROWS = 3

#: Bits of the argument of the square root that pick its seed: one of the exponent, the rest below.
SQRT_SEED_BITS = 6

_QUARTER = SINCOS_ROWS // 4

#: Where the centre of row 1 lies, in steps: nearer to zero than 1, so that what is added to the
#: value of row 1 stays at most half the result.
_FIRST_CENTRE = 0.73

#: Stored values are right to this part of a unit in the last place.
TABLE_ULP = 1 / 40


@dataclass(frozen=True)
class Precision:
    """The format of a table's values."""

    rounding: Rounding
    bits: int
    unit: float
    """Offsets of the centres are multiples of it, so that they are subtracted without rounding."""


DOUBLE = Precision(to_double, 53, 2.0**-40)
SINGLE = Precision(to_single, 24, 2.0**-24)

#: Rows are chosen in double, so an argument may fall just outside its row.
_SLACK = 1 + 2.0**-20


@dataclass(frozen=True)
class SincosRow:
    """Sine and cosine at row * 2 pi / SINCOS_ROWS + offset."""

    offset: float
    sine: float
    cosine: float


@dataclass(frozen=True)
class AtanRow:
    """A tangent and its angle in radians."""

    tangent: float
    angle: float


def _fits(value: Any, precision: Precision) -> bool:
    """Return whether `value` is right to `TABLE_ULP` when rounded."""
    rounded = precision.rounding(value)
    ulp = 2.0 ** (math.frexp(rounded)[1] - precision.bits)
    return float(abs(value - rounded)) < TABLE_ULP * ulp


def sincos_rows(precision: Precision = DOUBLE) -> tuple[SincosRow, ...]:
    """Return the rows of one turn: row -k mirrors row k, so that sine is odd in every bit.

    The rows of the first quarter decide all others; those on the axes are exact.
    """
    step = 2 * mpmath.pi / SINCOS_ROWS
    half = [SincosRow(0.0, 0.0, 1.0)]
    half += [_sincos_row(k * step, _shift(k) * float(step), precision) for k in range(1, _QUARTER)]
    for _ in range(2):  # a quarter turn further: (s, c) -> (c, -s)
        half += [SincosRow(r.offset, r.cosine, 0.0 - r.sine) for r in half[-_QUARTER:]]
    half = half[: 2 * _QUARTER + 1]
    return (*half, *(SincosRow(0.0 - r.offset, 0.0 - r.sine, r.cosine) for r in half[-2:0:-1]))


def _shift(row: int) -> float:
    """Return how far the centre of a row lies from its place, in steps, before any search."""
    return {1: _FIRST_CENTRE - 1, _QUARTER - 1: 1 - _FIRST_CENTRE}.get(row, 0.0)


def _alternate(first: int) -> Iterator[int]:
    """Yield first, first + 1, first - 1, first + 2, ..."""
    yield first
    for distance in itertools.count(1):
        yield first + distance
        yield first - distance


def _sincos_row(angle: Any, shift: float, precision: Precision) -> SincosRow:
    for multiple in _alternate(round(shift / precision.unit)):
        offset = multiple * precision.unit
        cosine, sine = mpmath.cos_sin(angle + offset)
        if _fits(sine, precision) and _fits(cosine, precision):
            break  # one in about 400 fits
    return SincosRow(offset, precision.rounding(sine), precision.rounding(cosine))


def sincos_reach() -> float:
    """Return the largest |r| that any row leaves, with a little room."""
    return (1.5 - _FIRST_CENTRE) * (2 * math.pi / SINCOS_ROWS) * _SLACK


def atan_rows(precision: Precision = DOUBLE) -> tuple[AtanRow, ...]:
    """Return the rows in the order of |x| + ATAN_OFFSET, the first ones around zero."""
    zero = AtanRow(0.0, 0.0)
    return tuple(
        zero if row < ATAN_ZERO_ROWS else _atan_row(*atan_edges(row), precision)
        for row in range(ATAN_ROWS)
    )


def atan_edges(row: int) -> tuple[float, float]:
    """Return where a row begins and ends in |x|."""
    low, high = (
        ATAN_OFFSET * 2.0**octave * (1 + part / ATAN_ROWS_PER_OCTAVE) - ATAN_OFFSET
        for octave, part in (divmod(k, ATAN_ROWS_PER_OCTAVE) for k in (row, row + 1))
    )
    return low, high


def _atan_row(low: float, high: float, precision: Precision) -> AtanRow:
    """Return the row with its centre a third of the way, as results are least at the low edge."""
    middle = (2 * low + high) / 3
    unit = max(precision.unit, 2.0 ** (math.frexp(middle)[1] - precision.bits))
    for multiple in _alternate(round(middle / unit)):
        tangent = multiple * unit
        angle = mpmath.atan(tangent)
        if _fits(angle, precision):
            break
    return AtanRow(tangent, precision.rounding(angle))


def atan_reach() -> float:
    """Return the largest |t| that any row leaves, or -1/x beyond them, with a little room."""
    left_over = [atan_edges(ATAN_ZERO_ROWS)[0], 1 / atan_edges(ATAN_ROWS)[0]]
    for row, centre in enumerate(atan_rows()[ATAN_ZERO_ROWS:], ATAN_ZERO_ROWS):
        c = centre.tangent
        left_over += [abs(edge - c) / (1 + edge * c) for edge in atan_edges(row)]
    return max(left_over) * _SLACK


def sqrt_seeds() -> tuple[tuple[int, ...], float]:
    """Return the words a seed of 1/sqrt x starts from, and the largest relative error of a seed.

    With w the word of x in single precision, the word of the seed is entry - w / 2, where the
    entry is picked by the lowest bit of the exponent and the first of the mantissa. The error of
    a seed is largest at an end of its interval, or inside where its slope is that of the root.
    """
    seeds, worst = [], 0.0
    for index in range(2**SQRT_SEED_BITS):
        entry, error = _sqrt_seed(index)
        seeds.append(entry)
        worst = max(worst, error)
    return tuple(seeds), worst


def _sqrt_seed(index: int) -> tuple[int, float]:
    shift = 24 - SQRT_SEED_BITS
    first = (126 << 23) + (index << shift)  # 126 is even: index fills the bits below
    words = range(first, first + 2**shift + 1, 2**shift // 16)
    wanted = [_word(1 / math.sqrt(_single(word))) + (word >> 1) for word in words]
    entry = (min(wanted) + max(wanted)) // 2
    seeds = [_single(entry - (word >> 1)) * math.sqrt(_single(word)) - 1 for word in words]
    return entry, max(map(abs, seeds))


def _single(word: int) -> float:
    (value,) = struct.unpack("<f", struct.pack("<I", word))
    return float(value)


def _word(value: float) -> int:
    (word,) = struct.unpack("<I", struct.pack("<f", value))
    return int(word)
