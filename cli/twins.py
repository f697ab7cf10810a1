"""`pfaffian simulate` and `pfaffian pil` of a scenario on the twin."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.cli import output

if TYPE_CHECKING:
    from pfaffian.runtime.generated_model import GeneratedModel
    from pfaffian.runtime.twin.recording import Flight, Wanted
    from pfaffian.runtime.twin.settings import TwinScenario


def twin_document(
    reference: str, mode: str, set_name: str | None, generated: Path | None
) -> dict[str, Any]:
    """Fly a scenario with a [twin] table; on an emulator also on the host, and compare."""
    from pfaffian.runtime.twin.read import read_twin
    from pfaffian.runtime.twin.recording import Wanted
    from pfaffian.runtime.twin.rig import plant_model

    scenario = read_twin(reference, generated, set_name)
    model = plant_model(scenario.base.folder)
    if mode == "host":
        return _document(_fly(scenario, model, "host", Wanted(rigs=())), "host")
    return _compared(scenario, model, mode, Wanted(rigs=range(scenario.rigs)))[1]


def whole_flight(reference: str, generated: Path) -> tuple[Flight, dict[str, Any]]:
    """Fly a scenario of one rig on the emulated 750 and on the host; return the latter with both
    flights' document."""
    from pfaffian.runtime.twin.read import read_twin
    from pfaffian.runtime.twin.recording import Wanted
    from pfaffian.runtime.twin.rig import plant_model

    scenario = read_twin(reference, generated)
    return _compared(scenario, plant_model(scenario.base.folder), "unicorn", Wanted())


def _compared(
    scenario: TwinScenario, model: GeneratedModel, mode: str, wanted: Wanted
) -> tuple[Flight, dict[str, Any]]:
    from pfaffian.runtime.twin.recording import differing_bits

    there = _fly(scenario, model, "ppc750", wanted)
    here = _fly(scenario, model, "host", wanted)
    return here, {
        **_document(there, f"pil-{mode}"),
        "host_trajectory_sha256": here.sha256(),
        "differing_bits": differing_bits(here, there),
    }


def _fly(scenario: TwinScenario, model: GeneratedModel, machine: str, wanted: Wanted) -> Flight:
    from pfaffian.runtime.twin.controllers import CONTROLLERS
    from pfaffian.runtime.twin.flight import fly_twin

    place = "the host" if machine == "host" else "the emulated PowerPC 750GX"
    unit = CONTROLLERS[scenario.controller](scenario, model, machine)
    with output.progress(f"flying {scenario.base.name} on the twin, {place}") as update:
        return fly_twin(scenario, unit, wanted, model=model, threads=2, progress=update)


def _document(flight: Flight, mode: str) -> dict[str, Any]:
    """Return the document of a flight: the worst of all rigs where there are several."""
    from pfaffian.runtime.twin.statistics import summary

    of, found = flight.scenario, flight.statistics
    captured = int(found.captured.sum())
    return {
        "scenario": of.base.name,
        "set": of.base.set_name,
        "mode": mode,
        "controller": of.controller,
        "rigs": of.rigs,
        "steps": int(found.periods.max()),
        **summary(found, of.coordinates),
        "captured": captured == of.rigs,
        "captured_rigs": captured,
        "time_to_capture": float(found.capture_time.max()) if captured == of.rigs else None,
        "saturated_share": float(found.saturated.max()),
        "limit_violations": int(found.violations.sum()),
        "fault_periods": int(found.fault_periods.sum()),
        "lost_rigs": int(found.lost.sum()),
        "trajectory_sha256": flight.sha256(),
    }
