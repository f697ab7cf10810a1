"""Emission of derivatives: C99 and one NumPy module, beside the code they are derivatives of."""

from __future__ import annotations

from dataclasses import dataclass

from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.emit.files.c import Body, body_of, dialect_of, wrap_line
from pfaffian.derive.emit.files.python import python_body
from pfaffian.derive.emit.names import comment_text
from pfaffian.derive.emit.precision import DOUBLE
from pfaffian.derive.emit.structures import structures_of
from pfaffian.derive.emit.templates import fill
from pfaffian.derive.ir.names import PLANT_PARAMETER, PLANT_PREFIX
from pfaffian.derive.ir.own_names import derivative_name
from pfaffian.derive.ir.program import Program, Signal

#: Where each program finds its inputs: the group, and the argument that holds it. The groups are
#: in the order of the arguments; the argument's role names its structure.
_ARGUMENTS: dict[str, tuple[tuple[str, str, str], ...]] = {
    "plant_jacobian": (
        ("params", "plant_params", "parameter"),
        ("state", "plant_state", "input"),
        ("input", "plant_input", "torque"),
    ),
    "step_jacobian": (
        ("state", "state", "state prepared"),
        ("params", "params", "parameter"),
        ("input", "input", "input"),
    ),
    "closed_loop_jacobian": (
        ("state", "continuous_state", "state"),
        ("params", "params", "parameter"),
        ("plant", "plant_params", PLANT_PARAMETER),
        ("input", "input", "input"),
    ),
}
_NOTES = {
    "plant_jacobian": "Derivatives of the accelerations of the plant.",
    "step_jacobian": "Derivatives of the torque commanded in this state: 0 where it is at its "
    "limit. Nothing is validated.",
    "closed_loop_jacobian": "Derivatives of x', x = (q, q', states of the law), of the plant under "
    "the continuous law; those of q' are left out.",
}


@dataclass(frozen=True)
class _Function:
    """A function of derivatives: its arguments with their structures, and its members."""

    name: str
    note: str
    arguments: tuple[tuple[str, str], ...]
    unused: tuple[str, ...]
    members: tuple[Signal, ...]
    body: Body


def _source(program: Program) -> dict[str, str]:
    """Return the argument of each group of inputs."""
    return {group: name for name, _, groups in _ARGUMENTS[program.name] for group in groups.split()}


def _member(program: Program, signal: Signal) -> str:
    own = signal.group == PLANT_PARAMETER
    name = signal.name.removeprefix(PLANT_PREFIX) if own else signal.name
    return f"{_source(program)[signal.group]}->{name}"


def _function(emission: Emission, program: Program) -> _Function:
    structures = structures_of(emission.model)
    dialect = dialect_of(emission.model, DOUBLE.dialect)
    body = body_of(program, lambda _, signal: _member(program, signal), dialect)
    text = "\n".join((*body.lines, *body.results.values()))
    arguments = tuple((n, structures[role].name) for n, role, _ in _ARGUMENTS[program.name])
    return _Function(
        name=program.name,
        note=_NOTES[program.name],
        arguments=arguments,
        unused=tuple(name for name, _ in arguments if f"{name}->" not in text),
        members=program.outputs,
        body=body,
    )


def _c_context(emission: Emission) -> dict[str, object]:
    model = emission.model
    functions = [_function(emission, p) for p in emission.jacobians]
    return {
        "further_header": emission.further_header,
        "header": "\n".join(["/*", *(f" * {line}" for line in emission.banner()), " */"]),
        "model": model.name,
        "guard": model.name.upper(),
        "functions": [
            {
                "name": f.name,
                "note": f.note,
                "arguments": ",\n    ".join(f"const {t} *{n}" for n, t in f.arguments),
                "unused": f.unused,
                "members": [
                    {"name": s.name, "text": comment_text(f"{s.description} [{s.unit}]")}
                    for s in f.members
                ],
                "lines": f.body.lines,
                "assignments": [
                    line
                    for name, value in f.body.results.items()
                    for line in wrap_line(f"jacobian->{name} = ({value}) + 0.0;")
                ],
                "operations": sum(p.op_count().values()),
            }
            for f, p in zip(functions, emission.jacobians, strict=True)
        ],
    }


def _python_function(program: Program) -> dict[str, object]:
    sources = _source(program)
    body = python_body(program, sources, lambda s: _member(program, s).replace("->", "."))
    return {
        "name": program.name,
        "class": "".join(word.capitalize() for word in program.name.split("_")),
        "note": _NOTES[program.name],
        "arguments": [name for name, _, _ in _ARGUMENTS[program.name]],
        "members": [
            {"name": s.name, "text": comment_text(f"{s.description} [{s.unit}]")}
            for s in program.outputs
        ],
        "body": body,
    }


def _python_context(emission: Emission) -> dict[str, object]:
    model = emission.model
    by_name = {p.name: p for p in emission.jacobians}
    coordinates = [c.name for c in model.coordinates]
    closed = by_name["closed_loop_jacobian"].inputs
    made = {s.name for s in by_name["closed_loop_jacobian"].outputs}
    states = [s.name for s in closed if s.group == "state"]
    rates = {n: model.own(f"{n}_rate") for n in states}
    moving = [n for n in states if derivative_name(rates[n], coordinates[0]) in made]
    return {
        "header": emission.banner(),
        "title": comment_text(model.title),
        "model": model.name,
        "functions": [_python_function(p) for p in emission.jacobians],
        "coordinates": coordinates,
        "actuators": [a.name for a in model.actuators],
        "own_states": moving,
        "own_rates": [rates[n] for n in moving],
        "default_rates": [f"{n}_rate" for n in moving],
    }


def emit_jacobian(emission: Emission) -> dict[str, str]:
    """Return the files of the derivatives of `emission` by path: C, its header, and Python."""
    name = emission.model.name
    c = _c_context(emission)
    return {
        f"c/{name}_jacobian.h": fill("c/jacobian.h.j2", c),
        f"c/{name}_jacobian.c": fill("c/jacobian.c.j2", c),
        f"{name}_jacobian.py": fill("python/jacobian.py.j2", _python_context(emission)),
    }
