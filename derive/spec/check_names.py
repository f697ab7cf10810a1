"""What must hold of the names in a specification: none is reserved, none means two things."""

from __future__ import annotations

from collections.abc import Iterator

from pfaffian.derive.spec.model_spec import ModelSpec
from pfaffian.derive.spec.reserved_names import objection, objection_to_model
from pfaffian.derive.spec.source_line import about_constraint
from pfaffian.runtime.base.errors import InputError

_OF_THE_LAW = ("gain", "target", "swing_up")


def check_names(spec: ModelSpec) -> None:
    """Raise `InputError` for the first name that is reserved, or that two things have.

    Each is checked with the names that follow from it: the rate dx of x, the setpoint xd.
    """
    reason = objection_to_model(spec.name)
    if reason:
        raise InputError(f"model {spec.name}: {spec.name} {reason}", remedy="rename the model")
    known: dict[str, str] = {}
    for name, what, about in _declared(spec):
        _check_reserved(spec, name, what, about)
        if name in known:
            raise InputError(
                f"model {spec.name}: {name} is the name of {known[name]} and of {what}",
                remedy="rename what is yours; the law's own gains and limits keep their names",
                about=about,
            )
        known[name] = what
    for symbol in spec.constraint.residual_symbols:
        if symbol.name in known and len(spec.constraint.residual_symbols) == len(spec.actuators):
            if known[symbol.name].startswith("the actuator"):
                continue  # the two never meet
            raise InputError(
                f"model {spec.name}: {symbol.name} is the name of {known[symbol.name]} and of a "
                "servo-constraint",
                remedy="rename one of them",
                about=about_constraint(symbol.name),
            )


def _declared(spec: ModelSpec) -> Iterator[tuple[str, str, str]]:
    """Yield each name with what it is of, and the declaration at fault should it be wrong."""
    for c in spec.coordinates:
        yield c.name, f"the coordinate {c.name}", c.name
    for c in spec.coordinates:
        yield c.velocity.name, f"the rate of the coordinate {c.name}", c.name
        yield c.acceleration.name, f"the acceleration of the coordinate {c.name}", c.name
    for a in spec.actuators:
        yield a.name, f"the actuator {a.name}", a.name
    setpoints = {f"{c.name}d": c.name for c in spec.coordinates}
    law = {s.name for s in (*spec.law.limits, *spec.law.slews)}
    for p in spec.parameters:
        if p.name in setpoints and p.group == "gain":
            coordinate = setpoints[p.name]
            yield p.name, f"the setpoint of {coordinate}", f"{p.name} {coordinate}"
        elif p.group in _OF_THE_LAW or p.name in law:
            yield p.name, f"the law's own {p.name} ({p.description})", p.name
        else:
            yield p.name, f"the parameter {p.name} ({p.description})", p.name


def _check_reserved(spec: ModelSpec, name: str, what: str, about: str) -> None:
    member = name in {c.name for c in spec.coordinates} | {a.name for a in spec.actuators}
    reason = objection(name, spec.name, member=member)
    if reason:
        raise InputError(
            f"model {spec.name}: {what} cannot be called {name}: {name} {reason}",
            remedy="rename it; docs/own-plant.md lists what is reserved",
            about=about,
        )
