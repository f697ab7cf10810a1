"""`pfaffian run`: the main job, from the specification to the report."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from pfaffian.cli import output
from pfaffian.runtime.errors import InputError


def run_main_job(reference: str, folder: Path, samples: int, as_json: bool) -> None:
    """Derive, generate, verify, build, fly and report; leave one page in `folder`."""
    from pfaffian.cli.check import verification
    from pfaffian.cli.flights import fly_both
    from pfaffian.cli.twins import whole_flight
    from pfaffian.derive.library import find_model
    from pfaffian.runtime.files import write_whole
    from pfaffian.runtime.firmware import build_controller
    from pfaffian.runtime.generated_model import open_generated
    from pfaffian.runtime.report import ReportData, WholeFlight, render_report
    from pfaffian.runtime.reproduce.animation import animated_flight
    from pfaffian.runtime.scenario import read_scenario, report_scenarios, report_twin

    scenarios = report_scenarios(find_model(reference).name)
    page = _page_path(folder, reference)
    generated = _regenerate(reference)
    checked = verification(reference, samples, None, generated)
    code = open_generated(str(generated))
    output.note("building the controller for the PowerPC 750")
    _, built = build_controller(code, "ppc750")
    flights = [fly_both(read_scenario(name, generated)) for name in scenarios]
    flights.sort(key=lambda flight: flight[0].scenario.set_name)
    flights_found = [d for _, d in flights]
    twin, whole = report_twin(code.manifest.model), None
    if twin is not None:
        flown, found = whole_flight(twin, generated)
        flights_found.append(found)
        whole = WholeFlight(animated_flight(flown), found)
    data = ReportData(
        folder=code,
        flights=tuple(t for t, _ in flights),
        verification=checked,
        build=built,
        agreement={d["scenario"]: d["differing_bits"] for _, d in flights},
        whole=whole,
    )
    write_whole(page, render_report(data).encode())
    document = {
        "model": code.manifest.model,
        "generated": str(generated),
        "verification": checked,
        "build": built,
        "flights": flights_found,
        "report": str(page),
    }
    output.deliver(document, as_json, lambda: _print_summary(document), _failure(document))


def _page_path(folder: Path, reference: str) -> Path:
    """Return the report's path, having made sure that it can be written before the long work."""
    page = folder / f"{Path(reference).name}.html"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"{page}: cannot be written ({error.strerror})", remedy="choose another folder with -o"
        ) from error
    return page


def _regenerate(reference: str) -> Path:
    from pfaffian.derive.emit.emitter import Emission
    from pfaffian.derive.generation import generate
    from pfaffian.derive.library import find_model
    from pfaffian.derive.pipeline import (
        library_controls,
        library_sets,
        lowered_model,
        plan_tables,
    )
    from pfaffian.derive.writer import write_generation

    source = find_model(reference)
    output.note(f"deriving {source.name} and generating its code")
    model = lowered_model(source)
    target = Path("generated") / source.name
    sets = library_sets(model, source)
    plans = plan_tables(model, source, sets, None)
    controls = library_controls(model, source, sets, plans)
    emission = Emission(model, sets, plans=plans, controls=controls)
    write_generation(generate(emission), target)
    return target


def _print_summary(document: dict[str, Any]) -> None:
    checked, built = document["verification"], document["build"]
    rows: list[tuple[str, object]] = [
        ("derived and generated", document["generated"]),
        (
            "verified",
            f"{checked['samples']} samples, worst {checked['worst_scaled_ulp']:.3g} scaled ulp",
        ),
        (
            "host and target",
            f"{checked['target_mismatches']} of {checked['target_samples']} samples differ",
        ),
        (
            "code on the PowerPC 750",
            f"{built['text_bytes']} B text, {built['stack_bytes']} B stack, "
            f"{built['instructions_per_step']} instructions a step",
        ),
    ]
    for flight in document["flights"]:
        coordinates = [k.removeprefix("iae_") for k in flight if k.startswith("iae_")]
        figures = "; ".join(
            f"{q}: IAE {flight[f'iae_{q}']:.4g}, MAE2 {flight[f'mae2_{q}']:.3g}"
            for q in coordinates
        )
        rows.append(
            (
                f"{flight['scenario']}, in the loop",
                f"{figures}; {flight['differing_bits']} bits differ from the host",
            )
        )
    rows.append(("report", document["report"]))
    output.table(f"{document['model']}: the main job", ("step", "result"), rows)


def _failure(document: dict[str, Any]) -> str:
    """Return what the main job found wrong, or nothing."""
    differing = sum(f["differing_bits"] for f in document["flights"])
    caught = all(f.get("captured", True) for f in document["flights"])
    good = document["verification"]["passed"] and caught and not differing
    return "" if good else "the main job found an error: see the table and the report"
