"""One control step by several tools: built, compared, counted on the target, timed on the host.

A tool is C with an adapter around it that exports `bench_load`, `bench_steps`, `bench_store` and,
built with BENCH_TIMED, `bench_time`; the states go in and out as rows of doubles.
"""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.code.generated_model import host_model
from pfaffian.runtime.flight.closed_loop import fly
from pfaffian.runtime.flight.scenario import Scenario
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.emulator import Ppc750Machine, section_bytes
from pfaffian.runtime.machine.host import HostMachine, Machine
from pfaffian.runtime.machine.toolchain import (
    Target,
    host_target,
    ppc750_libm_target,
    ppc750_target,
    processor_has_fma,
)

Key = TypeVar("Key")

#: States that an adapter has room for.
CAPACITY = 512
#: Largest relative difference between two tools that is still the same law.
AGREEMENT = 1e-9
_SECTIONS = ("-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections")
_FLIGHT_STEPS = 1500
_LARGEST_RATE = 10.0


@dataclass(frozen=True)
class StepTool:
    """One tool's C: file texts by name, which of them to compile, the function to count.

    `adapter.c` is among the files but not among `units`. `taken` names the columns that it stores.
    `libm` tells that the tool calls the C library, `on_target` that it is counted there.
    """

    name: str
    sources: Mapping[str, str]
    units: tuple[str, ...]
    entry: str
    taken: tuple[str, ...]
    libm: bool = False
    on_target: bool = True


@dataclass(frozen=True)
class StepStates:
    """Where the step is evaluated: `given` (N, G) by `names`, `constants` (C,), in SI units."""

    names: tuple[str, ...]
    given: Array
    constants: Array

    def column(self, name: str) -> Array:
        """Return the values (N,) of one input."""
        column: Array = self.given[:, self.names.index(name)]
        return column


@dataclass(frozen=True)
class Count:
    """What one step costs on the target: instructions over the states, bytes of code and stack."""

    best: int
    median: int
    worst: int
    text_bytes: int
    stack_bytes: int


def flown_states(scenario: Scenario, names: Sequence[str], count: int) -> Array:
    """Return `count` rows of `names` along a flight: what is measured, and remembered before."""
    model = host_model(scenario.folder)
    flight = fly(replace(scenario, steps=_FLIGHT_STEPS), model, model, "host")
    picked = np.linspace(0, _FLIGHT_STEPS - 1, count).astype(int)
    rows = np.empty((count, len(names)))
    start = model.records("state")
    params = model.records("params")
    for name in params.dtype.names or ():
        params[name] = scenario.controller[name]
    model.init(start, params, np.zeros(1, np.int32))
    before = np.concatenate([start, flight.state[:-1]])
    for k, name in enumerate(names):
        measured = name in (flight.measured.dtype.names or ())
        rows[:, k] = (flight.measured if measured else before)[name][picked]
    return rows


def random_states(
    scenario: Scenario, names: Sequence[str], flown: Array, count: int, seed: int = 1
) -> Array:
    """Return `count` rows drawn over the whole circle, and over twice what the flight remembered.

    Angles lie within pi of the setpoint, rates within 10 rad/s. What is never negative along the
    flight stays so; flags are 0 or 1.
    """
    rng = np.random.default_rng(seed)
    rows = np.empty((count, len(names)))
    integers = {f.name for f in scenario.folder.manifest.structures["state"].fields
                if f.type != "double"}  # fmt: skip
    for k, name in enumerate(names):
        most = 2.0 * float(np.abs(flown[:, k]).max())
        if name in scenario.setpoint:
            rows[:, k] = scenario.setpoint[name] + rng.uniform(-np.pi, np.pi, count)
        elif name in scenario.folder.manifest.domain:
            rows[:, k] = rng.uniform(-_LARGEST_RATE, _LARGEST_RATE, count)
        elif name in integers:
            rows[:, k] = rng.integers(0, 2, count)
        else:
            rows[:, k] = rng.uniform(0.0 if flown[:, k].min() >= 0.0 else -most, most, count)
    return rows


def target_of(tool: StepTool) -> Target:
    """Return the PowerPC 750, with a C library where the tool needs one."""
    return ppc750_libm_target() if tool.libm else ppc750_target()


def _build(tool: StepTool, target: Target, units: Sequence[str], extra: Sequence[str]) -> bytes:
    with tempfile.TemporaryDirectory(prefix="pfaffian-") as scratch:
        folder = Path(scratch)
        for name, text in tool.sources.items():
            (folder / name).write_text(text, encoding="utf-8")
        return compile_image(target, [folder / n for n in units], folder, extra)


class ToolOnMachine:
    """A tool's image on a machine, with the states loaded."""

    def __init__(self, tool: StepTool, machine: Machine, states: StepStates) -> None:
        """Load `states`."""
        self.tool, self.machine, self.count = tool, machine, len(states.given)
        kind = np.dtype(f"{machine.byte_order}f8")
        self._given = np.ascontiguousarray(states.given).astype(kind)
        self._constants = states.constants.astype(kind)
        self._given.flags.writeable = self._constants.flags.writeable = False
        self._taken = np.zeros((self.count, len(tool.taken)), kind)
        self.load()

    def load(self) -> None:
        """Put every state back to where it was before the step."""
        self.machine.call("bench_load", self.count, self._given, self._constants)

    def results(self) -> dict[str, Array]:
        """Run one step from every state; return what it gives, float64 (N,) by name."""
        self.load()
        self.machine.call("bench_steps", 0, self.count)
        self.machine.call("bench_store", self.count, self._taken)
        return {n: self._taken[:, k].astype(float) for k, n in enumerate(self.tool.taken)}

    def nanoseconds(self) -> float:
        """Return nanoseconds a step of one pass over the states."""
        self.load()
        return self.machine.call("bench_time", self.count) / self.count


def on_host(tool: StepTool, states: StepStates, extra: Sequence[str] = ()) -> ToolOnMachine:
    """Build `tool` for this machine, ready to be timed."""
    units = (*tool.units, "adapter.c")
    image = _build(tool, host_target(), units, ("-DBENCH_TIMED", *extra))
    return ToolOnMachine(tool, HostMachine(image), states)


def on_target(tool: StepTool, states: StepStates) -> ToolOnMachine:
    """Build `tool` for the PowerPC 750."""
    keep = ("-Wl,-e,bench_load", "-Wl,-u,bench_steps", "-Wl,-u,bench_store")
    image = _build(tool, target_of(tool), (*tool.units, "adapter.c"), keep)
    return ToolOnMachine(tool, Ppc750Machine(image), states)


def worst_difference(found: Mapping[str, Array], reference: Mapping[str, Array]) -> float:
    """Return the largest difference over the columns that both have.

    It is relative to the reference, absolute where that is zero, infinite for what is not finite.
    """
    worst = 0.0
    for name in sorted(found.keys() & reference.keys()):
        a, b = found[name], reference[name]
        if not (np.isfinite(a).all() and np.isfinite(b).all()):
            return float("inf")
        part = np.abs(a - b) / np.where(b != 0.0, np.abs(b), 1.0)
        worst = max(worst, float(part.max()))
    return worst


def check_agreement(
    results: Mapping[str, Mapping[str, Array]], where: str, reference: str = "ours"
) -> dict[str, float]:
    """Return each tool's worst difference from `reference`; raise `CheckError` where one is off."""
    found = {n: worst_difference(r, results[reference]) for n, r in results.items()}
    for name, worst in found.items():
        if not worst <= AGREEMENT:
            raise CheckError(
                f"{where}: {name} disagrees with {reference}: relative difference {worst:.3g}",
                remedy="they are not the same law: nothing was counted",
            )
    return found


def count_step(loaded: ToolOnMachine) -> Count:
    """Count the instructions of one step from each state, and the bytes of the step alone."""
    machine, tool = loaded.machine, loaded.tool
    assert isinstance(machine, Ppc750Machine)
    loaded.load()
    counts, stack = [], 0
    for k in range(loaded.count):
        one_step = partial(machine.call, "bench_steps", k, k + 1)
        spent, bytes_used = machine.measure(tool.entry, one_step)
        counts.append(spent)
        stack = max(stack, bytes_used)
    alone = _build(tool, target_of(tool), tool.units, (*_SECTIONS, f"-Wl,-e,{tool.entry}"))
    sizes = section_bytes(alone)
    text = sum(v for k, v in sizes.items() if k.startswith((".text", ".rodata")))
    middle = statistics.median_low(counts)
    return Count(min(counts), middle, max(counts), text, stack)


def time_tools(loaded: Mapping[Key, ToolOnMachine], passes: int) -> dict[Key, float]:
    """Return the median nanoseconds a step of each; they take turns, pass by pass."""
    seen: dict[Key, list[float]] = {key: [] for key in loaded}
    for _ in range(passes):
        for key, tool in loaded.items():
            seen[key].append(tool.nanoseconds())
    return {key: statistics.median(values) for key, values in seen.items()}


def host_flags() -> tuple[str, ...]:
    """Return the flag that gives every tool the processor's fused multiply-add, if it has one."""
    return ("-mfma",) if processor_has_fma() else ()
