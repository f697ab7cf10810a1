"""What must hold of a specification before anything is derived from it, and where it is written.

The checks name the field or symbol at fault in `InputError.about`; `line_about` finds that in the
user's file.
"""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.spec.check_constraints import check_constraints, check_symbols
from pfaffian.derive.spec.check_names import check_names
from pfaffian.derive.spec.model_spec import ModelSpec, symbol_of
from pfaffian.derive.spec.source_line import about_constraint
from pfaffian.derive.symbolic.units import check_unit
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.toml import unprintable

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
