"""The comparison: every function of the generated code, in every language, on the same samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import numpy as np
from pfaffian.derive.derivation.derive import Derivation
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.symbolic.block import Block
from pfaffian.derive.verify.condition import Condition
from pfaffian.derive.verify.intermediate_values import NamedValues, values_of
from pfaffian.derive.verify.oracle import Oracle, absolute_error
from pfaffian.derive.verify.sampling import Samples, draw
from pfaffian.derive.verify.ulp_unit import DOUBLE_UNIT, UlpUnit
from pfaffian.runtime.base.arrays import Array

#: Functions of the generated code, by the block each was lowered from; a model may lack the last.
FUNCTIONS = ("step", "prepare", "continuous", "acceleration", "energy", "swing_up")
#: What is verified besides where the generated code follows a plan.
FOLLOWING = ("follow",)
#: What a parameter set is folded into.
FOLDED = ("step", "prepare")
#: What a correct build stays below, in condition-scaled units in the last place.
LIMIT_ULP = 4.0
_CHUNK = 5_000
_SEED = 20_260_101


class Subject(Protocol):
    """Generated code in one language or on one machine."""

    name: str

    def evaluate(self, function: str, values: Mapping[str, Array]) -> dict[str, Array]:
        """Return the outputs of `function` by name, float64 of shape (N,)."""


@dataclass(frozen=True)
class FunctionResult:
    """The worst scaled error of one function in one language, and where it was."""

    function: str
    language: str
    samples: int
    worst_scaled_ulp: float
    output: str
    at: Mapping[str, float]
    worst_input_scaled_ulp: float
    worst_input_scaled_ulp_near_sets: float
    #: The worst scaled error around the parameter sets, and the samples that could not be judged.
    worst_scaled_ulp_near_sets: float = 0.0
    undecided: int = 0


@dataclass(frozen=True)
class Verification:
    """What a verification found; `passed` is judged against `LIMIT_ULP` and zero mismatches."""

    samples: int
    worst_scaled_ulp: float
    target_samples: int
    target_mismatches: int
    undecided: int
    functions: tuple[FunctionResult, ...]
    branches: Mapping[str, float]
    precision: str = "double"
    #: Draws given up because the precision cannot hold a value they lead to; so around the sets.
    beyond: int = 0
    beyond_near: int = 0
    #: Samples that differ only because the emulator rounds a single multiply-add twice.
    emulator_roundings: int = 0

    @property
    def passed(self) -> bool:
        """Return whether every error is below the limit and host and target agree in all bits.

        A function of which most samples could not be judged has not been verified.
        """
        judged = all(2 * r.undecided < max(r.samples, 1) for r in self.functions)
        return judged and self.worst_scaled_ulp <= LIMIT_ULP and self.target_mismatches == 0

    def as_json(self) -> dict[str, object]:
        """Return the document `pfaffian verify --json` prints."""
        return {**asdict(self), "limit_ulp": LIMIT_ULP, "passed": self.passed}


@dataclass
class _Tally:
    """Running worst case of one function in one language."""

    worst: float = -1.0
    output: str = ""
    at: Mapping[str, float] | None = None
    worst_near: float = 0.0
    worst_by_input: float = 0.0
    worst_by_input_near: float = 0.0
    undecided: int = 0


def verify(
    derivation: Derivation,
    model: LoweredModel,
    sets: Sequence[Mapping[str, float]],
    subjects: Sequence[Subject],
    target: Subject | None,
    samples: int,
    target_samples: int,
    progress: Callable[[int, int], None] | None = None,
    unit: UlpUnit = DOUBLE_UNIT,
    witness: Subject | None = None,
    functions: Sequence[str] = FUNCTIONS,
    baked: Mapping[str, float] | None = None,
) -> Verification:
    """Compare `subjects` with the oracle on `samples` inputs of every function.

    The first subject that is not Python is the host whose bits `target` must repeat on the first
    `target_samples` inputs. The same seed gives the same samples on every machine. Inputs are
    those that `unit` holds, and errors are counted in it. Where the bits differ, `witness` may
    show that the emulator alone is to blame: samples where the target has its bits are counted
    apart. `baked` are the parameters that are folded into the code: what begins with `init` takes
    no others.
    """
    functions = [f for f in functions if model.has_program(f)]
    counts = _Counts()
    for number, function in enumerate(functions):
        block = derivation.block(function)
        judge = _Judge(model, block, unit)
        rng = np.random.default_rng([_SEED, number])
        fixed = baked if function in FOLDED else None
        for start in range(0, samples, _CHUNK):
            count = min(_CHUNK, samples - start)
            drawn = draw(model, block.inputs, sets, count, rng, unit, judge.holds, block, fixed)
            for_target = max(0, min(count, target_samples - start)) if target else 0
            computed = _computed(function, drawn.values, subjects, target, for_target)
            counts.beyond += drawn.beyond
            counts.beyond_near += drawn.beyond_near
            counts.undecided += judge.update(drawn, computed, counts.tallies)
            if target and for_target:
                here, there = computed[_host(subjects).name], computed[target.name]
                part = {n: v[:for_target] for n, v in drawn.values.items()}
                counts.compare_bits(function, here, there, part, witness)
            if function in ("step", "swing_up"):
                _count_branches(counts.branches, block, judge.last_exact, samples)
            counts.done += count
            if progress:
                progress(counts.done, samples * len(functions))
    drawn_for = {s.name: samples for s in subjects}
    drawn_for |= {target.name: target_samples} if target else {}
    return counts.verification(functions, drawn_for, samples, unit.precision)


@dataclass
class _Counts:
    """What is counted while functions are compared."""

    tallies: dict[tuple[str, str], _Tally] = field(default_factory=dict)
    branches: dict[str, float] = field(default_factory=dict)
    mismatches: int = 0
    undecided: int = 0
    compared: int = 0
    done: int = 0
    beyond: int = 0
    beyond_near: int = 0
    emulated: int = 0

    def compare_bits(
        self,
        function: str,
        here: Mapping[str, Array],
        there: Mapping[str, Array],
        values: Mapping[str, Array],
        witness: Subject | None,
    ) -> None:
        """Count the samples with other bits on the target, those of the emulator alone apart."""
        differs = _differing(here, there)
        if witness and differs.any():
            known = ~_differing(witness.evaluate(function, values), there)
            self.emulated += int((differs & known).sum())
            differs &= ~known
        self.mismatches += int(differs.sum())
        self.compared += len(differs) if function == "step" else 0

    def verification(
        self, functions: Sequence[str], drawn: Mapping[str, int], samples: int, precision: str
    ) -> Verification:
        """Return what was found of `functions`, with `drawn` samples by subject."""
        results = tuple(
            FunctionResult(
                function=f,
                language=name,
                samples=count,
                worst_scaled_ulp=t.worst,
                output=t.output,
                at=t.at or {},
                worst_input_scaled_ulp=t.worst_by_input,
                worst_input_scaled_ulp_near_sets=t.worst_by_input_near,
                worst_scaled_ulp_near_sets=t.worst_near,
                undecided=t.undecided,
            )
            for f in functions
            for name, count in drawn.items()
            if (t := self.tallies.get((f, name))) is not None
        )
        return Verification(
            samples=samples,
            worst_scaled_ulp=max(r.worst_scaled_ulp for r in results),
            target_samples=self.compared,
            target_mismatches=self.mismatches,
            undecided=self.undecided,
            functions=results,
            branches=self.branches,
            precision=precision,
            beyond=self.beyond,
            beyond_near=self.beyond_near,
            emulator_roundings=self.emulated,
        )


def _host(subjects: Sequence[Subject]) -> Subject:
    return next(s for s in subjects if s.name != "python")


def _computed(
    function: str,
    values: Mapping[str, Array],
    subjects: Sequence[Subject],
    target: Subject | None,
    for_target: int,
) -> dict[str, dict[str, Array]]:
    computed = {s.name: s.evaluate(function, values) for s in subjects}
    if target and for_target:
        part = {n: v[:for_target] for n, v in values.items()}
        computed[target.name] = target.evaluate(function, part)
    return computed


def _differing(here: Mapping[str, Array], there: Mapping[str, Array]) -> Array:
    """Return in which samples of `there`, the first ones of `here`, any output differs in a bit."""
    differs = np.zeros(len(next(iter(there.values()))), bool)
    for name, column in there.items():
        differs |= here[name][: len(column)].view(np.uint64) != column.view(np.uint64)
    return differs


class _Judge:
    """Holds the oracle and condition of one block, and updates the tallies."""

    def __init__(self, model: LoweredModel, block: Block, unit: UlpUnit) -> None:
        self.model, self.block, self.unit = model, block, unit
        self.oracle, self.condition = Oracle(block, unit.tie), Condition(block)
        self.named = NamedValues(block)
        self.last_exact: dict[str, Array] = {}

    def holds(self, values: Mapping[str, Array]) -> Array:
        """Return the samples of which the precision holds every value, shape (N,).

        These are the values that the derivation names and those that the code computes. Where the
        limit allows a named value the other sign, what follows from it cannot be judged.
        """
        if self.unit is DOUBLE_UNIT:
            return np.ones(len(next(iter(values.values()))), bool)
        computed = values_of(self.model, self.block.name, values)
        lost = self.condition.without_a_digit(values, LIMIT_ULP * 2.0**-self.unit.digits)
        named = self.named(values)
        for angle in self.named.angles:
            lost |= np.abs(named[angle]) > self.unit.angle
        return self.unit.holds([*named.values(), *computed]) & ~lost

    def update(
        self,
        samples: Samples,
        computed: Mapping[str, Mapping[str, Array]],
        tallies: dict[tuple[str, str], _Tally],
    ) -> int:
        """Compare one chunk; return how many samples sat on a branch boundary and were left out."""
        values = samples.values
        names = list(values)
        columns = zip(*(values[n].tolist() for n in names), strict=True)
        rows = [dict(zip(names, row, strict=True)) for row in columns]
        answers = [self.oracle(row) for row in rows]
        limit = LIMIT_ULP * 2.0**-self.unit.digits
        clear = np.array([c for _, c in answers]) & ~self.condition.close_calls(values, limit)
        # What is divided by a value without a digit of its own, as ADB in the singular set, has no
        # answer that doubles could give.
        divided = self.condition.vanishing(values, limit)
        clear &= ~divided
        named, by_input = self.condition(values)
        previous = {
            language: t.undecided for (f, language), t in tallies.items() if f == self.block.name
        }
        for k, signal in enumerate(self.block.outputs):
            exact = [outputs[k] for outputs, _ in answers]
            self.last_exact[signal.name] = np.array([float(v) for v in exact])
            answered = np.isfinite(self.last_exact[signal.name]) & ~divided
            size_of = np.abs(np.where(answered, self.last_exact[signal.name], 0.0))
            units = self.unit.last_place(np.maximum(size_of, named[signal.name]))
            strict_units = self.unit.last_place(np.maximum(size_of, by_input[signal.name]))
            for language, outputs in computed.items():
                column = outputs[signal.name]
                size = len(column)
                judged = (clear & answered)[:size]
                errors = errors_of(column, exact[:size], judged, answered[:size])
                scaled, strict = (
                    in_units(errors, units[:size]),
                    in_units(errors, strict_units[:size]),
                )
                tally = tallies.setdefault((self.block.name, language), _Tally())
                tally.undecided = max(tally.undecided, previous.get(language, 0) + _count(~judged))
                near = samples.near[:size]
                tally.worst_near = max(tally.worst_near, _most(scaled[near]))
                tally.worst_by_input = max(tally.worst_by_input, _most(strict))
                tally.worst_by_input_near = max(tally.worst_by_input_near, _most(strict[near]))
                worst = int(np.argmax(scaled))
                if scaled[worst] > tally.worst:
                    tally.worst, tally.output = float(scaled[worst]), signal.name
                    tally.at = {n: float(values[n][worst]) for n in names}
        return int((~clear).sum())


def errors_of(column: Array, exact: Sequence[Any], judged: Array, answered: Array) -> Array:
    """Return |column - exact|, (N,), and 0 where that cannot be `judged`.

    A comparison too close to call excuses either branch, never an answer that is no number where
    the formulas have one.
    """
    lost = answered & ~np.isfinite(column)
    found: Array = np.where(
        judged, absolute_error(column, list(exact)), np.where(lost, np.inf, 0.0)
    )
    return found


def in_units(errors: Array, units: Array) -> Array:
    """Return `errors` over `units`, (N,): infinite where there is an error but no sound unit."""
    with np.errstate(all="ignore"):
        scaled = errors / units
    found: Array = np.where(errors == 0.0, 0.0, np.where(np.isnan(scaled), np.inf, scaled))
    return np.where(np.isfinite(errors) | (errors == 0.0), found, np.inf)


def _most(errors: Array) -> float:
    return float(np.max(errors, initial=0.0))


def _count(samples: Array) -> int:
    return int(np.count_nonzero(samples))


def _count_branches(
    branches: dict[str, float], block: Block, exact: Mapping[str, Array], samples: int
) -> None:
    """Add up which share of the samples took each flagged branch."""
    for signal in block.outputs:
        if signal.group == "flag":
            name = signal.name if block.name == "step" else f"{block.name}_{signal.name}"
            share = float(np.count_nonzero(exact[signal.name])) / samples
            branches[name] = round(branches.get(name, 0.0) + share, 12)
