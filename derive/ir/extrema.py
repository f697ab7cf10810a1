"""Rigorous extrema over a box: branch and bound on interval enclosures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pfaffian.derive.ir.evaluate_arrays import evaluate_at
from pfaffian.derive.ir.intervals import Interval, enclose
from pfaffian.derive.ir.program import Op, Program
from pfaffian.runtime.base.arrays import Array

Box = Mapping[str, tuple[float, float]]

#: Relative gap between the bound and a value attained at which the search ends.
GAP = 5e-3
#: A bound this close to what is attained is as good: outward rounding of zeros ends there.
_NOTHING = float(np.finfo(float).tiny)
_BATCH = 2048
_MOST_PASSES = 150
#: Instructions evaluated on boxes after which a search stops with the bound it has: more dimensions
#: need more boxes than anybody waits for.
_MOST_WORK = 300_000_000


@dataclass(frozen=True)
class Extremum:
    """An extremum over a box: `bound` is never passed, `attained` is taken at `at`.

    `boxes` counts the boxes enclosed. |bound - attained| is all that the bound may give away.
    """

    bound: float
    attained: float
    at: Mapping[str, float]
    boxes: int


@dataclass(frozen=True)
class Objective:
    """|numerator|/denominator of a program's outputs, with `fixed` for what is not searched.

    `gradient` names the outputs that hold the numerator's derivatives, by input. `denominator` is
    an output or empty for 1.
    """

    program: Program
    numerator: str
    denominator: str
    fixed: Mapping[str, float]
    gradient: Mapping[str, str]

    def at(self, points: Mapping[str, Array]) -> Array:
        """Return the value at `points`, shape (N,)."""
        found = evaluate_at(self.program, {**self.fixed, **points})
        below = found[self.denominator] if self.denominator else np.asarray(1.0)
        shape = np.shape(next(iter(points.values()), np.zeros(1)))  # a constant has no inputs
        with np.errstate(all="ignore"):
            return np.broadcast_to(np.abs(found[self.numerator]) / below, shape)

    def enclose(self, names: list[str], low: Array, high: Array) -> Interval:
        """Return bounds from both sides over boxes whose sides are rows (N, d) for `names`."""
        known = {n: (np.asarray(v), np.asarray(v)) for n, v in self.fixed.items()}
        ends = {n: (low[:, k], high[:, k]) for k, n in enumerate(names)}
        found = enclose(self.program, {**known, **ends})
        above = self._by_mean_value(found, names, low, high)
        below = found[self.denominator] if self.denominator else (np.ones(1), np.ones(1))
        crosses = (above[0] <= 0.0) & (above[1] >= 0.0)
        with np.errstate(all="ignore"):
            greatest = np.maximum(np.abs(above[0]), np.abs(above[1])) / below[0]
            least = np.where(crosses, 0.0, np.minimum(np.abs(above[0]), np.abs(above[1])))
            least = least / below[1]
        shape = (len(low),)
        up = np.where(np.isnan(greatest) | (below[0] <= 0.0), np.inf, greatest * (1.0 + 1e-15))
        return np.broadcast_to(least * (1.0 - 1e-15), shape), np.broadcast_to(up, shape)

    def _by_mean_value(
        self, found: Mapping[str, Interval], names: list[str], low: Array, high: Array
    ) -> Interval:
        """Return the numerator's enclosure, cut with f(middle) + gradient (x - middle)."""
        natural = found[self.numerator]
        if not self.gradient:
            return natural
        middle = (low + high) / 2.0
        points = {n: (middle[:, k], middle[:, k]) for k, n in enumerate(names)}
        known = {n: (np.asarray(v), np.asarray(v)) for n, v in self.fixed.items()}
        centre = enclose(self.program, {**known, **points})[self.numerator]
        reach = np.zeros(len(low))
        for k, name in enumerate(names):
            if name in self.gradient:
                slope = found[self.gradient[name]]
                half = np.maximum(high[:, k] - middle[:, k], middle[:, k] - low[:, k])
                with np.errstate(invalid="ignore"):  # an unbounded slope over no width
                    reach = reach + np.maximum(np.abs(slope[0]), np.abs(slope[1])) * half
        reach = np.where(np.isnan(reach), np.inf, reach * (1.0 + 1e-14))
        return np.maximum(natural[0], centre[0] - reach), np.minimum(natural[1], centre[1] + reach)


def restricted(program: Program, outputs: Sequence[str]) -> Program:
    """Return `program` with `outputs` alone, and only the inputs and instructions they need."""
    chosen = {o.name: (o, r) for o, r in zip(program.outputs, program.results, strict=True)}
    alive = {chosen[name][1] for name in outputs}
    for index in reversed(range(len(program.instructions))):
        if index in alive:
            alive.update(program.instructions[index].args)
    kept = sorted(alive)
    number = {old: new for new, old in enumerate(kept)}
    tape = [program.instructions[i] for i in kept]
    taken = [i for i, step in enumerate(program.instructions) if step.op is Op.INPUT]
    return replace(
        program,
        inputs=tuple(s for s, i in zip(program.inputs, taken, strict=True) if i in alive),
        instructions=tuple(replace(s, args=tuple(number[a] for a in s.args)) for s in tape),
        outputs=tuple(chosen[name][0] for name in outputs),
        results=tuple(number[chosen[name][1]] for name in outputs),
    )


def objective_of(
    program: Program, numerator: str, denominator: str, fixed: Mapping[str, float]
) -> Objective:
    """Return |numerator|/denominator (1 where empty), without what of `program` it does not need.

    The derivatives are the outputs `NUMERATOR_by_INPUT`, where there are any.
    """
    slopes = [o.name for o in program.outputs if o.name.startswith(f"{numerator}_by_")]
    wanted = [numerator, *([denominator] if denominator else []), *slopes]
    gradient = {name.partition("_by_")[2]: name for name in slopes}
    return Objective(restricted(program, wanted), numerator, denominator, fixed, gradient)


def greatest(objective: Objective, box: Box) -> Extremum:
    """Return the greatest value of `objective` over `box`.

    The bound is rigorous however early the search ends; it may be infinite.
    """
    return _Search(objective, box, 1.0).run()


def least(objective: Objective, box: Box) -> Extremum:
    """Return the least value of `objective` over `box`, as `greatest` does."""
    found = _Search(objective, box, -1.0).run()
    return Extremum(max(0.0, -found.bound), -found.attained, found.at, found.boxes)


class _Search:
    """Maximises sign * objective, best box first; boxes are rows (N, d) of their ends."""

    def __init__(self, objective: Objective, box: Box, sign: float) -> None:
        taken = {s.name for s in objective.program.inputs}
        self.objective, self.sign = objective, sign
        self.names = [n for n in box if n in taken]
        self.at = {n: (a + b) / 2.0 for n, (a, b) in box.items()}
        self.low = np.array([[box[n][0] for n in self.names]])
        self.high = np.array([[box[n][1] for n in self.names]])
        self.best, self.count = -np.inf, 0
        self._cost = len(objective.program.instructions)
        self.upper = self._bound(self.low, self.high)

    def run(self) -> Extremum:
        """Split the most promising boxes until the bound is within the gap of the best value."""
        settled = -np.inf
        self._probe(self.low, self.high)
        for _ in range(_MOST_PASSES):
            hopeful = self.upper > self.best + GAP * abs(self.best) + _NOTHING
            settled = max(settled, float(self.upper[~hopeful].max(initial=-np.inf)))
            self._keep(hopeful)
            if not len(self.upper) or not self.names or self.count * self._cost > _MOST_WORK:
                break
            self._advance()
        bound = max(settled, self.best, float(self.upper.max(initial=-np.inf)))
        return Extremum(bound, self.best, self.at, self.count)

    def _keep(self, chosen: Array) -> None:
        self.low, self.high, self.upper = self.low[chosen], self.high[chosen], self.upper[chosen]

    def _advance(self) -> None:
        """Take the boxes with the greatest bounds out, halve them, and put the halves back."""
        chosen = np.zeros(len(self.upper), bool)
        chosen[np.argsort(-self.upper, kind="stable")[:_BATCH]] = True
        low, high = self._halves(self.low[chosen], self.high[chosen])
        self._keep(~chosen)
        self._probe(low, high)
        upper = self._bound(low, high)
        self.low, self.high = np.vstack([self.low, low]), np.vstack([self.high, high])
        self.upper = np.concatenate([self.upper, upper])

    def _bound(self, low: Array, high: Array) -> Array:
        self.count += len(low)
        least, greatest = self.objective.enclose(self.names, low, high)
        return np.asarray(greatest if self.sign > 0.0 else -least).copy()

    def _probe(self, low: Array, high: Array) -> None:
        """Evaluate at the middle and two opposite corners of every box."""
        for points in ((low + high) / 2.0, low, high):
            values = {n: points[:, k] for k, n in enumerate(self.names)}
            found = self.sign * self.objective.at(values)
            found = np.where(np.isfinite(found), found, -np.inf)
            index = int(np.argmax(found))
            if found[index] > self.best:
                self.best = float(found[index])
                here = dict(zip(self.names, map(float, points[index]), strict=True))
                self.at = {**self.at, **here}

    def _halves(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Halve every box across the side whose collapse to its middle lowers the bound most."""
        middle = (low + high) / 2.0
        bounds = np.empty(low.shape)
        for k in range(low.shape[1]):
            thin_low, thin_high = low.copy(), high.copy()
            thin_low[:, k] = thin_high[:, k] = middle[:, k]
            bounds[:, k] = self._bound(thin_low, thin_high)
            bounds[high[:, k] <= low[:, k], k] = np.inf
        # Where nothing tells the sides apart (all bounds infinite), the widest one is halved.
        tied = np.ptp(np.where(np.isfinite(bounds), bounds, 1e300), axis=1) == 0.0
        side = np.where(tied, np.argmax(high - low, axis=1), np.argmin(bounds, axis=1))
        rows = np.arange(len(side))
        left, right = high.copy(), low.copy()
        left[rows, side] = right[rows, side] = middle[rows, side]
        return np.vstack([low, right]), np.vstack([left, high])
