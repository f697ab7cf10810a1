"""Gains from poles or weights, and motions to the setpoint, as results in Python."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.api.display import html_table, keywords

if TYPE_CHECKING:
    import numpy as np
    from pfaffian.api.parameters import Parameters
    from pfaffian.derive.derivation.derive import Derivation
    from pfaffian.derive.design.study import Study, Wishes
    from pfaffian.derive.ir.lowered import LoweredModel
    from pfaffian.derive.plan.planner import Plan
    from pfaffian.derive.plan.wishes import Wishes as PlanWishes
    from pfaffian.derive.sets.raw_set import RawSet

    Array = np.ndarray[Any, np.dtype[Any]]


@dataclass(frozen=True, kw_only=True, eq=False)
class DesignResult:
    """What a set of gains amounts to.

    `gains` are in SI units by name, `poles` those of the zero dynamics in 1/s. `changed` has them,
    and what was proposed, as a set holds them: `model.parameters(set, **changed)`; `failure`
    says why the design is not stable, and is empty where it is. `document` is what
    `pfaffian design --json` prints.
    """

    model: str
    set_name: str
    method: str
    gains: Mapping[str, float]
    poles: tuple[complex, ...]
    stable: bool
    input_gain: float
    decay_rate: float
    changed: Mapping[str, str]
    failure: str
    document: Mapping[str, Any]
    _study: Study = field(repr=False)

    def __repr__(self) -> str:
        """Return one line."""
        gains = ", ".join(f"{n} = {v:.6g}" for n, v in self.gains.items())
        stable = "stable" if self.stable else "unstable"
        return f"<design of {self.model} {self.set_name} by {self.method}: {gains}, {stable}>"

    def _repr_html_(self) -> str:
        rows: list[tuple[str, object]] = list(self.gains.items())
        rows.append(("zero-dynamics poles [1/s]", ", ".join(f"{p:.4g}" for p in self.poles)))
        rows += [("stable", self.stable), ("ADB at the setpoint", self.input_gain)]
        return html_table(f"{self.model}, {self.set_name}", ("figure", "value"), rows)


def design(model: LoweredModel, raw: RawSet, wishes: Wishes) -> DesignResult:
    """Carry out a study of `raw` and return what was found."""
    from pfaffian.derive.design.study import study

    with keywords():
        found = study(model, raw, wishes)
    units = {p.name: p.unit for p in model.parameters}
    return DesignResult(
        model=found.model,
        set_name=found.parameters.name,
        method=found.method,
        gains=dict(found.design.gains),
        poles=found.design.zero_dynamics_poles,
        stable=found.design.stable,
        input_gain=found.design.input_gain,
        decay_rate=found.design.decay_rate,
        changed={n: f"{v!r} {units[n]}".rstrip() for n, v in found.changed().items()},
        failure=found.failure(),
        document={**found.as_json(), "notes": list(found.parameters.notes)},
        _study=found,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionPlan:
    """A planned motion from rest to the setpoint, in SI units, checked against the ODE.

    `time` is (N+1,), `states` (N+1, 2n) of (q, q'), `torques` (N+1, m) at the nodes; `peak_torque`
    (m,) and `energy_used` are those of the check, `defect` its largest miss of a node.
    """

    model: str
    set_name: str
    time: Array
    states: Array
    torques: Array
    peak_torque: tuple[float, ...]
    energy_used: float
    defect: float
    _plan: Plan = field(repr=False)

    def save(self, path: str | Path) -> Path:
        """Write the plan as JSON, which `generate(plan=...)` takes; return the path."""
        from pfaffian.derive.plan.document import plan_text
        from pfaffian.runtime.base.files import write_outputs

        write_outputs({Path(path): plan_text(self._plan).encode()})
        return Path(path)

    def __repr__(self) -> str:
        """Return one line."""
        peaks = ", ".join(f"{p:.4g}" for p in self.peak_torque)
        return (
            f"<plan of {self.model} {self.set_name}: {self.time[-1]:.4g} s, "
            f"{len(self.time)} nodes, peak torque {peaks}>"
        )


def plan(derivation: Derivation, parameters: Parameters, wishes: PlanWishes) -> MotionPlan:
    """Plan a motion to the setpoint of `parameters`."""
    from pfaffian.derive.plan.planner import make_plan
    from pfaffian.derive.plan.wishes import read_row_weights, read_wishes

    with keywords():
        options = read_wishes(derivation.spec, wishes)
        weights = read_row_weights(derivation.spec, wishes.riccati)
        found = make_plan(derivation, parameters._set, options, weights)
    return MotionPlan(
        model=found.problem.model,
        set_name=found.problem.set_name,
        time=found.trajectory.times,
        states=found.trajectory.states,
        torques=found.trajectory.torques,
        peak_torque=found.check.peak_torque,
        energy_used=found.check.energy_used,
        defect=found.check.defect,
        _plan=found,
    )


def joined(values: Iterable[object]) -> str:
    """Return values as options of the command line have them: separated by commas."""
    return ",".join(map(str, values))


def assignments(values: Mapping[str, Any] | None) -> str:
    """Return values by name as options of the command line have them: NAME=VALUE,..."""
    return joined(f"{name}={value}" for name, value in (values or {}).items())


def pole_text(pole: complex | str) -> str:
    """Return a pole as the option `--poles` has it, with all its digits."""
    if isinstance(pole, str):
        return pole
    value = complex(pole)
    return f"{value.real!r}{value.imag:+}j" if value.imag else repr(value.real)
