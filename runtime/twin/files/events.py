"""What happens during a flight on the twin, read from its scenario: forces, faults, orders."""

from __future__ import annotations

import math

from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.toml_table import Table
from pfaffian.runtime.flight.scenario import Scenario
from pfaffian.runtime.twin.settings import FAULTS, SHAPES, Disturbance, Fault, Order, Push
from pfaffian.runtime.twin.unit import COMMANDS

_DISTURBANCE = ("joint", "shape", "amplitude", "start", "end", "frequency", "phase")
_PUSH = ("joint", "time", "impulse", "force", "duration")
_FAULT = ("kind", "time", "duration", "joint", "counts", "parameter", "bit", "rigs")
_ENCODER_FAULTS = ("freeze_encoder", "jump", "drop_reading")


def units(base: Scenario, role: str) -> dict[str, str]:
    """Return the units of the members of a structure by name."""
    return {f.name: f.unit for f in base.folder.manifest.structures[role].fields}


def force_units(base: Scenario) -> dict[str, str]:
    """Return the unit of the generalised force on each coordinate: a torque, or a force."""
    of = units(base, "plant_state")
    return {c: "N*m" if of[c] == "rad" else "N" for c in base.folder.manifest.coordinates}


def disturbances(table: Table, base: Scenario) -> tuple[Disturbance, ...]:
    """Return the disturbances in order."""
    joints, forces = base.folder.manifest.coordinates, force_units(base)
    found = []
    for row in table.rows("disturbance", _DISTURBANCE):
        row.need("joint", "shape", "amplitude")
        joint, shape = row.choice("joint", joints), row.choice("shape", SHAPES)
        row.need(
            *{"sine": ("frequency",), "step": ("start",), "pulse": ("start", "end")}.get(shape, ())
        )
        start = row.quantity("start", "s", 0.0, 0.0)
        found.append(
            Disturbance(
                joint=joint,
                shape=shape,
                amplitude=row.quantity("amplitude", forces[joint], 0.0),
                start=start,
                end=row.quantity("end", "s", math.inf, start, above=True),
                frequency=row.quantity("frequency", "Hz", 0.0, 0.0, 1000.0),
                phase=row.quantity("phase", "rad", 0.0, 0.0, 2.0 * math.pi) / (2.0 * math.pi),
            )
        )
    return tuple(found)


def pushes(table: Table, base: Scenario) -> tuple[Push, ...]:
    """Return the pushes in order."""
    joints, forces = base.folder.manifest.coordinates, force_units(base)
    found = []
    for row in table.rows("push", _PUSH):
        row.need("joint", "time")
        if row.has("impulse") == row.has("force"):
            raise InputError(
                f"{row.where}: needs either impulse or force",
                remedy="give an impulse, or a force with its duration",
            )
        row.need(*(("duration",) if row.has("force") else ()))
        joint = row.choice("joint", joints)
        found.append(
            Push(
                joint=joint,
                time=row.quantity("time", "s", 0.0, 0.0),
                impulse=row.quantity("impulse", f"{forces[joint]}*s", 0.0),
                force=row.quantity("force", forces[joint], 0.0),
                duration=row.quantity("duration", "s", 0.0, 0.0, above=True),
            )
        )
    return tuple(found)


def faults(table: Table, base: Scenario) -> tuple[Fault, ...]:
    """Return the faults in order."""
    return tuple(_fault(row, base) for row in table.rows("fault", _FAULT))


def _fault(row: Table, base: Scenario) -> Fault:
    row.need("kind", "time")
    kind = row.choice("kind", tuple(FAULTS))
    row.need(*(("joint",) if kind in _ENCODER_FAULTS else ()))
    row.need(*{"jump": ("counts",), "flip": ("parameter", "bit")}.get(kind, ()))
    parameters = base.folder.manifest.structures["params"].names()
    usual = 0.0 if FAULTS[kind] else math.inf
    coordinates = base.folder.manifest.coordinates
    return Fault(
        kind=kind,
        time=row.quantity("time", "s", 0.0, 0.0),
        duration=row.quantity("duration", "s", usual, 0.0, above=True),
        joint=row.choice("joint", coordinates) if row.has("joint") else "",
        counts=row.whole("counts", 0, -(2**31), 2**31),
        parameter=row.choice("parameter", parameters) if row.has("parameter") else "",
        bit=row.whole("bit", 0, 0, 63),
        rigs=_rigs(row),
    )


def _rigs(row: Table) -> tuple[int, ...]:
    raw = row.raw.get("rigs", [])
    if not isinstance(raw, list) or not all(type(r) is int and r >= 0 for r in raw):
        raise InputError(f"{row.at('rigs')} is no list of rigs", remedy="write rigs = [0, 3]")
    return tuple(raw)


def orders(table: Table) -> tuple[Order, ...]:
    """Return the operator's orders in order: `start` at once, where none is given."""
    rows = table.rows("command", ("time", "value"))
    if not table.has("command"):
        return (Order(0.0, "start"),)
    found = []
    for row in rows:
        row.need("time", "value")
        found.append(
            Order(row.quantity("time", "s", 0.0, 0.0), row.choice("value", tuple(COMMANDS)))
        )
    return tuple(sorted(found, key=lambda o: o.time))
