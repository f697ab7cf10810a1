"""Campaigns: one scenario flown in many variants, each by many rigs.

A campaign is a TOML file that names a scenario with a [twin] table and the axes along which it is
changed; every combination of their points is a case. What a point changes is merged into the
scenario's document before it is read: a case is judged as a scenario of its own would be.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.toml import read_toml, suggestion
from pfaffian.runtime.flight.scenario_files import find_scenario
from pfaffian.runtime.twin.files.read import twin_of
from pfaffian.runtime.twin.flight import fly_twin
from pfaffian.runtime.twin.recording import Wanted
from pfaffian.runtime.twin.rig import plant_model
from pfaffian.runtime.twin.settings import TwinScenario
from pfaffian.runtime.twin.statistics import Statistics
from pfaffian.runtime.twin.units.registry import CONTROLLERS

Document = dict[str, Any]
Progress = Callable[[int, int], None]
_TOP = ("title", "source", "scenario", "change", "axis")
_AXIS = ("name", "point")
_POINT = ("name", "change")
_MOST_CASES = 10_000


@dataclass(frozen=True)
class Case:
    """One variant: its point on every axis by the axis's name, and the scenario it makes."""

    points: Mapping[str, str]
    document: Document

    @property
    def name(self) -> str:
        """Return the points in one line."""
        return ", ".join(self.points.values()) or "as it is"


@dataclass(frozen=True)
class Campaign:
    """All cases of a campaign; `path` is the scenario's, for messages."""

    name: str
    title: str
    source: str
    path: Path
    cases: tuple[Case, ...]

    def scenario(self, case: Case, generated: Path | None = None) -> TwinScenario:
        """Return the scenario of `case`; raise `InputError` naming the case where it has none."""
        try:
            return twin_of(case.document, self.path, generated)
        except InputError as error:
            what = f"{self.name} ({case.name}): {error.message}"
            raise InputError(what, remedy=error.remedy) from error


@dataclass(frozen=True)
class Result:
    """What came of one case: the statistics of its rigs, and the digest of their outputs."""

    case: Case
    seed: int
    statistics: Statistics
    sha256: str


def campaign_paths() -> dict[str, Path]:
    """Return the campaigns that come with this package, by name."""
    root = Path(str(files("pfaffian.runtime"))) / "campaigns"
    return {p.stem: p for p in sorted(root.glob("*.toml"))}


def read_campaign(reference: str) -> Campaign:
    """Read the campaign called `reference`, or the one in that file.

    Raises `InputError` for an unknown campaign, scenario or key, an axis without points, and a name
    that two axes or two points of one have.
    """
    known = campaign_paths()
    path = known.get(reference, Path(reference))
    if reference not in known and not path.is_file():
        raise InputError(f"unknown campaign {reference}", remedy=suggestion(reference, list(known)))
    document = read_toml(path)
    _check(document, _TOP, ("scenario",), f"{path}")
    scenario = find_scenario(str(document["scenario"]))
    base = _merged(read_toml(scenario), _table(document, "change", f"{path}"))
    axes = [_points(axis, f"{path}: axis {k + 1}") for k, axis in enumerate(_axes(document, path))]
    _check_distinct([axis[0][0] for axis in axes], "axes", f"{path}")
    cases = []
    for combination in itertools.product(*axes):
        changed = base
        for _, _, change in combination:
            changed = _merged(changed, change)
        cases.append(Case({axis: point for axis, point, _ in combination}, changed))
    if len(cases) > _MOST_CASES:
        raise InputError(f"{path}: {len(cases)} cases", remedy=f"at most {_MOST_CASES}")
    title, source = str(document.get("title", path.stem)), str(document.get("source", ""))
    return Campaign(path.stem, title, source, scenario, tuple(cases))


def _axes(document: Mapping[str, Any], path: Path) -> list[Any]:
    axes = document.get("axis", [])
    if not isinstance(axes, list):
        raise InputError(f"{path}: axis must be an array of tables", remedy="write [[axis]]")
    return axes


def _points(axis: Any, where: str) -> list[tuple[str, str, Document]]:
    if not isinstance(axis, dict):
        raise InputError(f"{where} is no table", remedy="write [[axis]]")
    _check(axis, _AXIS, _AXIS, where)
    points = axis["point"]
    if not isinstance(points, list) or not points:
        raise InputError(f"{where}: point is no array of tables", remedy="write [[axis.point]]")
    found = []
    for k, point in enumerate(points):
        here = f"{where}, point {k + 1}"
        if not isinstance(point, dict):
            raise InputError(f"{here} is no table", remedy="write [[axis.point]]")
        _check(point, _POINT, ("name",), here)
        found.append((str(axis["name"]), str(point["name"]), _table(point, "change", here)))
    _check_distinct([name for _, name, _ in found], "points", where)
    return found


def _check_distinct(names: list[str], what: str, where: str) -> None:
    """Refuse names that are empty or given twice: cases would not be told apart by them."""
    for k, name in enumerate(names):
        if not name.strip():
            raise InputError(f"{where}: one of its {what} has no name", remedy="give it one")
        if name in names[:k]:
            raise InputError(f"{where}: two {what} are called {name}", remedy="rename one of them")


def _check(
    table: Mapping[str, Any], known: tuple[str, ...], needed: tuple[str, ...], where: str
) -> None:
    for key in table:
        if key not in known:
            raise InputError(f"{where}: unknown key {key}", remedy=suggestion(key, list(known)))
    for key in needed:
        if key not in table:
            raise InputError(f"{where}: missing {key}", remedy=f"add {key}")


def _table(document: Mapping[str, Any], key: str, where: str) -> Document:
    table = document.get(key, {})
    if not isinstance(table, dict):
        raise InputError(f"{where}: {key} must be a table", remedy=f"write [{key}]")
    return table


def _merged(document: Document, change: Document) -> Document:
    """Return `document` with `change` in it: tables entry by entry, all else replaced."""
    merged = deepcopy(document)
    for key, value in change.items():
        old = merged.get(key)
        if isinstance(value, dict) and isinstance(old, dict):
            merged[key] = _merged(old, value)
        else:
            merged[key] = deepcopy(value)
    return merged


def fly_case(campaign: Campaign, case: Case, generated: Path | None = None) -> Result:
    """Fly all rigs of one case on the host."""
    scenario = campaign.scenario(case, generated)
    model = plant_model(scenario.base.folder)
    unit = CONTROLLERS[scenario.controller](scenario, model, "host")
    flight = fly_twin(scenario, unit, Wanted(rigs=()), model=model)
    return Result(case, scenario.seed, flight.statistics, flight.sha256())


def fly_campaign(
    campaign: Campaign, generated: Path | None = None, jobs: int = 1
) -> Iterator[Result]:
    """Yield the result of every case in order; `jobs` processes share the work."""
    for case in campaign.cases:
        campaign.scenario(case, generated)  # a mistake is told before anything flies
    if jobs == 1 or len(campaign.cases) == 1:
        yield from (fly_case(campaign, case, generated) for case in campaign.cases)
        return
    with ProcessPoolExecutor(jobs) as pool:
        count = len(campaign.cases)
        yield from pool.map(fly_case, [campaign] * count, campaign.cases, [generated] * count)


def row_of(result: Result, coordinates: tuple[str, ...]) -> dict[str, Any]:
    """Return the figures of a case: shares, quantiles over its rigs and the rigs that failed.

    Times in seconds; IAE and MAE2 are the medians over the rigs that were captured.
    """
    found = result.statistics
    captured, count = found.captured, len(found.lost)
    times = np.sort(found.capture_time[captured])
    row: dict[str, Any] = {
        **result.case.points,
        "rigs": count,
        "captured": int(captured.sum()),
        "capture_time_least": _quantile(times, 0.0),
        "capture_time_median": _quantile(times, 0.5),
        "capture_time_95": _quantile(times, 0.95),
        "capture_time_most": _quantile(times, 1.0),
    }
    for k, name in enumerate(coordinates):
        for figure in ("iae", "mae2"):
            row[f"{figure}_{name}"] = _quantile(np.sort(getattr(found, figure)[captured, k]), 0.5)
    row |= {
        "peak_torque": float(found.peak_torque.max()),
        "violations": int(found.violations.sum()),
        "faulted": int((found.first_fault != 0).sum()),
        "failed": [int(k) for k in np.flatnonzero(~captured)],
        "seed": result.seed,
        "sha256": result.sha256,
    }
    return row


def _quantile(ordered: np.ndarray[Any, Any], share: float) -> float | None:
    """Return the entry of a sorted array below which `share` of it lies; None of an empty one."""
    if not len(ordered):
        return None
    return float(ordered[round(share * (len(ordered) - 1))])
