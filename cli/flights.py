"""`pfaffian simulate` and `pfaffian pil`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.cli import output
from pfaffian.runtime.errors import InputError

if TYPE_CHECKING:
    from pfaffian.runtime.flight import Trajectory
    from pfaffian.runtime.scenario import Scenario

EMULATORS = ("unicorn",)


def fly_scenario(
    reference: str, mode: str, set_name: str | None, generated: Path | None, as_json: bool
) -> None:
    """Fly a scenario on the host, or on the emulator `mode` and compare with the host."""
    from pfaffian.cli.twins import twin_document
    from pfaffian.runtime.scenario import read_scenario
    from pfaffian.runtime.twin.read import is_twin

    if mode != "host" and mode not in EMULATORS:
        raise InputError(f"unknown emulator {mode}", remedy=f"known: {', '.join(EMULATORS)}")
    if is_twin(reference):
        document = twin_document(reference, mode, set_name, generated)
    else:
        scenario = read_scenario(reference, generated, set_name)
        _, document = fly_host(scenario) if mode == "host" else fly_both(scenario)
    differing, name = document.get("differing_bits", 0), document["scenario"]
    output.deliver(
        document,
        as_json,
        lambda: _print_flight(document),
        f"{name}: {differing} bits differ between host and target" if differing else "",
    )


def fly_host(scenario: Scenario) -> tuple[Trajectory, dict[str, Any]]:
    """Fly on this machine; return the trajectory and its document."""
    from pfaffian.runtime.flight import fly
    from pfaffian.runtime.generated_model import host_model

    host = host_model(scenario.folder)
    with output.progress(f"flying {scenario.name} on the host") as update:
        trajectory = fly(scenario, host, host, "host", update)
    return trajectory, flight_document(trajectory)


def fly_both(scenario: Scenario) -> tuple[Trajectory, dict[str, Any]]:
    """Fly on the emulated target and on this machine; return the target's flight.

    Where bits of a flight in single differ, a build that rounds as the emulator does may have the
    target's: they are then counted as the emulator's.
    """
    from pfaffian.runtime.flight import differing_bits, fly
    from pfaffian.runtime.generated_model import (
        host_model,
        ppc750_model,
        twice_rounding_model,
    )

    host, target = host_model(scenario.folder), ppc750_model(scenario.folder)
    with output.progress(f"flying {scenario.name} on the emulated PowerPC 750GX") as update:
        there = fly(scenario, target, host, "pil-unicorn", update)
    with output.progress(f"flying {scenario.name} on the host") as update:
        here = fly(scenario, host, host, "host", update)
    document = {**flight_document(there), "host_trajectory_sha256": here.sha256()}
    differing = differing_bits(here, there)
    if scenario.folder.manifest.precision == "single":
        witness = fly(scenario, twice_rounding_model(scenario.folder), host, "host")
        remaining = min(differing, differing_bits(witness, there))
        document["emulator_bits"] = differing - remaining
        differing = remaining
    return there, {**document, "differing_bits": differing}


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
