"""What a user asks of a plan as text, and the options it amounts to."""

from __future__ import annotations

from dataclasses import dataclass, fields

from pfaffian.derive.plan.problem import PlanOptions, Weights
from pfaffian.derive.spec.model_spec import ModelSpec
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import parse_quantity
from pfaffian.runtime.base.toml import shown, suggestion


@dataclass(frozen=True)
class Wishes:
    """What is asked, as text from the command line; empty means not asked for."""

    end_time: str = ""
    torque_limit: str = ""
    speed_limit: str = ""
    weights: str = ""
    start: str = ""
    riccati: str = ""
    seeds: int = 12
    seed: int = 0
    coarse: int = 40
    nodes: int = 150


def read_wishes(spec: ModelSpec, wishes: Wishes) -> PlanOptions:
    """Return the options that `wishes` amount to; raise `InputError` naming the option at fault."""
    coordinates = {c.name: c.unit for c in spec.coordinates}
    return PlanOptions(
        end_time=_end_time(wishes.end_time),
        torque_limits=_quantities(
            wishes.torque_limit, {a.name: a.unit for a in spec.actuators}, "--torque-limit"
        ),
        speed_limits=_quantities(
            wishes.speed_limit, {n: f"{u}/s" for n, u in coordinates.items()}, "--speed-limit"
        ),
        weights=_weights(wishes.weights),
        start=_quantities(wishes.start, coordinates, "--start"),
        starts=wishes.seeds,
        seed=wishes.seed,
        coarse=wishes.coarse,
        fine=wishes.nodes,
    )


def read_row_weights(spec: ModelSpec, text: str) -> tuple[tuple[float, ...], float] | None:
    """Return diag Q (2n) and R from "Q1,..,Q2n[,R]", or nothing where `text` is empty."""
    if not text:
        return None
    order = 2 * len(spec.coordinates)
    remedy = f"give {order} positive weights of (q, q'), and R after them if it is not 1"
    numbers = [_number(part, "--riccati", remedy) for part in text.split(",")]
    if len(numbers) not in (order, order + 1):
        raise InputError(f"--riccati: {len(numbers)} weights for {order} states", remedy=remedy)
    for number in numbers:
        if not number > 0.0:
            raise InputError(f"--riccati: {number:g} is not a positive weight", remedy=remedy)
    return tuple(numbers[:order]), numbers[order] if len(numbers) > order else 1.0


def _end_time(text: str) -> tuple[float, float] | None:
    if not text:
        return None
    least, separator, most = text.partition(":")
    first = _quantity(least, "s", "--end-time")
    return first, _quantity(most, "s", "--end-time") if separator else first


def _quantities(text: str, units: dict[str, str], where: str) -> dict[str, float]:
    """Return values by name from "NAME=VALUE,..."; one value without a name is that of all."""
    if not text:
        return {}
    if "=" not in text:
        if len(set(units.values())) > 1:
            raise InputError(
                f"{where}: {shown(text)} does not say of what, and units differ",
                remedy=f'write {where} "{next(iter(units))}=..."; {suggestion("", list(units))}',
            )
        return {name: _quantity(text, unit, where) for name, unit in units.items()}
    found: dict[str, float] = {}
    for part in text.split(","):
        name, separator, value = (p.strip() for p in part.partition("="))
        if not separator:
            raise InputError(
                f"{where}: {shown(part)} is not of the form NAME=VALUE",
                remedy=suggestion(name, list(units)),
            )
        if name not in units:
            raise InputError(f"{where}: there is no {name}", remedy=suggestion(name, list(units)))
        if name in found:
            raise InputError(f"{where}: {name} is given twice", remedy="leave one of them out")
        found[name] = _quantity(value, units[name], f"{where}: {name}")
    return found


def _quantity(text: str, unit: str, where: str) -> float:
    """Return a value in `unit`; a bare number is taken to be in it."""
    try:
        return parse_quantity(f"{float(text)!r} {unit}", unit, where)
    except ValueError:
        return parse_quantity(text.strip(), unit, where)


def _weights(text: str) -> Weights:
    known = [f.name for f in fields(Weights)]
    found: dict[str, float] = {}
    for part in text.split(",") if text else []:
        name, separator, value = (p.strip() for p in part.partition("="))
        if not separator:
            raise InputError(
                f"--weights: {shown(part)} is not of the form NAME=VALUE",
                remedy=suggestion(name, known),
            )
        if name not in known:
            raise InputError(
                f"--weights: there is no weight {shown(name)}", remedy=suggestion(name, known)
            )
        if name in found:
            raise InputError(f"--weights: {name} is given twice", remedy="leave one of them out")
        found[name] = _number(value, f"--weights: {name}", "give a number")
    return Weights(**found)


def _number(text: str, where: str, remedy: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{where}: {shown(text)} is not a number", remedy=remedy) from None
