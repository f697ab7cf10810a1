"""`pfaffian simulate` and `pfaffian pil`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.cli import output
from pfaffian.runtime.errors import InputError

if TYPE_CHECKING:
    from pfaffian.runtime.flight import Trajectory
    from pfaffian.runtime.generated_model import GeneratedModel
    from pfaffian.runtime.scenario import Scenario

EMULATORS = ("unicorn", "qemu-user", "qemu-system")
#: Emulators, and the targets that each flies.
BARE_TARGET = "ppc750"


@dataclass(frozen=True)
class Emulated:
    """Where a flight in the loop runs; `budget` is the share of a period that a step may take."""

    emulator: str = "unicorn"
    target: str = BARE_TARGET
    budget: float = 0.1

    def check(self) -> None:
        """Raise `InputError` for what is not there."""
        if self.emulator not in EMULATORS:
            raise InputError(
                f"unknown emulator {self.emulator}", remedy=f"known: {', '.join(EMULATORS)}"
            )
        if self.emulator == "qemu-system" and self.target != BARE_TARGET:
            raise InputError(
                f"--emulator qemu-system has no board with target {self.target}",
                remedy=f"it flies {BARE_TARGET}; other targets: unicorn or qemu-user",
            )
        if not 0.0 < self.budget <= 1.0:
            raise InputError(f"--budget {self.budget:g} is no share of a period", remedy="0 to 1")


def fly_scenario(
    reference: str,
    where: Emulated | None,
    set_name: str | None,
    generated: Path | None,
    as_json: bool,
) -> None:
    """Fly a scenario on the host, or in the loop and compare with the host."""
    from pfaffian.cli.twins import twin_document
    from pfaffian.runtime.scenario import read_scenario
    from pfaffian.runtime.twin.read import is_twin

    if where:
        where.check()
    if is_twin(reference):
        if where and (where.emulator, where.target) != ("unicorn", BARE_TARGET):
            raise InputError(
                f"{reference} flies on the twin, which --emulator {where.emulator} "
                f"--target {where.target} does not drive",
                remedy=f"leave them out: the twin flies {BARE_TARGET} on unicorn",
            )
        mode = where.emulator if where else "host"
        document = twin_document(reference, mode, set_name, generated)
    else:
        scenario = read_scenario(reference, generated, set_name)
        _, document = fly_both(scenario, where) if where else fly_host(scenario)
    output.deliver(
        document,
        as_json,
        lambda: _print_flight(document),
        _fault(document),
    )


def _fault(document: dict[str, Any]) -> str:
    """Return what a flight found wrong, or nothing."""
    name, differing = document["scenario"], document.get("differing_bits", 0)
    if differing:
        return f"{name}: {differing} bits differ between host and target"
    if document.get("overruns", 0):
        return f"{name}: {document['overruns']} periods ended after the next one was due"
    if document.get("step_ticks", 0) > document.get("budget_ticks", 0):
        spent, budget = document["step_ticks"], document["budget_ticks"]
        return f"{name}: the longest step took {spent} ticks, and the budget is {budget}"
    return ""


def fly_host(scenario: Scenario) -> tuple[Trajectory, dict[str, Any]]:
    """Fly on this machine; return the trajectory and its document."""
    from pfaffian.runtime.flight import fly
    from pfaffian.runtime.generated_model import host_model

    host = host_model(scenario.folder)
    with output.progress(f"flying {scenario.name} on the host") as update:
        trajectory = fly(scenario, host, host, "host", update)
    return trajectory, flight_document(trajectory)


def fly_both(
    scenario: Scenario, where: Emulated | None = None
) -> tuple[Trajectory, dict[str, Any]]:
    """Fly on the emulated target and on this machine; return the target's flight.

    Where bits of a flight in single differ, a build that rounds as the emulator does may have the
    target's: they are then counted as the emulator's.
    """
    from pfaffian.runtime.flight import differing_bits, fly
    from pfaffian.runtime.generated_model import host_model, twice_rounding_model

    where = where or Emulated()
    host = host_model(scenario.folder)
    there, costs = _fly_there(scenario, where, host)
    with output.progress(f"flying {scenario.name} on the host") as update:
        here = fly(scenario, host, host, "host", update)
    document = {**flight_document(there), **costs, "host_trajectory_sha256": here.sha256()}
    differing = differing_bits(here, there)
    if scenario.folder.manifest.precision == "single":
        witness = fly(scenario, twice_rounding_model(scenario.folder), host, "host")
        remaining = min(differing, differing_bits(witness, there))
        document["emulator_bits"] = differing - remaining
        differing = remaining
    return there, {**document, "differing_bits": differing}


def _fly_there(
    scenario: Scenario, where: Emulated, host: GeneratedModel
) -> tuple[Trajectory, dict[str, Any]]:
    """Fly on the emulated target; return the flight, and what it cost where that is known.

    With unicorn the plant stays on this machine; the others fly it on the target too.
    """
    from pfaffian.runtime.flight import fly
    from pfaffian.runtime.flight_program import bare_document, fly_bare, fly_qemu_user
    from pfaffian.runtime.generated_model import emulated_model
    from pfaffian.runtime.toolchain import find_target

    text = f"flying {scenario.name} on the emulated {where.target}, {where.emulator}"
    if where.emulator == "unicorn":
        target = find_target(where.target)
        if not target.unicorn:
            raise InputError(
                f"target {where.target} is not emulated by unicorn",
                remedy="try --emulator qemu-user",
            )
        there = emulated_model(scenario.folder, target)
        with output.progress(text) as update:
            return fly(scenario, there, host, "pil-unicorn", update), {}
    with output.progress(text):
        if where.emulator == "qemu-user":
            return fly_qemu_user(scenario, where.target), {}
        flown, report = fly_bare(scenario)
        return flown, bare_document(report, where.budget)


def flight_document(trajectory: Trajectory) -> dict[str, Any]:
    """Return the document of one flight."""
    from pfaffian.runtime.metrics import status_counts, tracking_metrics

    return {
        "scenario": trajectory.scenario.name,
        "set": trajectory.scenario.set_name,
        "mode": trajectory.mode,
        "steps": len(trajectory.time),
        **tracking_metrics(trajectory),
        "status": status_counts(trajectory),
        "trajectory_sha256": trajectory.sha256(),
    }


def _print_flight(document: dict[str, Any]) -> None:
    rows = [
        (k, output.figure(v) if isinstance(v, float) else v)
        for k, v in document.items()
        if k != "scenario"
    ]
    output.table(f"scenario {document['scenario']}", ("figure", "value"), rows)
