"""The structures of runtime/c, member by member in the order of their headers.

The generator writes constants of them and the runtime fills records; neither needs the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

#: Members (name, NumPy type without byte order) of each structure of pf_sensing.h.
SENSING: Mapping[str, tuple[tuple[str, str], ...]] = {
    "params": (
        *((n, "f8") for n in ("counts_per_turn", "offset", "sample_time", "bandwidth", "damping")),
        *((n, "u4") for n in ("estimator", "counter_bits", "counter_zero", "largest_jump")),
        *(("longest_gap", "u4"), ("direction", "i4")),
    ),
    "input": (("raw", "u4"), ("valid", "u4")),
    "state": (
        *((n, "f8") for n in ("error", "velocity", "radians_per_count", "offset", "sample_time")),
        *(("error_kept", "f8"), ("velocity_gain", "f8"), ("count", "i8")),
        *((n, "u4") for n in ("raw", "mask", "counter_zero", "largest_jump", "longest_gap")),
        *((n, "u4") for n in ("missed", "seen", "jumped", "lost", "rest", "resting")),
        *((n, "u4") for n in ("ready", "started")),
    ),
    "output": (("angle", "f8"), ("velocity", "f8"), ("count", "i8")),
}
#: Estimators by name, with their number in `pf_sensing_estimator_t`.
ESTIMATORS = {"tracking": 0, "difference": 1}
#: Laws of a complete controller by name, with their numbers in the generated header.
SWING_UP_LAWS = {"none": 0, "energy": 1, "plan": 2}
BALANCE_LAWS = {"robust": 0, "nominal": 1, "feedback": 2}

#: Measures that a supervisor can look at.
MEASURES = 8
_TRANSITION = ("period", "frame", "from", "to", "reason", "fault")
#: Members of each structure of pf_supervisor.h; a third entry is the length of an array.
SUPERVISOR: Mapping[str, tuple[tuple[Any, ...], ...]] = {
    "params": (
        *((n, "f8", MEASURES) for n in ("capture_limit", "release_limit")),
        *((n, "f8") for n in ("sample_time", "shortest_period", "longest_period")),
        *((n, "f8") for n in ("watchdog_time", "swing_up_timeout")),
        *((n, "u4") for n in ("capture_periods", "release_periods", "overruns", "attempts")),
    ),
    "input": (
        ("measure", "f8", MEASURES),
        ("elapsed", "f8"),
        *((n, "u4") for n in ("measures", "frame", "heartbeat", "command", "checks")),
        ("position", "u4"),
    ),
    "state": (
        ("log", "u4", (16, len(_TRANSITION))),
        *((n, "u4") for n in ("logged", "mode", "mode_inverse", "fault", "fault_inverse")),
        *((n, "u4") for n in ("ready", "ready_inverse", "period", "since", "inside", "outside")),
        *((n, "u4") for n in ("frame", "heartbeat", "silent", "overruns", "good", "releases")),
        *((n, "u4") for n in ("reason", "started", "seal")),
    ),
    "output": tuple((n, "u4") for n in ("mode", "fault", "reason", "entered", "torque_allowed")),
}
