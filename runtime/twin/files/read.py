"""Scenario files with a [twin] table: what is read from where, and what is refused.

Keys are those of the dataclasses in `settings`, quantities strings with units.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.toml import read_toml
from pfaffian.runtime.base.toml_table import Table
from pfaffian.runtime.code.sensing import Encoder
from pfaffian.runtime.contract.runtime_structs import BALANCE_LAWS, SWING_UP_LAWS
from pfaffian.runtime.flight.scenario import Scenario, check_plant, scenario_of
from pfaffian.runtime.flight.scenario_files import find_scenario
from pfaffian.runtime.twin.files import events
from pfaffian.runtime.twin.settings import (
    LONGEST_SUBSTEP,
    Channel,
    Drive,
    DryFriction,
    Sampling,
    TwinScenario,
)
from pfaffian.runtime.twin.units.registry import CONTROLLERS

_KEYS = (
    *("controller", "rigs", "seed", "actuator", "sampling", "encoder", "friction", "spread"),
    *("disturbance", "push", "fault", "command", "tolerance", "control"),
)
_DRIVE = ("limit", "time_constant", "delay", "delay_spread", "slew", "bits")
_ENCODER = (
    *("counts_per_turn", "quantum", "offset", "offset_spread", "counter_bits", "counter_zero"),
    *("direction", "noise", "dropout"),
)
_FRICTION = ("coulomb", "stiction", "stribeck", "layer")
_MOST_RIGS = 1_000_000
_LONGEST_DELAY = 0.1
_MOST_VARIED = 10


def is_twin(reference: str) -> bool:
    """Return whether the scenario called `reference`, or in that file, has a [twin] table."""
    return "twin" in read_toml(find_scenario(reference))


def read_twin(
    reference: str, generated: Path | None = None, set_name: str | None = None
) -> TwinScenario:
    """Read the scenario called `reference`, or the one in that file, with its [twin] table.

    `generated` and `set_name` as in `read_scenario`, which raises the same errors. `InputError`
    also for an unknown key, a value out of its bounds, and a plant that the spread can make
    impossible.
    """
    path = find_scenario(reference)
    return twin_of(read_toml(path), path, generated, set_name)


def twin_of(
    document: dict[str, object],
    path: Path,
    generated: Path | None = None,
    set_name: str | None = None,
) -> TwinScenario:
    """Return the scenario in `document`, as `read_twin` does; `path` is for messages."""
    if "twin" not in document:
        raise InputError(f"{path}: missing twin", remedy="add a [twin] table to the scenario")
    table = Table(document["twin"], f"{path}: twin", _KEYS)
    controller = table.choice("controller", tuple(CONTROLLERS), "balance")
    base = scenario_of(document, path, generated, set_name, start=controller == "balance")
    _check_substeps(base, path)
    scenario = TwinScenario(
        base=base,
        rigs=table.whole("rigs", 1, 1, _MOST_RIGS),
        seed=table.whole("seed", 0, 0, 2**63 - 1),
        controller=controller,
        drives=_drives(table, base),
        sampling=_sampling(table.part("sampling", ("jitter", "missed"))),
        channels=_channels(table, base),
        frictions=_frictions(table, base),
        spread=_spread(table, base),
        initial_spread=_initial_spread(table, base),
        disturbances=events.disturbances(table, base),
        pushes=events.pushes(table, base),
        faults=events.faults(table, base),
        orders=events.orders(table),
        tolerance=_tolerance(table, base),
        control=_control(table),
    )
    _check_spread(scenario, path)
    return scenario


def _check_substeps(base: Scenario, path: Path) -> None:
    if base.sample_time / base.plant_substeps > LONGEST_SUBSTEP * (1.0 + 1e-9):
        raise InputError(
            f"{path}: plant_substeps = {base.plant_substeps} are too few for a twin",
            remedy=f"take {math.ceil(base.sample_time / LONGEST_SUBSTEP - 1e-9)} or more",
        )


def _drives(table: Table, base: Scenario) -> dict[str, Drive]:
    names = base.folder.manifest.actuators
    units = events.units(base, "plant_input")
    common = table.part("actuator", (*_DRIVE, *names))
    shared = {k: v for k, v in common.raw.items() if k in _DRIVE}
    drives = {}
    for name in names:
        own = common.part(name, _DRIVE)
        where = own.where if own.raw else common.where
        drives[name] = _drive(Table({**shared, **own.raw}, where, _DRIVE), units[name])
    return drives


def _drive(table: Table, unit: str) -> Drive:
    drive = Drive(
        limit=table.quantity("limit", unit, math.inf, 0.0, above=True),
        time_constant=table.quantity("time_constant", "s", 0.0, 0.0, 10.0),
        delay=table.quantity("delay", "s", 0.0, 0.0, _LONGEST_DELAY),
        delay_spread=table.quantity("delay_spread", "s", 0.0, 0.0, _LONGEST_DELAY),
        slew=table.quantity("slew", f"{unit}/s", math.inf, 0.0, above=True),
        bits=table.whole("bits", 0, 0, 32),
    )
    if drive.bits == 1 or (drive.bits and math.isinf(drive.limit)):
        raise InputError(
            f"{table.at('bits')} = {drive.bits}: a converter has 2 bits or more and a limit",
            remedy="give limit, the largest torque that the drive puts out",
        )
    if drive.delay_spread > drive.delay:
        raise InputError(
            f"{table.at('delay_spread')} = {drive.delay_spread:g} is beyond the delay",
            remedy="give at most the delay: torque does not come before its command",
        )
    return drive


def _sampling(table: Table) -> Sampling:
    return Sampling(
        jitter=table.quantity("jitter", "", 0.0, 0.0, 0.4),
        missed=table.quantity("missed", "", 0.0, 0.0, 0.5),
    )


def _channels(table: Table, base: Scenario) -> dict[str, Channel]:
    if not table.has("encoder"):
        return {}
    names = base.folder.manifest.coordinates
    units = events.units(base, "plant_state")
    common = table.part("encoder", (*_ENCODER, *names))
    shared = {k: v for k, v in common.raw.items() if k in _ENCODER}
    channels = {}
    for name in names:
        own = common.part(name, _ENCODER)
        where = own.where if own.raw else common.where
        channels[name] = _channel(Table({**shared, **own.raw}, where, _ENCODER), units[name])
    return channels


def _channel(table: Table, unit: str) -> Channel:
    bits = table.whole("counter_bits", 32, 8, 32)
    direction = table.whole("direction", 1, -1, 1)
    if direction == 0:
        raise InputError(f"{table.at('direction')} = 0 is no direction", remedy="give 1 or -1")
    if table.has("quantum"):
        counts = 2.0 * math.pi / table.quantity("quantum", unit, 1.0, 0.0, 1.0, above=True)
    elif unit == "rad":
        counts = table.quantity("counts_per_turn", "", Encoder().counts_per_turn, 4.0, 2.0**31)
    else:
        raise InputError(
            f"{table.where}: an encoder in {unit} has no turns",
            remedy=f'give quantum, what a count is worth, for instance "0.0001 {unit}"',
        )
    return Channel(
        encoder=Encoder(
            counts_per_turn=counts,
            offset=table.quantity("offset", unit, 0.0, -1000.0, 1000.0),
            counter_bits=bits,
            counter_zero=table.whole("counter_zero", 0, 0, (1 << bits) - 1),
            direction=direction,
        ),
        offset_spread=table.quantity("offset_spread", unit, 0.0, 0.0, 1000.0),
        noise=table.whole("noise", 0, 0, 1000),
        dropout=table.quantity("dropout", "", 0.0, 0.0, 1.0),
    )


def _frictions(table: Table, base: Scenario) -> tuple[DryFriction, ...]:
    names = base.folder.manifest.coordinates
    forces, rates = events.force_units(base), events.units(base, "plant_state")
    part = table.part("friction", names)
    frictions = []
    for name in part.raw:
        one = part.part(name, _FRICTION)
        one.need("coulomb", "layer")
        rate = rates[f"d{name}"]
        coulomb = one.quantity("coulomb", forces[name], 0.0, 0.0)
        layer = one.quantity("layer", rate, 1.0, 0.0, above=True)
        frictions.append(
            DryFriction(
                joint=name,
                coulomb=coulomb,
                stiction=one.quantity("stiction", forces[name], coulomb, coulomb),
                stribeck=one.quantity("stribeck", rate, 10.0 * layer, 0.0, above=True),
                layer=layer,
            )
        )
    return tuple(frictions)


def _spread(table: Table, base: Scenario) -> dict[str, float]:
    part = table.part("spread", ("plant", "initial")).part("plant", tuple(base.plant))
    return {n: part.quantity(n, "", 0.0, 0.0, 0.9) for n in part.raw}


def _initial_spread(table: Table, base: Scenario) -> dict[str, float]:
    part = table.part("spread", ("plant", "initial")).part("initial", tuple(base.initial))
    units = events.units(base, "plant_state")
    return {n: part.quantity(n, units[n], 0.0, 0.0) for n in part.raw}


def _control(table: Table) -> dict[str, float | int]:
    """Return changes of the complete controller's members: numbers in SI units, laws by name."""
    words = {"swing_up": SWING_UP_LAWS, "balance": BALANCE_LAWS}
    part = table.part("control", None)
    found: dict[str, float | int] = {}
    for key, raw in part.raw.items():
        known = words.get(key)
        value = known.get(str(raw)) if known else raw
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(
                f"{part.at(key)} = {raw!r}",
                remedy=f"known: {', '.join(known)}" if known else "give a number in SI units",
            )
        found[key] = value
    return found


def _tolerance(table: Table, base: Scenario) -> dict[str, float]:
    units = events.units(base, "plant_state")
    part = table.part("tolerance", base.folder.manifest.coordinates)
    return {n: part.quantity(n, units[n], 0.0, 0.0, above=True) for n in part.raw}


def _check_spread(scenario: TwinScenario, path: Path) -> None:
    """Judge the mass matrix in every corner of the spread: the least eigenvalue is concave in M.

    The parameters that shape it are linear in M, or monotone, in the models of the library.
    """
    base = scenario.base
    shaping = [n for n in scenario.spread if n in base.controller and scenario.spread[n]]
    if len(shaping) > _MOST_VARIED:
        raise InputError(
            f"{path}: twin.spread.plant: {len(shaping)} parameters of the model differ",
            remedy=f"spread at most {_MOST_VARIED} of them",
        )
    for signs in itertools.product((-1.0, 1.0), repeat=len(shaping)):
        factors = {n: 1.0 + s * scenario.spread[n] for n, s in zip(shaping, signs, strict=True)}
        plant = {n: v * factors.get(n, 1.0) for n, v in base.plant.items()}
        check_plant(replace(base, plant=plant), path, "twin.spread.plant")
