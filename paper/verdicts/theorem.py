"""Theorem 1 beside the runs of sections 5.1 to 5.3, by the certificate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pfaffian.derive.certificate.certify import Certificate, certify
from pfaffian.derive.derivation.derive import Derivation
from pfaffian.paper.results.drawing import Line, Row, histories, histories_csv
from pfaffian.paper.results.result import Drawn
from pfaffian.paper.simulations.fly import Run
from pfaffian.paper.verdicts.figures import NAMES
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.code.generated_model import GeneratedModel
from pfaffian.runtime.flight.continuous import ContinuousFlight, ContinuousLoop, record
from pfaffian.runtime.flight.scenario import read_scenario

_BASE = "section-5.1-paper"
_CHANNELS = ("q1", "q2", "dq1", "dq2")
#: Samples that the bounds are judged at.
_MOST_SAMPLES = 10_001


@dataclass(frozen=True)
class Judged:
    """A run, and the certificate around it."""

    run: Run
    certificate: Certificate

    def claim(self, form: str) -> Any:
        """Return the certificate's claim of `form`, or nothing."""
        return next((c for c in self.certificate.claims if c.form == form), None)


def judge(run: Run, derivation: Derivation, host: GeneratedModel) -> Judged:
    """Certify over the region that `run` passed through.

    Raises `CheckError` where an assumption of the theorem fails there.
    """
    return Judged(run, certify(derivation, flight_of(run, host)))


def flight_of(run: Run, host: GeneratedModel) -> ContinuousFlight:
    """Return `run` with everything the certificate asks for."""
    case = run.case
    base = read_scenario(_BASE)
    scenario = replace(
        base,
        name=case.name,
        set_name=case.column,
        initial=dict(zip(_CHANNELS, case.start, strict=True)),
        controller=dict(case.controller),
        plant=dict(case.plant),
    )
    every = max(1, (len(run.time) - 1) // (_MOST_SAMPLES - 1))
    return record(ContinuousLoop(scenario, host), run.time[::every], run.state[::every], run.ended)


def figure(section: str, judged: list[Judged]) -> Drawn:
    """Draw |beta| of the runs of one section below its bounds."""
    titles = [NAMES[j.run.case.column] for j in judged]
    panels = []
    for j in judged:
        time, beta = j.run.time, np.abs(j.run.signals["beta"])
        lines = [Line("|β|", 0, time, beta), _level("bound by p₂", 1, j.claim("p2").bound, time)]
        if scaled := j.claim("scaled"):
            lines.append(_level("Theorem 1, scaled", 2, scaled.bound, time))
        panels.append(tuple(lines))
    rows = [Row("|β| [rad/s]", tuple(panels), log=True)]
    image = histories(titles, rows)
    csv = histories_csv([j.run.case.column for j in judged], rows, ["beta_size"])
    return Drawn(
        f"theorem-{section}",
        0,
        section,
        "|β| and what bounds it",
        " The bounds hold for all time while the state stays in the region of the run.",
        image,
        csv,
    )


def _level(label: str, style: int, value: float, time: Array) -> Line:
    ends = time[[0, -1]]
    return Line(label, style, ends, np.full(2, value))
