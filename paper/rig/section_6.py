"""Section 6: the experiment, flown on the twin with the complete generated controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from pfaffian.paper.results.drawing import Image
from pfaffian.paper.results.result import (
    FAILS,
    HOLDS,
    PARTLY,
    Claim,
    Drawn,
    Request,
    SectionResult,
    Table,
)
from pfaffian.paper.rig import failures as rig_failures
from pfaffian.paper.rig import figures as rig_figures
from pfaffian.paper.rig import tables as rig_tables
from pfaffian.paper.rig.flights import (
    GRID,
    LAWS,
    RIGS,
    Measures,
    case_of,
    fly_each,
    fly_recorded,
    measured,
    scenarios_of,
    swing_of,
    with_control,
)
from pfaffian.paper.simulations.baseline import lqr_gain, slowest_rate
from pfaffian.runtime.code.generated_model import host_model, open_generated
from pfaffian.runtime.report.animation import animated_flight, shown_csv
from pfaffian.runtime.twin.files.campaign import fly_campaign, read_campaign
from pfaffian.runtime.twin.files.read import read_twin
from pfaffian.runtime.twin.flight import Twin
from pfaffian.runtime.twin.recording import Flight, Wanted, differing_bits
from pfaffian.runtime.twin.statistics import Statistics
from pfaffian.runtime.twin.units.registry import CONTROLLERS

PROPOSED, NOMINAL, LQR = "proposed", "p1 alone", "LQR"
_SCENARIO, _NONE = "rig-swing-up", "none"
#: Weights (R, of the rates in Q) of the regulators beside the paper's (1, 1), and their cases.
REGULATORS = ((0.01, 1.0), (0.1, 1.0), (10.0, 1.0), (1.0, 0.01), (0.1, 0.01))
REGULATOR_CASES = (_NONE, "friction", "constant 0.05 N m", "sine 0.1 N m, 1 Hz", "delay 5 ms")


@dataclass(frozen=True)
class Sizes:
    """How much is flown: rigs of the campaign (None: all), whether the grid is, and jobs."""

    rigs: int | None = None
    grid: bool = True
    jobs: int = 2


def make(name: str, request: Request, sizes: Sizes | None = None) -> SectionResult:
    """Return section 6; without its studies only the figures wanted."""
    campaign, chosen = read_campaign(LAWS), sizes or Sizes()
    flights: dict[str, Flight] = {}
    for k, law in enumerate((PROPOSED, LQR)):
        flights[law] = fly_recorded(campaign.scenario(case_of(campaign, law=law, case=_NONE)))
        request.update("section 6: flights of the figures", k + 1, 2)
    figures = tuple(_figure(number, flights) for number in request.figures)
    return _studied(figures, request, chosen) if request.studies else SectionResult(figures)


def _figure(number: int, flights: Mapping[str, Flight]) -> Drawn:
    if number in (19, 20):
        return rig_figures.measure_bars(number, {n: measured(f) for n, f in flights.items()})
    return {17: rig_figures.outputs, 18: rig_figures.torque}[number](flights)


def _studied(figures: tuple[Drawn, ...], request: Request, sizes: Sizes) -> SectionResult:
    found = laws(request, sizes.jobs)
    compared = rig_tables.laws_table(found, (PROPOSED, NOMINAL, LQR))
    others = regulators(request, sizes.jobs, found)
    here, there, bits = whole_flight(request)
    swings = {"plan": swing_of(here), "energy": swing_of(_by_energy(request))}
    drawn, rig_parts, broken = rigs(request, sizes)
    tables = [compared, others, bits, rig_tables.swings_table(swings), drawn, *rig_parts]
    if sizes.grid:
        tables += grid(request, sizes.jobs)
    film = animated_flight(here)
    moving = Drawn(
        "swing-up-flight",
        0,
        "6",
        "The flight",
        " It repeats; the link turns in real time.",
        Image(film, None),
        shown_csv(here),
    )
    differ = differing_bits(here, there)
    failures = [f"section 6: {differ} bits differ between host and 750"] if differ else []
    return SectionResult((*figures, moving), tuple(tables), (_claim(found),), (*failures, *broken))


def laws(request: Request, jobs: int) -> dict[tuple[str, str], Measures]:
    """Fly every law in every case; return the measures by (case, law)."""
    cases = scenarios_of(LAWS)
    label = "section 6: laws and cases"
    flown = fly_each([s for _, s in cases], jobs, lambda k, n: request.update(label, k, n))
    by_name = {(p["case"], p["law"]): one for (p, _), (one, _, _) in zip(cases, flown, strict=True)}
    names = dict.fromkeys(p["case"] for p, _ in cases)
    return {(c, law): by_name[c, law] for c in names for law in (PROPOSED, NOMINAL, LQR)}


def regulators(request: Request, jobs: int, found: Mapping[tuple[str, str], Measures]) -> Table:
    """Fly regulators of other weights, and return them beside the paper's and the proposed law."""
    host, campaign = host_model(open_generated("pendubot")), read_campaign(LAWS)
    planned, rates = [], {(1.0, 1.0): slowest_rate(host, lqr_gain(host, "rig"), "rig")}
    for effort, rates_weight in REGULATORS:
        gain = lqr_gain(host, "rig", effort, rates_weight)
        rates[effort, rates_weight] = slowest_rate(host, gain, "rig")
        members = {
            f"feedback_tau_{n}": k for n, k in zip(("q1", "q2", "dq1", "dq2"), gain, strict=True)
        }
        for case in REGULATOR_CASES:
            scenario = campaign.scenario(case_of(campaign, law=LQR, case=case))
            planned.append((case, (effort, rates_weight), with_control(scenario, **members)))
    label = "section 6: other regulators"
    flown = fly_each([s for _, _, s in planned], jobs, lambda k, n: request.update(label, k, n))
    rows = []
    for case in REGULATOR_CASES:
        rows.append((case, PROPOSED, "", *rig_tables.cells(found[case, PROPOSED])))
        made = [((1.0, 1.0), found[case, LQR])]
        made += [
            (w, one) for (c, w, _), (one, _, _) in zip(planned, flown, strict=True) if c == case
        ]
        for weights, one in made:
            name = f"LQR, R = {weights[0]:g}, Q = diag(1, 1, {weights[1]:g}, {weights[1]:g})"
            rows.append((case, name, f"{rates[weights]:.2f}", *rig_tables.cells(one)))
    columns = ("case", "law", "slowest pole [1/s]", "IAE q₁", "IAE q₂", "MAE2 q₁", "MAE2 q₂")
    note = (
        "Cases and figures as in the table of laws. Where other weights beat the proposed law, "
        "the kind of law is not what decides."
    )
    return Table("regulators", "6", "LQR with other weights", columns, tuple(rows), note)


def whole_flight(request: Request) -> tuple[Flight, Flight, Table]:
    """Fly the whole flight on the host and on the emulated 750, and compare."""
    scenario = read_twin(_SCENARIO)
    flights, label = [], "section 6: host and emulated 750"
    for k, machine in enumerate(("host", "ppc750")):
        flights.append(fly_recorded(scenario, machine))
        request.update(label, k + 1, 2)
    here, there = flights
    rows = tuple(
        (
            machine,
            rig_tables.figure(float(f.statistics.capture_time[0])),
            rig_tables.figure(float(f.time[-1, 0] - f.statistics.capture_time[0])),
            f.sha256(),
        )
        for machine, f in (("host", here), ("emulated PowerPC 750", there))
    )
    note = f"{differing_bits(here, there)} bits of all recorded signals differ."
    columns = ("machine", "within 0.03 rad from [s]", "held for [s]", "SHA-256 of the outputs")
    return here, there, Table("machines", "6", "One flight on two machines", columns, rows, note)


def _by_energy(request: Request) -> Flight:
    scenario = read_twin(_SCENARIO)
    request.update("section 6: the energy law", 0, 1)
    flight = fly_recorded(with_control(scenario, swing_up=1))
    request.update("section 6: the energy law", 1, 1)
    return flight


def rigs(request: Request, sizes: Sizes) -> tuple[Table, list[Table], list[str]]:
    """Fly the randomised rigs; return the table, those of failures, and what must not be."""
    campaign, rows, parts, broken = read_campaign(RIGS), [], [], []
    for k, case in enumerate(campaign.cases):
        name, scenario = case.points["swing_up"], campaign.scenario(case)
        scenario = replace(scenario, rigs=sizes.rigs or scenario.rigs)
        twin = Twin(scenario, threads=sizes.jobs)
        drawn = rig_tables.drawn_parameters(scenario, twin.rigs)
        unit = CONTROLLERS[scenario.controller](scenario, twin.model, "host")
        found = twin.fly(unit, Wanted(rigs=())).statistics
        request.update("section 6: randomised rigs", k + 1, len(campaign.cases))
        rows.append(rig_tables.rigs_row(name, found, bool(scenario.faults)))
        broken += _broken(name, found, k == 0)
        if scenario.faults:
            continue
        failed = ~rig_tables.caught_within(found)
        if k == 0 and failed.any():
            parts.append(_explained(request, sizes, twin, found))
        if failed.any():
            why = rig_failures.distinguishing(drawn, failed)
            parts.append(rig_failures.distinguishing_table(name, why))
    return rig_tables.rigs_table(rows), parts, broken


def _explained(request: Request, sizes: Sizes, twin: Twin, found: Statistics) -> Table:
    """Return the rigs that were not caught, each flown again without a deviation of its own."""
    scenario, label = twin.scenario, "section 6: failures flown again"
    failed = [int(k) for k in (~rig_tables.caught_within(found)).nonzero()[0]]
    again = rig_failures.fly_again(
        scenario, failed, sizes.jobs, lambda k, n: request.update(label, k, n)
    )
    off = rig_failures.ratios_off(scenario, twin.rigs.params)
    return rig_failures.failures_table(scenario.seed, found, off, twin.rigs.delays[:, 0], again)


def _broken(name: str, found: Statistics, first: bool) -> list[str]:
    few = first and rig_tables.caught_within(found).mean() < 0.95
    texts = [f"section 6: fewer than 95 % of the rigs are caught ({name})"] if few else []
    if found.violations.any():
        texts.append(f"section 6: torque beyond the limit ({name})")
    if len(rig_tables.left_fault(found)):
        texts.append(f"section 6: a rig left FAULT by itself ({name})")
    return texts


def grid(request: Request, jobs: int) -> list[Table]:
    """Fly the grid of rates and limits; return its tables."""
    campaign, found = read_campaign(GRID), {}
    for k, result in enumerate(fly_campaign(campaign, None, jobs)):
        p = result.case.points
        found[p["rate"], p["limit"], p["swing_up"]] = result.statistics
        request.update("section 6: rates and limits", k + 1, len(campaign.cases))
    return rig_tables.grid_tables(found)


def _claim(found: Mapping[tuple[str, str], Measures]) -> Claim:
    worse = rig_tables.exceptions(found, PROPOSED, LQR)
    plain = [text for text in worse if text.startswith(f"{_NONE}:")]
    ours, theirs = found[_NONE, PROPOSED], found[_NONE, LQR]
    measured_text = (
        f"Undisturbed: IAE {' / '.join(rig_tables.figure(v) for v in ours.iae)} against "
        f"{' / '.join(rig_tables.figure(v) for v in theirs.iae)} rad s, MAE2 "
        f"{' / '.join(rig_tables.figure(v) for v in ours.mae2)} against "
        f"{' / '.join(rig_tables.figure(v) for v in theirs.mae2)} rad. "
    )
    count = len({case for case, _ in found})
    measured_text += (
        f"Smaller in all of {count} cases." if not worse else "LQR is better: " + "; ".join(worse)
    )
    verdict = FAILS if plain else PARTLY if worse else HOLDS
    says = "IAE and MAE2 of q₁ and q₂ are smaller under the proposed control than under LQR."
    return Claim("6", ("figure-19", "figure-20"), says, measured_text, verdict, "laws; regulators")
