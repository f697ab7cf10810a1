"""What the paper prints and the derivation contradicts, typed in literally: (10) and (48)."""

from __future__ import annotations

import math
from collections.abc import Mapping


def printed_gain(params: Mapping[str, float], q2: float) -> float:
    """Return ADB as (10) prints it, in 1/(kg m^2): lam theta2/det M, positive everywhere."""
    return params["lam"] * adaptation_gain(params, q2)


def adaptation_gain(params: Mapping[str, float], q2: float) -> float:
    """Return the factor before the braces of (48) as printed, in 1/(kg m^2): theta2/det M."""
    coupling = params["theta3"] * math.cos(q2)
    return params["theta2"] / (params["theta1"] * params["theta2"] - coupling * coupling)
