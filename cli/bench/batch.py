"""`pfaffian bench batch`: the batch form beside the scalar functions in a loop, in one run."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pfaffian.cli import output
from pfaffian.runtime.base.errors import CheckError

if TYPE_CHECKING:
    from pfaffian.runtime.code.batch import BatchModel


_SUBSTEPS = 10


def bench_batch(reference: str, samples: int, passes: int, as_json: bool) -> None:
    """Time step and plant step of `samples` samples, scalar and batch taking turns."""
    from pfaffian.derive.emit.emission import Emission
    from pfaffian.derive.generation import generate
    from pfaffian.derive.pipeline import library_sets, lowered_model
    from pfaffian.derive.spec.library import find_model
    from pfaffian.derive.writer import write_generation
    from pfaffian.runtime.code.batch import batch_model
    from pfaffian.runtime.code.generated_model import open_generated
    from pfaffian.runtime.machine.toolchain import COMMON_FLAGS, host_target, vector_flags

    source = find_model(reference)
    model = lowered_model(source)
    with tempfile.TemporaryDirectory(prefix="pfaffian-") as scratch:
        emission = Emission(model, library_sets(model, source), batch=True)
        write_generation(generate(emission), Path(scratch) / model.name)
        batch = batch_model(open_generated(str(Path(scratch) / model.name)))
    rows = {
        name: _ratio(scalar, vector, samples, passes)
        for name, (scalar, vector) in _pairs(batch, samples).items()
    }
    flags = (*COMMON_FLAGS, *host_target(fma=True).flags, *vector_flags())
    document = {"model": model.name, "samples": samples, "flags": " ".join(flags), **rows}
    if as_json:
        output.emit_json(document)
        return
    output.table(
        f"{model.name}: {samples} samples, ns each",
        ("function", "scalar", "batch", "scalar / batch"),
        [
            (n, f"{r['scalar_ns']:.1f}", f"{r['batch_ns']:.1f}", f"{r['ratio']:.2f}")
            for n, r in rows.items()
        ],
    )


def _ratio(
    scalar: Callable[[], None], vector: Callable[[], None], samples: int, passes: int
) -> dict[str, float]:
    """Return the least times a sample in ns and their ratio; the two take turns.

    Whatever else the machine does only ever adds time, and more to the longer call.
    """
    times: dict[str, list[float]] = {"scalar": [], "batch": []}
    for _ in range(passes + 1):
        for name, call in (("scalar", scalar), ("batch", vector)):
            since = time.perf_counter()
            call()
            times[name].append((time.perf_counter() - since) * 1e9 / samples)
    one, other = (min(times[n][1:]) for n in ("scalar", "batch"))
    return {"scalar_ns": one, "batch_ns": other, "ratio": one / other}


def _pairs(
    batch: BatchModel, samples: int
) -> dict[str, tuple[Callable[[], None], Callable[[], None]]]:
    """Return the scalar call and the batch call of each function, on the same samples.

    Raises `CheckError` where one period differs by a bit.
    """
    host, folder = batch.host, batch.folder
    rng, sets = np.random.default_rng(1), folder.manifest.parameter_sets
    values = folder.parameters(next(iter(sets)))
    roles = ("params", "state", "input", "output", "plant_params", "plant_state", "plant_input")
    records = {role: host.records(role, samples) for role in roles}
    for role in ("params", "plant_params"):
        for name in records[role].dtype.names or ():
            records[role][name] = values[name]
    for role in ("input", "plant_state", "plant_input"):
        for name in records[role].dtype.names or ():
            records[role][name] = rng.normal(0.0, 0.5, samples)
    status = np.zeros(samples, np.int32)
    host.init(records["state"], records["params"], status)
    columns = {role: batch.columns(role, samples).spread(records[role]) for role in roles}
    step = np.full(samples, 1e-4)

    def steps(machine: Any, given: Any) -> Callable[[], None]:
        control = [given[role] for role in ("state", "params", "input", "output")]
        return lambda: machine.step(*control, status)

    def moves(machine: Any, given: Any) -> Callable[[], None]:
        plant = [given[role] for role in ("plant_state", "plant_params", "plant_input")]
        return lambda: machine.plant_step(*plant, step, _SUBSTEPS)

    pairs = {
        "step": (steps(host, records), steps(batch, columns)),
        f"plant_step ({_SUBSTEPS} substeps)": (moves(host, records), moves(batch, columns)),
    }
    for one, other in pairs.values():
        one()
        other()
    for role in ("state", "output", "plant_state"):
        for name in columns[role].names():
            if columns[role][name].tobytes() != records[role][name].tobytes():
                raise CheckError(
                    f"{folder.manifest.model}: {name} of batch and scalar form differ",
                    remedy="report this with the compiler's name and version",
                )
    return pairs
