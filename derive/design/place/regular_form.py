"""Zero dynamics placed at wanted poles by the regular form, for any number of actuators.

With T orthonormal and T B = (0, B2), x' = A x + B tau splits into z' = A11 z + A12 w and the rest.
On s = C1 z + w = 0 the state z moves by A11 - A12 C1: C1 is a state feedback for (A11, A12).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import place_poles

Array = NDArray[np.float64]

#: Relative distance between copies of a pole that cannot be met as often as it is wanted.
SPREAD = 0.02


@dataclass(frozen=True)
class PlacedRows:
    """Rows S (m, 2n), up to a left factor, that place the zero dynamics at `poles`.

    `spread` is the largest relative distance of a pole from the one that was wanted.
    """

    rows: Array
    poles: tuple[complex, ...]
    spread: float


def placed_rows(a: Array, b: Array, poles: tuple[complex, ...]) -> PlacedRows | None:
    """Return rows that place the zero dynamics of (A, B) at `poles`, or nothing if none do.

    `a` (2n, 2n), `b` (2n, m), 2n - m poles. A pole is met at most as often as A12 has rank, and
    less often where the actuators' chains are of unlike length: what is wanted more often is
    spread, `SPREAD` a step, into as few places as will do.
    """
    order, m = b.shape
    turn = np.linalg.qr(b, mode="complete")[0].T
    turn = np.vstack([turn[m:], turn[:m]])  # B has its m rows last
    moved = turn @ a @ turn.T
    a11, a12 = moved[: order - m, : order - m], moved[: order - m, order - m :]
    for most in range(int(np.linalg.matrix_rank(a12)), 0, -1):
        apart = spread_poles(poles, most, SPREAD)
        feedback = _feedback(a11, a12, apart)
        if feedback is not None:
            rows = np.hstack([feedback, np.eye(m)]) @ turn
            pairs = zip(apart, _ordered(poles), strict=True)
            return PlacedRows(rows, apart, max(abs(x - p) / abs(p) for x, p in pairs))
    return None


def _feedback(a11: Array, a12: Array, poles: tuple[complex, ...]) -> Array | None:
    """Return C1 with the eigenvalues of A11 - A12 C1 at `poles`, or nothing if there is none."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # whether the poles were met is checked below
            found = place_poles(a11, a12, np.array(poles), rtol=1e-8, maxiter=200)
            feedback: Array = found.gain_matrix
            reached = np.linalg.eigvals(a11 - a12 @ feedback)
    except (ValueError, np.linalg.LinAlgError):
        return None
    return feedback if _alike(reached, poles) else None


def spread_poles(poles: tuple[complex, ...], most: int, step: float) -> tuple[complex, ...]:
    """Return `poles`, sorted, with those that occur more than `most` times moved apart.

    The copies go in groups of `most` to p (1 + k step), k symmetric about zero; a conjugate
    moves with its partner.
    """
    ordered = _ordered(poles)
    seen: dict[complex, int] = {}
    apart: list[complex] = []
    for pole in ordered:
        copies = sum(p == pole for p in ordered)
        groups = -(-copies // most)
        index = seen.get(pole, 0)
        seen[pole] = index + 1
        apart.append(pole * (1.0 + step * (index // most - (groups - 1) / 2.0)))
    return tuple(apart)


def _ordered(poles: tuple[complex, ...]) -> list[complex]:
    return sorted((complex(p) for p in poles), key=lambda p: (p.real, abs(p.imag), p.imag))


def _alike(reached: NDArray[Any], wanted: tuple[complex, ...]) -> bool:
    """Return whether both have the same characteristic polynomial, as far as rounding tells."""
    radius = max(abs(p) for p in wanted)
    if not np.all(np.isfinite(reached)):
        return False
    off = np.poly(reached / radius) - np.poly(np.array(wanted) / radius)
    return bool(np.max(np.abs(off)) < 1e-8)
