"""One control step in Python: the generated NumPy module, and SymPy's lambdify, timed."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import sympy as sp
from pfaffian.derive.block import Block
from pfaffian.derive.step_peers import shared_assignments
from pfaffian.runtime.generated_model import GeneratedFolder
from pfaffian.runtime.step_bench import StepStates, check_agreement

Array = np.ndarray[Any, Any]

#: How often each is timed; the median counts.
_RUNS = 5


def python_steps(
    block: Block,
    folder: GeneratedFolder,
    states: StepStates,
    parameters: Mapping[str, float],
    rows: int,
) -> dict[str, float | None]:
    """Return nanoseconds a step by way of calling it.

    `numpy_vectorised` is one call over `rows` states, `lambdify_loop` SymPy's lambdify (for NumPy,
    as by default, and for the module math) called once a state. `compiled_call` is one call of the
    compiled step through Python: None, as there is no such path yet. Raises `CheckError` where
    they do not agree.
    """
    vectorised = _numpy_step(folder, states, parameters, rows)
    loops = {
        "lambdify_loop": _lambdified(block, states, "numpy"),
        "lambdify_math_loop": _lambdified(block, states, "math"),
    }
    results = {"numpy_vectorised": {n: v[: len(states.given)] for n, v in vectorised().items()}}
    for name, loop in loops.items():
        table = np.array(loop(), float)
        results[name] = {
            s.name: table[:, k] for k, s in enumerate(block.outputs) if s.group != "flag"
        }
    check_agreement(results, "Python", "numpy_vectorised")
    figures: dict[str, float | None] = {"numpy_vectorised": _median_ns(vectorised, rows)}
    figures |= {n: _median_ns(loop, len(states.given)) for n, loop in loops.items()}
    return {**figures, "compiled_call": None}


def _numpy_step(
    folder: GeneratedFolder, states: StepStates, parameters: Mapping[str, float], rows: int
) -> Callable[[], dict[str, Array]]:
    """Return the generated module's step over `rows` states, which repeat those given."""
    module, structures = folder.python_module(), folder.manifest.structures
    params = module.Params(**{n: parameters[n] for n in structures["params"].names()})
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
