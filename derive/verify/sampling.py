"""Random inputs of a block: half around the known parameter sets, half over the whole domain."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp
from pfaffian.derive.elementary.coefficients import SINCOS_MAX
from pfaffian.derive.emit.bounds import measured_bounds
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.parameter import Parameter
from pfaffian.derive.ir.program import Signal
from pfaffian.derive.symbolic.block import Block
from pfaffian.derive.symbolic.numeric import function_of
from pfaffian.derive.verify.intermediate_values import NamedValues, has_domains
from pfaffian.derive.verify.ulp_unit import DOUBLE_UNIT, UlpUnit
from pfaffian.runtime.base.arrays import Array

#: Smallest magnitude drawn where a bound is zero, and largest for states that have no bound.
_SMALL, _LARGE = 1e-6, 1e4
#: How far from the values in the sets parameters without bounds are drawn, and those that are zero.
_AROUND, _UNSET = 1e6, 1e3
#: Smallest magnitude of a measurement that is drawn, besides zero, as a share of its bound.
_LEAST_SHARE = 1e-9


@dataclass(frozen=True)
class Samples:
    """Inputs by name, float64 of shape (N,); `near` (N,) marks those around a parameter set.

    `beyond` counts draws that were given up because the precision cannot hold what they lead to,
    `beyond_near` those around a parameter set.
    """

    values: dict[str, Array]
    near: Array
    beyond: int = 0
    beyond_near: int = 0


def draw(
    model: LoweredModel,
    inputs: Sequence[Signal],
    sets: Sequence[Mapping[str, float]],
    count: int,
    rng: np.random.Generator,
    unit: UlpUnit = DOUBLE_UNIT,
    holds: Callable[[Mapping[str, Array]], Array] | None = None,
    block: Block | None = None,
    fixed: Mapping[str, float] | None = None,
) -> Samples:
    """Return `count` samples of each of `inputs`, those of `block`, all of which `unit` holds.

    Measurements lie within what the generated code takes for one, and inputs named in `fixed` have
    that one value, as where a parameter set is folded into the code. A sample is redrawn, where it
    was drawn, until the mass matrix is positive definite there, the precision `holds` what follows
    from it, and `block` takes no sine of an angle beyond `SINCOS_MAX`, as of a fast reference after
    a long time, and no root or logarithm of a negative number: there the formulas say nothing.
    """
    angles = _angles(block) if block else []
    real = NamedValues(block).are_real if block and has_domains(block) else None
    near = rng.random(count) < (0.5 if sets else 0.0)
    given = fixed or {}

    def mixed(near: Array) -> dict[str, Array]:
        values = _rounded(model, _mixed(model, inputs, sets, near, rng), unit)
        return {n: np.full_like(v, given[n]) if n in given else v for n, v in values.items()}

    values = mixed(near)
    beyond, beyond_near, open_ = 0, 0, np.arange(count)
    for _ in range(200):
        now = {n: v[open_] for n, v in values.items()}
        physical = _is_physical(model, now) & _is_in_range(angles, now)
        if real:
            physical &= real(now)
        held = holds(now) if holds else np.ones(len(open_), bool)
        beyond += int((physical & ~held).sum())
        beyond_near += int((physical & ~held & near[open_]).sum())
        open_ = open_[~(physical & held)]
        if not len(open_):
            return Samples(values, near, beyond, beyond_near)
        again = mixed(near[open_])
        for name, column in values.items():
            column[open_] = again[name]
    raise RuntimeError("no physical parameters found in 200 draws")


def _rounded(model: LoweredModel, values: dict[str, Array], unit: UlpUnit) -> dict[str, Array]:
    bounds = {p.name: unit.bounds(p) for p in model.parameters}
    bounds |= {n: (-b, b) for n, b in measured_domain(model, unit).items()}
    rounded = {n: unit.rounded(v) for n, v in values.items()}
    return {n: np.clip(v, *bounds[n]) if n in bounds else v for n, v in rounded.items()}


def _mixed(
    model: LoweredModel,
    inputs: Sequence[Signal],
    sets: Sequence[Mapping[str, float]],
    near: Array,
    rng: np.random.Generator,
) -> dict[str, Array]:
    wide = _wide(model, inputs, sets, len(near), rng)
    local = _near(model, inputs, wide, sets, len(near), rng) if sets else wide
    return {n: np.where(near, local[n], wide[n]) for n in wide}


def _drawn(parameter: Parameter, sets: Sequence[Mapping[str, float]]) -> tuple[float, float]:
    """Return between what a parameter is drawn: its bounds, or around the sets without any."""
    lower, upper = parameter.lower, parameter.upper
    if math.isfinite(lower) and math.isfinite(upper):
        return lower, upper
    sizes = [abs(s[parameter.name]) for s in sets if s.get(parameter.name)] or [_UNSET / _AROUND]
    least = min(sizes) / _AROUND if parameter.lower_open and lower == 0.0 else lower
    most = max(sizes) * _AROUND
    return max(least, -most), min(upper, most)


def _wide(
    model: LoweredModel,
    inputs: Sequence[Signal],
    sets: Sequence[Mapping[str, float]],
    count: int,
    rng: np.random.Generator,
) -> dict[str, Array]:
    """Draw over the whole stated domain.

    Measurements are drawn evenly, with a third of them of magnitudes down to a billionth of the
    bound, on the edge or zero; everything else evenly in the logarithm of its magnitude.
    """
    bounds = {p.name: _drawn(p, sets) for p in model.parameters}
    domain, own = dict(measured_bounds(model)), model.own
    values = {}
    for signal in inputs:
        if signal.name in domain:
            values[signal.name] = _measurements(domain[signal.name], count, rng)
        elif signal.name == own("engaged"):
            values[signal.name] = rng.integers(0, 2, count).astype(float)
        elif signal.name == own("leakage_decay"):
            values[signal.name] = rng.uniform(0.0, 1.0, count)
        elif signal.group == "parameter":
            values[signal.name] = _within(*bounds[signal.name], count, rng)
        else:
            positive = (own("bound_estimate"), own("adaptation_step"))
            low = 0.0 if signal.name in positive else -_LARGE
            values[signal.name] = _within(low, _LARGE, count, rng)
    return values


def _measurements(bound: float, count: int, rng: np.random.Generator) -> Array:
    even = rng.uniform(-1.0, 1.0, count)
    small = np.sign(even) * _LEAST_SHARE ** rng.uniform(0.0, 1.0, count)
    kind = rng.uniform(0.0, 1.0, count)
    shares = np.select([kind < 0.65, kind < 0.9, kind < 0.95], [even, small, np.sign(even)], 0.0)
    return shares * bound


def measured_domain(model: LoweredModel, unit: UlpUnit) -> dict[str, float]:
    """Return each measurement with the largest magnitude that the generated code takes for one."""
    return {name: unit.below(bound) for name, bound in measured_bounds(model)}


def _within(lower: float, upper: float, count: int, rng: np.random.Generator) -> Array:
    """Draw magnitudes evenly in their logarithm; both signs where the interval has both."""
    least = lower if lower > 0.0 else min(_SMALL, upper * 1e-3)
    share = rng.uniform(0.0, 1.0, count)
    values = least * (upper / least) ** share
    if lower < 0.0:
        most = abs(lower)
        below = -min(least, most) * (most / min(least, most)) ** share
        values = np.where(rng.choice([True, False], count), below, values)
    return np.clip(values, lower, upper)


def _near(
    model: LoweredModel,
    inputs: Sequence[Signal],
    wide: Mapping[str, Array],
    sets: Sequence[Mapping[str, float]],
    count: int,
    rng: np.random.Generator,
) -> dict[str, Array]:
    """Draw around the parameter sets: parameters within 30 %, motions of a few turns a second.

    Where a measurement has a narrower domain than that, half of it is the standard deviation.
    """
    which, domain = rng.integers(0, len(sets), count), dict(measured_bounds(model))
    bounds = {p.name: (p.lower, p.upper) for p in model.parameters}
    values = {}
    for signal in inputs:
        if signal.group == "parameter":
            base = np.array([s[signal.name] for s in sets])[which]
            around = base * rng.uniform(0.7, 1.3, count)
            values[signal.name] = np.clip(around, *bounds[signal.name])
        elif signal.group in ("input", "torque"):
            spread = min(3.0, 0.5 * domain.get(signal.name, math.inf))
            values[signal.name] = rng.normal(0.0, spread, count)
        elif signal.name in (model.own("engaged"), model.own("leakage_decay")):
            values[signal.name] = wide[signal.name]
        else:
            values[signal.name] = np.abs(rng.normal(0.0, 3.0, count)) * np.sign(wide[signal.name])
    return values


def _angles(block: Block) -> list[tuple[tuple[str, ...], Callable[..., Any]]]:
    """Return each angle whose sine or cosine `block` takes: the inputs it needs, its function."""
    known = {d.symbol: d.expression for d in block.definitions}
    taken = {
        f.args[0].xreplace(known): None
        for d in block.definitions
        for f in sorted(d.expression.atoms(sp.sin, sp.cos), key=sp.default_sort_key)
    }
    rows = []
    for angle in taken:
        needs = sorted(angle.free_symbols, key=lambda s: s.name)
        if set(needs) <= set(block.symbols):
            rows.append((tuple(s.name for s in needs), function_of(needs, angle, "numpy")))
    return rows


def _is_in_range(
    angles: Sequence[tuple[tuple[str, ...], Callable[..., Any]]], values: Mapping[str, Array]
) -> Array:
    good = np.ones(len(next(iter(values.values()))), bool)
    for needs, angle in angles:
        good &= np.abs(angle(*(values[n] for n in needs))) <= SINCOS_MAX
    return good


def _is_physical(model: LoweredModel, values: Mapping[str, Array]) -> Array:
    program = model.program("mass_minors")
    names = [s.name for s in program.inputs]
    count = len(next(iter(values.values())))
    if not set(names) <= set(values):
        return np.ones(count, bool)
    columns = zip(*(values[n].tolist() for n in names), strict=True)
    return np.array(
        [
            all(m > 0.0 for m in evaluate(program, dict(zip(names, row, strict=True))).values())
            for row in columns
        ]
    )
