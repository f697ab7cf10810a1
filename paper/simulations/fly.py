"""A case flown by a solver of scipy, sampled, and stored in the cache by content."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
from pfaffian.paper.simulations.cases import LQR, PRINTED, Case
from pfaffian.paper.simulations.loop import SIGNALS, Loop
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.cache import digest
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.base.import_closure import code_of
from pfaffian.runtime.code.generated_model import GeneratedFolder, GeneratedModel
from scipy.integrate import BDF, DOP853, LSODA, RK45, Radau

#: Solvers by the name in a task: those of scipy, and CVODES on a second formulation.
_SOLVERS = {"LSODA": LSODA, "Radau": Radau, "BDF": BDF, "RK45": RK45, "DOP853": DOP853}
CVODES = "CVODES"
RELATIVE, ABSOLUTE = 1e-8, 1e-10
#: Where a run ends early: a link at this rate in rad/s, or this far from its setpoint in rad.
RATE_END, ANGLE_END = 1000.0, np.pi
#: How a run ends where no step is small enough for the solver: in an escape in finite time.
STALLED = "stalled"
_MOST_EVALUATIONS = 30_000_000
_HALVINGS = 50


@dataclass(frozen=True)
class Task:
    """What to fly and how: tolerances of the solver, and the step of the record in seconds.

    With `record` 0 every step of the solver is kept.
    """

    case: Case
    solver: str = "LSODA"
    relative: float = RELATIVE
    absolute: float = ABSOLUTE
    record: float = 1e-3


@dataclass(frozen=True)
class Run:
    """A solution: `time` (N,) s, `state` (N, 6) as in `loop`, `signals` (N,) by name, SI units.

    `ended` says why it is shorter than the case, and is empty where it is not; `end` is its last
    time. `over_limit` is when |tau| first passed the torque limit of the set, or nothing.
    """

    task: Task
    time: Array
    state: Array
    signals: dict[str, Array]
    ended: str
    end: float
    over_limit: float | None
    evaluations: int

    @property
    def case(self) -> Case:
        """Return what was flown."""
        return self.task.case

    def errors(self) -> Array:
        """Return q - q_d (N, 2) in rad."""
        gains = self.case.controller
        return np.asarray(self.state[:, :2] - np.array([gains["q1d"], gains["q2d"]]))


def fly(task: Task, host: GeneratedModel) -> Run:
    """Fly `task`; raise `CheckError` where it needs too many evaluations.

    A run ends early where a link turns faster than `RATE_END`, or no step is small enough; for
    the law as printed also where a link has gone half round from its setpoint, for the others of
    the paper where ADB changes its sign.
    """
    loop = Loop(task.case, host)
    with np.errstate(all="ignore"):
        solver = _SOLVERS[task.solver](
            loop, 0.0, loop.start, task.case.duration, rtol=task.relative, atol=task.absolute
        )
        record = _Record(task, loop)
        while solver.status == "running" and not record.ended:
            solver.step()
            if solver.status == "failed":  # no step is small enough: the solution ends here
                record.ended = STALLED
                break
            if loop.evaluations > _MOST_EVALUATIONS:
                raise CheckError(
                    f"{task.case.name}: {task.solver} took {loop.evaluations} evaluations to "
                    f"come to {solver.t:.6g} s",
                    remedy="take another solver, or another tolerance",
                )
            record.take(solver)
    time, state = np.array(record.times), np.array(record.states)
    values = np.array([loop.signals(y) for y in state])
    return Run(
        task,
        time,
        state,
        dict(zip(SIGNALS, values.T, strict=True)),
        record.ended,
        float(time[-1]) if record.ended else task.case.duration,
        record.over_limit,
        loop.evaluations,
    )


class _Record:
    """What is kept of a run while it is solved, and when it has to end."""

    def __init__(self, task: Task, loop: Loop) -> None:
        self.task, self.loop = task, loop
        self.times, self.states = [0.0], [loop.start]
        self.ended = ""
        self.over_limit: float | None = None
        self._goal = [task.case.controller[n] for n in ("q1d", "q2d")]
        self._limit = task.case.controller["torque_limit"]
        self._sign = loop.gain(0.0, loop.start)

    def take(self, solver: Any) -> None:
        """Keep what the last step of `solver` passed; note where the run ends within it."""
        end, y = solver.t, solver.y
        self.ended = self._ending(y)
        step = self.task.record
        over = self.over_limit is None and self._beyond_limit(y)
        if not (step or over or self.ended):
            self._keep(end, y)
            return
        if not (over or self.ended) and len(self.times) * step > end:
            return
        path = solver.dense_output()
        if over:
            self.over_limit = _first(lambda t: self._beyond_limit(path(t)), solver.t_old, end)
        if self.ended:
            end = _first(lambda t: bool(self._ending(path(t))), solver.t_old, end)
        while step and len(self.times) * step <= end:
            self._keep(len(self.times) * step, path(len(self.times) * step))
        if self.ended or not step:
            self._keep(end, path(end))

    def _keep(self, time: float, y: Array) -> None:
        self.times.append(time)
        self.states.append(np.array(y))

    def _ending(self, y: Array) -> str:
        """Return why a run cannot go beyond the state `y`, or nothing."""
        q1, q2, v1, v2 = y.tolist()[:4]
        if not max(abs(v1), abs(v2)) < RATE_END:
            return "speed"
        column = self.task.case.column
        if column == PRINTED:
            far = max(abs(q1 - self._goal[0]), abs(q2 - self._goal[1])) >= ANGLE_END
            return "angle" if far else ""
        return "singular" if column != LQR and self._sign * self.loop.gain(0.0, y) < 0.0 else ""

    def _beyond_limit(self, y: Array) -> bool:
        return not abs(self.loop.signals(y)[0]) < self._limit


def _first(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Return where `holds` becomes true between `low`, where it is false, and `high`."""
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def task_key(task: Task, folder: GeneratedFolder, *more: bytes) -> str:
    """Return the digest of all that the run of `task` depends on."""
    tools = [f"{n} {version(n)}".encode() for n in ("numpy", "scipy", "casadi")]
    sources = sorted((folder.path / "c").glob("*.[ch]"))
    asked = json.dumps(asdict(task), sort_keys=True).encode()
    return digest(asked, *code_of(__name__), *tools, *(p.read_bytes() for p in sources), *more)


def pack_run(run: Run) -> bytes:
    """Return `run` as the cache keeps it; `read_run` reads it again."""
    about = {
        "ended": run.ended,
        "end": run.end,
        "over_limit": run.over_limit,
        "evaluations": run.evaluations,
    }
    buffer = io.BytesIO()
    values = np.stack([run.signals[n] for n in SIGNALS])
    np.savez_compressed(
        buffer,
        time=run.time,
        state=run.state,
        signals=values,
        about=np.array(json.dumps(about)),
    )
    return buffer.getvalue()


def read_run(task: Task, content: bytes) -> Run:
    """Return the run of `task` that `content` of the cache holds."""
    with np.load(io.BytesIO(content)) as stored:
        about = json.loads(str(stored["about"]))
        signals = dict(zip(SIGNALS, stored["signals"], strict=True))
        return Run(task, stored["time"], stored["state"], signals, **about)
