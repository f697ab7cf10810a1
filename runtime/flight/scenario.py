"""Scenarios: which model and parameters fly, from where, against what, for how long."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import parse_quantity
from pfaffian.runtime.base.toml import read_toml, suggestion
from pfaffian.runtime.code.generated_model import GeneratedFolder, open_generated
from pfaffian.runtime.contract.manifest import Structure
from pfaffian.runtime.flight.scenario_files import find_scenario as find_scenario
from pfaffian.runtime.flight.scenario_files import scenario_paths as scenario_paths

_TABLES = ("initial", "controller", "plant", "twin")
_TOP = ("title", "source", "model", "set", "duration", "plant_substeps", "in_report", *_TABLES)
_MAX_STEPS = 10_000_000
#: Points of the grid on which the mass matrix is judged.
_MOST_POINTS = 24**3


@dataclass(frozen=True)
class Scenario:
    """A flight: all values in SI units.

    `initial` holds q and q' by name, `controller` the controller's parameters, `plant` those of
    the simulated plant, both complete. The plant advances by `plant_substeps` Runge-Kutta steps a
    period. `in_report` marks the flights of the main job.
    """

    name: str
    title: str
    source: str
    folder: GeneratedFolder
    set_name: str
    steps: int
    plant_substeps: int
    initial: Mapping[str, float]
    controller: Mapping[str, float]
    plant: Mapping[str, float]
    setpoint: Mapping[str, float]
    in_report: bool

    @property
    def sample_time(self) -> float:
        """Return the period in seconds."""
        return self.controller["sample_time"]


def read_scenario(
    reference: str, generated: Path | None = None, set_name: str | None = None
) -> Scenario:
    """Read the scenario called `reference`, or the one in that file.

    `generated` replaces the folder of the generated model, `set_name` the parameter set. Raises
    `InputError` for an unknown scenario, model, set or key, a wrong unit, and a start inside the
    singular set or cut off from the setpoint by it.
    """
    path = find_scenario(reference)
    return scenario_of(read_toml(path), path, generated, set_name)


def scenario_of(
    document: Mapping[str, object],
    path: Path,
    generated: Path | None = None,
    set_name: str | None = None,
    *,
    start: bool = True,
    parameters: Mapping[str, float] | None = None,
) -> Scenario:
    """Return the flight in `document`, which stands in `path`: see `read_scenario`.

    `parameters` are flown instead of those of the set in the generated code, if they are given.

    Its table [twin] is left to `pfaffian.runtime.twin`. With `start` false the start may lie
    anywhere: the controller does more than balancing.
    """
    _check_keys(document, path)
    folder = open_generated(str(generated or _text(document, "model", path)))
    set_name = set_name or _text(document, "set", path)
    parameters = folder.parameters(set_name) if parameters is None else parameters
    structures = folder.manifest.structures
    known = dict(parameters)
    controller = known | _quantities(document, "controller", structures["params"], path)
    plant = known | _quantities(document, "plant", structures["plant_params"], path)
    _check_parameters(folder, parameters, document, path)
    initial = dict.fromkeys(structures["plant_state"].names(), 0.0)
    initial |= _quantities(document, "initial", structures["plant_state"], path)
    scenario = Scenario(
        name=path.stem,
        title=str(document.get("title", path.stem)),
        source=str(document.get("source", "")),
        folder=folder,
        set_name=set_name,
        steps=_steps(document, controller["sample_time"], path),
        plant_substeps=_substeps(document, path),
        initial=initial,
        controller={n: controller[n] for n in structures["params"].names()},
        plant={n: plant[n] for n in structures["plant_params"].names()},
        setpoint=_setpoint(folder, controller),
        in_report=document.get("in_report", False) is True,
    )
    _judge(scenario, path, start)
    return scenario


def _judge(scenario: Scenario, path: Path, start: bool) -> None:
    _check_domain(scenario, path)
    check_plant(scenario, path)
    if start:
        _check_start(scenario, path)


def _check_keys(document: Mapping[str, object], path: Path) -> None:
    for key in document:
        if key not in _TOP:
            raise InputError(f"{path}: unknown key {key}", remedy=suggestion(key, list(_TOP)))
    for key in ("model", "set", "duration", "initial"):
        if key not in document:
            raise InputError(f"{path}: missing {key}", remedy=f"add {key} to the scenario")
    for key in _TABLES:
        if not isinstance(document.get(key, {}), dict):
            raise InputError(f"{path}: {key} must be a table", remedy=f"write [{key}] above it")


def _text(document: Mapping[str, object], key: str, path: Path) -> str:
    value = document[key]
    if not isinstance(value, str):
        raise InputError(f"{path}: {key} must be a string", remedy=f'write {key} = "..."')
    return value


def _quantities(
    document: Mapping[str, object], table: str, structure: Structure, path: Path
) -> dict[str, float]:
    raw = document.get(table, {})
    units = {f.name: f.unit for f in structure.fields}
    values = {}
    for key, value in raw.items():  # type: ignore[attr-defined]
        if key not in units:
            raise InputError(
                f"{path}: unknown key {table}.{key}", remedy=suggestion(key, list(units))
            )
        values[key] = parse_quantity(value, units[key], f"{path}: {table}.{key}")
    return values


def _steps(document: Mapping[str, object], sample_time: float, path: Path) -> int:
    where = f"{path}: duration"
    duration = parse_quantity(document["duration"], "s", where)
    periods = duration / sample_time
    steps = round(min(periods, 2.0 * _MAX_STEPS))
    if not 1 <= steps <= _MAX_STEPS:
        raise InputError(
            f"{where}: {duration:g} s are {periods:.3g} periods of {sample_time:g} s",
            remedy=f"choose 1 to {_MAX_STEPS} periods",
        )
    return steps


def _substeps(document: Mapping[str, object], path: Path) -> int:
    value = document.get("plant_substeps", 10)
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 10_000:
        raise InputError(
            f"{path}: plant_substeps = {value!r} is no count", remedy="give 1 to 10000"
        )
    return value


def _check_parameters(
    folder: GeneratedFolder,
    parameters: Mapping[str, float],
    document: Mapping[str, object],
    path: Path,
) -> None:
    """Ask the generated code whether each value given here is within its declared bounds."""
    module, structures = folder.python_module(), folder.manifest.structures
    names = structures["params"].names()
    for table, role in (("controller", "params"), ("plant", "plant_params")):
        for key, value in _quantities(document, table, structures[role], path).items():
            if key not in names:
                continue  # a disturbance, which the controller does not know
            params = {n: parameters[n] for n in names} | {key: value}
            if int(module.init(module.Params(**params))[1]) != module.OK:
                raise InputError(
                    f"{path}: {table}.{key} = {value:g} is out of its bounds",
                    remedy=f"give a value that `pfaffian generate {folder.manifest.model}` takes",
                )


def _setpoint(folder: GeneratedFolder, controller: Mapping[str, float]) -> dict[str, float]:
    module = folder.python_module()
    names = folder.manifest.structures["params"].names()
    point = module.setpoint(module.Params(**{n: controller[n] for n in names}))
    return {name: float(value) for name, value in point.items()}


def _check_domain(scenario: Scenario, path: Path) -> None:
    for name, bound in scenario.folder.manifest.domain.items():
        if abs(scenario.initial[name]) > bound:
            raise InputError(
                f"{path}: initial.{name} = {scenario.initial[name]:g} is beyond the controller's "
                f"domain of {bound:g}",
                remedy="start within the domain",
            )


def check_plant(scenario: Scenario, path: Path, where: str = "plant") -> None:
    """Read the plant's mass matrix out of its kinetic energy: it must be positive definite.

    Raises `InputError` naming `path` and the table `where`.
    """
    module, names = scenario.folder.python_module(), scenario.folder.manifest.coordinates
    plant = module.PlantParams(**scenario.plant)
    steps = min(24, max(4, round(_MOST_POINTS ** (1.0 / len(names)))))
    turn = np.linspace(0.0, 2.0 * np.pi, steps, endpoint=False)
    grid = dict(zip(names, np.meshgrid(*[turn] * len(names)), strict=True))
    fast = 2.0**20  # so that T is not lost beside V

    def kinetic(*moving: str) -> np.ndarray[Any, Any]:
        rates = {f"d{n}": fast * moving.count(n) for n in names}
        still = dict.fromkeys(rates, 0.0)
        energy = [module.energy(plant, module.PlantState(**grid, **r)) for r in (rates, still)]
        return np.asarray(energy[0] - energy[1]) / fast**2

    mass = np.array([[kinetic(a, b) - kinetic(a) - kinetic(b) for a in names] for b in names])
    least = float(np.linalg.eigvalsh(np.moveaxis(mass, (0, 1), (-2, -1))).min())
    if not least > 0.0:
        raise InputError(
            f"{path}: {where}: the mass matrix is not positive definite (least eigenvalue "
            f"{least:.3g} kg m^2)",
            remedy="check the inertias: no rigid mechanism has this mass matrix",
        )


def _check_start(scenario: Scenario, path: Path) -> None:
    """Follow ADB on the straight way from the start to the setpoint: it must keep its sign."""
    module = scenario.folder.python_module()
    params = module.Params(**scenario.controller)
    goal = dict.fromkeys(scenario.initial, 0.0) | dict(scenario.setpoint)
    way = np.linspace(0.0, 1.0, 1001)
    point = {n: v + way * (goal[n] - v) for n, v in scenario.initial.items()}
    measured = dict.fromkeys(scenario.folder.manifest.structures["input"].names(), 0.0) | point
    gain = np.broadcast_to(module.input_gain(params, module.Input(**measured)), way.shape)
    least = scenario.controller["singular_threshold"]
    bad = (np.abs(gain) < least) | (np.sign(gain) != np.sign(gain[-1]))
    if not bad.any():
        return
    index = int(np.argmax(bad)) if bad[0] else int(np.flatnonzero(bad)[-1])
    where = ", ".join(f"{n} = {point[n][index]:.4g}" for n in scenario.folder.manifest.coordinates)
    what = (
        "the start lies in the singular set"
        if bad[0]
        else ("the singular set lies between the start and the setpoint")
    )
    raise InputError(
        f"{path}: {what}: ADB = {gain[index]:.4g} at {where}, ADB = {gain[-1]:.4g} at the setpoint",
        remedy="start nearer to the setpoint, or take gains with a wider regular region",
    )
