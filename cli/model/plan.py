"""`pfaffian plan`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.cli import output
from pfaffian.runtime.base.errors import InputError

if TYPE_CHECKING:
    from pfaffian.derive.derivation.derive import Derivation
    from pfaffian.derive.plan.follow import Following, Run
    from pfaffian.derive.plan.planner import Plan
    from pfaffian.derive.plan.wishes import Wishes
    from pfaffian.derive.sets.parameter_set import ParameterSet
    from pfaffian.derive.spec.library import ModelFolder


@dataclass(frozen=True)
class PlanFiles:
    """Where a plan comes from and goes to: the set by name or file, a plan to check, new files."""

    set_name: str | None = None
    params: Path | None = None
    checked: Path | None = None
    written: Path | None = None
    plot: Path | None = None
    force: bool = False


def plan_motion(
    reference: str, wishes: Wishes, files: PlanFiles, draws: int, as_json: bool
) -> None:
    """Plan a motion to the setpoint, or check one that is there, fly it and say what it needs."""
    from pfaffian.derive.pipeline import derivation_of
    from pfaffian.derive.plan.document import plan_text
    from pfaffian.derive.plan.follow import FollowOptions, follow_plan
    from pfaffian.derive.spec.library import find_model
    from pfaffian.runtime.base.files import write_outputs

    folder = find_model(reference)
    _check_files(files, wishes)
    options = FollowOptions(draws=draws)
    output.note(f"deriving {folder.name}")
    derivation = derivation_of(folder)
    chosen = _parameters(folder, files)
    since = time.perf_counter()
    found = (
        _checked(derivation, chosen, files.checked)
        if files.checked
        else _planned(derivation, chosen, wishes)
    )
    seconds = time.perf_counter() - since
    output.note("following it on plants and from starts that are off")
    followed = follow_plan(derivation, found, options)
    outputs: dict[Path, bytes] = {}
    if files.written:
        outputs[files.written] = plan_text(found).encode()
    if files.plot:
        outputs[files.plot] = _plot(derivation.spec.title, found)
    write_outputs(outputs)
    document = {**_document(found, followed), "seconds": round(seconds, 3)}
    document |= {"written": files.written and str(files.written)}
    document |= {"plot": files.plot and str(files.plot)}
    output.deliver(document, as_json, lambda: _print(found, followed, document))


def _check_files(files: PlanFiles, wishes: Wishes) -> None:
    """Raise `InputError` for files that cannot be meant, before anything is computed."""
    from pfaffian.derive.plan.wishes import Wishes as Defaults
    from pfaffian.runtime.base.files import check_output

    if files.set_name and files.params:
        raise InputError("--set and --params are both given", remedy="give one of them")
    if files.checked and (wishes != Defaults() or files.written):
        raise InputError(
            "--check only checks a plan: options of planning, and -o, do not go with it",
            remedy="leave them out",
        )
    if files.written and files.written == files.plot:
        raise InputError(
            f"-o and --plot are both {files.plot}", remedy="give each a file of its own"
        )
    check_output(files.written, "-o", ".json", force=files.force)
    check_output(files.plot, "--plot", ".svg", force=files.force)


def _parameters(folder: ModelFolder, files: PlanFiles) -> ParameterSet:
    from pfaffian.derive.pipeline import lowered_model, parameter_set

    sets = folder.sets()
    if not (files.params or files.set_name or sets):
        raise InputError(
            f"model {folder.name} has no parameter set",
            remedy=f"write one beside {folder.spec_file}, or name a file with --params; "
            "pfaffian template prints one to fill in",
        )
    path = files.params or folder.set_path(files.set_name or next(iter(sets)))
    chosen = parameter_set(lowered_model(folder), folder, path)
    for line in chosen.notes:
        output.note(line)
    return chosen


def _planned(derivation: Derivation, chosen: ParameterSet, wishes: Wishes) -> Plan:
    from pfaffian.derive.plan.planner import make_plan
    from pfaffian.derive.plan.wishes import read_row_weights, read_wishes

    options = read_wishes(derivation.spec, wishes)
    weights = read_row_weights(derivation.spec, wishes.riccati)
    with output.progress(f"planning from {options.starts} starts") as update:
        return make_plan(derivation, chosen, options, weights, update)


def _checked(derivation: Derivation, chosen: ParameterSet, path: Path) -> Plan:
    from pfaffian.derive.plan.document import read_plan
    from pfaffian.derive.plan.planner import recheck

    output.note(f"checking {path} against the ODE")
    return recheck(derivation, chosen, read_plan(path), str(path))


def _plot(title: str, found: Plan) -> bytes:
    from pfaffian.derive.plan.plot import plan_svg

    return plan_svg(found, f"{title}, {found.problem.set_name}: planned motion to the setpoint")


def _document(found: Plan, followed: Sequence[Following]) -> dict[str, Any]:
    problem, check, row = found.problem, found.check, found.row
    figures = {k: v for k, v in asdict(check).items() if k != "violations"}
    return {
        "model": problem.model,
        "set": problem.set_name,
        "end_time": found.trajectory.end_time,
        "nodes": len(found.trajectory.times),
        **figures,
        "torque_limits": problem.torque_limits,
        "speed_limits": problem.speed_limits,
        "start": problem.start,
        "goal": problem.goal,
        "provenance": {**asdict(found.provenance), "tools": dict(found.provenance.tools)},
        "row": {
            "weights": row.weights,
            "effort": row.effort,
            "lyapunov_rate": row.lyapunov_rate,
            "input_gain": row.input_gain,
        },
        "following": [
            {
                "case": f.case,
                "law": [asdict(r) for r in f.law],
                "playback": [asdict(r) for r in f.playback],
            }
            for f in followed
        ],
    }


def _print(found: Plan, followed: Sequence[Following], document: dict[str, Any]) -> None:
    problem, check, origin = found.problem, found.check, found.provenance
    torques = zip(problem.actuators, check.peak_torque, problem.torque_limits, strict=True)
    speeds = zip(problem.coordinates, check.peak_speed, problem.speed_limits, strict=True)
    rows: list[tuple[str, object]] = [
        ("end time [s]", f"{found.trajectory.end_time:.6g}"),
        *((f"peak {n} [{u}]", f"{peak:.4g} of {limit:g}") for (n, u), peak, limit in torques),
        *((f"peak d{n} [{u}/s]", f"{v:.4g} of {limit:g}") for (n, u), v, limit in speeds),
        ("energy used [J]", output.figure(check.energy_used)),
        ("work done, and T + V gained [J]", f"{check.work:.6g}, {check.energy_change:.6g}"),
        ("worst ODE defect of an interval", output.figure(check.defect)),
        ("miss of the goal when played through", output.figure(check.drift)),
        ("cost", f"{origin.cost:.6g}"),
        ("from start", f"{origin.start_number} of seed {origin.seed}"),
        ("starts that converged", f"{origin.converged} of {origin.starts}"),
        (
            "intervals, Runge-Kutta steps in each",
            f"{len(found.trajectory.times) - 1}, {origin.steps}",
        ),
        ("largest V'/V on s = 0 [1/s]", output.figure(found.row.lyapunov_rate)),
        ("least input gain over that at the goal", output.figure(found.row.input_gain)),
        ("seconds", f"{document['seconds']:.1f}"),
    ]
    output.table(f"{problem.model}, set {problem.set_name}: plan", ("figure", "value"), rows)
    columns = ("case", "torque from", "largest |e|", "|e| at the end", "energy [J]", "peak", "held")
    lines = [
        (f.case, *_line(name, runs))
        for f in followed
        for name, runs in (("the law", f.law), ("playback", f.playback))
    ]
    output.table("following it (worst of the runs of each case)", columns, lines)


def _line(name: str, runs: Sequence[Run]) -> tuple[object, ...]:
    return (
        name,
        output.figure(max(max(r.error) for r in runs)),
        output.figure(max(r.end_error for r in runs)),
        output.figure(max(r.energy_used for r in runs)),
        output.figure(max(r.peak_torque for r in runs)),
        f"{sum(r.standing for r in runs)} of {len(runs)}",
    )
