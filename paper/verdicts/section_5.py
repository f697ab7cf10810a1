"""Sections 5.1 to 5.3: flies the runs, settles them, and judges what the paper says of them."""

from __future__ import annotations

from collections.abc import Mapping

from pfaffian.derive.pipeline import derivation_of
from pfaffian.derive.spec.library import find_model
from pfaffian.paper.results.result import Claim, Request, SectionResult, Table
from pfaffian.paper.simulations.baseline import lqr_gain
from pfaffian.paper.simulations.cases import DERIVED, DESIGNED
from pfaffian.paper.simulations.fly import Run, Task
from pfaffian.paper.simulations.mujoco import Agreement, agreement
from pfaffian.paper.simulations.pool import MODEL, fly_all
from pfaffian.paper.simulations.runs import (
    USED,
    choice_tasks,
    convergence_checks,
    figure_tasks,
    softened_tasks,
    variant_tasks,
)
from pfaffian.paper.verdicts import tables, theorem
from pfaffian.paper.verdicts.choices import choices_claim, choices_table
from pfaffian.paper.verdicts.claims import CLAIMS
from pfaffian.paper.verdicts.evidence import Evidence
from pfaffian.paper.verdicts.figures import FIGURES
from pfaffian.paper.verdicts.sampled import sampled_claim, sampled_flights, sampled_table
from pfaffian.runtime.base.errors import CheckError, MissingToolError
from pfaffian.runtime.code.generated_model import GeneratedFolder, host_model, open_generated

_IN_ENGINE = ("section-5.1-paper", "section-5.1-designed")


def make(name: str, request: Request) -> SectionResult:
    """Return the section called `name`; without its studies only the figures wanted."""
    section = name.removeprefix("section-")
    folder = open_generated(MODEL)
    feedback = lqr_gain(host_model(folder))
    main = figure_tasks(folder, section, feedback)
    if not request.studies:
        runs = _flown(main, folder, request, section)
        return SectionResult(tuple(FIGURES[n].drawn(runs) for n in request.figures))
    return _studied(section, main, folder, request)


def _flown(
    tasks: Mapping[str, Task], folder: GeneratedFolder, request: Request, section: str
) -> dict[str, Run]:
    label = f"section {section}: flights"
    return fly_all(tasks, folder, lambda done, total: request.update(label, done, total))


def _studied(
    section: str, main: Mapping[str, Task], folder: GeneratedFolder, request: Request
) -> SectionResult:
    variants = variant_tasks(folder, section)
    others = {**choice_tasks(folder, section), **softened_tasks(folder, section)}
    compared_with = convergence_checks(main, {**variants, **others})
    checks = {f"{c.reference} {k}": c for k, c in enumerate(compared_with)}
    every = {**main, **variants, **others, **{n: c.task for n, c in checks.items()}}
    flown = _flown(every, folder, request, section)
    runs = {n: flown[n] for n in main}
    compared = [tables.compare(c, flown[n], flown[c.reference]) for n, c in checks.items()]
    request.update(f"section {section}: Theorem 1", 0, 1)
    judged, refused = _judged(section, runs)
    request.update(f"section {section}: Theorem 1", 1, 1)
    flights, skipped = _in_engine(section, folder, request)
    request.update(f"section {section}: sampled law", 0, 1)
    seen = Evidence(
        section,
        runs,
        {n: flown[n] for n in variants},
        compared,
        judged,
        flights,
        {n: flown[n] for n in others},
        sampled_flights(folder) if section == "5.1" else (),
    )
    request.update(f"section {section}: sampled law", 1, 1)
    figures = [FIGURES[n].drawn(runs) for n in request.figures]
    if judged:
        figures.append(theorem.figure(section, judged))
    return SectionResult(
        tuple(figures),
        _tables(section, seen),
        _claims(section, seen),
        (*tables.unsettled(compared), *refused, *_broken(judged)),
        skipped,
    )


def _judged(section: str, runs: Mapping[str, Run]) -> tuple[list[theorem.Judged], list[str]]:
    """Return the runs with their certificates, and why others have none."""
    derivation, host = derivation_of(find_model(MODEL)), host_model(open_generated(MODEL))
    judged, refused = [], []
    for column in (DERIVED, DESIGNED):
        run = runs[f"{section}-{column}-{USED[section]}"]
        try:
            judged.append(theorem.judge(run, derivation, host))
        except CheckError as error:
            refused.append(f"{run.case.name}: no certificate: {error.message}")
    return judged, refused


def _broken(judged: list[theorem.Judged]) -> list[str]:
    return [
        f"{j.run.case.name}: {j.certificate.failure()}" for j in judged if j.certificate.failure()
    ]


def _in_engine(
    section: str, folder: GeneratedFolder, request: Request
) -> tuple[list[Agreement], tuple[str, ...]]:
    if section != "5.1":
        return [], ()
    flights, host = [], host_model(folder)
    for k, name in enumerate(_IN_ENGINE):
        request.update("section 5.1: MuJoCo", k, len(_IN_ENGINE))
        try:
            flights.append(agreement(name, host))
        except MissingToolError as error:
            return [], (f"section 5.1 in MuJoCo: {error.message}; {error.remedy}",)
    request.update("section 5.1: MuJoCo", len(_IN_ENGINE), len(_IN_ENGINE))
    return flights, ()


def _claims(section: str, seen: Evidence) -> tuple[Claim, ...]:
    """Return the claims of the paper, then what is said of our own choices."""
    own = [choices_claim(seen), *([sampled_claim(seen)] if seen.sampled else [])]
    return (*CLAIMS[section](seen), *own)


def _tables(section: str, seen: Evidence) -> tuple[Table, ...]:
    made = [
        tables.measure_table(section, seen.runs, f"measures-{section}", "The runs in numbers"),
        tables.convergence_table(section, seen.compared),
        tables.measure_table(
            section, seen.variants, f"variants-{section}", "Other starts, signs and gains"
        ),
    ]
    made.append(choices_table(seen))
    if seen.sampled:
        made.append(sampled_table(seen))
    if seen.judged:
        made.append(tables.theorem_table(section, seen.judged))
    if seen.flights:
        made.append(tables.engine_table(section, seen.flights))
    return tuple(made)
