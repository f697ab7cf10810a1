"""`pfaffian run`: the main job, from the specification to the report."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from pfaffian.cli import output


def run_main_job(
    reference: str, folder: Path, samples: int, generated: Path | None, as_json: bool
) -> None:
    """Derive, generate, verify, build, fly and report; leave the code, and one page in `folder`.

    With `generated` the code in that folder is the one that is verified and flown. All files
    appear at the end, and none where the job is broken off.
    """
    from pfaffian.api.main_job import Job, check_tools, job_document, job_failure
    from pfaffian.derive.generate_model import Sets, generate_model
    from pfaffian.derive.spec.library import find_model
    from pfaffian.derive.writer import check_target, write_generation
    from pfaffian.runtime.base.files import (
        check_output,
        check_output_folder,
        committing,
        write_outputs,
    )
    from pfaffian.runtime.flight.scenario_files import report_scenarios, report_twin
    from pfaffian.runtime.report.page import render_report

    source = find_model(reference)
    page, target = folder / f"{source.name}.html", generated or Path("generated") / source.name
    check_output_folder(folder, "-o")
    if folder.is_dir():
        check_output(page, "-o")
    if not generated:
        check_target(target)
    own = source.scenarios()
    job = Job(reference, report_scenarios(source.name, own), report_twin(source.name, own), samples)
    check_tools()
    with tempfile.TemporaryDirectory(prefix="pfaffian-") as scratch:
        place, generation = target, None
        if not generated:
            output.note(f"deriving {source.name} and generating its code")
            place = Path(scratch) / target
            generation = generate_model(source, Sets(whole=True)).generation
            write_generation(generation, place)
        data, flights = job.done(place, output)
        html = render_report(data).encode()
    with committing():
        if generation:
            write_generation(generation, target)
        write_outputs({page: html})
    document = job_document(data, flights, target) | {"report": str(page)}
    output.deliver(document, as_json, lambda: _print_summary(document), job_failure(document))


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
