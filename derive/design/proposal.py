"""kappa and epsilon from the loop delay, by the delays that were measured to hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pfaffian.derive.design.assess import setpoint_gain
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import parse_quantity

#: (rate kappa (ADB)^2 at the setpoint in 1/s, longest loop delay in s with which it still held):
#: simulated flights of a Pendubot ten times as heavy as the rig's, sampled at 500 Hz.
HELD_DELAYS = ((50.0, 0.020), (10.0, 0.038), (3.0, 0.040))
#: The rate proposed is one that held this many times the delay asked for.
DELAY_MARGIN = 2.0
#: Pi = (|e'| + 1)^2 + (|e| + 1)^2 of (47) at the setpoint at rest.
_REGRESSOR_AT_REST = 2.0
_NEEDED = ("kappa", "epsilon", "bound_initial", "sample_time")


@dataclass(frozen=True)
class Proposal:
    """kappa and epsilon with what they rest on: delays in s, rates in 1/s.

    `layer_rate` is (ahat Pi ADB)^2/epsilon, what p3 adds inside its layer at the setpoint at rest
    with ahat at its initial bound: by the choice of epsilon no more than `rate`.
    """

    delay: float
    total_delay: float
    held_delay: float
    rate: float
    layer_rate: float
    gains: dict[str, float]


def read_delay(text: str, where: str) -> float:
    """Return a delay in s from text such as "5 ms"; raise `InputError` naming `where`."""
    delay = parse_quantity(text, "s", where)
    if not delay >= 0.0:
        raise InputError(f"{where}: {delay:g} s is negative", remedy="give a delay of 0 s or more")
    return delay


def propose(model: LoweredModel, values: Mapping[str, float], delay: float, where: str) -> Proposal:
    """Return kappa and epsilon for a loop with this `delay` beside half a sample of its hold.

    The fastest measured rate is taken that held `DELAY_MARGIN` times the total. Raises
    `InputError` naming `where` if none did, or the law has no such gains.
    """
    missing = [n for n in _NEEDED if n not in values]
    if missing:
        raise InputError(
            f"{where}: model {model.name} has no parameter {missing[0]}",
            remedy="choose the rates of its law yourself",
        )
    if len(model.actuators) != 1:
        raise InputError(
            f"{where}: delays were measured with one actuator, model {model.name} has "
            f"{len(model.actuators)}",
            remedy="choose kappa and epsilon from your own flights",
        )
    total = delay + values["sample_time"] / 2.0
    fitting = [(r, held) for r, held in HELD_DELAYS if held >= DELAY_MARGIN * total]
    if not fitting:
        longest = max(held for _, held in HELD_DELAYS) / DELAY_MARGIN
        raise InputError(
            f"{where}: a delay of {1e3 * total:.3g} ms with the hold is more than any rate is "
            f"known to hold with margin ({1e3 * longest:g} ms)",
            remedy="shorten the delay, or choose kappa and epsilon from your own flights",
        )
    rate, held = fitting[0]
    gain = setpoint_gain(model, values)
    if not (math.isfinite(gain) and gain != 0.0):
        raise InputError(
            f"{where}: ADB is {gain:g} at the setpoint", remedy="choose gains with ADB != 0 there"
        )
    effort = values["bound_initial"] * _REGRESSOR_AT_REST
    gains = {"kappa": rate / gain**2, "epsilon": (effort * gain) ** 2 / rate}
    for parameter in model.parameters:
        if parameter.name in gains:
            parameter.check(gains[parameter.name], where)
    return Proposal(delay, total, held, rate, (effort * gain) ** 2 / gains["epsilon"], gains)
