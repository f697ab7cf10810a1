"""Which runs the sections need: those of the figures, and those that settle a question."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from pfaffian.paper.simulations.cases import (
    COLUMNS,
    DERIVED,
    DESIGNED,
    LQR,
    PRINTED,
    START,
    TERMS,
    Case,
    case_of,
    changed,
    damping,
    lasting,
    scaled_friction,
    softened,
    with_printed_adaptation,
)
from pfaffian.paper.simulations.fly import CVODES, Task
from pfaffian.runtime.code.generated_model import GeneratedFolder

SECTIONS = ("5.1", "5.2", "5.3")
#: Terms of (16) that a section uses.
USED = {"5.1": TERMS[1], "5.2": TERMS[2], "5.3": TERMS[2]}
#: The start as it may be read too: the paper prints its rates in one garbled line.
REST = (START[0], START[1], 0.0, 0.0)
#: Tolerances of MATLAB's ode45 where none are given; its pair is that of RK45.
ODE45 = ("RK45", 1e-3, 1e-6)
#: Other values of what the paper leaves open and we chose: ahat(t0) [N m], the length of a run [s].
OTHER_ESTIMATES = (0.01, 1.0)
SHORTER, LONGER = 5.0, 20.0
#: Periods in s at which the sampled law is set beside the continuous one, the target's first.
PERIODS = (1e-3, 5e-4, 2e-4, 1e-4)
_LQR_SOLVER = ("Radau", 1e-12, 1e-14)
_FAST_RECORD = 2e-4


@dataclass(frozen=True)
class Check:
    """One row of a convergence table: `task`, and the run of the figures it stands beside.

    Whether a run has converged `decides` by fine solvers alone; others show what they make of it.
    """

    reference: str
    task: Task
    decides: bool


def main_task(case: Case) -> Task:
    """Return how a run of the figures is flown."""
    if case.column == PRINTED:
        return Task(case, record=0.0)
    if case.column == LQR and case.section == "5.1":
        # It rests for seconds where it has lost its stability: what it does then is decided by
        # the smallest error.
        return Task(case, *_LQR_SOLVER)
    if case.column == LQR:
        return Task(case)
    if case.terms == TERMS[0]:
        return Task(case, record=0.0)
    fast = case.section == "5.3" and case.column == DERIVED
    return Task(case, record=_FAST_RECORD if fast else 1e-3)


def figure_tasks(
    folder: GeneratedFolder, section: str, feedback: tuple[float, ...]
) -> dict[str, Task]:
    """Return the runs of the figures of `section`, by name."""
    cases = [case_of(folder, section, column, USED[section]) for column in COLUMNS]
    if section == "5.1":
        cases += [case_of(folder, section, column, TERMS[0]) for column in COLUMNS]
    cases.append(case_of(folder, section, LQR, "", feedback))
    return {c.name: main_task(c) for c in cases}


def variant_tasks(folder: GeneratedFolder, section: str) -> dict[str, Task]:
    """Return the runs that show what a change of start, sign or gain does, by name."""
    cases: list[Case] = []
    for column in (DERIVED, DESIGNED):
        case = case_of(folder, section, column, USED[section])
        cases.append(changed(case, "at-rest", REST))
        if section == "5.1":
            alone = case_of(folder, section, column, TERMS[0])
            cases.append(changed(alone, "at-rest", REST))
        else:
            cases.append(with_printed_adaptation(case))
        if section == "5.3":
            cases += _settling(case)
    tasks = {c.name: main_task(c) for c in cases}
    return {n: replace(t, record=1e-3) if t.record else t for n, t in tasks.items()}


def choice_tasks(folder: GeneratedFolder, section: str) -> dict[str, Task]:
    """Return the runs with other values of what the paper leaves open, by name.

    Shorter ones are cut from those of the figures. Without adaptation (5.1) no ahat acts.
    """
    cases: list[Case] = []
    for column in (DERIVED, DESIGNED):
        case = case_of(folder, section, column, USED[section])
        cases.append(lasting(case, LONGER))
        if section != "5.1":
            cases += [changed(case, f"ahat-{a:g}", bound_initial=a) for a in OTHER_ESTIMATES]
    tasks = {c.name: replace(main_task(c), record=1e-3) for c in cases}
    # At rest to the last digit the finest tolerance costs seconds and shows nothing.
    long = {n: t for n, t in tasks.items() if t.case.duration == LONGER}
    return tasks | {n: replace(t, relative=1e-7, absolute=1e-9) for n, t in long.items()}


def softened_tasks(folder: GeneratedFolder, section: str) -> dict[str, Task]:
    """Return section 5.1 with p2 as weak as in the sampled law, for each of `PERIODS`, by name."""
    if section != "5.1":
        return {}
    cases = [case_of(folder, section, column, USED[section]) for column in (DERIVED, DESIGNED)]
    weak = [softened(case, period) for case in cases for period in PERIODS]
    return {c.name: main_task(c) for c in weak}


def _settling(case: Case) -> list[Case]:
    """Return section 5.3 with other signs, sizes and gains."""
    damped = damping(case, (2,))
    return [
        scaled_friction(case, "without-joint-2", 0.0),
        damped,
        replace(damping(case), name=f"{case.name}-damping-both"),
        scaled_friction(damped, "thousandth", 1e-3),
        scaled_friction(damped, "ten-thousandth", 1e-4),
        changed(case, "kappa-5", kappa=5.0),
        changed(case, "kappa-10", kappa=10.0),
        changed(case, "kappa-20", kappa=20.0),
        changed(case, "epsilon-1", epsilon=1.0),
    ]


def convergence_checks(
    main: Mapping[str, Task], variants: Mapping[str, Task] | None = None
) -> list[Check]:
    """Return what each run of `main`, and each of `variants`, is compared with."""
    checks: list[Check] = []
    for runs, others in ((main, _others), (variants or {}, _another)):
        for name, task in runs.items():
            checks += [
                Check(name, replace(task, solver=s, relative=r, absolute=a), decides)
                for s, r, a, decides in others(task.case)
            ]
    return checks


def _another(case: Case) -> list[tuple[str, float, float, bool]]:
    """Return the one solver that a variant is compared with."""
    if case.adaptation_printed or case.softened:  # which the second formulation does not have
        return [("LSODA", 1e-6, 1e-8, True)]
    if case.terms == TERMS[0] or case.name.endswith(("damping", "damping-both")):
        return [("LSODA", 1e-10, 1e-12, True)]  # these end in the singular set
    return [(CVODES, 1e-8, 1e-10, True)]


def _others(case: Case) -> list[tuple[str, float, float, bool]]:
    """Return the solvers that `case` is compared with: name, tolerances, whether it decides."""
    if case.column == PRINTED:
        return [("LSODA", 1e-10, 1e-12, True), ("RK45", 1e-9, 1e-11, True)]
    if case.column == LQR and case.section == "5.1":
        return [
            ("Radau", 1e-10, 1e-12, True),
            ("DOP853", 1e-13, 1e-15, True),
            ("LSODA", 1e-10, 1e-12, False),
            (*ODE45, False),
        ]
    if case.column == LQR:
        return [("LSODA", 1e-10, 1e-12, True), (*ODE45, False)]
    if case.terms == TERMS[0]:
        return [("LSODA", 1e-11, 1e-13, True), ("Radau", 1e-9, 1e-11, True)]
    return [
        ("LSODA", 1e-6, 1e-8, False),
        ("LSODA", 1e-10, 1e-12, True),
        (CVODES, 1e-8, 1e-10, True),
        (*ODE45, False),
    ]
