"""`pfaffian template`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pfaffian.cli import output
from pfaffian.runtime.base.errors import InputError

if TYPE_CHECKING:
    from pfaffian.derive.sets.template import Template


@dataclass(frozen=True)
class TemplateFiles:
    """The set whose values are filled in, by name or file, and where the template goes."""

    set_name: str | None = None
    params: Path | None = None
    written: Path | None = None
    force: bool = False


def show_template(reference: str, files: TemplateFiles, as_json: bool) -> None:
    """Print a parameter set to fill in, or write it to a file."""
    from pfaffian.derive.pipeline import lowered_model
    from pfaffian.derive.sets.raw_set import read_set
    from pfaffian.derive.sets.template import template_of
    from pfaffian.derive.spec.library import find_model
    from pfaffian.runtime.base.files import check_output, write_outputs

    if files.set_name and files.params:
        raise InputError("--set and --params are both given", remedy="give one of them")
    check_output(files.written, "-o", ".toml", force=files.force)
    folder = find_model(reference)
    path = folder.set_path(files.set_name) if files.set_name else files.params
    output.note(f"deriving {folder.name}")
    model = lowered_model(folder)
    sets = folder.sets()
    raw = read_set(path, model.parameters, sets) if path else None
    found = template_of(model, tuple(sets), raw)
    if files.written:
        write_outputs({files.written: found.text().encode()})
    output.deliver(
        {
            "model": model.name,
            "set": raw.name if raw else None,
            "required": list(found.required()),
            "keys": [asdict(entry) for entry in found.entries],
            "template": found.text(),
            "written": str(files.written) if files.written else None,
        },
        as_json,
        lambda: _show(found, files.written),
    )


def _show(found: Template, written: Path | None) -> None:
    if written:
        output.say(f"{written}: {len(found.required())} values still to fill in")
    else:
        output.write(found.text())
