"""What a verdict is decided from: the runs of a section, and what is read off them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from pfaffian.paper.results.result import FAILS, HOLDS, PARTLY, Claim
from pfaffian.paper.simulations.cases import DERIVED, DESIGNED, LQR
from pfaffian.paper.simulations.fly import Run
from pfaffian.paper.simulations.measures import measures
from pfaffian.paper.simulations.mujoco import Agreement
from pfaffian.paper.simulations.runs import USED
from pfaffian.paper.verdicts.figures import duration_text
from pfaffian.paper.verdicts.tables import Comparison, number
from pfaffian.paper.verdicts.theorem import Judged

#: What counts as at the goal: an error, and |beta|, of the last two seconds, in rad and rad/s.
SMALL = 0.02
TESTS = "tests/test_reproduction.py"


@dataclass(frozen=True)
class Evidence:
    """All that was measured for a section; `others` are the runs with other choices of ours and
    those that set the sampled law apart, `sampled` its flights."""

    section: str
    runs: Mapping[str, Run]
    variants: Mapping[str, Run]
    compared: Sequence[Comparison]
    judged: Sequence[Judged]
    flights: Sequence[Agreement]
    others: Mapping[str, Run] = field(default_factory=dict)
    sampled: Sequence[Sampled] = ()

    def run(self, column: str, terms: str = "") -> Run:
        """Return a run of the figures."""
        if column == LQR:
            return self.runs[f"{self.section}-{LQR}"]
        return self.runs[f"{self.section}-{column}-{terms or USED[self.section]}"]

    def value(self, column: str, key: str, terms: str = "") -> float:
        """Return one measure of a run."""
        return measures(self.run(column, terms))[key]

    def variant(self, column: str, mark: str, terms: str = "") -> Run:
        """Return a run with something changed."""
        return self.variants[f"{self.section}-{column}-{terms or USED[self.section]}-{mark}"]

    def other(self, column: str, mark: str) -> Run:
        """Return a run with another choice of ours, or between continuous and sampled law."""
        return self.others[f"{self.section}-{column}-{USED[self.section]}-{mark}"]

    def deviation(self, column: str, terms: str = "") -> float:
        """Return the largest change of a run's figures under any fine solver."""
        name = self.run(column, terms).case.name
        own = [c for c in self.compared if c.reference.case.name == name and c.check.decides]
        return max(c.deviation for c in own)

    def claim(
        self, figures: str, says: str, measured: str, verdict: str, evidence: str = ""
    ) -> Claim:
        """Return a claim of this section; `figures` are numbers, separated by spaces."""
        names = tuple(f"figure-{int(n):02d}" for n in figures.split())
        proof = evidence or f"convergence-{self.section}; {TESTS}"
        return Claim(self.section, names, says, measured, verdict, proof)


def graded(derived: bool, designed: bool) -> str:
    """Return the verdict on a claim from whether the derived law bears it out with both gains."""
    if derived:
        return HOLDS if designed else PARTLY
    return PARTLY if designed else FAILS


def pair(seen: Evidence, column: str, key: str) -> str:
    """Return a measure of both angles as it is printed."""
    return " / ".join(number(seen.value(column, f"{key}_{q}"), 3) for q in ("q1", "q2"))


def three(seen: Evidence, key: str) -> str:
    """Return a measure of both angles in the columns that run, and of the LQR."""
    lqr = seen.run(LQR)
    theirs = f"ends at {duration_text(lqr.end)}" if lqr.ended else pair(seen, LQR, key)
    return f"derived {pair(seen, DERIVED, key)}, designed {pair(seen, DESIGNED, key)}, LQR {theirs}"


def smaller(seen: Evidence, column: str, key: str) -> bool:
    """Return whether a measure of both angles is smaller than that of the LQR."""
    return all(
        seen.value(column, f"{key}_{q}") < seen.value(LQR, f"{key}_{q}") for q in ("q1", "q2")
    )


def settles(seen: Evidence, column: str) -> bool:
    """Return whether both angles come to their setpoints."""
    return all(seen.value(column, f"mae2_{q}") < SMALL for q in ("q1", "q2"))


def singular_angle(run: Run) -> float:
    """Return |q2| where ADB of `run` vanishes, in rad."""
    k = run.case.controller
    return math.acos((k["lam"] - 1.0) * k["theta2"] / k["theta3"])


def friction_slope(run: Run) -> float:
    """Return the slope at rest of the friction on joint 1, in N m s/rad."""
    f = [run.case.plant[f"joint1_friction{k}"] for k in range(1, 7)]
    return f[0] * (f[1] - f[2]) + f[3] * f[4] + f[5]


def frequencies(run: Run, window: float = 0.25) -> tuple[float, float]:
    """Return the least and greatest frequency in Hz at which q2' of `run` changes its sign.

    Windows in which it does so fewer than four times count as calm; without any other, NaN.
    """
    found = []
    for start in np.arange(0.0, run.time[-1] - window / 2, window):
        inside = (run.time >= start) & (run.time < start + window)
        time, rate = run.time[inside], run.state[inside, 3]
        turns = time[1:][np.diff(np.sign(rate)) != 0]
        if len(turns) >= 4:
            found.append((len(turns) - 1) / (2.0 * (turns[-1] - turns[0])))
    return (min(found), max(found)) if found else (math.nan, math.nan)


@dataclass(frozen=True)
class Sampled:
    """Section 5.1 under the generated sampled law of `period` [s]: IAE and MAE2 of both angles;
    `unlimited` is the same without limits of torque and slew and without a singularity guard."""

    column: str
    period: float
    held: Mapping[str, float]
    unlimited: Mapping[str, float]
