"""C99 emission: freestanding controller, continuous law, plant and parameter sets."""

from __future__ import annotations

import re
import textwrap
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from pfaffian.derive.emit.bounds import finite_bound, input_bounds, measured_bounds
from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.emit.finiteness import with_finiteness_checks
from pfaffian.derive.emit.local_names import C_PLANT_LOCALS
from pfaffian.derive.emit.names import comment_text, snake
from pfaffian.derive.emit.precision import DOUBLE, Precision
from pfaffian.derive.emit.precision import c_literal as c_literal
from pfaffian.derive.emit.statements import Dialect, Statement, statements_of, with_local_names
from pfaffian.derive.emit.structures import STATUS, STATUS_TEXT, structures_of, witness_of
from pfaffian.derive.emit.templates import fill
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.program import Program, Signal, restricted
from pfaffian.derive.ir.ranges import Range, unbounded
from pfaffian.runtime.contract.manifest import ABI_VERSION, Structure

_WIDTH = 100


@dataclass(frozen=True)
class Body:
    """A function body: lines that load inputs and compute, and the result expressions."""

    lines: tuple[str, ...]
    results: dict[str, str]


def wrap_line(line: str, indent: str = "    ") -> list[str]:
    """Break a statement at spaces so that it fits the width; continuation lines are indented."""
    return textwrap.wrap(
        line,
        _WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + "    ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def _statement_lines(statement: Statement, real: str) -> list[str]:
    if statement.kind == "sincos":
        sine, cosine = statement.name, statement.cosine
        return [
            f"    {real} {sine};",
            f"    {real} {cosine};",
            f"    {statement.function}({statement.expression}, &{sine}, &{cosine});",
        ]
    kind = "int" if statement.kind == "truth" else real
    code = f"const {kind} {statement.name} = {statement.expression};"
    text = comment_text(statement.comment)
    comment = f" /* {text} */" if text else ""
    if len(code) + len(comment) + 4 <= _WIDTH:
        return [f"    {code}{comment}"]
    above = [f"    /* {text} */"] if text else []
    return above + wrap_line(code)


def body_of(
    program: Program,
    member: Callable[[int, Signal], str],
    dialect: Dialect = DOUBLE.dialect,
    bounds: Mapping[str, Range] | None = None,
) -> Body:
    """Return the body of `program`; `member` says where input number k is read from.

    What is read once is read where it is used; the rest just before: values that are read early
    and used late only fill registers.
    """
    program = with_local_names(program, dialect.reserved)
    uses = Counter(a for i in program.instructions for a in i.args)
    uses.update(program.results)
    used = [
        (i.name, s, member(k, s), uses[k] == 1)
        for k, (i, s) in enumerate(zip(program.instructions, program.inputs, strict=False))
        if uses[k]
    ]
    places = {name: place for name, _, place, _ in used}
    direct = {
        name: place
        for name, s, place, once in used
        if once and s.group in ("parameter", "prepared", "state", "baked")
    }
    truths = {
        name: f"({place} != 0U)"
        for name, s, place, _ in used
        if s.group == "state" and s.name in dialect.truths
    }
    dialect = replace(dialect, truths=truths)
    statements, results = statements_of(program, dialect, inputs=direct, bounds=bounds)
    waiting = [n for n in places if n not in direct and n not in truths]
    lines: list[str] = []
    real = dialect.real
    for statement in statements:
        words = set(re.findall(r"\w+", statement.expression))
        lines += [f"    const {real} {n} = {places[n]};" for n in waiting if n in words]
        waiting = [n for n in waiting if n not in words]
        lines += _statement_lines(statement, real)
    lines += [f"    const {real} {n} = {places[n]};" for n in waiting]
    return Body(tuple(lines), results)


def dialect_of(
    model: LoweredModel, dialect: Dialect, reserved: frozenset[str] = frozenset()
) -> Dialect:
    """Return `dialect` with its truth values under the names that `model` has for them.

    `reserved` are further names that the function around the body has itself.
    """
    truths = {model.own(name): text for name, text in dialect.truths.items()}
    return replace(dialect, truths=truths, reserved=dialect.reserved | reserved)


def pointers(**sources: str) -> Callable[[int, Signal], str]:
    """Return a reader of structure members: each input group through its own pointer."""
    return lambda _, signal: f"{sources[signal.group]}->{signal.name}"


def member_lines(structure: Structure) -> list[str]:
    """Return one line of C a member of `structure`, its meaning and unit in a comment."""
    lines = []
    for f in structure.fields:
        unit = f" [{f.unit}]" if f.unit else ""
        lines.append(f"    {f.type} {f.name}; /* {comment_text(f.description + unit)} */")
    return lines


def _set_contexts(emission: Emission, structure: Structure) -> list[dict[str, object]]:
    units, literal = {f.name: f.unit for f in structure.fields}, emission.precision.literal
    return [
        {
            "name": f"{emission.model.name}_params_{snake(s.name)}",
            "title": comment_text(s.title),
            "source": textwrap.wrap(comment_text(s.source), 90),
            "members": [
                {"name": n, "literal": literal(s.as_dict()[n]), "unit": comment_text(units[n])}
                for n in structure.names()
            ],
        }
        for s in emission.sets
    ]


def _bounds(model: LoweredModel, structure: Structure, precision: Precision) -> list[str]:
    """Return one C condition a parameter: within its declared bounds, false for NaN."""
    declared = {p.name: p for p in model.parameters}
    rows = []
    for name in structure.names():
        p = declared[name]
        relation = ">" if p.lower_open else ">="
        lower = precision.literal(precision.at_least(finite_bound(p.lower)))
        upper = precision.literal(precision.at_most(finite_bound(p.upper)))
        rows.append(f"(params->{name} {relation} {lower}) && (params->{name} <= {upper})")
    return rows


def _fixed(emission: Emission, structure: Structure) -> list[str]:
    """Return one C condition a parameter whose value is folded into the step."""
    if not emission.bake:
        return []
    values = {n: c_literal(v) for n, v in emission.sets[0].values}
    return [
        f"(params->{n} >= {values[n]}) && (params->{n} <= {values[n]})" for n in structure.names()
    ]


def domain(model: LoweredModel, precision: Precision = DOUBLE) -> list[str]:
    """Return one C condition a measurement: inside its domain, false for NaN."""
    f, literal, at_most = precision.suffix, precision.literal, precision.at_most
    return [
        f"(pf_abs{f}(input->{name}) < {literal(at_most(bound))})"
        for name, bound in measured_bounds(model)
    ]


def emit_c(emission: Emission) -> dict[str, str]:
    """Return the C files of `emission` by path."""
    model = emission.model
    precision = emission.precision
    structures = structures_of(
        model, precision.real, emission.step, emission.prepare, follow=bool(emission.plans)
    )
    header = "\n".join(["/*", *(f" * {line}" for line in emission.banner()), " */"])
    context: dict[str, object] = {
        "header": header,
        "has_control": bool(emission.controls) and precision is DOUBLE,
        "has_swing_up": model.has_program("swing_up"),
        **precision.names(),
        "further_header": emission.further_header,
        "abi": ABI_VERSION,
        "model": model.name,
        "own": model.own,
        "guard": model.name.upper(),
        "title": comment_text(model.title),
        "structures": {
            role: {"name": s.name, "members": member_lines(s), "names": s.names()}
            for role, s in structures.items()
        },
        "status": [{"name": n, "text": STATUS_TEXT[n]} for n in STATUS],
        **_declarations(emission, structures),
        **_bodies(emission),
        "operations": {p.name: sum(p.op_count().values()) for p in model.programs},
    }
    elementary = {"header": header, **emission.elementary()}
    names = [*precision.elementary_files, *filter(None, [emission.further_header])]
    files = {f"c/{n}": fill(f"c/{n}.j2", elementary) for n in names}
    swings = model.has_program("swing_up")
    if swings:
        context |= _swing_up(model, precision)
    for template, path in (
        ("pf_arithmetic.h", f"pf_arithmetic{precision.suffix}.h"),
        ("pf_scalar.h", f"pf_scalar{precision.suffix}.h"),
        ("pf_model.h", "pf_model.h"),
        ("params.h", f"{model.name}_params.h"),
        ("params.c", f"{model.name}_params.c"),
        ("step.h", f"{model.name}.h"),
        ("step.c", f"{model.name}.c"),
        ("continuous.h", f"{model.name}_continuous.h"),
        ("continuous.c", f"{model.name}_continuous.c"),
        ("plant.h", f"{model.name}_plant.h"),
        ("plant.c", f"{model.name}_plant.c"),
        *((f"swing_up.{end}", f"{model.name}_swing_up.{end}") for end in "hc" if swings),
    ):
        files[f"c/{path}"] = fill(f"c/{template}.j2", context)
    return files


def _declarations(emission: Emission, structures: Mapping[str, Structure]) -> dict[str, object]:
    """Return the parameter sets, the bounds and the names that the files declare."""
    model, precision, params = emission.model, emission.precision, structures["params"]
    constants = emission.baked.constants if emission.baked else ()
    return {
        "witness": witness_of(structures, emission.prepare),
        "sets": _set_contexts(emission, params),
        "parameter_bounds": [*_bounds(model, params, precision), *_fixed(emission, params)],
        "baked": [{"name": n, "literal": precision.literal(v)} for n, v in constants],
        "domain": domain(model, precision),
        "actuators": [a.name for a in model.actuators],
        "limits": model.limits,
        "coordinates": [c.name for c in model.coordinates],
        "plans": [f"{model.name}_plan_{snake(p.name)}" for p in emission.plans],
    }


def _bodies(emission: Emission) -> dict[str, object]:
    """Return the bodies of the law's and of the plant's functions, and what is checked in them."""
    model, prepare, precision = emission.model, emission.prepare, emission.precision
    inline, plain = (dialect_of(model, d) for d in (precision.inline, precision.dialect))
    of_plant = dialect_of(model, precision.dialect, C_PLANT_LOCALS)
    controller = pointers(
        input="input", state="state", prepared="state", parameter="params", baked="baked"
    )
    plant = pointers(input="state", torque="input", parameter="params")
    program, checks = with_finiteness_checks(emission.step)
    step = body_of(program, controller, inline, input_bounds(model))
    return {
        "step": step,
        "checked": [step.results[name] for name in checks],
        "next_state": [s.name for s in program.outputs if s.group == "next_state"],
        "prepare": body_of(restricted(prepare, "prepared"), controller, plain),
        "unbounded": unbounded(prepare, input_bounds(model)),
        "start": body_of(restricted(prepare, "state"), controller, plain),
        "continuous": body_of(model.program("continuous"), controller, plain),
        "acceleration": body_of(model.program("acceleration"), plant, of_plant),
        "energy": body_of(model.program("energy"), plant, of_plant),
    }


def _swing_up(model: LoweredModel, precision: Precision) -> dict[str, object]:
    """Return what the templates of the energy swing-up law are filled with besides."""
    program, checks = with_finiteness_checks(model.program("swing_up"))
    body = body_of(program, pointers(input="input", parameter="params"), precision.dialect)
    return {"swing_up": body, "swing_up_checked": [body.results[name] for name in checks]}
