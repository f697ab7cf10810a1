"""Why the sampled figures differ from the continuous ones: the law of section 5.1, step by step."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace

from pfaffian.paper.results.result import ADDED, Claim, Table
from pfaffian.paper.simulations.cases import DERIVED, DESIGNED
from pfaffian.paper.simulations.measures import measures
from pfaffian.paper.simulations.runs import PERIODS
from pfaffian.paper.verdicts.evidence import TESTS, Evidence, Sampled
from pfaffian.paper.verdicts.tables import label, number
from pfaffian.runtime.base.cache import cached, digest
from pfaffian.runtime.base.import_closure import code_of
from pfaffian.runtime.code.generated_model import GeneratedFolder, host_model
from pfaffian.runtime.flight.closed_loop import fly
from pfaffian.runtime.flight.metrics import tracking_metrics
from pfaffian.runtime.flight.scenario import read_scenario

_SCENARIOS = {DERIVED: "section-5.1-paper", DESIGNED: "section-5.1-designed"}
#: The plant's Runge-Kutta step in seconds, whatever the period.
_PLANT_STEP = 1e-4
_KEYS = ("iae_q1", "iae_q2", "mae2_q1", "mae2_q2")


def sampled_flights(folder: GeneratedFolder) -> list[Sampled]:
    """Fly section 5.1 with the sampled law at every one of `PERIODS`, each cached by content."""
    return [
        Sampled(column, period, **figures_of(name, period, folder))
        for column, name in _SCENARIOS.items()
        for period in PERIODS
    ]


def figures_of(name: str, period: float, folder: GeneratedFolder) -> dict[str, dict[str, float]]:
    """Return the figures of one scenario at `period` [s], with and without limits."""
    sources = sorted((folder.path / "c").glob("*.[ch]"))
    scenario = replace(read_scenario(name), folder=folder)
    asked = (name, period, _PLANT_STEP, scenario.initial, scenario.controller, scenario.plant)
    key = digest(
        json.dumps(asked, sort_keys=True).encode(),
        *code_of(__name__),
        *(p.read_bytes() for p in sources),
    )
    content = cached("sampled", key, lambda: json.dumps(_fly(name, period, folder)).encode())
    found: dict[str, dict[str, float]] = json.loads(content)
    return found


def _fly(name: str, period: float, folder: GeneratedFolder) -> dict[str, dict[str, float]]:
    host, base = host_model(folder), read_scenario(name)
    duration = base.steps * base.sample_time
    free = {"torque_limit": 1e4, "slew_limit": 1e9, "singular_threshold": 1e-9}
    found = {}
    for key, more in (("held", {}), ("unlimited", free)):
        scenario = replace(
            base,
            steps=round(duration / period),
            plant_substeps=max(1, round(period / _PLANT_STEP)),
            controller={**base.controller, "sample_time": period, **more},
        )
        figures = tracking_metrics(fly(scenario, host, host, "host"))
        found[key] = {k: figures[k] for k in _KEYS}
    return found


def sampled_table(seen: Evidence) -> Table:
    """Return the continuous law, the same with the weaker p2, and the sampled law, by period."""
    rows = []
    for column in (DERIVED, DESIGNED):
        own = measures(seen.run(column))
        rows.append((label(seen.run(column)), "–", "continuous", *_cells(own), ""))
        for flown in (f for f in seen.sampled if f.column == column):
            weak = measures(seen.other(column, f"softened-{flown.period:g}"))
            period = f"{1e3 * flown.period:g} ms"
            rows += [
                ("", period, "continuous, p₂/(1 + T κ (ADB)²)", *_cells(weak), _share(weak, own)),
                ("", period, "sampled", *_cells(flown.held), _share(flown.held, own)),
                (
                    "",
                    period,
                    "sampled, no limits",
                    *_cells(flown.unlimited),
                    _share(flown.unlimited, own),
                ),
            ]
    columns = ("run", "period", "law", "IAE q₁", "IAE q₂", "MAE2 q₁", "MAE2 q₂", "IAE q₁ more by")
    note = (
        "The sampled law holds its torque for a period T and divides p₂ by 1 + T κ (ADB)², which "
        "an implicit step needs. Flown continuously with that division alone it shows which "
        "share of the difference is the division's; without limits, which is that of the limits "
        "of torque and slew and of the singularity guard."
    )
    title = "Sampled and continuous law"
    return Table(f"sampled-{seen.section}", seen.section, title, columns, tuple(rows), note)


def _cells(m: Mapping[str, float]) -> tuple[str, ...]:
    return tuple(number(m[k], 4) for k in _KEYS)


def _share(m: Mapping[str, float], own: Mapping[str, float]) -> str:
    return f"{number(100 * (m['iae_q1'] / own['iae_q1'] - 1), 3)} %"


def sampled_claim(seen: Evidence) -> Claim:
    """Say where the figures of the sampled law come from, and that they go to the continuous."""
    parts = []
    for column in (DERIVED, DESIGNED):
        own = measures(seen.run(column))["iae_q1"]
        flown = [f for f in seen.sampled if f.column == column]
        first, last = flown[0], flown[-1]
        weak = measures(seen.other(column, f"softened-{first.period:g}"))["iae_q1"]
        held, free = first.held["iae_q1"], first.unlimited["iae_q1"]
        parts.append(
            f"{column}: IAE of q₁ {number(held, 3)} instead of {number(own, 3)} rad s at "
            f"{1e3 * first.period:g} ms, {number(weak - own, 2)} of it from the division, "
            f"{number(held - weak, 1)} from holding, {number(held - free, 1)} from limits; at "
            f"{1e3 * last.period:g} ms {number(last.held['iae_q1'], 3)}"
        )
    return seen.claim(
        "",
        "The simulations are those of the continuous law; the target runs the sampled one.",
        "Nearly all of the difference is the division of p₂ by 1 + T κ (ADB)², that is of the "
        f"gain by which the implicit step stays stable; it goes to 0 with T. {'; '.join(parts)}.",
        ADDED,
        f"sampled-{seen.section}; {TESTS}",
    )
