"""NumPy emission: one module that imports NumPy alone, vectorised over leading axes."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pfaffian.derive.emit.bounds import finite_bound, input_bounds, measured_bounds
from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.emit.finiteness import with_finiteness_checks
from pfaffian.derive.emit.local_names import PYTHON_LOCALS
from pfaffian.derive.emit.names import comment_text, snake
from pfaffian.derive.emit.precision import DOUBLE
from pfaffian.derive.emit.statements import Dialect, Statement, statements_of, with_local_names
from pfaffian.derive.emit.structures import STATUS, STATUS_TEXT, structures_of, witness_of
from pfaffian.derive.emit.templates import fill
from pfaffian.derive.ir.program import Op, Program, Signal
from pfaffian.derive.ir.ranges import unbounded
from pfaffian.runtime.contract.manifest import Structure

DIALECT = Dialect(
    patterns={
        Op.FMA: "({0} * {1} + {2})",
        Op.FMS: "({0} * {1} - {2})",
        Op.FNMS: "({2} - {0} * {1})",
        Op.ABS: "np.abs({0})",
        Op.SIGN: "_sign({0})",
        Op.MIN: "_min({0}, {1})",
        Op.MAX: "_max({0}, {1})",
        Op.SQRT: "np.sqrt({0})",
        Op.SIN: "np.sin({0})",
        Op.COS: "np.cos({0})",
        Op.ATAN: "np.arctan({0})",
        Op.EXP: "np.exp({0})",
        Op.EXPM1: "np.expm1({0})",
        Op.TANH: "np.tanh({0})",
        Op.LOG: "np.log({0})",
        Op.ASIN: "np.arcsin({0})",
        Op.ACOS: "np.arccos({0})",
        Op.SINH: "np.sinh({0})",
        Op.COSH: "np.cosh({0})",
        Op.LESS: "({0} < {1})",
        Op.LESS_EQUAL: "({0} <= {1})",
        Op.NOT: "np.logical_not({0})",
        Op.AND: "np.logical_and({0}, {1})",
        Op.OR: "np.logical_or({0}, {1})",
        Op.SELECT: "np.where({0}, {1}, {2})",
    },
    literal=repr,
    reserved=PYTHON_LOCALS,
)


_SINGLE_NOTE = """

The C code beside this module is of single precision; this module computes in double."""


def _line(statement: Statement) -> str:
    comment = f"  # {comment_text(statement.comment)}" if statement.comment else ""
    return f"{statement.name} = {statement.expression}{comment}"


def python_body(
    program: Program,
    sources: dict[str, str],
    member: Callable[[Signal], str] | None = None,
) -> dict[str, object]:
    """Return loads, lines and result expressions of `program`; `sources` name what is read.

    An input is read as a double from its group's source, or as it is from `member`.
    """
    program = with_local_names(program, DIALECT.reserved)
    used = {a for i in program.instructions for a in i.args} | set(program.results)
    loads = [
        f"{program.instructions[index].name} = "
        # An array stays one, uncopied.
        + (member(s) if member else f"np.float64({sources[s.group]}.{s.name})")
        for index, s in enumerate(program.inputs)
        if index in used
    ]
    statements, results = statements_of(program, DIALECT)
    return {"loads": loads, "lines": [_line(s) for s in statements], "results": results}


#: Where the law's and the plant's functions find their inputs, by group.
_CONTROLLER = {
    "input": "measured",
    "state": "state",
    "prepared": "state",
    "parameter": "params",
    "baked": "_Baked",
}
_PLANT = {"input": "state", "torque": "applied", "parameter": "params"}


def emit_python(emission: Emission) -> dict[str, str]:
    """Return the Python module of `emission` and the package's `__init__`."""
    model = emission.model
    structures = structures_of(
        model, step=emission.step, prepare=emission.prepare, follow=bool(emission.plans)
    )
    checked, checks = with_finiteness_checks(emission.step)
    context: dict[str, object] = {
        "header": emission.banner(),
        "has_swing_up": model.has_program("swing_up"),
        "title": comment_text(model.title),
        "note": "" if emission.precision is DOUBLE else _SINGLE_NOTE,
        "model": model.name,
        "own": model.own,
        **_declarations(emission, structures),
        **_members(emission, structures),
        "checked": checks,
        "step": python_body(checked, _CONTROLLER),
        **_following(emission, _CONTROLLER),
        "unbounded": unbounded(emission.prepare, input_bounds(model)),
        "baked": [{"name": n, "value": repr(v)} for n, v in _constants(emission)],
        "fixed": [{"name": n, "value": repr(v)} for n, v in _fixed(emission)],
        "prepare": python_body(emission.prepare, _CONTROLLER),
        **{
            name: python_body(model.program(name), sources)
            for name, sources in (
                *((n, _CONTROLLER) for n in ("continuous", "setpoint", "input_gain")),
                *((n, _PLANT) for n in ("acceleration", "energy")),
            )
        },
    }
    if model.has_program("swing_up"):
        swing_up, swing_up_checks = with_finiteness_checks(model.program("swing_up"))
        context["swing_up"] = python_body(swing_up, _CONTROLLER)
        context["swing_up_checked"] = swing_up_checks
        context["swing_up_names"] = structures["swing_up_output"].names()
    return {
        f"{model.name}.py": fill("python/model.py.j2", context),
        "__init__.py": fill("python/package.py.j2", context),
    }


def _declarations(
    emission: Emission, structures: Mapping[str, Structure]
) -> dict[str, list[dict[str, object]]]:
    """Return the classes, statuses, parameter sets and bounds that the module declares."""
    model, params = emission.model, structures["params"].names()
    return {
        "classes": [
            {
                "name": _class_name(role),
                "fields": [
                    {
                        "name": f.name,
                        "unit": comment_text(f.unit),
                        "text": comment_text(f.description),
                    }
                    for f in s.fields
                ],
            }
            for role, s in structures.items()
        ],
        "status": [{"name": n, "value": k, "text": STATUS_TEXT[n]} for k, n in enumerate(STATUS)],
        "sets": [
            {
                "name": snake(s.name).upper(),
                "title": comment_text(s.title),
                "members": [{"name": n, "value": repr(s.as_dict()[n])} for n in params],
            }
            for s in emission.sets
        ],
        "bounds": [{"name": name, "bound": repr(bound)} for name, bound in measured_bounds(model)],
        "parameter_bounds": [
            {
                "name": p.name,
                "lower": repr(finite_bound(p.lower)),
                "upper": repr(finite_bound(p.upper)),
                "relation": ">" if p.lower_open else ">=",
            }
            for p in model.parameters
            if p.name in params
        ],
    }


def _members(emission: Emission, structures: Mapping[str, Structure]) -> dict[str, object]:
    """Return the names of what is prepared, remembered, given and limited."""
    model = emission.model
    prepared = [s.name for s in model.program("prepare").outputs if s.group == "prepared"]
    return {
        "witness": witness_of(structures, emission.prepare),
        "prepared": prepared,
        "state_names": structures["state"].names(),
        "output_names": structures["output"].names(),
        "limits": model.limits,
        "next_state": [s.name for s in emission.step.outputs if s.group == "next_state"],
    }


def _following(emission: Emission, sources: dict[str, str]) -> dict[str, object]:
    """Return the law along a reference, where there is a plan to follow."""
    if not emission.plans:
        return {"follow": None, "follow_checked": ()}
    program, checks = with_finiteness_checks(emission.model.program("follow"))
    body = python_body(program, {**sources, "reference": "reference"})
    return {"follow": body, "follow_checked": checks}


def _constants(emission: Emission) -> tuple[tuple[str, float], ...]:
    return emission.baked.constants if emission.baked else ()


def _fixed(emission: Emission) -> list[tuple[str, float]]:
    """Return the parameters that must have their value, because it is folded into the step."""
    if not emission.bake:
        return []
    values = emission.sets[0].as_dict()
    names = structures_of(emission.model)["params"].names()
    return [(name, values[name]) for name in names]


def _class_name(role: str) -> str:
    return "".join(word.capitalize() for word in role.split("_"))
