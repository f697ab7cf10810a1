"""The plan file: JSON in a fixed order, numbers that read back to the same bits.

The file is the source of truth, not the solver: another machine or version of IPOPT may find the
same motion with other last digits, or another one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pfaffian.derive.plan.check import PlanCheck
from pfaffian.derive.plan.planner import Plan, Provenance
from pfaffian.derive.plan.problem import NO_LIMIT, Problem, Weights
from pfaffian.derive.plan.riccati import RowPath
from pfaffian.derive.plan.shooting import Trajectory
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.files import write_outputs
from pfaffian.runtime.base.toml import shown

Array = NDArray[np.float64]
FORMAT = "pfaffian plan 1"
#: Largest file that is read at all, in bytes.
_LARGEST = 64_000_000


def plan_text(plan: Plan) -> str:
    """Return the file of `plan`: one node a line, floats in their shortest exact decimals."""
    sections = _sections(plan)
    return "{\n" + ",\n".join(f"{json.dumps(k)}: {_laid_out(v)}" for k, v in sections) + "\n}\n"


def _laid_out(value: Any) -> str:
    """Return `value` in JSON: lists of lists and tables one entry a line."""
    if isinstance(value, Mapping) and value:
        inner = ",\n ".join(f"{json.dumps(k)}: {_dumped(v)}" for k, v in value.items())
        return "{\n " + inner + "\n}"
    if isinstance(value, list) and value and isinstance(value[0], list):
        return "[\n " + ",\n ".join(map(_dumped, value)) + "\n]"
    return _dumped(value)


def _dumped(value: Any) -> str:
    return json.dumps(value, allow_nan=False, ensure_ascii=False)


def _sections(plan: Plan) -> Iterator[tuple[str, Any]]:
    problem, path, row = plan.problem, plan.trajectory, plan.row
    yield "format", FORMAT
    yield "model", problem.model
    yield "set", problem.set_name
    yield "model_sha256", problem.model_sha256
    yield "parameter_sha256", problem.parameter_sha256
    yield "parameters", dict(problem.parameters)
    yield "coordinates", dict(problem.coordinates)
    yield "actuators", dict(problem.actuators)
    yield (
        "problem",
        {
            "start": list(problem.start),
            "goal": list(problem.goal),
            "start_torque": list(problem.start_torque),
            "goal_torque": list(problem.goal_torque),
            "torque_limits": list(problem.torque_limits),
            "available_limits": list(problem.available_limits),
            "speed_limits": [v if math.isfinite(v) else None for v in problem.speed_limits],
            "end_time": list(problem.end_time),
            "sample_time": problem.sample_time,
            "weights": vars(problem.weights),
        },
    )
    yield "provenance", {**vars(plan.provenance), "tools": dict(plan.provenance.tools)}
    yield "check", {k: list(v) if isinstance(v, tuple) else v for k, v in vars(plan.check).items()}
    yield (
        "riccati",
        {
            "weights": list(row.weights),
            "effort": row.effort,
            "lyapunov_rate": row.lyapunov_rate,
            "input_gain": row.input_gain,
        },
    )
    yield "times", path.times.tolist()
    yield "states", path.states.tolist()
    yield "torques", path.torques.tolist()
    yield "accelerations", plan.accelerations.tolist()
    yield "rows", row.rows.tolist()
    yield "row_rates", row.rates.tolist()
    yield "riccati_matrices", row.matrices.tolist()


def write_plan(plan: Plan, path: Path) -> None:
    """Write `plan` into `path`, whole or not at all; raise `InputError` where that fails."""
    write_outputs({path: plan_text(plan).encode()})


def read_plan(path: Path) -> Plan:
    """Return the plan in `path`; raise `InputError` naming the file and the key at fault."""
    remedy = "write it again: pfaffian plan MODEL -o FILE"
    try:
        if path.stat().st_size > _LARGEST:
            raise InputError(f"{path}: is too large to be a plan", remedy=remedy)
        raw = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror})", remedy="check the path and its rights"
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not valid JSON: {error}", remedy=remedy) from error
    return _plan(_Reader(raw, str(path), remedy))


class _Reader:
    """Takes typed values out of a JSON table, or raises `InputError` with file and key."""

    def __init__(self, raw: object, where: str, remedy: str) -> None:
        self.where, self.remedy = where, remedy
        if not isinstance(raw, dict):
            raise self.error("must be a table")
        self.raw: dict[str, Any] = raw

    def error(self, what: str) -> InputError:
        return InputError(f"{self.where}: {what}", remedy=self.remedy)

    def value(self, key: str) -> Any:
        if key not in self.raw:
            raise self.error(f"missing {key}")
        return self.raw[key]

    def table(self, key: str) -> _Reader:
        return _Reader(self.value(key), f"{self.where}: {key}", self.remedy)

    def text(self, key: str) -> str:
        value = self.value(key)
        if not isinstance(value, str):
            raise self.error(f"{key} = {shown(value)} is no text")
        return value

    def number(self, key: str) -> float:
        return self._float(self.value(key), key)

    def count(self, key: str) -> int:
        value = self.value(key)
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**63:
            raise self.error(f"{key} = {shown(value)} is no count")
        return value

    def numbers(self, key: str, length: int | None = None) -> tuple[float, ...]:
        value = self.value(key)
        if not isinstance(value, list) or length not in (None, len(value)):
            wanted = "a list of numbers" if length is None else f"a list of {length} numbers"
            raise self.error(f"{key} is not {wanted}")
        return tuple(self._float(v, key) for v in value)

    def array(self, key: str, *shape: int) -> Array:
        """Return an array of this shape; every entry must be a finite number."""

        def entries(value: Any, left: tuple[int, ...]) -> Iterator[float]:
            if not left:
                yield self._float(value, key)
                return
            if not isinstance(value, list) or len(value) != left[0]:
                raise self.error(f"{key} does not have the shape {shape}")
            for entry in value:
                yield from entries(entry, left[1:])

        return np.array(list(entries(self.value(key), shape))).reshape(shape)

    def texts(self, key: str) -> tuple[tuple[str, str], ...]:
        table = self.table(key)
        return tuple((k, table.text(k)) for k in table.raw)

    def _float(self, value: object, key: str) -> float:
        try:
            if isinstance(value, int | float) and not isinstance(value, bool):
                number = float(value)
                if math.isfinite(number):
                    return number
        except OverflowError:
            pass
        raise self.error(f"{key}: {shown(value)} is not a finite number")


def _plan(top: _Reader) -> Plan:
    found = top.text("format")
    if found != FORMAT:
        raise top.error(f"format = {shown(found)}, but {FORMAT!r} is read here")
    problem = _problem(top)
    n, m = problem.order, len(problem.actuators)
    times = np.array(top.numbers("times"))
    count = len(times)
    if count < 2 or times[0] != 0.0 or not np.all(np.diff(times) > 0.0):
        raise top.error("times must begin with 0 and increase")
    provenance, row = top.table("provenance"), top.table("riccati")
    path = Trajectory(
        times=times,
        states=top.array("states", count, 2 * n),
        torques=top.array("torques", count, m),
        cost=provenance.number("cost"),
        iterations=provenance.count("iterations"),
    )
    rows = RowPath(
        weights=row.numbers("weights", 2 * n),
        effort=row.number("effort"),
        rows=top.array("rows", count, m, 2 * n),
        rates=top.array("row_rates", count, m, 2 * n),
        matrices=top.array("riccati_matrices", count, 2 * n, 2 * n),
        lyapunov_rate=row.number("lyapunov_rate"),
        input_gain=row.number("input_gain"),
    )
    return Plan(
        problem=problem,
        trajectory=path,
        accelerations=top.array("accelerations", count, n),
        row=rows,
        check=_check(top.table("check"), n, m),
        provenance=_provenance(provenance),
    )


def _problem(top: _Reader) -> Problem:
    coordinates, actuators = top.texts("coordinates"), top.texts("actuators")
    n, m = len(coordinates), len(actuators)
    if not n or not m:
        raise top.error("a plan has at least one coordinate and one actuator")
    raw, parameters = top.table("problem"), top.table("parameters")
    weights = raw.table("weights")
    least, most = raw.numbers("end_time", 2)
    limits = raw.value("speed_limits")
    if not isinstance(limits, list) or len(limits) != n:
        raise raw.error(f"speed_limits is not a list of {n} numbers or null")
    raw.raw["speed_limits"] = [v for v in limits if v is not None]
    known = iter(raw.numbers("speed_limits"))
    return Problem(
        model=top.text("model"),
        set_name=top.text("set"),
        coordinates=coordinates,
        actuators=actuators,
        start=raw.numbers("start", 2 * n),
        goal=raw.numbers("goal", 2 * n),
        start_torque=raw.numbers("start_torque", m),
        goal_torque=raw.numbers("goal_torque", m),
        torque_limits=raw.numbers("torque_limits", m),
        available_limits=raw.numbers("available_limits", m),
        speed_limits=tuple(NO_LIMIT if v is None else next(known) for v in limits),
        end_time=(least, most),
        sample_time=raw.number("sample_time"),
        weights=Weights(**{k: weights.number(k) for k in vars(Weights())}),
        parameters=tuple((k, parameters.number(k)) for k in parameters.raw),
        model_sha256=top.text("model_sha256"),
        parameter_sha256=top.text("parameter_sha256"),
    )


def _check(raw: _Reader, n: int, m: int) -> PlanCheck:
    said: Sequence[object] = raw.value("violations")
    if not isinstance(said, list) or not all(isinstance(v, str) for v in said):
        raise raw.error("violations is not a list of texts")
    numbers = ("defect", "defect_time", "drift", "energy_used", "work", "energy_change")
    return PlanCheck(
        **{k: raw.number(k) for k in numbers},
        peak_torque=raw.numbers("peak_torque", m),
        peak_speed=raw.numbers("peak_speed", n),
        violations=tuple(map(str, said)),
    )


def _provenance(raw: _Reader) -> Provenance:
    counts = ("seed", "starts", "start_number", "converged", "coarse", "steps", "iterations")
    return Provenance(
        **{k: raw.count(k) for k in counts}, cost=raw.number("cost"), tools=raw.texts("tools")
    )
