"""One orchestration of a generation: from a model's folder to all files, still in memory."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pfaffian.runtime.base.errors import InputError

if TYPE_CHECKING:
    from pfaffian.derive.generation import Generation
    from pfaffian.derive.ir.lowered import LoweredModel
    from pfaffian.derive.pipeline import StageClock
    from pfaffian.derive.sets.parameter_set import ParameterSet
    from pfaffian.derive.spec.library import ModelFolder


@dataclass(frozen=True)
class Extras:
    """What a generation has beyond the default: a set folded in, derivatives, a batch form.

    These come in double precision only.
    """

    bake: bool = False
    jacobians: bool = False
    batch: bool = False
    precision: str = "double"
    plan: Path | None = None

    def check(self) -> None:
        """Raise `InputError` for what does not come in single precision."""
        if self.bake and self.plan:
            raise InputError(
                "--plan and --bake are both given",
                remedy="leave one out: a law with a set folded in follows no plan",
            )
        names = [n for n in ("bake", "jacobians", "batch") if getattr(self, n)]
        if names and self.precision != "double":
            raise InputError(
                f"--{names[0]} comes in double precision only",
                remedy="leave --precision out, or generate it apart",
            )


@dataclass(frozen=True, kw_only=True)
class Sets:
    """Which parameter sets are generated: `given` ones, the file `params`, the one `named`, or all.

    Of all sets, those that are incomplete are left out, unless they must be `whole`: then they
    are refused. Where `none` is fine, code is generated that any caller's values suit.
    """

    given: Sequence[ParameterSet] = ()
    params: Path | None = None
    named: str | None = None
    whole: bool = False
    none: bool = False


@dataclass(frozen=True, kw_only=True)
class ModelGeneration:
    """A generation with the model and the sets that it came from, and why sets are missing."""

    model: LoweredModel
    sets: tuple[ParameterSet, ...]
    left_out: Mapping[str, str]
    generation: Generation


def generate_model(
    source: ModelFolder,
    wanted: Sets | None = None,
    extras: Extras | None = None,
    *,
    reference: str = "",
    clock: StageClock | None = None,
    note: Callable[[str], None] = lambda line: None,
) -> ModelGeneration:
    """Derive, lower and emit `source`. Nothing is written.

    `reference` is what the user calls the model, in notes. Raises `InputError` for a set that is
    at fault, and where there is none.
    """
    from pfaffian.derive.emit.emission import Emission
    from pfaffian.derive.emit.precision import DOUBLE, precision_named
    from pfaffian.derive.generation import generate
    from pfaffian.derive.pipeline import (
        StageClock,
        jacobian_programs,
        library_controls,
        lowered_model,
        plan_tables,
        single_elementary,
    )

    wanted, extras, clock = wanted or Sets(), extras or Extras(), clock or StageClock()
    extras.check()
    precision = precision_named(extras.precision)
    model = lowered_model(source, clock)
    since = time.perf_counter()
    sets, left_out = _sets(model, source, wanted, reference or source.name, note)
    clock.record("parameters", since)
    for line in (n for s in sets for n in s.notes):
        note(line)
    jacobians = jacobian_programs(source, clock) if extras.jacobians else ()
    plans = () if extras.bake else plan_tables(model, source, sets, extras.plan)
    since = time.perf_counter()
    with source.blamed():
        single = {} if precision is DOUBLE else single_elementary()
        generation = generate(
            Emission(
                *(model, sets, extras.bake, jacobians, extras.batch, precision, single),
                plans=plans,
                controls=() if extras.bake else library_controls(model, source, sets, plans),
            )
        )
    clock.record("emit", since)
    return ModelGeneration(model=model, sets=sets, left_out=left_out, generation=generation)


def _sets(
    model: LoweredModel,
    source: ModelFolder,
    wanted: Sets,
    reference: str,
    note: Callable[[str], None],
) -> tuple[tuple[ParameterSet, ...], Mapping[str, str]]:
    from pfaffian.derive.pipeline import complete_sets, library_sets, parameter_set

    left_out: Mapping[str, str] = {}
    if wanted.given:
        sets = tuple(wanted.given)
    elif wanted.params:
        sets = (parameter_set(model, source, wanted.params),)
    elif wanted.named:
        sets = (parameter_set(model, source, source.set_path(wanted.named)),)
    elif wanted.whole:
        sets = library_sets(model, source)
    else:
        found = complete_sets(model, source)
        sets, left_out = found.sets, found.left_out
        for line in found.notes(reference):
            note(line)
    if not (sets or left_out or wanted.none):
        named = "" if wanted.whole else ", or name a file with --params"
        raise InputError(
            f"model {source.name} has no parameter set",
            remedy=f"write one beside {source.spec_file}{named}; "
            "pfaffian template prints one to fill in",
        )
    return sets, left_out
