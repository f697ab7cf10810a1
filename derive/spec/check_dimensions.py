"""Units of a specification: every energy one of energy, every rate one of its kind."""

from __future__ import annotations

from pfaffian.derive.spec.model_spec import ModelSpec
from pfaffian.derive.symbolic.units import dimension_of
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import unit_registry


def check_dimensions(spec: ModelSpec) -> None:
    """Raise `InputError` unless T and V are energies and each lumped parameter has its unit."""
    units = {p.name: p.unit for p in spec.parameters}
    for c in spec.coordinates:
        units |= {c.name: c.unit, c.velocity.name: f"{c.unit}/s"}
    registry = unit_registry()
    wanted = [
        ("kinetic energy", spec.kinetic_energy, "J", "kinetic_energy"),
        ("potential energy", spec.potential_energy, "J", "potential_energy"),
    ]
    wanted += [(s.name, combination, units[s.name], s.name) for s, combination in spec.lumping]
    for what, expression, unit, field in wanted:
        where = f"model {spec.name}: {what}"
        if expression == 0:
            continue  # nothing at all is an energy too
        try:
            have = dimension_of(expression, units, where)
        except InputError as error:
            error.about = f"{error.about} {field}"
            raise
        if have != registry.parse_units(unit).dimensionality:
            raise InputError(
                f"{where} has dimension {have}, but {unit} is needed",
                remedy="mend the unit of one of its symbols",
                about=field,
            )
