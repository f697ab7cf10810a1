"""Angles in whole turns, and within one."""

from __future__ import annotations

import math

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.contract.manifest import Manifest


def turns(manifest: Manifest) -> Array:
    """Return the period of each coordinate, (n,): a turn of an angle, 0 of a length."""
    units = {f.name: f.unit for f in manifest.structures["plant_state"].fields}
    return np.array([2.0 * math.pi if units[c] == "rad" else 0.0 for c in manifest.coordinates])


def wrapped(error: Array, turn: Array) -> Array:
    """Return `error` (N, n) less the nearest whole number of turns."""
    share = np.divide(1.0, turn, out=np.zeros_like(turn), where=turn > 0.0)
    return np.asarray(error - turn * np.rint(error * share))
