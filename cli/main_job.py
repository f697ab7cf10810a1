"""`pfaffian run`: the main job, from the specification to the report."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.cli import output

if TYPE_CHECKING:
    from pfaffian.runtime.report import ReportData

#: The model whose complete flight is drawn in the report.
_FILMED = "pendubot"


def run_main_job(
    reference: str, folder: Path, samples: int, generated: Path | None, as_json: bool
) -> None:
    """Derive, generate, verify, build, fly and report; leave the code, and one page in `folder`.

    With `generated` the code in that folder is the one that is verified and flown. All files
    appear at the end, and none where the job is broken off.
    """
    from pfaffian.derive.generate_model import Sets, generate_model
    from pfaffian.derive.library import find_model
    from pfaffian.derive.writer import check_target, write_generation
    from pfaffian.runtime.files import check_output, check_output_folder, committing, write_outputs
    from pfaffian.runtime.report import render_report
    from pfaffian.runtime.scenario_files import report_scenarios, report_twin

    source = find_model(reference)
    page, target = folder / f"{source.name}.html", generated or Path("generated") / source.name
    check_output_folder(folder, "-o")
    if folder.is_dir():
        check_output(page, "-o")
    if not generated:
        check_target(target)
    own = source.scenarios()
    job = _Job(
        reference, report_scenarios(source.name, own), report_twin(source.name, own), samples
    )
    _check_tools()
    with tempfile.TemporaryDirectory(prefix="pfaffian-") as scratch:
        place, generation = target, None
        if not generated:
            output.note(f"deriving {source.name} and generating its code")
            place = Path(scratch) / target
            generation = generate_model(source, Sets(whole=True)).generation
            write_generation(generation, place)
        data, flights = job.done(place)
        html = render_report(data).encode()
    with committing():
        if generation:
            write_generation(generation, target)
        write_outputs({page: html})
    document = {
        "model": data.folder.manifest.model,
        "generated": str(target),
        "verification": data.verification,
        "build": data.build,
        "flights": flights,
        "report": str(page),
    }
    output.deliver(document, as_json, lambda: _print_summary(document), _failure(document))


@dataclass(frozen=True)
class _Job:
    """What is verified and flown of a model."""

    reference: str
    scenarios: list[str]
    twin: str | None
    samples: int

    def done(self, generated: Path) -> tuple[ReportData, list[dict[str, Any]]]:
        """Verify, build and fly the code in `generated`; return the report's data and flights."""
        from pfaffian.cli.check import verification
        from pfaffian.cli.flights import fly_both
        from pfaffian.cli.twins import whole_flight
        from pfaffian.runtime.firmware import build_controller
        from pfaffian.runtime.generated_model import open_generated
        from pfaffian.runtime.report import ReportData, WholeFlight
        from pfaffian.runtime.reproduce.animation import animated_flight
        from pfaffian.runtime.scenario import read_scenario

        code = open_generated(str(generated))
        scenarios = [read_scenario(name, generated) for name in self.scenarios]
        checked = verification(self.reference, self.samples, None, generated)
        output.note("building the controller for the PowerPC 750")
        _, built = build_controller(code, "ppc750")
        flown = [fly_both(scenario) for scenario in scenarios]
        flown.sort(key=lambda flight: flight[0].scenario.set_name)
        found, whole = [document for _, document in flown], None
        if self.twin is not None:
            twin, document = whole_flight(self.twin, generated)
            film = animated_flight(twin) if code.manifest.model == _FILMED else b""
            found, whole = [*found, document], WholeFlight(film, document)
        return ReportData(
            folder=code,
            flights=tuple(trajectory for trajectory, _ in flown),
            verification=checked,
            build=built,
            agreement={d["scenario"]: d["differing_bits"] for _, d in flown},
            whole=whole,
        ), found


def _check_tools() -> None:
    """Raise `MissingToolError` for a compiler or emulator that the job would miss at its end."""
    from pfaffian.runtime.machine import emulator
    from pfaffian.runtime.toolchain import host_target, ppc750_target

    host_target()
    ppc750_target()
    emulator()


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
