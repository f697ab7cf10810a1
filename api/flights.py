"""Flights of a scenario: the trajectory, its figures, and what a notebook does with them."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.api.display import SILENT, Teller, html_table
from pfaffian.runtime.base.errors import InputError, MissingToolError

if TYPE_CHECKING:
    import numpy as np
    from pfaffian.runtime.code.generated_model import GeneratedFolder, GeneratedModel
    from pfaffian.runtime.flight.closed_loop import Trajectory as Recorded
    from pfaffian.runtime.flight.scenario import Scenario
    from pfaffian.runtime.twin.recording import Flight, Wanted
    from pfaffian.runtime.twin.settings import TwinScenario

    Array = np.ndarray[Any, np.dtype[Any]]

#: Entries of a scenario outside its tables that may be changed.
_TOP = ("duration", "plant_substeps")
Changes = Mapping[str, Any]
EMULATORS = ("unicorn", "qemu-user", "qemu-system")
#: Emulators, and the targets that each flies.
BARE_TARGET = "ppc750"


@dataclass(frozen=True)
class Emulated:
    """Where a flight in the loop runs; `budget` is the share of a period that a step may take."""

    emulator: str = "unicorn"
    target: str = BARE_TARGET
    budget: float = 0.1

    def check(self) -> None:
        """Raise `InputError` for what is not there."""
        if self.emulator not in EMULATORS:
            raise InputError(
                f"unknown emulator {self.emulator}", remedy=f"known: {', '.join(EMULATORS)}"
            )
        if self.emulator == "qemu-system" and self.target != BARE_TARGET:
            raise InputError(
                f"--emulator qemu-system has no board with target {self.target}",
                remedy=f"it flies {BARE_TARGET}; other targets: unicorn or qemu-user",
            )
        if not 0.0 < self.budget <= 1.0:
            raise InputError(f"--budget {self.budget:g} is no share of a period", remedy="0 to 1")


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """A recorded flight of N periods, in SI units.

    `time` is (N,), the start of each period; `signals` has (N,) by name: what the controller
    measured, gave and remembered, `status` and the plant's `energy`. `metrics` are those of
    `pfaffian simulate`: IAE, MAE, MAE2 by coordinate and the peak torque.
    """

    scenario: str
    set_name: str
    mode: str
    time: Array
    signals: Mapping[str, Array]
    metrics: Mapping[str, float]
    status: Mapping[str, int]
    sha256: str
    coordinates: tuple[str, ...]
    actuators: tuple[str, ...]
    units: Mapping[str, str]
    _recorded: Recorded = field(repr=False)

    def __len__(self) -> int:
        """Return the number of periods."""
        return len(self.time)

    def __getitem__(self, name: str) -> Array:
        """Return the signal called `name`, shape (N,)."""
        return self.signals[name]

    def to_pandas(self) -> Any:
        """Return the signals as a `DataFrame` over time; needs pandas."""
        try:
            import pandas as pd
        except ImportError as error:
            raise MissingToolError(
                "pandas is not installed, which a DataFrame is of",
                remedy="pip install pandas, or pfaffian[notebook]; to_csv() does without it",
            ) from error
        return pd.DataFrame(dict(self.signals), index=pd.Index(self.time, name="time"))

    def to_csv(self, path: str | Path) -> Path:
        """Write time and signals as CSV, each number with all its digits; return the path."""
        from pfaffian.runtime.base.files import write_outputs

        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(("time", *self.signals))
        columns = [self.time.tolist(), *(s.tolist() for s in self.signals.values())]
        writer.writerows(zip(*columns, strict=True))
        write_outputs({Path(path): text.getvalue().encode()})
        return Path(path)

    def plot(self) -> Any:
        """Return a Matplotlib figure of coordinates, with their setpoints, and torques."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7.0, 5.0), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True)
        goals = self._recorded.scenario.setpoint
        for name in self.coordinates:
            (line,) = above.plot(self.time, self.signals[name], label=self._label(name))
            if name in goals:
                above.axhline(goals[name], color=line.get_color(), linestyle=":", linewidth=1.0)
        for name in self.actuators:
            below.plot(self.time, self.signals[name], label=self._label(name))
        above.set_title(f"{self.scenario}, set {self.set_name}")
        below.set_xlabel("time [s]")
        for axes in (above, below):
            axes.legend()
            axes.grid(visible=True, alpha=0.3)
        return figure

    def __repr__(self) -> str:
        """Return one line."""
        errors = ", ".join(f"IAE {q} {self.metrics[f'iae_{q}']:.4g}" for q in self.coordinates)
        return f"<flight {self.scenario}, set {self.set_name}: {len(self)} periods, {errors}>"

    def _repr_html_(self) -> str:
        return html_table(
            f"{self.scenario}, set {self.set_name}", ("figure", "value"), list(self.metrics.items())
        )

    def _label(self, name: str) -> str:
        return f"{name} [{self.units[name]}]"


def trajectory_of(flown: Recorded) -> Trajectory:
    """Return a flight as the public face shows it."""
    from pfaffian.runtime.flight.metrics import status_counts, tracking_metrics

    manifest = flown.scenario.folder.manifest
    signals = {
        name: records[name]
        for records in (flown.measured, flown.output, flown.state)
        for name in records.dtype.names or ()
    }
    structures = manifest.structures
    units = {f.name: f.unit for r in ("input", "output", "state") for f in structures[r].fields}
    return Trajectory(
        scenario=flown.scenario.name,
        set_name=flown.scenario.set_name,
        mode=flown.mode,
        time=flown.time,
        signals={**signals, "status": flown.status, "energy": flown.energy},
        metrics=tracking_metrics(flown),
        status=status_counts(flown),
        sha256=flown.sha256(),
        coordinates=manifest.coordinates,
        actuators=manifest.actuators,
        units=units,
        _recorded=flown,
    )


def changed_scenario(
    path: Path,
    code: GeneratedFolder,
    parameters: tuple[str, Mapping[str, float]] | None,
    changes: Changes,
    tables: Mapping[str, Changes],
) -> Scenario:
    """Return the scenario in `path` with `changes` to its top and its start, and to its tables.

    `parameters` are the name and values of a set to fly instead of its own. Raises `InputError`
    as for a scenario's file, and for one that flies on the twin.
    """
    from pfaffian.runtime.base.toml import read_toml
    from pfaffian.runtime.flight.scenario import scenario_of

    document = dict(read_toml(path))
    if "twin" in document:
        raise InputError(
            f"{path}: flies on the twin",
            remedy=f"fly it by pfaffian simulate {path.stem}, or name a scenario without [twin]",
        )
    document |= {n: v for n, v in changes.items() if n in _TOP}
    merged = {**tables, "initial": {n: v for n, v in changes.items() if n not in _TOP}}
    for table, values in merged.items():
        if values:
            before = document.get(table, {})
            document[table] = {**(before if isinstance(before, dict) else {}), **values}
    name, values_in_si = parameters or (None, None)
    return scenario_of(document, path, code.path, name, parameters=values_in_si)


def is_of_flight(name: str, code: GeneratedFolder) -> bool:
    """Return whether `name` is of the flight: of its start, its duration or its integration."""
    return name in _TOP or name in code.manifest.structures["plant_state"].names()


def fly_host(scenario: Scenario, tell: Teller = SILENT) -> tuple[Recorded, dict[str, Any]]:
    """Fly on this machine; return the trajectory and its document."""
    from pfaffian.runtime.code.generated_model import host_model
    from pfaffian.runtime.flight.closed_loop import fly

    host = host_model(scenario.folder)
    with tell.progress(f"flying {scenario.name} on the host") as update:
        trajectory = fly(scenario, host, host, "host", update)
    return trajectory, flight_document(trajectory)


def fly_both(
    scenario: Scenario, where: Emulated | None = None, tell: Teller = SILENT
) -> tuple[Recorded, dict[str, Any]]:
    """Fly on the emulated target and on this machine; return the target's flight.

    Where bits of a flight in single differ, a build that rounds as the emulator does may have the
    target's: they are then counted as the emulator's.
    """
    from pfaffian.runtime.code.generated_model import host_model, twice_rounding_model
    from pfaffian.runtime.flight.closed_loop import differing_bits, fly

    where = where or Emulated()
    host = host_model(scenario.folder)
    there, costs = _fly_there(scenario, where, host, tell)
    with tell.progress(f"flying {scenario.name} on the host") as update:
        here = fly(scenario, host, host, "host", update)
    document = {**flight_document(there), **costs, "host_trajectory_sha256": here.sha256()}
    differing = differing_bits(here, there)
    if scenario.folder.manifest.precision == "single":
        witness = fly(scenario, twice_rounding_model(scenario.folder), host, "host")
        remaining = min(differing, differing_bits(witness, there))
        document["emulator_bits"] = differing - remaining
        differing = remaining
    return there, {**document, "differing_bits": differing}


def _fly_there(
    scenario: Scenario, where: Emulated, host: GeneratedModel, tell: Teller
) -> tuple[Recorded, dict[str, Any]]:
    """Fly on the emulated target; return the flight, and what it cost where that is known.

    With unicorn the plant stays on this machine; the others fly it on the target too.
    """
    from pfaffian.runtime.code.generated_model import emulated_model
    from pfaffian.runtime.flight.closed_loop import fly
    from pfaffian.runtime.flight.flight_program import bare_document, fly_bare, fly_qemu_user
    from pfaffian.runtime.machine.toolchain import find_target

    text = f"flying {scenario.name} on the emulated {where.target}, {where.emulator}"
    if where.emulator == "unicorn":
        target = find_target(where.target)
        if not target.unicorn:
            raise InputError(
                f"target {where.target} is not emulated by unicorn",
                remedy="try --emulator qemu-user",
            )
        there = emulated_model(scenario.folder, target)
        with tell.progress(text) as update:
            return fly(scenario, there, host, "pil-unicorn", update), {}
    with tell.progress(text):
        if where.emulator == "qemu-user":
            return fly_qemu_user(scenario, where.target), {}
        flown, report = fly_bare(scenario)
        return flown, bare_document(report, where.budget)


def flight_document(trajectory: Recorded) -> dict[str, Any]:
    """Return the document of one flight."""
    from pfaffian.runtime.flight.metrics import status_counts, tracking_metrics

    return {
        "scenario": trajectory.scenario.name,
        "set": trajectory.scenario.set_name,
        "mode": trajectory.mode,
        "steps": len(trajectory.time),
        **tracking_metrics(trajectory),
        "status": status_counts(trajectory),
        "trajectory_sha256": trajectory.sha256(),
    }


def twin_document(
    reference: str, mode: str, set_name: str | None, generated: Path | None, tell: Teller = SILENT
) -> dict[str, Any]:
    """Fly a scenario with a [twin] table; on an emulator also on the host, and compare."""
    from pfaffian.runtime.twin.files.read import read_twin
    from pfaffian.runtime.twin.recording import Wanted
    from pfaffian.runtime.twin.rig import plant_model

    scenario = read_twin(reference, generated, set_name)
    model = plant_model(scenario.base.folder)
    if mode == "host":
        return _twin_document(_fly_twin(scenario, model, "host", Wanted(rigs=()), tell), "host")
    return _compared_twins(scenario, model, mode, Wanted(rigs=range(scenario.rigs)), tell)[1]


def whole_flight(
    reference: str, generated: Path, tell: Teller = SILENT
) -> tuple[Flight, dict[str, Any]]:
    """Fly a scenario of one rig on the emulated 750 and on the host; return the latter with both
    flights' document."""
    from pfaffian.runtime.twin.files.read import read_twin
    from pfaffian.runtime.twin.recording import Wanted
    from pfaffian.runtime.twin.rig import plant_model

    scenario = read_twin(reference, generated)
    return _compared_twins(scenario, plant_model(scenario.base.folder), "unicorn", Wanted(), tell)


def _compared_twins(
    scenario: TwinScenario, model: GeneratedModel, mode: str, wanted: Wanted, tell: Teller
) -> tuple[Flight, dict[str, Any]]:
    from pfaffian.runtime.twin.recording import differing_bits

    there = _fly_twin(scenario, model, "ppc750", wanted, tell)
    here = _fly_twin(scenario, model, "host", wanted, tell)
    return here, {
        **_twin_document(there, f"pil-{mode}"),
        "host_trajectory_sha256": here.sha256(),
        "differing_bits": differing_bits(here, there),
    }


def _fly_twin(
    scenario: TwinScenario, model: GeneratedModel, machine: str, wanted: Wanted, tell: Teller
) -> Flight:
    from pfaffian.runtime.twin.flight import fly_twin
    from pfaffian.runtime.twin.units.registry import CONTROLLERS

    place = "the host" if machine == "host" else "the emulated PowerPC 750GX"
    unit = CONTROLLERS[scenario.controller](scenario, model, machine)
    with tell.progress(f"flying {scenario.base.name} on the twin, {place}") as update:
        return fly_twin(scenario, unit, wanted, model=model, threads=2, progress=update)


def _twin_document(flight: Flight, mode: str) -> dict[str, Any]:
    """Return the document of a flight: the worst of all rigs where there are several."""
    from pfaffian.runtime.twin.statistics import summary

    of, found = flight.scenario, flight.statistics
    captured = int(found.captured.sum())
    return {
        "scenario": of.base.name,
        "set": of.base.set_name,
        "mode": mode,
        "controller": of.controller,
        "rigs": of.rigs,
        "steps": int(found.periods.max()),
        **summary(found, of.coordinates),
        "captured": captured == of.rigs,
        "captured_rigs": captured,
        "time_to_capture": float(found.capture_time.max()) if captured == of.rigs else None,
        "saturated_share": float(found.saturated.max()),
        "limit_violations": int(found.violations.sum()),
        "fault_periods": int(found.fault_periods.sum()),
        "lost_rigs": int(found.lost.sum()),
        "trajectory_sha256": flight.sha256(),
    }
