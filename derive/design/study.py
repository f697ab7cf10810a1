"""One design study: what is asked, and everything that was found, as `pfaffian design` shows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from pfaffian.derive.design.assess import Design, assess, base_set, with_values
from pfaffian.derive.design.place.placement import Placement
from pfaffian.derive.design.place.poles import placement_for_poles, read_poles
from pfaffian.derive.design.place.riccati import RiccatiRow, read_weights, riccati_row
from pfaffian.derive.design.proposal import Proposal, propose, read_delay
from pfaffian.derive.design.tradeoff import TradeoffPoint, tradeoff_curve
from pfaffian.derive.design.worst_case import (
    WorstCase,
    friction_limits,
    read_box,
    read_friction,
    worst_case,
)
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.sets.gains import gain_names
from pfaffian.derive.sets.parameter_set import ParameterSet
from pfaffian.derive.sets.raw_set import RawSet
from pfaffian.runtime.base.errors import InputError


@dataclass(frozen=True)
class Wishes:
    """What a study is to do, as text from the command line; empty means not asked for."""

    poles: str = ""
    riccati: str = ""
    friction: str = ""
    box: str = ""
    delay: str = ""
    curve: bool = False


@dataclass(frozen=True)
class Study:
    """The figures of one design, with all that was asked for besides.

    `where` is the file of the set it started from, `parameters` are those of the design: the
    set's own with the gains chosen here. `wanted_poles` are empty unless gains were synthesised.
    """

    model: str
    where: str
    parameters: ParameterSet
    wanted_poles: tuple[complex, ...]
    placement: Placement | None
    design: Design
    friction: Mapping[str, float]
    friction_limits: Mapping[str, float]
    riccati: RiccatiRow | None
    proposal: Proposal | None
    worst_case: WorstCase | None
    curve: tuple[TradeoffPoint, ...]

    @property
    def method(self) -> str:
        """Return where the gains come from: `set`, `poles` or `riccati`."""
        if self.riccati:
            return "riccati"
        return "poles" if self.wanted_poles else "set"

    def changed(self) -> dict[str, float]:
        """Return all gains of the design that a parameter set would have to hold."""
        return {**self.design.gains, **(self.proposal.gains if self.proposal else {})}

    def failure(self) -> str:
        """Return why the design is not stable, or nothing if it is."""
        gains = ", ".join(f"{n} = {v:.6g}" for n, v in self.design.gains.items())
        if not self.design.stable:
            poles = ", ".join(pole_text(p) for p in self.design.zero_dynamics_poles)
            bounds = "; ".join(self.design.violated)
            return (
                f"{self.where}: the zero dynamics are unstable with {gains}: "
                f"poles {poles} 1/s" + (f"; violated: {bounds}" if bounds else "")
            )
        if self.worst_case and not self.worst_case.stable:
            at = ", ".join(f"{n} = {v:.6g}" for n, v in self.worst_case.at.items())
            return (
                f"{self.where}: the zero dynamics are unstable within the box with "
                f"{gains}: margin {self.worst_case.margin:.4g} 1/s at {at}"
            )
        return ""

    def as_json(self) -> dict[str, Any]:
        """Return the document of `pfaffian design --json`."""
        return {
            "model": self.model,
            "set": self.parameters.name,
            "method": self.method,
            **asdict(self.design),
            "decay_rate": self.design.decay_rate,
            "friction": dict(self.friction),
            "friction_limits": dict(self.friction_limits),
            "placement": self._placement(),
            "lyapunov": self.riccati.as_json() if self.riccati else None,
            "proposal": asdict(self.proposal) if self.proposal else None,
            "box": asdict(self.worst_case) if self.worst_case else None,
            "curve": [asdict(p) for p in self.curve],
        }

    def _placement(self) -> dict[str, Any] | None:
        if (found := self.placement) is None:
            return None
        return {"by": found.by, "row_gap": found.row_gap, "spread": found.spread}


def study(model: LoweredModel, raw: RawSet, wishes: Wishes) -> Study:
    """Carry out `wishes` on the parameter set `raw`. Raises `InputError` for one at fault."""
    if wishes.poles and wishes.riccati:
        raise InputError("--poles and --riccati are both given", remedy="give one of them")
    chooses = bool(wishes.poles or wishes.riccati)
    friction = read_friction(model, wishes.friction, "--friction") if wishes.friction else {}
    parameters = with_values(base_set(model, raw, chooses), friction)
    poles = read_poles(wishes.poles, "--poles") if wishes.poles else ()
    placement = None
    row = _riccati(model, parameters, wishes.riccati) if wishes.riccati else None
    if poles:
        placement = placement_for_poles(model, parameters.as_dict(), poles, "--poles")
        parameters = with_values(parameters, placement.gains)
    elif row:
        parameters = with_values(parameters, row.gains)
    proposal = None
    if wishes.delay:
        delay = read_delay(wishes.delay, "--delay")
        proposal = propose(model, parameters.as_dict(), delay, "--delay")
        parameters = with_values(parameters, proposal.gains)
    values = parameters.as_dict()
    box = read_box(model, values, wishes.box, "--box") if wishes.box else ()
    return Study(
        model=model.name,
        where=raw.path,
        parameters=parameters,
        wanted_poles=poles,
        placement=placement,
        design=assess(model, parameters),
        friction=friction,
        friction_limits=friction_limits(model, values),
        riccati=row,
        proposal=proposal,
        worst_case=worst_case(model, values, box) if box else None,
        curve=_curve(model, parameters, row) if wishes.curve else (),
    )


def pole_text(pole: complex) -> str:
    """Return a pole with four digits, its imaginary part only where that is more than rounding."""
    if abs(pole.imag) <= 1e-4 * abs(pole):
        return f"{pole.real:.4g}"
    return f"{pole:.4g}"


def _riccati(model: LoweredModel, parameters: ParameterSet, text: str) -> RiccatiRow:
    weights, effort = read_weights(model, text, "--riccati")
    return riccati_row(model, parameters.as_dict(), weights, effort, "--riccati")


def _curve(
    model: LoweredModel, parameters: ParameterSet, row: RiccatiRow | None
) -> tuple[TradeoffPoint, ...]:
    """The Riccati family scales the weights asked for, or else 10 and 0.1."""
    n = len(model.coordinates)
    weights = row.weights if row else (10.0,) * n + (0.1,) * n
    points = tradeoff_curve(model, parameters, weights, row.effort if row else 1.0)
    if not points:
        names = ", ".join(gain_names(model))
        raise InputError(
            f"--curve: no design of either family exists for the gains {names}",
            remedy="the model's residual has too few gains to choose its zero dynamics",
        )
    return points
