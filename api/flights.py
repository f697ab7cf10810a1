"""Flights of a scenario: the trajectory, its figures, and what a notebook does with them."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.api.display import html_table
from pfaffian.runtime.errors import InputError, MissingToolError

if TYPE_CHECKING:
    import numpy as np
    from pfaffian.runtime.flight import Trajectory as Recorded
    from pfaffian.runtime.generated_model import GeneratedFolder
    from pfaffian.runtime.scenario import Scenario

    Array = np.ndarray[Any, np.dtype[Any]]

#: Entries of a scenario outside its tables that may be changed.
_TOP = ("duration", "plant_substeps")
Changes = Mapping[str, Any]


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
        from pfaffian.runtime.files import write_outputs

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
    from pfaffian.runtime.metrics import status_counts, tracking_metrics

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


def fly_here(scenario: Scenario) -> Trajectory:
    """Fly `scenario` on this machine."""
    from pfaffian.runtime.flight import fly
    from pfaffian.runtime.generated_model import host_model

    host = host_model(scenario.folder)
    return trajectory_of(fly(scenario, host, host, "host"))


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
    from pfaffian.runtime.documents import read_toml
    from pfaffian.runtime.scenario import scenario_of

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
