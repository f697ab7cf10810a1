"""What is to be planned: the plant's figures, start and goal, limits, end time and weights."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from pfaffian.derive.derivation.derive import Derivation
from pfaffian.derive.derivation.plant_digest import plant_digest
from pfaffian.derive.plan.plant import NumericPlant
from pfaffian.derive.plan.rest import hanging_rest, held_torque, slowest_period
from pfaffian.derive.sets.parameter_set import ParameterSet
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.toml import suggestion

#: Free end times reach from this to this many of the slowest periods about the resting start.
_PERIODS = (0.4, 3.0)
#: Without speed limits a plan may use whatever speed it likes.
NO_LIMIT = math.inf


@dataclass(frozen=True)
class Weights:
    """Weights of the cost, the integral over the plan of

    effort (tau/limit)^2 + smoothness (tau'/limit)^2 + speed |q'|^2 + time,

    tau' in limits per second, |q'|^2 in the coordinates' own units per second; each is summed over
    actuators or coordinates. `time` matters only where the end time is free.
    """

    effort: float = 1.0
    smoothness: float = 1e-3
    speed: float = 1e-3
    time: float = 0.1


@dataclass(frozen=True)
class PlanOptions:
    """What a user asks of a plan; SI throughout. What is left empty follows from the model.

    `end_time` is (least, most) in s, equal where it is fixed. `start` gives coordinates by name.
    `starts` random starts are tried on `coarse` intervals, the best is refined on about `fine`.
    """

    end_time: tuple[float, float] | None = None
    torque_limits: Mapping[str, float] = field(default_factory=dict)
    speed_limits: Mapping[str, float] = field(default_factory=dict)
    weights: Weights = Weights()
    start: Mapping[str, float] = field(default_factory=dict)
    starts: int = 12
    seed: int = 0
    coarse: int = 40
    fine: int = 150


@dataclass(frozen=True)
class Problem:
    """A planning problem in numbers.

    `start` and `goal` are (q, q') (2n,); `start_torque` and `goal_torque` (m,) hold the plant
    there, but `start_torque` is 0 where none does: the plant is let go there. `torque_limits`
    (m,) bind the plan; a law that follows it has `available_limits` (m,), those of the set where
    they are larger. `speed_limits` (n,) are infinite where there is none. `parameters` are those
    the plant's acceleration depends on, and `model_sha256` identifies the equations.
    """

    model: str
    set_name: str
    coordinates: tuple[tuple[str, str], ...]
    actuators: tuple[tuple[str, str], ...]
    start: tuple[float, ...]
    goal: tuple[float, ...]
    start_torque: tuple[float, ...]
    goal_torque: tuple[float, ...]
    torque_limits: tuple[float, ...]
    available_limits: tuple[float, ...]
    speed_limits: tuple[float, ...]
    end_time: tuple[float, float]
    sample_time: float
    weights: Weights
    parameters: tuple[tuple[str, float], ...]
    model_sha256: str
    parameter_sha256: str

    @property
    def order(self) -> int:
        """Return n, the number of coordinates."""
        return len(self.coordinates)


def plan_problem(
    derivation: Derivation, plant: NumericPlant, chosen: ParameterSet, options: PlanOptions
) -> Problem:
    """Put the question of `options` about a model and a parameter set into numbers.

    Raises `InputError` for options out of bounds, names the model does not have, a plant without
    a resting place, and limits that cannot hold start or goal.
    """
    spec, values = derivation.spec, chosen.as_dict()
    names = [c.name for c in spec.coordinates]
    _check_options(options)
    goal = plant.setpoint
    start = hanging_rest(spec, plant, goal)
    if start is None and not options.start:
        raise InputError(
            f"model {spec.name}: the potential energy has no isolated minimum to rest in",
            remedy='say where to start: --start "NAME=VALUE,..."',
        )
    start = _replaced(start or goal, names, options.start, "--start")
    if max(abs(a - b) for a, b in zip(start, goal, strict=True)) < 1e-6:
        raise InputError(
            f"model {spec.name}: the plan would start at its goal: the setpoint of set "
            f"{chosen.name} is where the plant rests by itself",
            remedy=f'say where to start: --start "{names[0]}=..."',
        )
    actuators = [a.name for a in spec.actuators]
    own = [values[limit.name] for limit in spec.law.limits]
    limits = _replaced(own, actuators, options.torque_limits, "--torque-limit")
    speeds = _replaced([NO_LIMIT] * len(names), names, options.speed_limits, "--speed-limit")
    released = held_torque(spec, plant, start, limits, "start") or tuple(0.0 for _ in actuators)
    held = held_torque(spec, plant, goal, limits, "goal")
    if held is None:
        raise InputError(
            f"model {spec.name}: no torque holds the setpoint of set {chosen.name}",
            remedy="choose a setpoint where the unactuated joints are in balance",
        )
    sample = values[spec.law.sample_time.name]
    return Problem(
        model=spec.name,
        set_name=chosen.name,
        coordinates=tuple((c.name, c.unit) for c in spec.coordinates),
        actuators=tuple((a.name, a.unit) for a in spec.actuators),
        start=(*start, *(0.0 for _ in names)),
        goal=(*goal, *(0.0 for _ in names)),
        start_torque=released,
        goal_torque=held,
        torque_limits=tuple(limits),
        available_limits=tuple(map(max, limits, own)),
        speed_limits=tuple(speeds),
        end_time=_end_time(options, plant, start, sample),
        sample_time=sample,
        weights=options.weights,
        parameters=plant_parameters(derivation, chosen),
        model_sha256=plant_digest(derivation),
        parameter_sha256=chosen.digest(),
    )


def plant_parameters(derivation: Derivation, chosen: ParameterSet) -> tuple[tuple[str, float], ...]:
    """Return the parameters that the acceleration or the input matrix depends on, by name."""
    values = chosen.as_dict()
    block = derivation.block("acceleration")
    return tuple((s.name, values[s.name]) for s in block.inputs if s.group == "parameter")


def _replaced(
    own: list[float] | tuple[float, ...], names: list[str], given: Mapping[str, float], where: str
) -> tuple[float, ...]:
    for name in given:
        if name not in names:
            raise InputError(f"{where}: there is no {name}", remedy=suggestion(name, names))
    return tuple(given.get(name, value) for name, value in zip(names, own, strict=True))


def _end_time(
    options: PlanOptions, plant: NumericPlant, start: tuple[float, ...], sample: float
) -> tuple[float, float]:
    if options.end_time is None:
        period = slowest_period(plant, start)
        return (_PERIODS[0] * period, _PERIODS[1] * period)
    least, most = options.end_time
    if most < 10.0 * sample:
        raise InputError(
            f"--end-time: {most:g} s is less than ten sample times of {sample:g} s",
            remedy="give a longer end time",
        )
    return least, most


def _check_options(options: PlanOptions) -> None:
    """Raise `InputError` for an option out of bounds."""

    def need(holds: bool, where: str, what: str, remedy: str) -> None:
        if not holds:
            raise InputError(f"{where}: {what}", remedy=remedy)

    for name, weight in vars(options.weights).items():
        need(
            math.isfinite(weight) and weight >= 0.0,
            "--weights",
            f"{name} = {weight:g} is no weight",
            "give a number that is not negative",
        )
    need(
        options.weights.effort > 0.0 or options.weights.smoothness > 0.0,
        "--weights",
        "neither effort nor smoothness costs anything, so that the torque is not determined",
        "give one of them a positive weight",
    )
    for where, limits in (
        ("--torque-limit", options.torque_limits),
        ("--speed-limit", options.speed_limits),
    ):
        for name, limit in limits.items():
            need(
                math.isfinite(limit) and limit > 0.0,
                where,
                f"{name} = {limit:g} is no limit",
                "give a positive number",
            )
    for name, value in options.start.items():
        need(math.isfinite(value), "--start", f"{name} = {value:g}", "give a finite number")
    need(1 <= options.starts <= 1000, "--seeds", f"{options.starts}", "give 1 to 1000")
    need(0 <= options.seed < 2**32, "--seed", f"{options.seed}", "give 0 to 4294967295")
    need(8 <= options.coarse <= 400, "--coarse", f"{options.coarse}", "give 8 to 400 intervals")
    need(8 <= options.fine <= 2000, "--nodes", f"{options.fine}", "give 8 to 2000 intervals")
    if options.end_time is not None:
        least, most = options.end_time
        need(
            math.isfinite(most) and 0.0 < least <= most,
            "--end-time",
            f"{least:g} to {most:g} s is no end time",
            "give a positive time, or a range such as 1:3",
        )
