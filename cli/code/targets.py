"""`pfaffian targets`."""

from __future__ import annotations

from pfaffian.cli import output


def list_targets(as_json: bool) -> None:
    """Print every target with its compilers and whether they are installed."""
    from pfaffian.runtime.base.errors import MissingToolError
    from pfaffian.runtime.machine.target_files import read_target, target_paths
    from pfaffian.runtime.machine.toolchain import find_target

    rows: list[tuple[str, str, str]] = []
    for name in target_paths():
        described = read_target(name)
        found = []
        for tool in described.toolchains:
            try:
                find_target(name, tool.name)
            except MissingToolError as error:
                found.append(f"{tool.name} (missing: {error.remedy.removeprefix('install one: ')})")
            else:
                found.append(tool.name)
        rows.append((name, described.title, ", ".join(found)))
    if as_json:
        output.emit_json(
            {"targets": [{"name": n, "title": t, "toolchains": c} for n, t, c in rows]}
        )
    else:
        output.table("targets", ("name", "machine", "compilers"), rows)
