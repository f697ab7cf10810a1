"""The main job: generated code verified, built for PowerPC, flown in the loop, and reported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.api.checking import Verification, verification, verified
from pfaffian.api.display import SILENT, Teller
from pfaffian.api.flights import fly_both, whole_flight

if TYPE_CHECKING:
    from pfaffian.runtime.report.page import ReportData

#: The model whose complete flight is drawn in the report.
_FILMED = "pendubot"


@dataclass(frozen=True, kw_only=True)
class Report:
    """What a run found out; shows itself as its page in a notebook.

    `flights` are the documents of the flights in the loop, `build` what `pfaffian build` prints;
    `failure` says what was found wrong, and is empty where all is well. `html` is one page that
    loads nothing.
    """

    model: str
    passed: bool
    failure: str
    verification: Verification
    build: Mapping[str, Any] = field(repr=False)
    flights: Sequence[Mapping[str, Any]] = field(repr=False)
    html: str = field(repr=False)

    def save(self, path: str | Path) -> Path:
        """Write the page; return its path."""
        from pfaffian.runtime.base.files import write_outputs

        write_outputs({Path(path): self.html.encode()})
        return Path(path)

    def _repr_html_(self) -> str:
        style = "width:100%;height:40em;border:0"
        return f'<iframe srcdoc="{escape(self.html)}" style="{style}"></iframe>'


@dataclass(frozen=True)
class Job:
    """What is verified and flown of a model; with `set_name` another set than the scenarios'."""

    reference: str
    scenarios: list[str]
    twin: str | None
    samples: int
    set_name: str | None = None

    def done(
        self, generated: Path, tell: Teller = SILENT
    ) -> tuple[ReportData, list[dict[str, Any]]]:
        """Verify, build and fly the code in `generated`; return the report's data and flights."""
        from pfaffian.runtime.code.firmware import build_controller
        from pfaffian.runtime.code.generated_model import open_generated
        from pfaffian.runtime.flight.scenario import read_scenario
        from pfaffian.runtime.report.animation import animated_flight
        from pfaffian.runtime.report.page import ReportData, WholeFlight

        code = open_generated(str(generated))
        scenarios = [read_scenario(name, generated, self.set_name) for name in self.scenarios]
        checked = verification(self.reference, self.samples, None, generated, tell=tell)
        tell.note("building the controller for the PowerPC 750")
        _, built = build_controller(code, "ppc750")
        flown = [fly_both(scenario, tell=tell) for scenario in scenarios]
        flown.sort(key=lambda flight: flight[0].scenario.set_name)
        found, whole = [document for _, document in flown], None
        if self.twin is not None:
            twin, document = whole_flight(self.twin, generated, tell)
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


def check_tools() -> None:
    """Raise `MissingToolError` for a compiler or emulator that the job would miss at its end."""
    from pfaffian.runtime.machine.emulator import emulator
    from pfaffian.runtime.machine.toolchain import host_target, ppc750_target

    host_target()
    ppc750_target()
    emulator()


def job_document(
    data: ReportData, flights: list[dict[str, Any]], generated: Path
) -> dict[str, Any]:
    """Return what a job found, as `pfaffian run --json` prints it."""
    return {
        "model": data.folder.manifest.model,
        "generated": str(generated),
        "verification": data.verification,
        "build": data.build,
        "flights": flights,
    }


def job_failure(document: dict[str, Any]) -> str:
    """Return what the main job found wrong, or nothing."""
    differing = sum(f["differing_bits"] for f in document["flights"])
    caught = all(f.get("captured", True) for f in document["flights"])
    good = document["verification"]["passed"] and caught and not differing
    return "" if good else "the main job found an error: see the table and the report"


def report_of(job: Job, generated: Path) -> Report:
    """Do `job` on the code in `generated` and return its report."""
    from pfaffian.runtime.report.page import render_report

    data, flights = job.done(generated)
    failure = job_failure(job_document(data, flights, generated))
    model = data.folder.manifest.model
    return Report(
        model=model,
        passed=not failure,
        failure=failure,
        verification=verified(model, data.verification),
        build=data.build,
        flights=tuple(flights),
        html=render_report(data),
    )
