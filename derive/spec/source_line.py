"""Where in a specification something stands, for messages."""

from __future__ import annotations

import ast

#: What `line_about` may find: a field given by keyword, or a symbol by the string that names it.
_CONSTRAINTS = ("first_order", "holonomic", "second_order")
_DECLARATIONS = (
    *("coordinate", "parameter", "uncertain", "gain", "actuator"),
    *("Coordinate", "Parameter", "Actuator"),
)


def line_about(text: str, about: str) -> int | None:
    """Return the line of `text` that gives the field, or names the symbol, `about`.

    `constraint:NAME` is the line where a builder adds the servo-constraint of that name, and
    `number:VALUE` that where this number is written.
    """
    try:
        nodes = list(ast.walk(ast.parse(text)))
    except SyntaxError:
        return None
    if about.startswith("constraint:"):
        name = about.removeprefix("constraint:")
        calls = [n for n in nodes if isinstance(n, ast.Call) and _calls(n, _CONSTRAINTS, name)]
        return min((n.lineno for n in calls), default=None)
    if about.startswith("number:"):
        value = float(about.removeprefix("number:"))
        written = [n for n in nodes if isinstance(n, ast.Constant) and type(n.value) is float]
        return min((n.lineno for n in written if n.value == value), default=None)
    declared = [
        n.lineno for n in nodes if isinstance(n, ast.Call) and _calls(n, _DECLARATIONS, about)
    ]
    fields = [n.value.lineno for n in nodes if isinstance(n, ast.keyword) and n.arg == about]
    firsts = [n.args[0] for n in nodes if isinstance(n, ast.Call) and n.args]
    names = [
        a.lineno
        for a in firsts
        if isinstance(a, ast.Constant)
        and isinstance(a.value, str)
        and about in a.value.replace(",", " ").split()
    ]
    return min(declared or fields or names, default=None)


def _calls(node: ast.Call, methods: tuple[str, ...], name: str) -> bool:
    """Return whether `node` calls one of `methods` with `name` as what is named."""
    called = node.func.attr if isinstance(node.func, ast.Attribute) else ""
    called = node.func.id if isinstance(node.func, ast.Name) else called
    given = [*node.args[:1], *(k.value for k in node.keywords if k.arg == "name")]
    return called in methods and any(isinstance(g, ast.Constant) and g.value == name for g in given)


def about_constraint(name: str) -> str:
    """Return what `InputError.about` says of a constraint: where it is added, else the field."""
    return f"constraint:{name} residual"
