"""Where scenarios are: in this package, in a plant's folder, in a file; and which a report flies.

Kept apart from reading them: whoever only lists files needs no NumPy.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.toml import read_toml, suggestion


def scenario_paths() -> dict[str, Path]:
    """Return the scenarios that come with this package, by name; those on the twin come last."""
    root = Path(str(files("pfaffian.runtime"))) / "scenarios"
    return {p.stem: p for p in (*sorted(root.glob("*.toml")), *sorted(root.glob("twin/*.toml")))}


def find_scenario(reference: str) -> Path:
    """Return the file of the scenario called `reference`, or `reference` as a path.

    Raises `InputError` where there is neither.
    """
    known = scenario_paths()
    path = known.get(reference, Path(reference))
    if reference not in known and not path.is_file():
        raise InputError(f"unknown scenario {reference}", remedy=suggestion(reference, list(known)))
    return path


def is_scenario(path: Path) -> bool:
    """Return whether the TOML file at `path` is a scenario, not a parameter set.

    A file that cannot be read is none: whoever reads it as a set says what is wrong with it.
    """
    try:
        document = read_toml(path)
    except InputError:
        return False
    return bool({"initial", "duration"} & set(document))


def scenarios_of(model: str, own: Mapping[str, Path]) -> dict[str, dict[str, Any]]:
    """Return the documents of a model's scenarios by reference: those in its folder, `own`, or
    else those that come with this package."""
    if own:
        return {str(path): read_toml(path) for path in own.values()}
    documents = {name: read_toml(path) for name, path in scenario_paths().items()}
    return {n: d for n, d in documents.items() if d.get("model") == model}


def report_scenarios(model: str, own: Mapping[str, Path]) -> list[str]:
    """Return the scenarios that the main job flies: those marked `in_report`, or else all.

    Raises `InputError` where there is none.
    """
    flown = {n: d for n, d in scenarios_of(model, own).items() if "twin" not in d}
    if not flown:
        raise InputError(
            f"there is no scenario of model {model}",
            remedy="write one beside spec.py: scenarios/NAME.toml with model, set, duration and "
            "[initial]; docs/own-plant.md shows one",
        )
    return [n for n, d in flown.items() if d.get("in_report")] or list(flown)


def report_twin(model: str, own: Mapping[str, Path]) -> str | None:
    """Return the scenario of the complete controller of `model` that the main job flies."""
    marked = scenarios_of(model, own).items()
    return next((n for n, d in marked if "twin" in d and d.get("in_report")), None)
