"""Complete, judged parameter sets: every value known, and a design that can work."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.names import (
    CONSERVED,
    CYCLIC,
    MASS_MATRIX,
    POLES_KEY,
    SWING_UP_PROGRAM,
    TIME_NAME,
)
from pfaffian.derive.sets.definiteness import (
    Definiteness,
    definiteness,
    points_within_bounds,
    worded,
)
from pfaffian.derive.sets.equilibrium import solve_setpoint
from pfaffian.derive.sets.gains import (
    is_hurwitz,
    places_poles,
    roots_of,
    synthesise_gains,
    zero_order,
    zero_polynomial,
)
from pfaffian.derive.sets.raw_set import RawSet
from pfaffian.derive.sets.routh import (
    hurwitz_margins,
    violated_margins,
    violated_rows,
    worded_margins,
)
from pfaffian.derive.sets.swing_up_limit import is_regular, largest_limit
from pfaffian.runtime.base.errors import InputError

#: Real poles proposed where a given set of gains is refused.
PROPOSED_POLE = -6.0
#: Real part, beside the largest root, that rounding gives a root on the imaginary axis: the square
#: root of the rounding of the coefficients, for a double one.
_ON_THE_AXIS = 2.0**-24


class IncompleteSetError(InputError):
    """A parameter set that says nothing of something the model needs, as of its gains."""


@dataclass(frozen=True)
class ParameterSet:
    """All parameters of a model in SI units, by name, in the order of declaration.

    `notes` say what was changed on the way from the file: set-points that were solved for.
    """

    name: str
    title: str
    source: str
    values: tuple[tuple[str, float], ...]
    #: What is worth saying of a set that is accepted all the same.
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, float]:
        """Return the values by name."""
        return dict(self.values)

    def digest(self) -> str:
        """Return the SHA-256 of names and exact values."""
        exact = [[name, value.hex()] for name, value in self.values]
        return hashlib.sha256(json.dumps(exact).encode()).hexdigest()


def resolve_set(model: LoweredModel, raw: RawSet, *, judge: bool = True) -> ParameterSet:
    """Complete `raw` with lumped, synthesised and default values, and judge it.

    A set-point that was rounded or left out is solved for. Raises `InputError` for a missing
    parameter, a mass matrix that is not positive definite, and a setpoint that is no equilibrium
    nor rounded from one; where it is to `judge` also for a setpoint in the singular
    set, unstable zero dynamics and a swing-up law that is singular somewhere: `design` shows the
    figures of any gains.
    """
    defaults = {p.name: p.default for p in model.parameters if p.default is not None}
    values = defaults | dict(raw.values)
    _complete_plant(model, raw, values)
    _require(model, raw, values, ("plant", "gain", "target"))
    rest = solve_setpoint(model, raw, values)
    values |= rest.values
    rankless = _check_mass_matrix(model, raw, values)
    if raw.poles:
        values |= synthesise_gains(model, values, raw.poles, f"{raw.path}: gains.{POLES_KEY}")
        for parameter in model.parameters:
            if parameter.group == "synthesised":
                parameter.check(values[parameter.name], f"{raw.path}: gains.{POLES_KEY}")
    _require(model, raw, values, ("synthesised",))
    if judge:
        _check_rest(model, raw, values)
        _check_zero_dynamics(model, raw, values)
        _check_setpoint_gain(model, raw, values)
        _check_swing_up(model, raw, values)
    ordered = tuple((p.name, values[p.name]) for p in model.parameters if p.name in values)
    notes = (*rest.notes, *([rankless] if rankless else []))
    return ParameterSet(raw.name, raw.title, raw.source, ordered, notes)


def cyclic_notes(model: LoweredModel) -> tuple[str, ...]:
    """Return of each cyclic coordinate that s does not see what can be asked for."""
    if not model.has_program(CYCLIC):
        return ()
    return tuple(signal.description for signal in model.program(CYCLIC).outputs)


def _complete_plant(model: LoweredModel, raw: RawSet, values: dict[str, float]) -> None:
    given = [p for p in model.parameters if p.group == "physical" and p.name in values]
    if not given:
        _require(model, raw, values, ("lumped",))
        return
    _require(model, raw, values, ("physical",))
    lumped = evaluate(model.program("lumping"), values)
    for parameter in model.parameters:
        if parameter.name in lumped:
            parameter.check(lumped[parameter.name], f"{raw.path}: parameters (lumped)")
    values |= lumped


def _require(
    model: LoweredModel, raw: RawSet, values: Mapping[str, float], groups: tuple[str, ...]
) -> None:
    missing = [
        p
        for p in model.parameters
        if p.group in groups and p.name not in values and p.default is None
    ]
    if missing:
        first = missing[0]
        unit = f" in {first.unit}" if first.unit else ""
        raise IncompleteSetError(
            f"{raw.path}: missing {', '.join(p.name for p in missing)}",
            remedy=f"add {first.name} ({first.description}){unit}, or start from another set "
            f'with extends = "..."',
        )


def _check_mass_matrix(model: LoweredModel, raw: RawSet, values: Mapping[str, float]) -> str:
    """Refuse a mass matrix that is not positive definite within the declared bounds.

    Where it only loses rank at single points, the coordinates are at fault and not the inertias:
    what is to be said of that is returned.
    """
    setpoint = evaluate(model.program("setpoint"), values)
    rankless = None
    for at in points_within_bounds(model, setpoint):
        found = definiteness(model, {**values, **at})
        if found is Definiteness.POSITIVE:
            continue
        if found is Definiteness.NONE:
            inertias = ", ".join(
                f"{s.name} = {values[s.name]:.6g}"
                for s in model.program(MASS_MATRIX).inputs
                if s.group == "parameter"
            )
            minors = evaluate(model.program("mass_minors"), {**values, **at})
            worst = min(minors.items(), key=lambda item: item[1])
            raise InputError(
                f"{raw.path}: the mass matrix is not positive definite at {worded(model, at)}: "
                f"{worst[0]} = {worst[1]:.3g} with {inertias}",
                remedy="check the inertias: no rigid mechanism has this mass matrix",
            )
        if all(at[name] == setpoint[name] for name in at):
            raise InputError(
                f"{raw.path}: the mass matrix loses rank at the setpoint, {worded(model, at)}",
                remedy="choose other coordinates or another setpoint",
            )
        rankless = rankless or at
    if rankless is None:
        return ""
    return (
        f"set {raw.name}: the mass matrix loses rank at {worded(model, rankless)}, within the "
        "declared bounds; nothing can be controlled there: declare a smaller bound in spec.py"
    )


def _check_setpoint_gain(model: LoweredModel, raw: RawSet, values: Mapping[str, float]) -> None:
    setpoint = evaluate(model.program("setpoint"), values)
    at_rest = {**_at_rest(model), **values, **setpoint}
    adb = evaluate(model.program("input_gain"), at_rest)["adb"]
    least = values["singular_threshold"]
    if not abs(adb) >= least:
        raise InputError(
            f"{raw.path}: the setpoint lies in the singular set: |ADB| = {abs(adb):.4g} there, "
            f"below target.singular_threshold = {least:.4g}",
            remedy="choose gains with a larger input gain, or lower the threshold",
        )


def _check_swing_up(model: LoweredModel, raw: RawSet, values: Mapping[str, float]) -> None:
    """Refuse gains for which the denominator of the energy swing-up law has a zero somewhere."""
    if not model.has_program(SWING_UP_PROGRAM) or is_regular(
        model, values, values["kD"] / values["kE"]
    ):
        return
    found = largest_limit(model, values)
    unit = model.program(SWING_UP_PROGRAM).outputs[0].unit
    units = {p.name: p.unit for p in model.parameters}
    ratio, least = values["kD"] / values["kE"], _just_above(found.most * values["kE"])
    at = ", ".join(f"{n} = {v:.3g}" for n, v in found.at.items())
    raise InputError(
        f"{raw.path}: the swing-up law is singular in some state: kD/kE = {ratio:.6g} {unit} is "
        f"{found.most - ratio:.4g} short of {found.most:.6g}, (V(goal) - V(q)) det M/N"
        + (f" at {at}" if at else ""),
        remedy=f'raise swing_up.kD to at least "{least:g} {units["kD"]}", or lower swing_up.kE',
    )


def _just_above(value: float) -> float:
    """Return a number of four digits that exceeds a positive `value` by at least a thousandth."""
    scale = 10.0 ** (math.floor(math.log10(value)) - 3) if 0.0 < value < math.inf else 1.0
    return math.ceil(1.001 * value / scale) * scale


def _check_rest(model: LoweredModel, raw: RawSet, values: Mapping[str, float]) -> None:
    """Refuse a setpoint at which the servo-constraint itself does not rest."""
    if not model.has_program("rest_constraint"):
        return
    program = model.program("rest_constraint")
    # What counts as zero: small against the same with any one parameter moved or doubled.
    names = [s.name for s in program.inputs]
    moved = [{n: change(values[n])} for n in names for change in (_next, _doubled)]
    elsewhere = [evaluate(program, {**values, **at}) for at in moved]
    for signal, value in zip(program.outputs, evaluate(program, values).values(), strict=True):
        sizes = [abs(e[signal.name]) for e in elsewhere]
        scale = max([s for s in sizes if math.isfinite(s)], default=0.0)
        if not abs(value) <= 1e-9 * scale:
            raise InputError(
                f"{raw.path}: the servo-constraint does not rest at the setpoint: "
                f"{signal.description} is {value:.4g} {signal.unit} there",
                remedy="mend the setpoint, or the constraint",
            )


def _next(value: float) -> float:
    return value + 1.0


def _doubled(value: float) -> float:
    return 2.0 * value


def _at_rest(model: LoweredModel) -> dict[str, float]:
    return {f"d{c.name}": 0.0 for c in model.coordinates} | {TIME_NAME: 0.0}


def _check_zero_dynamics(model: LoweredModel, raw: RawSet, values: Mapping[str, float]) -> None:
    coefficients = zero_polynomial(model, values)
    if is_hurwitz(coefficients):
        return
    violated = violated_bounds(model, values)
    roots = roots_of(coefficients) if coefficients[0] else ()
    poles = ", ".join(f"{r:.4g}" for r in roots) if roots else "none"
    gains = [p.name for p in model.parameters if p.group == "synthesised"]
    given = ", ".join(f"{g} = {values[g]:.6g}" for g in gains)
    what = "marginal, nothing damps them," if is_marginal(roots) else "unstable"
    raise InputError(
        f"{raw.path}: the zero dynamics are {what} with {given}: poles {poles} 1/s"
        + (f"; violated: {'; '.join(violated)}" if violated else ""),
        remedy=_proposal(model, values, any("never holds" in text for text in violated)),
    )


def is_marginal(roots: Sequence[complex]) -> bool:
    """Return whether no root lies right of the imaginary axis beyond the rounding of a pair."""
    size = max((abs(r) for r in roots), default=0.0)
    return bool(roots) and all(r.real <= _ON_THE_AXIS * size for r in roots)


def violated_bounds(model: LoweredModel, values: Mapping[str, float]) -> list[str]:
    """Return the stability conditions that do not hold, and by how much.

    They are those the specification words itself, for the plant without friction; where it words
    none, or they all hold, those derived, with friction; and failing these a row of Routh's array.
    """
    return (
        violated_margins(worded_margins(model, values))
        or violated_margins(hurwitz_margins(model, values))
        or violated_rows(zero_polynomial(model, values))
    )


def _proposal(model: LoweredModel, values: Mapping[str, float], never: bool) -> str:
    """Return gains that make the zero dynamics stable, or why there are none to propose."""
    never = never or not any(p.group == "synthesised" for p in model.parameters)
    if places_poles(model) and not never:
        poles = (complex(PROPOSED_POLE),) * zero_order(model)
        with contextlib.suppress(InputError):
            gains = synthesise_gains(model, values, poles, "proposal")
            if is_hurwitz(zero_polynomial(model, {**values, **gains})):
                return f"for poles at {PROPOSED_POLE:g} take {_written(model, gains)}, or give " + (
                    POLES_KEY
                )
    if model.has_program(CONSERVED):
        notes = "; ".join(s.description for s in model.program(CONSERVED).outputs)
        return f"{notes}: leave what turns or moves against it out of the servo-constraint"
    if never:
        return "choose another servo-constraint: no gains of this one make them stable"
    return "choose other gains, which pfaffian design may find, or another servo-constraint"


def _written(model: LoweredModel, gains: Mapping[str, float]) -> str:
    units = {p.name: p.unit for p in model.parameters}
    return ", ".join(
        f'{n} = "{v:.6g} {units[n]}"' if units[n] else f"{n} = {v:.6g}" for n, v in gains.items()
    )
