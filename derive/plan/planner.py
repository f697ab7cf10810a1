"""The stages of planning in order: random starts, the fine grid, the check, the Riccati row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pfaffian.derive.derivation.derive import Derivation
from pfaffian.derive.derivation.plant_digest import plant_digest
from pfaffian.derive.plan.check import DEFECT_TOLERANCE, PlanCheck, check_plan
from pfaffian.derive.plan.plant import NumericPlant, casadi_rates, numeric_plant
from pfaffian.derive.plan.problem import PlanOptions, Problem, plan_problem, plant_parameters
from pfaffian.derive.plan.rest import slowest_period
from pfaffian.derive.plan.riccati import RowPath, riccati_path
from pfaffian.derive.plan.shooting import Grid, Shooting, Trajectory, random_guess, resampled
from pfaffian.derive.sets.parameter_set import ParameterSet
from pfaffian.runtime.base.errors import CheckError, InputError

Array = NDArray[np.float64]
#: The first and the most Runge-Kutta steps in an interval of the fine grid.
_STEPS = (2, 32)
#: How far what a file stores twice may disagree, relative.
_AGREEMENT = 1e-9


@dataclass(frozen=True)
class Provenance:
    """How a plan was found: what to repeat, and what its figures were then.

    `start_number` is the random start it came from, `converged` how many of `starts` led anywhere.
    """

    seed: int
    starts: int
    start_number: int
    converged: int
    coarse: int
    steps: int
    iterations: int
    cost: float
    tools: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Plan:
    """A plan: the problem, the trajectory with accelerations (N+1, n), its row, its check."""

    problem: Problem
    trajectory: Trajectory
    accelerations: Array
    row: RowPath
    check: PlanCheck
    provenance: Provenance


@dataclass(frozen=True)
class _Found:
    """A solution on the coarse grid, and the number of the start it came from."""

    number: int
    trajectory: Trajectory


def make_plan(
    derivation: Derivation,
    chosen: ParameterSet,
    options: PlanOptions,
    weights: tuple[tuple[float, ...], float] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Plan:
    """Plan a motion from rest to the setpoint of `chosen`; `weights` are Q and R of its row.

    Raises `InputError` for what cannot be asked, `CheckError` where no plan is found or the one
    found does not pass its check.
    """
    values = chosen.as_dict()
    plant, rates = numeric_plant(derivation, values), casadi_rates(derivation, values)
    problem = plan_problem(derivation, plant, chosen, options)
    total = options.starts + 3
    found = _coarse(problem, rates, options, lambda done: progress(done, total))
    best, grid, fine = _refined(problem, rates, plant, options, found)
    progress(options.starts + 1, total)
    check = check_plan(plant, problem, fine)
    check.demand(f"model {problem.model}, set {problem.set_name}: the plan does not hold")
    progress(options.starts + 2, total)
    q_weights, effort = weights or default_weights(problem, plant)
    row = riccati_path(problem, rates, fine, q_weights, effort)
    progress(total, total)
    return Plan(
        problem=problem,
        trajectory=fine,
        accelerations=accelerations_along(plant, fine),
        row=row,
        check=check,
        provenance=Provenance(
            seed=options.seed,
            starts=options.starts,
            start_number=best.number,
            converged=len(found),
            coarse=options.coarse,
            steps=grid.steps,
            iterations=fine.iterations,
            cost=fine.cost,
            tools=tuple((name, version(name)) for name in ("casadi", "numpy", "scipy", "sympy")),
        ),
    )


def recheck(derivation: Derivation, chosen: ParameterSet, plan: Plan, where: str) -> Plan:
    """Return `plan` with a fresh check on the plant of `chosen`, without any solver.

    Raises `InputError` naming `where` for the plan of another model, equations, plant or goal,
    `CheckError` where it does not hold.
    """
    plant = numeric_plant(derivation, chosen.as_dict())
    _check_belonging(derivation, chosen, plant, plan, where)
    check = check_plan(plant, plan.problem, plan.trajectory)
    check = replace(check, violations=(*check.violations, *_disagreements(plant, plan)))
    check.demand(f"{where}: the plan does not hold")
    return replace(plan, check=check)


def _disagreements(plant: NumericPlant, plan: Plan) -> list[str]:
    """Return what is stored beside the trajectory and does not follow from it, worded."""
    path, n = plan.trajectory, plant.n
    said = []
    off = np.max(np.abs(plan.accelerations - accelerations_along(plant, path)), axis=1)
    if not np.all(off <= _AGREEMENT * (1.0 + np.max(np.abs(plan.accelerations)))):
        said.append(
            f"the acceleration at {path.times[np.argmax(off)]:.4g} s is {off.max():.3g} off"
        )
    for time, x, p, row in zip(
        path.times, path.states, plan.row.matrices, plan.row.rows, strict=True
    ):
        mass, _, inputs = plant.matrices(x[:n], x[n:])
        wanted = np.linalg.solve(mass, inputs).T @ p[n:]
        if not np.max(np.abs(row - wanted)) <= _AGREEMENT * np.max(np.abs(wanted)):
            said.append(f"the row at {time:.4g} s is not B^T P")
            break
    return said


def _check_belonging(
    derivation: Derivation, chosen: ParameterSet, plant: NumericPlant, plan: Plan, where: str
) -> None:
    """Raise `InputError` unless `plan` is one of this model, these equations, plant and goal."""
    problem, spec = plan.problem, derivation.spec
    remedy = f"plan again: pfaffian plan {spec.name} -o FILE"
    if problem.model != spec.name:
        raise InputError(f"{where}: is a plan of model {problem.model}", remedy=remedy)
    if problem.model_sha256 != plant_digest(derivation):
        raise InputError(f"{where}: the equations of {spec.name} have changed since", remedy=remedy)
    for (name, then), (_, now) in zip(
        problem.parameters, plant_parameters(derivation, chosen), strict=True
    ):
        if then != now:
            raise InputError(
                f"{where}: {name} was {then:g}, but is {now:g} in set {chosen.name}",
                remedy=f"name its own set, {problem.set_name}, or {remedy}",
            )
    if problem.goal[: plant.n] != plant.setpoint:
        raise InputError(f"{where}: does not end at the setpoint of {chosen.name}", remedy=remedy)


def default_weights(problem: Problem, plant: NumericPlant) -> tuple[tuple[float, ...], float]:
    """Return Q and R of the row: an error of 1 costs as much as the full torque.

    Rates are weighed by the square of period/2 pi, of the slowest oscillation about the start.
    """
    n = problem.order
    time = slowest_period(plant, problem.start[:n]) / (2.0 * np.pi)
    return (*(1.0 for _ in range(n)), *(float(time**2) for _ in range(n))), 1.0


def accelerations_along(plant: NumericPlant, found: Trajectory) -> Array:
    """Return q'' (N+1, n) at the nodes."""
    pairs = zip(found.states, found.torques, strict=True)
    return np.array([plant.rates(x, tau)[plant.n :] for x, tau in pairs])


def _coarse(
    problem: Problem, rates: Any, options: PlanOptions, progress: Callable[[int], None]
) -> list[_Found]:
    """Return the solutions from all random starts, the cheapest first."""
    shooting = Shooting(problem, rates, Grid(options.coarse, 2, 1e-6, 1000), None)
    found = []
    for number in range(options.starts):
        guess = random_guess(problem, options.coarse, options.seed, number)
        trajectory = shooting.solve(guess)
        if trajectory is not None:
            found.append(_Found(number, trajectory))
        progress(number + 1)
    if not found:
        least, most = problem.end_time
        raise CheckError(
            f"model {problem.model}, set {problem.set_name}: none of {options.starts} starts led "
            f"to a plan within {least:.4g} to {most:.4g} s",
            remedy="give more starts (--seeds), a longer --end-time, or looser limits",
        )
    # Starts that lead to the same motion differ in the last digits: the first of them is taken.
    return sorted(found, key=lambda f: (float(f"{f.trajectory.cost:.4g}"), f.number))


def _refined(
    problem: Problem,
    rates: Any,
    plant: NumericPlant,
    options: PlanOptions,
    found: list[_Found],
) -> tuple[_Found, Grid, Trajectory]:
    """Return the first of `found` that the fine grid confirms, with enough Runge-Kutta steps."""
    for candidate in found:
        end, intervals = fine_grid(candidate.trajectory.end_time, options.fine, problem.sample_time)
        guess, steps = resampled(candidate.trajectory, intervals, end), _STEPS[0]
        while steps <= _STEPS[1]:
            grid = Grid(intervals, steps, 1e-10, 1000)
            fine = Shooting(problem, rates, grid, end).solve(guess)
            if fine is None:
                break
            check = check_plan(plant, problem, fine)
            if check.defect <= DEFECT_TOLERANCE / 2.0:
                return candidate, grid, fine
            guess, steps = resampled(fine, intervals, end), 2 * steps
    raise CheckError(
        f"model {problem.model}, set {problem.set_name}: {len(found)} coarse plans, but the fine "
        "grid confirms none",
        remedy="give more starts (--seeds), more nodes (--nodes) or a longer --end-time",
    )


def fine_grid(end_time: float, wanted: int, sample_time: float) -> tuple[float, int]:
    """Return the end time and the number of intervals: each a whole number of sample times.

    Where no number of sample times near end_time/wanted divides the end time, that is cut short
    by less than one interval.
    """
    samples = int(end_time / sample_time + 1e-6)
    each = max(1, round(samples / wanted))
    near = [d for d in range(1, samples + 1) if samples % d == 0 and each <= 1.5 * d <= 2.25 * each]
    if near:
        each = min(near, key=lambda d: (abs(d - each), d))
    intervals = samples // each
    return intervals * each * sample_time, intervals
