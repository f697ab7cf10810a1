"""`pfaffian bench step`: one control step by several tools, on the same states, in one run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from pfaffian.cli import output
from pfaffian.runtime.base.errors import CheckError

if TYPE_CHECKING:
    from pfaffian.benchmarks.step import Count, StepStates, StepTool, ToolOnMachine
    from pfaffian.derive.symbolic.block import Block
    from pfaffian.runtime.flight.scenario import Scenario

#: The flight along which states are taken; the steps written by hand are for its model.
_SCENARIO = "rig-balance"


def bench_step(states: int, passes: int, rows: int, as_json: bool) -> None:
    """Compare, count and time the tools; print their table."""
    document = measured_steps(states, passes, rows)
    output.deliver(document, as_json, lambda: _print(document))


def measured_steps(count: int, passes: int, rows: int) -> dict[str, Any]:
    """Return the document of one run over `count` flown and `count` random states."""
    from pfaffian.benchmarks.step import host_flags
    from pfaffian.benchmarks.step_python import python_steps
    from pfaffian.derive.ir.evaluate import evaluate
    from pfaffian.derive.pipeline import derivation_of, lowered_model
    from pfaffian.derive.spec.library import find_model
    from pfaffian.runtime.flight.scenario import read_scenario
    from pfaffian.runtime.machine.toolchain import host_target, ppc750_libm_target, ppc750_target

    scenario = read_scenario(_SCENARIO)
    source = find_model(scenario.folder.manifest.model)
    block = derivation_of(source).block("step")
    parameters = dict(scenario.controller)
    prepared = evaluate(lowered_model(source).program("prepare"), parameters)
    states = _states(scenario, block, {**parameters, **prepared}, count)
    tools, missing = _tools(block, scenario)
    host, agreement = _time_on_host(tools, states, passes, missing)
    counted = _count_on_target({n: t for n, t in tools.items() if t.on_target}, states)
    instructions = {n: c.median for n, c in counted.items()}
    return {
        "model": source.name,
        "scenario": scenario.name,
        "states": {"flown": count, "random": count},
        "ppc750": instructions,
        "ppc750_detail": {n: asdict(c) for n, c in counted.items()},
        "ratio_to_casadi": instructions["ours"] / instructions["casadi"],
        **host,
        "host_ratios": {n: host["host_ns"]["ours"] / t for n, t in host["host_ns"].items()},
        "python_ns": python_steps(block, scenario.folder, states, parameters, rows),
        "largest_difference": agreement,
        "compilers": {
            "host": " ".join((host_target().description, *host_flags())),
            "host_plain": host_target().description,
            "ppc750": ppc750_target().description,
            "ppc750_libm": ppc750_libm_target().description,
        },
        "missing": missing,
    }


def _states(
    scenario: Scenario, block: Block, constants: Mapping[str, float], count: int
) -> StepStates:
    from pfaffian.benchmarks.step import StepStates, flown_states, random_states
    from pfaffian.benchmarks.step_peers import constant_names, given_names

    names = given_names(block)
    flown = flown_states(scenario, names, count)
    rows = np.vstack([flown, random_states(scenario, names, flown, count)])
    return StepStates(names, rows, np.array([constants[n] for n in constant_names(block)]))


def _tools(block: Block, scenario: Scenario) -> tuple[dict[str, StepTool], list[str]]:
    """Return the tools of every run and those found here, and the names of those that are not."""
    from pfaffian.benchmarks.step_optional_peers import OPTIONAL_PEERS
    from pfaffian.benchmarks.step_peers import PEERS

    tools: dict[str, StepTool] = {}
    missing: list[str] = []
    for name, make in PEERS.items():
        output.note(f"generating: {name}")
        tools[name] = make(block, scenario.folder, scenario.controller)
    for name, make_optional in OPTIONAL_PEERS.items():
        try:
            tools[name] = make_optional(block)
            output.note(f"generating: {name}")
        except ImportError:
            missing.append(name)
    return tools, missing


def _time_on_host(
    tools: Mapping[str, StepTool], states: StepStates, passes: int, missing: list[str]
) -> tuple[dict[str, Any], dict[str, float]]:
    """Build, compare and time every tool; one that is optional and does not build is missing.

    `host_ns` is with the processor's fused multiply-add where it has one, `host_plain_ns` without.
    """
    from pfaffian.benchmarks.step import check_agreement, host_flags, on_host, time_tools

    forms = {"host_ns": host_flags(), **({"host_plain_ns": ()} if host_flags() else {})}
    loaded: dict[tuple[str, str], ToolOnMachine] = {}
    largest: dict[str, float] = {}
    for form, flags in forms.items():
        output.note(" ".join(("building for the host", *flags)))
        here = {}
        for name, tool in tools.items():
            try:
                here[name] = on_host(tool, states, flags)
            except CheckError:
                if tool.on_target:
                    raise
                if name not in missing:
                    output.note(f"{name} does not build here")
                    missing.append(name)
        found = check_agreement({n: t.results() for n, t in here.items()}, f"host ({form})")
        largest = {n: max(d, largest.get(n, 0.0)) for n, d in found.items()}
        loaded |= {(form, name): tool for name, tool in here.items()}
    output.note("timing on the host")
    figures: dict[str, Any] = {form: {} for form in forms}
    for (form, name), nanoseconds in time_tools(loaded, passes).items():
        figures[form][name] = nanoseconds
    return {"host_plain_ns": figures["host_ns"], **figures}, largest


def _count_on_target(tools: Mapping[str, StepTool], states: StepStates) -> dict[str, Count]:
    from pfaffian.benchmarks.step import check_agreement, count_step, on_target

    output.note("building for the PowerPC 750; the first time, the C library takes a minute")
    loaded = {n: on_target(t, states) for n, t in tools.items()}
    check_agreement({n: t.results() for n, t in loaded.items()}, "ppc750")
    counted = {}
    for name, tool in loaded.items():
        output.note(f"counting: {name}")
        counted[name] = count_step(tool)
    return counted


def _print(document: Mapping[str, Any]) -> None:
    detail, host, plain = (document[k] for k in ("ppc750_detail", "host_ns", "host_plain_ns"))
    rows = []
    for name in host:
        count = detail.get(name)
        cells = [count[k] for k in _COLUMNS] if count else ["-"] * len(_COLUMNS)
        ratio = document["host_ratios"][name]
        rows.append([name, *cells, f"{host[name]:.1f}", f"{ratio:.2f}", f"{plain[name]:.1f}"])
    output.table(
        "one control step: instructions on the PowerPC 750, nanoseconds on the host",
        ("tool", "best", "median", "worst", "text [B]", "stack [B]", "host [ns]", "ours/it",
         "plain [ns]"),
        rows,
    )  # fmt: skip
    output.table(
        "one control step in Python",
        ("call", "ns a step"),
        [[n, "-" if v is None else f"{v:.1f}"] for n, v in document["python_ns"].items()],
    )
    ratio, host_ratio = document["ratio_to_casadi"], document["host_ratios"]["casadi"]
    output.say(
        f"ours / casadi: {ratio:.3f} in instructions on the PowerPC 750, {host_ratio:.3f} in time "
        "on the host"
    )
    python = document["python_ns"]
    quotients = {
        n: python[n] / python["numpy_vectorised"] for n in ("lambdify_loop", "lambdify_math_loop")
    }
    output.say(
        "numpy_vectorised is faster than "
        + " and ".join(f"{n} {q:.0f} times" for n, q in quotients.items())
    )
    if document["missing"]:
        output.say(f"not installed, left out: {', '.join(document['missing'])}")


_COLUMNS = ("best", "median", "worst", "text_bytes", "stack_bytes")
