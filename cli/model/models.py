"""`pfaffian models`."""

from __future__ import annotations

from pfaffian.cli import output


def list_models(as_json: bool) -> None:
    """Print models, their parameter sets, and the scenarios."""
    from pfaffian.derive.spec.library import library_models
    from pfaffian.runtime.base.toml import read_toml
    from pfaffian.runtime.flight.scenario_files import scenario_paths

    sets = [
        {"model": name, "set": key, "title": read_toml(path).get("title", "")}
        for name, folder in library_models().items()
        for key, path in folder.sets().items()
    ]
    scenarios = [
        {"scenario": name, **{k: read_toml(path).get(k, "") for k in ("model", "set", "title")}}
        for name, path in scenario_paths().items()
    ]
    if as_json:
        output.emit_json({"models": list(library_models()), "sets": sets, "scenarios": scenarios})
        return
    output.table(
        "models and parameter sets", ("model", "set", "title"), [list(s.values()) for s in sets]
    )
    output.table(
        "scenarios", ("scenario", "model", "set", "title"), [list(s.values()) for s in scenarios]
    )
