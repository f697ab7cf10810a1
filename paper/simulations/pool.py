"""Flies what a reproduction needs on several processes, each run cached by its content."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache

from pfaffian.paper.simulations.fly import CVODES, Run, Task, fly, pack_run, read_run, task_key
from pfaffian.runtime.base.cache import cached, stored
from pfaffian.runtime.base.import_closure import code_of
from pfaffian.runtime.code.generated_model import (
    GeneratedFolder,
    GeneratedModel,
    host_model,
    open_generated,
)

MODEL = "pendubot"
_MOST_WORKERS = 2
#: Cases that take long, by the end of their name: they start first.
_LONG = ("5.3-derived", "5.1-lqr")


@cache
def _host() -> GeneratedModel:
    return host_model(open_generated(MODEL))


def compute(task: Task) -> bytes:
    """Fly `task` in this process; return the run as the cache keeps it."""
    if task.solver == CVODES:
        from pfaffian.paper.simulations.independent import fly_independent

        return pack_run(fly_independent(task))
    return pack_run(fly(task, _host()))


def _key(task: Task, folder: GeneratedFolder) -> str:
    if task.solver != CVODES:
        return task_key(task, folder)
    return task_key(task, folder, *code_of("pfaffian.paper.simulations.independent"))


def fly_all(
    tasks: Mapping[str, Task], folder: GeneratedFolder, update: Callable[[int, int], None]
) -> dict[str, Run]:
    """Return the runs of `tasks` by name; `update` is called with (done, total)."""
    keys = {name: _key(task, folder) for name, task in tasks.items()}
    known = {n: body for n, k in keys.items() if (body := stored("reproduce", k)) is not None}
    missing = [n for n in tasks if n not in known]
    missing.sort(key=lambda n: not any(mark in n for mark in _LONG))
    update(len(known), len(tasks))
    if missing:
        _host()  # compiled once, for all processes
        workers = min(_MOST_WORKERS, os.cpu_count() or 1, len(missing))
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, mp_context=context) as pool:
            waiting = {pool.submit(compute, tasks[n]): n for n in missing}
            for future in as_completed(waiting):
                name = waiting[future]
                known[name] = cached("reproduce", keys[name], future.result)
                update(len(known), len(tasks))
    return {name: read_run(task, known[name]) for name, task in tasks.items()}
