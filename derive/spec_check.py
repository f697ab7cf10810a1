"""What must hold of a specification before anything is derived from it, and where it is written.

The checks name the field or symbol at fault in `InputError.about`; `line_about` finds that in the
user's file.
"""

from __future__ import annotations

import ast

import sympy as sp
from pfaffian.derive.constraint import about_constraint
from pfaffian.derive.constraint_check import check_constraints, check_symbols
from pfaffian.derive.dimensions import check_unit
from pfaffian.derive.name_check import check_names
from pfaffian.derive.spec import ModelSpec, symbol_of
from pfaffian.runtime.documents import unprintable
from pfaffian.runtime.errors import InputError

#: What `line_about` may find: a field given by keyword, or a symbol by the string that names it.
_CONSTRAINTS = ("first_order", "holonomic", "second_order")
_DECLARATIONS = (
    *("coordinate", "parameter", "uncertain", "gain", "actuator"),
    *("Coordinate", "Parameter", "Actuator"),
)
_ENERGIES = (("kinetic energy", "kinetic_energy"), ("potential energy", "potential_energy"))


def check_spec(spec: ModelSpec) -> None:
    """Raise `InputError` for energies that are none, and coordinates and inputs without effect."""
    check_names(spec)
    _check_energies(spec)
    _check_texts(spec)
    _check_units(spec)
    _check_coordinates(spec)
    for k, actuator in enumerate(spec.actuators):
        if not any(spec.input_matrix[:, k]):
            raise InputError(
                f"model {spec.name}: ADB is identically zero, the actuators do not move s: "
                f"{actuator.name} acts on no coordinate",
                remedy="choose a servo-constraint that the actuators reach; say what they act on",
                about=actuator.name,
            )
    check_constraints(spec)


def _check_energies(spec: ModelSpec) -> None:
    for what, field in _ENERGIES:
        value = getattr(spec, field)
        if not isinstance(value, sp.Expr):
            raise InputError(
                f"model {spec.name}: the {what} is {value!r}, no SymPy expression",
                remedy="write it in the symbols of the coordinates and parameters",
                about=field,
            )
        if value.has(sp.zoo, sp.nan, sp.oo, -sp.oo):
            raise InputError(
                f"model {spec.name}: the {what} is not finite: {value}",
                remedy="look for a division by zero",
                about=field,
            )
    declared = {*spec.positions, *spec.velocities, *(symbol_of(p) for p in spec.parameters)}
    for what, field in _ENERGIES:
        check_symbols(spec, f"the {what}", getattr(spec, field), declared, field)
    moving = sorted(s.name for s in spec.potential_energy.free_symbols & set(spec.velocities))
    if moving:
        raise InputError(
            f"model {spec.name}: the potential energy depends on the velocity {moving[0]}",
            remedy="put what depends on velocities into the kinetic energy",
            about="potential_energy",
        )


def _check_texts(spec: ModelSpec) -> None:
    """Refuse control characters in what ends up in comments of the generated code."""
    texts = [("title", spec.title), ("source", spec.source)]
    for declared in (spec.coordinates, spec.parameters, spec.actuators):
        texts += [(d.name, text) for d in declared for text in (d.description, d.unit)]
    texts += [("stability", condition.text) for condition in spec.stability]
    for about, text in texts:
        if found := unprintable(text):
            raise InputError(
                f"model {spec.name}: a text of {about} holds the control character {found}",
                remedy="leave it out",
                about=about,
            )


def _check_units(spec: ModelSpec) -> None:
    units = {c.name: c.unit for c in spec.coordinates} | {a.name: a.unit for a in spec.actuators}
    for name, unit in (units | {p.name: p.unit for p in spec.parameters}).items():
        check_unit(unit, f"model {spec.name}: {name}", name)
    for symbol, unit in zip(
        spec.constraint.residual_symbols, spec.constraint.residual_units, strict=True
    ):
        what = f"model {spec.name}: the servo-constraint {symbol.name}"
        check_unit(unit, what, about_constraint(symbol.name))


def _check_coordinates(spec: ModelSpec) -> None:
    for c in spec.coordinates:
        if c.velocity not in spec.kinetic_energy.free_symbols:
            raise InputError(
                f"model {spec.name}: M is singular: the kinetic energy does not depend on the "
                f"velocity {c.velocity.name} of coordinate {c.name}",
                remedy=f"add what moves with {c.name} to the kinetic energy, or leave {c.name} out",
                about=c.name,
            )
        if not (c.bound > 0.0 and c.rate_bound > 0.0):
            raise InputError(
                f"model {spec.name}: coordinate {c.name} has no domain: bound {c.bound:g}, "
                f"rate_bound {c.rate_bound:g}",
                remedy="give positive bounds",
                about=c.name,
            )


def check_mass_matrix(spec: ModelSpec, mass: sp.Matrix) -> None:
    """Raise `InputError` where M is singular at a point with nothing special about it.

    The point has rational coordinates, so that the determinant is exact but for sines and cosines.
    """
    symbols = sorted(mass.free_symbols, key=lambda s: s.name)
    point = {s: sp.Rational(sp.prime(k + 5), sp.prime(k + 6)) for k, s in enumerate(symbols)}
    numbers = mass.subs(point).evalf(40)
    scale = sp.Mul(*[max(abs(x) for x in numbers[i, :]) for i in range(mass.rows)])
    if abs(numbers.det()) <= scale * sp.Float("1e-25"):
        raise InputError(
            f"model {spec.name}: M is singular: the kinetic energy does not hold all velocities "
            f"apart",
            remedy="leave out a coordinate that follows from the others, or add its inertia",
            about="kinetic_energy",
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
