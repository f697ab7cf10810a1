"""The tables of a section: measures, convergence, variants, Theorem 1, MuJoCo."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pfaffian.paper.results.result import Table
from pfaffian.paper.simulations.cases import LQR, PRINTED, Case
from pfaffian.paper.simulations.fly import CVODES, STALLED, Run
from pfaffian.paper.simulations.measures import measures
from pfaffian.paper.simulations.mujoco import Agreement
from pfaffian.paper.simulations.runs import ODE45, Check
from pfaffian.paper.verdicts.figures import duration_text
from pfaffian.paper.verdicts.theorem import Judged

#: What the figures of a run that converged may change by.
CONVERGED = 0.02
_ENDS = {
    "speed": "a link passes 1000 rad/s",
    "angle": "a link is half a turn from its setpoint",
    "singular": "ADB changes its sign",
    STALLED: "no step is small enough",
}
_SUBSCRIPTS = str.maketrans("123", "₁₂₃")
#: What the end of a variant's name stands for.
_CHANGES = {
    "at-rest": "from rest",
    "48": "(48) for (15)",
    "without-joint-2": "no friction on joint 2",
    "damping": "damping on joint 2",
    "damping-both": "damping on both joints",
    "damping-thousandth": "damping on joint 2, a thousandth",
    "damping-ten-thousandth": "damping on joint 2, a ten-thousandth",
    "kappa-5": "κ = 5",
    "kappa-10": "κ = 10",
    "kappa-20": "κ = 20",
    "epsilon-1": "ε = 1",
}
#: The same for marks that end in a number.
_MARKS = {"ahat-": "α̂(t₀) = {} N m", "softened-": "p₂ as in the sampled law of {} s"}


@dataclass(frozen=True)
class Comparison:
    """A run beside the same case flown otherwise: `deviation` is the largest relative change of
    IAE and MAE2, or of the time of the end; `largest` the greatest difference of an angle [rad]."""

    check: Check
    run: Run
    reference: Run
    deviation: float
    largest: float


def compare(check: Check, run: Run, reference: Run) -> Comparison:
    """Compare `run`, flown as `check` says, with the run of the figures."""
    if run.ended or reference.ended:
        same = bool(run.ended) == bool(reference.ended)
        change = abs(run.end - reference.end) / reference.end if same else math.inf
        return Comparison(check, run, reference, change, math.nan)
    one, other = measures(run), measures(reference)
    names = [n for n in one if n.startswith(("iae", "mae2"))]
    # Below a microradian MAE2 is what the tolerances leave, not a property of the loop.
    change = max(abs(one[n] - other[n]) / max(abs(other[n]), 1e-6) for n in names)
    size = min(len(run.time), len(reference.time))
    shared = np.allclose(run.time[:size], reference.time[:size])
    largest = math.nan
    if shared:
        largest = float(np.abs(run.state[:size, :2] - reference.state[:size, :2]).max())
    return Comparison(check, run, reference, change, largest)


def number(value: float, digits: int = 4) -> str:
    """Return a number as it is printed, a dash for none."""
    return "–" if math.isnan(value) else f"{value:.{digits}g}"


def end_text(run: Run) -> str:
    """Return how a run ended."""
    if run.ended:
        return f"{duration_text(run.end)}: {_ENDS[run.ended]}"
    return f"{run.case.duration:g} s"


def measure_table(section: str, runs: Mapping[str, Run], name: str, title: str) -> Table:
    """Return IAE, MAE, MAE2 and what beta and the torque come to, for each of `runs`."""
    rows = []
    for run in runs.values():
        m = measures(run)
        over = duration_text(run.over_limit) if run.over_limit is not None else "never"
        keys = ["iae_q1", "iae_q2", "mae_q1", "mae_q2", "mae2_q1", "mae2_q2", "beta_max"]
        cells = [number(m[k], 3) for k in (*keys, "beta_sum", "effort", "peak_torque")]
        rows.append((label(run), end_text(run), *cells, over))
    columns = (
        "run",
        "ends",
        "IAE q₁",
        "IAE q₂",
        "MAE q₁",
        "MAE q₂",
        "MAE2 q₁",
        "MAE2 q₂",
        "max |β|",
        "∫|β|dt",
        "∫τ²dt",
        "peak |τ|",
        "|τ| > 10 N m",
    )
    note = "IAE in rad s, MAE and MAE2 in rad, β in rad/s, its integral in rad, τ in N m."
    return Table(name, section, title, columns, tuple(rows), note)


def terms_text(case: Case) -> str:
    """Return the parts of the law that act, as they are printed: p₁ + p₂."""
    return case.terms.replace("+", " + ").translate(_SUBSCRIPTS)


def label(run: Run) -> str:
    """Return what a run is called in a table."""
    case = run.case
    if case.column == LQR:
        return "LQR"
    rest = case.name.removeprefix(f"{case.section}-{case.column}-{case.terms}").strip("-")
    words = f", {_change_text(rest)}" if rest else ""
    return f"as {case.column}, {terms_text(case)}{words}"


def _change_text(mark: str) -> str:
    """Return what the end of a variant's name stands for."""
    for start, words in _MARKS.items():
        if mark.startswith(start):
            return words.format(mark.removeprefix(start))
    return _CHANGES.get(mark) or mark.replace("-", " ")


def convergence_table(section: str, comparisons: Sequence[Comparison]) -> Table:
    """Return every comparison of a section."""
    rows = []
    for reference in dict.fromkeys(c.reference.task.case.name for c in comparisons):
        own = [c for c in comparisons if c.reference.case.name == reference]
        first = own[0].reference
        rows.append((label(first), f"{_solver(first)}, as drawn", *_figures(first), "", ""))
        rows += [
            (
                "",
                _solver(c.run),
                *_figures(c.run),
                number(c.deviation, 2) if math.isfinite(c.deviation) else "another end",
                number(c.largest, 2),
            )
            for c in own
        ]
    columns = (
        "run",
        "solver, relative tolerance",
        "evaluations",
        "ends",
        "IAE q₁",
        "IAE q₂",
        "MAE2 q₁",
        "MAE2 q₂",
        "largest change",
        "largest |Δq| [rad]",
    )
    note = (
        "CVODES solves a second formulation, typed in from the paper's (1) to (23). RK45 at 1e-3 "
        "stands for ode45 with its defaults: the paper names ode45 and no tolerances. The largest "
        "change is relative, of IAE and MAE2 (of the time of the end where a run ends early); "
        "below 1e-6 rad MAE2 is compared with 1e-6 rad."
    )
    return Table(f"convergence-{section}", section, "Convergence", columns, tuple(rows), note)


def _solver(run: Run) -> str:
    task = run.task
    return f"{task.solver}, {task.relative:g}"


def _figures(run: Run) -> tuple[str, ...]:
    m = measures(run)
    values = (m["iae_q1"], m["iae_q2"], m["mae2_q1"], m["mae2_q2"])
    end = f"{run.end:.7g} s" if run.ended else f"{run.case.duration:g} s"
    shown = ["–"] * 4 if run.ended else [number(v, 6) for v in values]
    return (f"{run.evaluations}" if run.evaluations else "–", end, *shown)


def unsettled(comparisons: Sequence[Comparison]) -> list[str]:
    """Return the runs whose figures still change by more than 2 % under a fine solver."""
    found = []
    for c in comparisons:
        if not c.check.decides or c.deviation <= CONVERGED:
            continue
        found.append(
            f"{c.reference.case.name}: {c.run.task.solver} at {c.run.task.relative:g} changes it "
            f"by {c.deviation:.2g}"
        )
    return found


def is_default_ode45(comparison: Comparison) -> bool:
    """Return whether a comparison is the one with the defaults of ode45."""
    return (comparison.run.task.solver, comparison.run.task.relative) == ODE45[:2]


def is_independent(comparison: Comparison) -> bool:
    """Return whether a comparison is the one with the second formulation."""
    return comparison.run.task.solver == CVODES


def theorem_table(section: str, judged: Sequence[Judged]) -> Table:
    """Return Theorem 1 in numbers beside the runs of a section."""
    rows = []
    for j in judged:
        c = j.certificate
        for claim in c.claims:
            theorem = c.theorem.alpha if c.theorem else math.nan
            rows.append(
                (
                    label(j.run),
                    claim.form,
                    number(math.sqrt(c.assumptions.lmin)),
                    number(theorem),
                    number(claim.bound),
                    number(claim.largest),
                    number(claim.ultimate),
                    number(claim.settling),
                    number(math.nan if claim.late is None else claim.late),
                    number(c.least_slack, 3),
                )
            )
    columns = (
        "run",
        "form",
        "min |ADB|",
        "α [N m]",
        "bound",
        "largest seen",
        "ultimate bound",
        "after [s]",
        "largest then",
        "least bound − V′",
    )
    note = (
        "Forms as in docs/certificate.md: printed bounds (β, α̂ − α) as in (41) to (46), scaled in "
        "rad/s alone, p2 bounds |β| by p₂. A negative last column would be a broken bound."
    )
    return Table(f"theorem-{section}", section, "Theorem 1 on the runs", columns, tuple(rows), note)


def engine_table(section: str, flights: Sequence[Agreement]) -> Table:
    """Return section 5.1 in MuJoCo beside our plant."""
    rows = []
    for a in flights:
        for where, m in (("generated plant", a.ours), ("MuJoCo", a.theirs)):
            first = where != "MuJoCo"
            cells = [number(m[k], 6) for k in ("iae_q1", "iae_q2", "mae2_q1", "mae2_q2")]
            ends = ("", "") if first else (number(a.largest, 2), number(a.torque, 2))
            rows.append((a.scenario if first else "", where, *cells, *ends))
    columns = (
        "scenario",
        "plant",
        "IAE q₁",
        "IAE q₂",
        "MAE2 q₁",
        "MAE2 q₂",
        "largest |Δq| [rad]",
        "largest |Δτ| [N m]",
    )
    note = (
        "Both under the generated C controller at 1 kHz, the sampled law. Both take the classical "
        "Runge-Kutta step of 0.1 ms, so what differs is the dynamics alone."
    )
    return Table("mujoco", section, "The same in MuJoCo", columns, tuple(rows), note)


def printed_ends(runs: Mapping[str, Run]) -> list[Run]:
    """Return the runs as printed that could not go on."""
    return [r for r in runs.values() if r.case.column == PRINTED and r.ended]
