"""One control step in Python, timed: the NumPy module, compiled C behind it, SymPy's lambdify."""

from __future__ import annotations

import statistics
import time
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import sympy as sp
from pfaffian.benchmarks.step import StepStates, check_agreement
from pfaffian.benchmarks.step_peers import shared_assignments
from pfaffian.derive.symbolic.block import Block
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.code.compiled import compiled_model
from pfaffian.runtime.code.generated_model import GeneratedFolder

#: How often each is timed; the median counts.
_RUNS = 5
#: Calls of the compiled controller that are timed together.
_CALLS = 10_000


def python_steps(
    block: Block,
    folder: GeneratedFolder,
    states: StepStates,
    parameters: Mapping[str, float],
    rows: int,
) -> dict[str, float | None]:
    """Return nanoseconds a step by way of calling it.

    `numpy_vectorised` is one call over `rows` states, `lambdify_loop` SymPy's lambdify (for NumPy,
    as by default, and for the module math) called once a state. `compiled_vectorised` is one call
    of the compiled model over `rows` states, `compiled_call` one call of its controller in a loop;
    both are None without a C compiler. Raises `CheckError` where they do not agree.
    """
    with warnings.catch_warnings():  # that there is no compiler shows in the figures
        warnings.simplefilter("ignore", RuntimeWarning)
        model = compiled_model(folder.path)
    calls = {"numpy_vectorised": _vectorised(model.module, folder, states, parameters, rows)}
    if model.compiled:
        calls["compiled_vectorised"] = _vectorised(model, folder, states, parameters, rows)
    loops = {
        "lambdify_loop": _lambdified(block, states, "numpy"),
        "lambdify_math_loop": _lambdified(block, states, "math"),
    }
    count = len(states.given)
    results = {c: {n: v[:count] for n, v in call().items()} for c, call in calls.items()}
    for name, loop in loops.items():
        table = np.array(loop(), float)
        results[name] = {
            s.name: table[:, k] for k, s in enumerate(block.outputs) if s.group != "flag"
        }
    check_agreement(results, "Python", "numpy_vectorised")
    figures: dict[str, float | None] = dict.fromkeys(("compiled_vectorised", "compiled_call"))
    figures |= {n: _median_ns(call, rows) for n, call in calls.items()}
    figures |= {n: _median_ns(loop, count) for n, loop in loops.items()}
    if model.compiled:
        controller = model.Controller(model.Params(**_chosen(folder, "params", parameters)))
        figures["compiled_call"] = _median_ns(_controlled(controller, folder, states), _CALLS)
    return figures


def _chosen(folder: GeneratedFolder, role: str, values: Mapping[str, float]) -> dict[str, float]:
    return {n: values[n] for n in folder.manifest.structures[role].names()}


def _controlled(controller: Any, folder: GeneratedFolder, states: StepStates) -> Callable[[], None]:
    """Return a plain loop of `_CALLS` steps of the controller over what was measured."""
    names = folder.manifest.structures["input"].names()
    measured = np.column_stack([states.column(n) for n in names]).tolist()
    given = [tuple(row) for row in measured * (-(-_CALLS // len(measured)))][:_CALLS]

    def steps() -> None:
        step = controller.step
        for q in given:
            step(*q)

    return steps


def _vectorised(
    module: Any,
    folder: GeneratedFolder,
    states: StepStates,
    parameters: Mapping[str, float],
    rows: int,
) -> Callable[[], dict[str, Array]]:
    """Return the step of `module` over `rows` states, which repeat those given."""
    structures = folder.manifest.structures
    params = module.Params(**_chosen(folder, "params", parameters))
    started = vars(module.init(params)[0])
    repeat = -(-rows // len(states.given))
    column = {n: np.tile(states.column(n), repeat)[:rows] for n in states.names}
    measured = module.Input(**{n: column[n] for n in structures["input"].names()})
    state = module.State(**{n: column.get(n, started[n]) for n in structures["state"].names()})

    def step() -> dict[str, Array]:
        after, output, _ = module.step(state, params, measured)
        return {n: np.broadcast_to(v, (rows,)) for n, v in {**vars(output), **vars(after)}.items()}

    return step


def _lambdified(block: Block, states: StepStates, module: str) -> Callable[[], list[Any]]:
    """Return a loop that calls the lambdified step once a state."""
    given = [s for s in block.symbols if s.name in states.names]
    constant = [s for s in block.symbols if s.name not in states.names]
    assignments, outputs = shared_assignments(block)
    step = sp.lambdify(
        [*given, *constant], outputs, modules=module, cse=lambda _: (assignments, outputs)
    )
    order = [states.names.index(s.name) for s in given]
    constants = states.constants.tolist()
    rows = [[row[k] for k in order] for row in states.given.tolist()]
    return lambda: [step(*row, *constants) for row in rows]


def _median_ns(call: Callable[[], object], steps: int) -> float:
    seconds = []
    for _ in range(_RUNS):
        since = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - since)
    return statistics.median(seconds) / steps * 1e9
