"""Plans as constant tables: read and judged with neither NumPy nor SymPy, for a warm generation."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.sets.parameter_set import ParameterSet
from pfaffian.runtime.base.errors import InputError

#: Largest table in bytes that keeps every node of its plan.
_LARGEST = 1 << 16
#: How far nodes may lie from even spacing, as a share of it.
_EVEN = 1e-6


@dataclass(frozen=True)
class PlanTable:
    """The plan of one parameter set: a row of `members` a node, in order, at k `period` seconds.

    `scale` is what its rows were multiplied with. `missed` is, for q and q', the largest
    difference at nodes that are left out when only every second one of the table is kept;
    `thinned` that at the nodes of the plan which the table leaves out, 0 where it has them all.
    `defect` is the largest |d(q)/dt - q'| in between, in 1/s of the coordinate's unit.
    """

    name: str
    period: float
    members: tuple[str, ...]
    nodes: tuple[tuple[float, ...], ...]
    scale: float
    missed: tuple[float, float]
    thinned: tuple[float, float]
    defect: float

    @property
    def end_time(self) -> float:
        """Return the time of the last node in s."""
        return self.period * (len(self.nodes) - 1)


def plan_table(model: LoweredModel, chosen: ParameterSet, path: Path) -> PlanTable:
    """Return the table of the plan in `path`, which must be one of `model` and of set `chosen`.

    The rows are multiplied by one constant so that |det ADB| at the plan's end is that of the
    balance law's constraint at the setpoint: the gains of the set then mean the same for both.
    Raises `InputError` for a plan of another model, equations, parameters or goal.
    """
    raw = _read(path)
    remedy = f"plan again: pfaffian plan {model.name} -o {path.name}"
    try:
        _check_belonging(model, chosen, raw, path, remedy)
        period, count = _period(raw, path, remedy), len(raw["times"])
        members = reference_members(model)
        nodes = [_node(raw, k) for k in range(count)]
    except (KeyError, TypeError, IndexError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: is no plan ({error!r})", remedy=remedy) from error
    if any(len(n) != len(members) or not all(map(math.isfinite, n)) for n in nodes):
        raise InputError(f"{path}: its nodes are not of {model.name}", remedy=remedy)
    scale = _scale(model, chosen, dict(zip(members, nodes[-1], strict=True)))
    first = 3 * len(model.coordinates)
    scaled = [(*n[:first], *(scale * v for v in n[first:])) for n in nodes]
    stride = _stride(count, len(members))
    kept, n = scaled[::stride], len(model.coordinates)
    return PlanTable(
        name=str(raw["set"]),
        period=period * stride,
        members=members,
        nodes=tuple(kept),
        scale=scale,
        missed=_missed(kept, 2, period * stride, n),
        thinned=_missed(scaled, stride, period, n),
        defect=_defect(kept, period * stride, n),
    )


def plan_set(path: Path) -> str:
    """Return the name of the parameter set that the plan in `path` is of."""
    return str(_read(path).get("set"))


def reference_members(model: LoweredModel) -> tuple[str, ...]:
    """Return the members of a reference in order: q, q', q'', R0, R1, R0', R1'."""
    return model.own.reference([c.name for c in model.coordinates])


def _read(path: Path) -> dict[str, Any]:
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror})", remedy="check the path and its rights"
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not valid JSON: {error}", remedy="plan it again") from error
    if not isinstance(raw, dict):
        raise InputError(f"{path}: is no plan", remedy="name a file that pfaffian plan wrote")
    return raw


def _check_belonging(
    model: LoweredModel, chosen: ParameterSet, raw: Mapping[str, Any], path: Path, remedy: str
) -> None:
    if raw["set"] != chosen.name:
        raise InputError(
            f"{path}: is a plan of set {raw['set']}, not of {chosen.name}", remedy=remedy
        )
    if raw["model"] != model.name:
        raise InputError(f"{path}: is a plan of model {raw['model']}", remedy=remedy)
    if raw["model_sha256"] != model.plant_sha256:
        raise InputError(f"{path}: the equations of {model.name} have changed since", remedy=remedy)
    known = chosen.as_dict()
    for p in model.parameters_of("acceleration"):
        then, now = raw["parameters"].get(p.name), known[p.name]
        if then != now:
            raise InputError(
                f"{path}: {p.name} was {then} when it was planned, but is {now:g} in set "
                f"{chosen.name}",
                remedy=remedy,
            )
    goal = tuple(evaluate(model.program("setpoint"), known).values())
    if tuple(raw["problem"]["goal"][: len(goal)]) != goal:
        raise InputError(
            f"{path}: does not end at the setpoint of set {chosen.name}", remedy=remedy
        )


def _period(raw: Mapping[str, Any], path: Path, remedy: str) -> float:
    times = raw["times"]
    period = float(times[-1]) / (len(times) - 1)
    if times[0] != 0.0 or not period > 0.0:
        raise InputError(f"{path}: its times do not begin with 0 and increase", remedy=remedy)
    if any(abs(t - k * period) > _EVEN * period for k, t in enumerate(times)):
        raise InputError(f"{path}: its nodes are not evenly spaced", remedy=remedy)
    return period


def _node(raw: Mapping[str, Any], k: int) -> tuple[float, ...]:
    """Return the members of node `k`; a row holds the weights of q, then those of q'."""
    row, rate = raw["rows"][k], raw["row_rates"][k]
    n = len(raw["accelerations"][k])
    values = [*raw["states"][k], *raw["accelerations"][k]]
    for table in (row, rate):
        values += [v for part in (slice(0, n), slice(n, None)) for r in table for v in r[part]]
    return tuple(float(v) for v in values)


def _scale(model: LoweredModel, chosen: ParameterSet, last: Mapping[str, float]) -> float:
    known = chosen.as_dict()
    at_rest = evaluate(model.program("setpoint"), known)
    values = {**known, **{f"d{c.name}": 0.0 for c in model.coordinates}, **at_rest, "time": 0.0}
    wanted = evaluate(model.program("input_gain"), values)["adb"]
    values |= evaluate(model.program("prepare"), values)
    follow = model.program("follow")
    state = {s.name: 0.0 for s in follow.inputs if s.group == "state"}
    there = evaluate(follow, {**state, **values, **last})[model.own("adb")]
    ratio = abs(wanted / there) if there else math.inf
    if not math.isfinite(ratio) or ratio == 0.0:
        raise InputError(
            f"model {model.name}: ADB of the plan's row is {there:g} at its end",
            remedy="plan with other weights of the Riccati row",
        )
    return float(ratio ** (1.0 / len(model.actuators)))


def _stride(count: int, members: int) -> int:
    """Return the least stride that divides the plan and keeps its table within `_LARGEST`."""
    intervals = count - 1
    fitting = (
        s
        for s in range(1, intervals + 1)
        if intervals % s == 0 and 8 * members * (intervals // s + 1) <= _LARGEST
    )
    return next(fitting, intervals)


def hermite(a: float, b: float, c: float, d: float, u: float) -> float:
    """Return the cubic with values `a`, `b` and slopes `c`, `d` (of u) at 0 and 1, at `u`."""
    rise = b - a
    return a + u * (c + u * (3.0 * rise - 2.0 * c - d + u * (c + d - 2.0 * rise)))


def _missed(
    nodes: Sequence[Sequence[float]], stride: int, period: float, n: int
) -> tuple[float, float]:
    """Return the largest error in q and in q' at the nodes between every `stride`-th one."""
    worst = [0.0, 0.0]
    h = stride * period
    for k in range(0, len(nodes) - stride, stride):
        one, two = nodes[k], nodes[k + stride]
        for j in range(1, stride):
            for i in range(2 * n):
                found = hermite(one[i], two[i], h * one[i + n], h * two[i + n], j / stride)
                kind = i // n
                worst[kind] = max(worst[kind], abs(found - nodes[k + j][i]))
    return worst[0], worst[1]


def _defect(nodes: Sequence[Sequence[float]], h: float, n: int) -> float:
    """Return the largest |d(q)/dt - q'| between nodes, at eight points of each interval."""
    worst = 0.0
    for one, two in itertools.pairwise(nodes):
        for i in range(n):
            rise, c, d = (two[i] - one[i]) / h, one[i + n], two[i + n]
            for j in range(1, 8):
                u = j / 8
                slope = c + u * (2.0 * (3.0 * rise - 2.0 * c - d) + 3.0 * u * (c + d - 2.0 * rise))
                rate = hermite(c, d, h * one[i + 2 * n], h * two[i + 2 * n], u)
                worst = max(worst, abs(slope - rate))
    return worst
