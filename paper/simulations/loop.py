"""The closed loop of a case: the generated plant under one of the laws, for a solver to integrate.

The state is y = (q1, q2, q1', q2', J, ahat): J the integral of the drift of (6), ahat of (15).
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pfaffian.paper.simulations.as_printed import adaptation_gain, printed_gain
from pfaffian.paper.simulations.cases import LQR, PRINTED, Case
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import MissingToolError
from pfaffian.runtime.code.generated_model import GeneratedModel
from pfaffian.runtime.contract.dtypes import layout_of
from pfaffian.runtime.machine.host import HostMachine

#: What `Loop.signals` returns, in its order, in SI units.
SIGNALS = ("tau", "p1", "p2", "p3", "beta", "adb", "s")


class Loop:
    """The right-hand side y' = f(t, y) of `case` on the C code of `host`; a call is about 5 us."""

    def __init__(self, case: Case, host: GeneratedModel) -> None:
        """Engage the law at the start of `case`: s there is what beta is counted from.

        Raises `MissingToolError` where `host` is not this machine.
        """
        if not isinstance(host.machine, HostMachine):
            raise MissingToolError(
                f"a reproduction runs on this machine, not on {host.machine.name}",
                remedy="build the model for the host",
            )
        self.case, self.evaluations = case, 0
        structures = host.folder.manifest.structures

        def made(role: str) -> Any:
            layout: Any = layout_of(structures[role])
            kind: Any = np.ctypeslib.as_ctypes_type(layout)
            return kind()

        self._params, self._plant = made("params"), made("plant_params")
        for record, values in ((self._params, case.controller), (self._plant, case.plant)):
            for name, value in values.items():
                setattr(record, name, value)
        self._state, self._measured, self._out = (
            made(r) for r in ("continuous_state", "input", "continuous_output")
        )
        self._motion, self._force, self._rate = (
            made(r) for r in ("plant_state", "plant_input", "plant_rate")
        )
        model = host.folder.manifest.model
        entry = host.machine.entry
        self._law_call = _bound(
            entry(f"{model}_continuous"), self._state, self._params, self._measured, self._out
        )
        self._plant_call = _bound(
            entry(f"{model}_acceleration"), self._plant, self._motion, self._force, self._rate
        )
        self._law: Callable[..., tuple[float, ...]]
        self._law = {PRINTED: self._printed, LQR: self._regulated}.get(case.column, self._derived)
        self.start = np.array([*case.start, 0.0, case.controller["bound_initial"]])
        self._observe(*map(float, self.start))
        self._state.residual_initial = self._out.s

    def __call__(self, _time: float, y: Array) -> list[float]:
        """Return y'."""
        self.evaluations += 1
        q1, q2, v1, v2, drift_integral, bound = y.tolist()
        self._observe(q1, q2, v1, v2, drift_integral, bound)
        tau, bound_rate = self._law(q1, q2, v1, v2, bound)[0:2]
        motion = self._motion
        motion.q1, motion.q2, motion.dq1, motion.dq2 = q1, q2, v1, v2
        self._force.tau = tau
        self._plant_call()
        rate = self._rate
        return [v1, v2, rate.ddq1, rate.ddq2, self._out.drift_integral_rate, bound_rate]

    def gain(self, _time: float, y: Array) -> float:
        """Return ADB in the state `y`; a run may not pass its zero."""
        self._observe(*y.tolist())
        return float(self._out.adb)

    def signals(self, y: Array) -> tuple[float, ...]:
        """Return the values named in `SIGNALS` in the state `y`."""
        values = y.tolist()
        self._observe(*values)
        tau, _, p1, p2, p3 = self._law(*values[:4], values[5])
        return (tau, p1, p2, p3, self._out.beta, self._out.adb, self._out.s)

    def _observe(
        self, q1: float, q2: float, v1: float, v2: float, drift_integral: float, bound: float
    ) -> None:
        measured, state = self._measured, self._state
        measured.q1, measured.q2, measured.dq1, measured.dq2 = q1, q2, v1, v2
        state.drift_integral, state.bound_estimate = drift_integral, bound
        self._law_call()

    def _derived(
        self, q1: float, q2: float, v1: float, v2: float, bound: float
    ) -> tuple[float, float, float, float, float]:
        """Return (tau, ahat', p1, p2, p3) of (15)-(23) with the ADB that is derived."""
        out = self._out
        rate = out.bound_estimate_rate
        if self.case.adaptation_printed:
            rate = self._printed_rate(self._regressor(q1, q2, v1, v2), q2, bound)
        if self.case.softened:
            p2 = out.p2 / (1.0 + self.case.softened * self.case.controller["kappa"] * out.adb**2)
            return out.p1 + p2 + out.p3, rate, out.p1, p2, out.p3
        return out.tau, rate, out.p1, out.p2, out.p3

    def _regressor(self, q1: float, q2: float, v1: float, v2: float) -> float:
        """Return Pi of (47)."""
        gains = self.case.controller
        speed, distance = math.hypot(v1, v2), math.hypot(q1 - gains["q1d"], q2 - gains["q2d"])
        return (speed + 1.0) ** 2 + (distance + 1.0) ** 2

    def _printed_rate(self, regressor: float, q2: float, bound: float) -> float:
        """Return ahat' of (48) as printed."""
        gains = self.case.controller
        grown = gains["k1"] * regressor * abs(adaptation_gain(gains, q2) * self._out.beta)
        return float(grown - gains["k2"] * bound)

    def _printed(
        self, q1: float, q2: float, v1: float, v2: float, bound: float
    ) -> tuple[float, float, float, float, float]:
        """Return the same with (10) for ADB in (17)-(22), and (48) for (15)."""
        out, gains = self._out, self.case.controller
        gain = printed_gain(gains, q2)
        p1 = out.p1 * out.adb / gain  # b + AD (C q' + G) is what the code divides by its own ADB
        following = gain * out.beta
        p2 = -gains["kappa"] * following
        regressor = self._regressor(q1, q2, v1, v2)
        effort = bound * regressor
        mu = following * effort
        p3 = -effort * mu / max(abs(mu), gains["epsilon"])
        return p1 + p2 + p3, self._printed_rate(regressor, q2, bound), p1, p2, p3

    def _regulated(
        self, q1: float, q2: float, v1: float, v2: float, _bound: float
    ) -> tuple[float, float, float, float, float]:
        """Return -K x; ahat rests, and beta is only watched."""
        k, gains = self.case.feedback, self.case.controller
        error = (q1 - gains["q1d"], q2 - gains["q2d"], v1, v2)
        return -sum(a * b for a, b in zip(k, error, strict=True)), 0.0, 0.0, 0.0, 0.0


def _bound(function: Callable[..., int], *records: Any) -> Callable[[], object]:
    """Return `function` with its arguments' addresses fixed."""
    pointers = tuple(ctypes.byref(r) for r in records)
    return lambda: function(*pointers)
