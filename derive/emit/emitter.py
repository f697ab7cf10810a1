"""What every emitter gets and gives, and how templates are filled."""

from __future__ import annotations

import hashlib
import json
import keyword
import math
import re
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from typing import Any, Protocol

import jinja2
from pfaffian.derive.control_set import ControlSet
from pfaffian.derive.emit.plan_table import PlanTable
from pfaffian.derive.emit.precision import DOUBLE, Precision
from pfaffian.derive.lowered import LoweredModel
from pfaffian.derive.optimise.bake import Baked, bake
from pfaffian.derive.optimise.ranges import Range
from pfaffian.derive.parameter_set import ParameterSet
from pfaffian.derive.program import FURTHER, TIME_NAME, Op, Program
from pfaffian.runtime.cache import cache_folder
from pfaffian.runtime.errors import InputError
from pfaffian.runtime.manifest import ABI_VERSION

#: Words of C99 and C++11 that no generated name may be, and names the templates use themselves.
_C_WORDS = """
    alignas alignof and and_eq asm auto bitand bitor bool break case catch char class compl const
    const_cast constexpr continue decltype default delete do double dynamic_cast else enum explicit
    export extern false float for friend goto if inline int long mutable namespace new noexcept not
    not_eq nullptr operator or or_eq private protected public register reinterpret_cast restrict
    return short signed sizeof static static_assert static_cast struct switch template this
    thread_local throw true try typedef typeid typename union unsigned using virtual void volatile
    wchar_t while xor xor_eq
"""
_OWN_WORDS = """
    advanced applied dataclass finite good input limited measured np output params prepared rate
    state status time valid zero
"""
#: Largest |time| in seconds taken as a measurement of a time-varying constraint: thirty years.
TIME_BOUND = 1e9
_RESERVED = frozenset((*_C_WORDS.split(), *_OWN_WORDS.split(), *keyword.kwlist))

#: Files of the elementary functions of double; each has a template of its name.
ELEMENTARY_FILES = DOUBLE.elementary_files


@dataclass(frozen=True)
class Emission:
    """All that one generation depends on: the model, its parameter sets and the C's precision.

    `single` holds the coefficients of single precision's elementary functions, where it is asked
    for; those of double come with the model.
    """

    model: LoweredModel
    sets: tuple[ParameterSet, ...]
    bake: bool = False
    jacobians: tuple[Program, ...] = ()
    batch: bool = False
    precision: Precision = DOUBLE
    single: Mapping[str, Any] = field(default_factory=dict)
    controls: tuple[ControlSet, ...] = ()
    plans: tuple[PlanTable, ...] = ()

    @cached_property
    def baked(self) -> Baked | None:
        """Return the step with the one parameter set folded in; nothing where none is."""
        if not self.bake:
            return None
        program = self.model.program
        return bake(program("step"), program("prepare"), self.sets[0].as_dict())

    @property
    def step(self) -> Program:
        """Return the step as it is emitted."""
        return self.baked.step if self.baked else self.model.program("step")

    @property
    def prepare(self) -> Program:
        """Return what is prepared once, as it is emitted."""
        return self.baked.prepare if self.baked else self.model.program("prepare")

    def __post_init__(self) -> None:
        """Refuse names that no compiler would take, or that would hide one another.

        A baked step belongs to one parameter set.
        """
        if self.bake and len(self.sets) != 1:
            raise InputError(
                f"model {self.model.name}: {len(self.sets)} parameter sets to fold into one step",
                remedy="name one with --set or --params",
            )
        _check_name(self.model.name, self.model.name)
        for program in (*self.model.programs, *self.jacobians):
            _check_program(self.model.name, program)
        _check_sets(self.sets)
        taken = [n for n in ("step", "swing_up") if self.model.has_program(n)]
        for s in self.sets:
            for name in taken:
                self.precision.check_set(self.model.parameters_of(name), s)

    def parameters_sha256(self) -> str:
        """Return one digest of all parameter sets with their names."""
        text = json.dumps([[s.name, s.digest()] for s in self.sets])
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def further_header(self) -> str:
        """Return the header of the elementary functions that few models call; else nothing."""
        programs = (*self.model.programs, *self.jacobians)
        return self.precision.further_header if any(map(calls_further, programs)) else ""

    def elementary(self) -> Mapping[str, Any]:
        """Return what the templates of the elementary functions are filled with."""
        return self.model.elementary if self.precision is DOUBLE else self.single

    def operations(self) -> int:
        """Return the operations of one control step."""
        return sum(self.step.op_count().values())

    def banner(self) -> tuple[str, ...]:
        """Return the lines that head every generated file; no date, no path."""
        option = "" if self.precision is DOUBLE else f" --precision {self.precision.name}"
        tools = ", ".join(f"{name} {number}" for name, number in self.model.tools)
        return (
            f"Generated by pfaffian {package_version()}: do not edit, regenerate with "
            f"`pfaffian generate {self.model.name}{option}`.",
            f"Tools: {tools}; ABI {ABI_VERSION}.",
            f"Model {self.model.name}, SHA-256 {self.model.sha256}",
            f"Parameters, SHA-256 {self.parameters_sha256()}",
            f"Operations a control step: {self.operations()}",
            *([f"Parameter set folded into the step: {self.sets[0].name}"] if self.bake else []),
        )


def calls_further(program: Program) -> bool:
    """Return whether `program` calls an elementary function of the header that few models get."""
    return any(i.op in FURTHER for i in program.instructions)


class Emitter(Protocol):
    """One language: a generation in, the text of its files by relative path out."""

    def __call__(self, emission: Emission) -> dict[str, str]:
        """Return file texts by path relative to the model's folder."""


def package_version() -> str:
    """Return this package's version."""
    try:
        return version("pfaffian")
    except PackageNotFoundError:
        return "0"


def _bytecode_cache() -> jinja2.FileSystemBytecodeCache | None:
    """Return a cache of compiled templates, checked against their text; None where it is off."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        (folder / "templates").mkdir(parents=True, exist_ok=True)
        return jinja2.FileSystemBytecodeCache(str(folder / "templates"))
    except OSError:
        return None


def _environment() -> jinja2.Environment:
    def load(name: str) -> str:
        return files("pfaffian.templates").joinpath(name).read_text(encoding="utf-8")

    return jinja2.Environment(
        loader=jinja2.FunctionLoader(load),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
        bytecode_cache=_bytecode_cache(),
    )


_ENVIRONMENT = _environment()


def fill(template: str, context: Mapping[str, object]) -> str:
    """Fill `template` (path below `templates/`) with a complete set of keys."""
    return _ENVIRONMENT.get_template(template).render(**context)


def _check_name(model: str, name: str) -> None:
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        what, remedy = "is no identifier in C", "use ASCII letters, digits and underscores"
    elif name in _RESERVED or name.lower().startswith("pf_"):
        what, remedy = "is a name the generated code needs itself", "rename it"
    else:
        return
    raise InputError(f"model {model}: {name} {what}", remedy=remedy, about=name)


def _check_program(model: str, program: Program) -> None:
    inputs = [s.name for s in program.inputs]
    for name in inputs:
        if name != TIME_NAME:
            _check_name(model, name)
    named = {i.name for i in program.instructions if i.name and i.op is not Op.INPUT}
    twice = [n for n, count in Counter(inputs).items() if count > 1 or n in named]
    if twice:
        raise InputError(
            f"model {model}: {twice[0]} names two different values of {program.name}",
            remedy="rename your coordinate, actuator or parameter",
            about=twice[0],
        )


def _check_sets(sets: tuple[ParameterSet, ...]) -> None:
    """Refuse sets whose constants would share a name, with each other or with something else."""
    from pfaffian.derive.emit.structures import STATUS

    taken = dict.fromkeys(STATUS, "a status") | {"T": "a type"}
    for s in sets:
        constant = snake(s.name).upper()
        if constant in taken:
            raise InputError(
                f"parameter set {s.name}: its constant {constant} is the name of "
                f"{taken[constant]} in the generated code",
                remedy="rename the file of the set",
            )
        taken[constant] = f"parameter set {s.name}"


def comment_text(text: str) -> str:
    """Return `text` on one line, with nothing in it that ends a comment of C or a docstring."""
    line = " ".join(text.split())
    for harmful, harmless in (("*/", "* /"), ("/*", "/ *"), ("??", "? ?"), ('"""', "'''")):
        line = line.replace(harmful, harmless)
    return line.replace("\\", "/")


def finite_bound(value: float) -> float:
    """Return a bound as a literal can hold it: what is unbounded must still be finite."""
    return math.copysign(sys.float_info.max, value) if math.isinf(value) else value


def measured_bounds(model: LoweredModel) -> list[tuple[str, float]]:
    """Return each measurement of a period with the largest magnitude that is taken for one."""
    rows = []
    for c in model.coordinates:
        rows += [(c.name, c.bound), (f"d{c.name}", c.rate_bound)]
    if any(s.name == TIME_NAME for s in model.program("step").inputs):
        rows.append((TIME_NAME, TIME_BOUND))
    return [(name, finite_bound(bound)) for name, bound in rows]


def input_bounds(model: LoweredModel) -> dict[str, Range]:
    """Return what the checks before the step, and those of `init`, leave of its inputs."""
    bounds = {p.name: (p.lower, p.upper) for p in model.parameters}
    return bounds | {name: (-b, b) for name, b in measured_bounds(model)}


def snake(name: str) -> str:
    """Return `name` as an identifier: letters, digits and underscores."""
    word = "".join(c if c.isascii() and c.isalnum() else "_" for c in name)
    return f"set_{word}" if not word or word[0].isdigit() else word
