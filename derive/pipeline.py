"""The stages in order, each cached by the content it depends on.

    spec.py --derive--> Derivation --lower--> LoweredModel --emit--> files

SymPy and CasADi are imported only where a stage really runs: after a parameter change both stages
come from the cache and neither is loaded.
"""

from __future__ import annotations

import json
import pickle
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.derive.ir.lowered import LoweredModel, lowered_from_json, lowered_to_json
from pfaffian.derive.ir.program import Program, program_from_json, program_to_json
from pfaffian.derive.sets.controller_set import ControllerSettings, control_paths, read_control
from pfaffian.derive.sets.parameter_set import IncompleteSetError, ParameterSet, resolve_set
from pfaffian.derive.sets.plan_table import PlanTable, plan_set, plan_table
from pfaffian.derive.sets.raw_set import read_set
from pfaffian.derive.spec.library import ModelFolder
from pfaffian.runtime.base.cache import cached, digest
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.import_closure import code_of, modules_in

if TYPE_CHECKING:
    from pfaffian.derive.derivation.derive import Derivation

#: The module that each stage enters; what it imports decides the key of its results.
_DERIVATION = "pfaffian.derive.derivation.derive"
_LOWERING = "pfaffian.derive.lower.model"
_JACOBIAN = "pfaffian.derive.lower.jacobian"
_SINGLE = "pfaffian.derive.elementary.single"
#: What a specification imports, in a model's folder.
_AUTHORING = "pfaffian.derive.authoring"
_TOOLS = ("sympy", "casadi", "mpmath", "jinja2")


@dataclass
class StageClock:
    """Seconds spent in each stage, in the order the stages ran."""

    seconds: dict[str, float] = field(default_factory=dict)

    def record(self, stage: str, since: float) -> None:
        """Add the time from `since` (of `time.perf_counter`) to `stage`."""
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - since


def tool_versions() -> tuple[tuple[str, str], ...]:
    """Return name and version of the tools whose output the generated files depend on."""
    return tuple((name, version(name)) for name in _TOOLS)


def derivation_key(folder: ModelFolder) -> str:
    """Return the digest of all that the derivation of `folder` depends on."""
    sources = [p.read_bytes() for p in sorted(folder.path.glob("*.py"))]
    tools = repr(tool_versions()).encode()
    imports = sorted({name for text in sources for name in modules_in(text)})
    return digest(
        folder.name.encode(), tools, *code_of(_DERIVATION, _AUTHORING, *imports), *sources
    )


def derivation_of(folder: ModelFolder, clock: StageClock | None = None) -> Derivation:
    """Return the derivation of the model in `folder`, from the cache where it is known."""
    since = time.perf_counter()

    def compute() -> bytes:
        from pfaffian.derive.derivation.derive import derive

        with folder.blamed():
            return pickle.dumps(derive(folder.load()))

    from pfaffian.derive.derivation import derive as _loaded  # noqa: F401  (pickle needs its classes)

    result: Derivation = pickle.loads(cached("derivation", derivation_key(folder), compute))
    if clock:
        clock.record("derive", since)
    return result


def lowered_model(folder: ModelFolder, clock: StageClock | None = None) -> LoweredModel:
    """Return the lowered model of `folder`, from the cache where it is known."""
    since = time.perf_counter()
    key = digest(derivation_key(folder).encode(), *code_of(_LOWERING))

    def compute() -> bytes:
        from pfaffian.derive.lower.model import lower_model

        derivation = derivation_of(folder, clock)
        with folder.blamed():
            return lowered_to_json(lower_model(derivation, tool_versions())).encode()

    model = lowered_from_json(cached("lowered", key, compute).decode())
    if clock:
        clock.record("lower", since)
        clock.seconds["lower"] -= clock.seconds.get("derive", 0.0)
    return model


def jacobian_programs(folder: ModelFolder, clock: StageClock | None = None) -> tuple[Program, ...]:
    """Return the derivatives of the model in `folder`, from the cache where they are known.

    They are a stage of their own: who does not ask for them does not pay for them.
    """
    since = time.perf_counter()
    key = digest(derivation_key(folder).encode(), *code_of(_JACOBIAN))

    def compute() -> bytes:
        from pfaffian.derive.lower.jacobian import jacobian_programs_of

        with folder.blamed():
            found = jacobian_programs_of(derivation_of(folder))
        return json.dumps([program_to_json(p) for p in found], separators=(",", ":")).encode()

    programs = json.loads(cached("jacobian", key, compute))
    if clock:
        clock.record("differentiate", since)
    return tuple(program_from_json(p) for p in programs)


def single_elementary() -> Mapping[str, Any]:
    """Return the coefficients of single precision's elementary functions, cached likewise."""
    key = digest(version("mpmath").encode(), *code_of(_SINGLE))

    def compute() -> bytes:
        from pfaffian.derive.elementary.single import single_render_context

        return json.dumps(single_render_context(), sort_keys=True).encode()

    known: dict[str, Any] = json.loads(cached("elementary-single", key, compute))
    return known


def parameter_set(model: LoweredModel, folder: ModelFolder, path: Path) -> ParameterSet:
    """Read, complete and judge the parameter set in `path`."""
    return resolve_set(model, read_set(path, model.parameters, folder.sets()))


def library_sets(model: LoweredModel, folder: ModelFolder) -> tuple[ParameterSet, ...]:
    """Return every parameter set that comes with the model, sorted by name."""
    return tuple(parameter_set(model, folder, path) for path in folder.sets().values())


@dataclass(frozen=True)
class CompleteSets:
    """The parameter sets of a folder that are complete, and why each other one is not."""

    sets: tuple[ParameterSet, ...]
    left_out: Mapping[str, str]

    def notes(self, reference: str) -> list[str]:
        """Return one line for each set that is left out, with the command that helps."""
        return [
            f"set {name} is left out: {why}; pfaffian design {reference} --set {name} finds gains"
            for name, why in self.left_out.items()
        ]


def complete_sets(
    model: LoweredModel, folder: ModelFolder, names: Sequence[str] = ()
) -> CompleteSets:
    """Return the sets of `folder` that are complete, or those of `names`, sorted by name.

    A set that is asked for by name must be complete, and any set that is must be good: else
    `InputError` is raised.
    """
    if names:
        paths = [folder.set_path(n) for n in sorted(set(names))]
        return CompleteSets(tuple(parameter_set(model, folder, p) for p in paths), {})
    sets, left_out = [], {}
    for name, path in folder.sets().items():
        try:
            sets.append(parameter_set(model, folder, path))
        except IncompleteSetError as error:
            left_out[name] = error.message.removeprefix(f"{path}: ")
    return CompleteSets(tuple(sets), left_out)


def library_controls(
    model: LoweredModel,
    folder: ModelFolder,
    sets: tuple[ParameterSet, ...],
    plans: tuple[PlanTable, ...],
) -> tuple[ControllerSettings, ...]:
    """Return the complete controllers that come with the model, of the parameter sets in `sets`."""
    paths, names = control_paths(folder.path), tuple(p.name for p in plans)
    return tuple(
        read_control(paths[s.name], model, s.as_dict(), names) for s in sets if s.name in paths
    )


def plan_tables(
    model: LoweredModel, folder: ModelFolder, sets: tuple[ParameterSet, ...], extra: Path | None
) -> tuple[PlanTable, ...]:
    """Return the plans that come with the model for these sets, and the one in `extra`.

    A plan belongs to the set it names, or its file: where that is not generated, the model's own
    plans are left out, and `extra` is refused with `InputError`. So is any that does not fit.
    """
    known = {s.name: s for s in sets}
    paths = {p.stem: p for p in sorted((folder.path / "plans").glob("*.json")) if p.stem in known}
    if extra is not None:
        name = plan_set(extra)
        if name not in known:
            raise InputError(
                f"{extra}: is a plan of set {name}, which is not generated",
                remedy=f"generate it along: --set {name}",
            )
        paths[name] = extra
    if paths and not model.has_program("follow"):
        raise InputError(
            f"model {model.name}: its drift depends on more than s, so no plan can be followed",
            remedy="give a constraint whose drift is a function of s, or leave the plan out",
        )
    return tuple(plan_table(model, known[name], path) for name, path in sorted(paths.items()))
