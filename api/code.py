"""The generated code that a model runs on in Python, and what `generate` leaves in a folder."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pfaffian.api.display import Note, keywords, silent

if TYPE_CHECKING:
    from pfaffian.derive.generate_model import Extras, Sets
    from pfaffian.derive.ir.lowered import LoweredModel
    from pfaffian.derive.spec.library import ModelFolder
    from pfaffian.runtime.code.generated_model import GeneratedFolder


@dataclass(frozen=True, kw_only=True)
class GeneratedFiles:
    """What one generation left: the folder, its files, those whose bytes changed, and the sets."""

    model: str
    folder: Path
    files: tuple[str, ...]
    changed: tuple[str, ...]
    sets: tuple[str, ...]

    def __repr__(self) -> str:
        """Return one line."""
        sets = ", ".join(self.sets) or "no set"
        return (
            f"<{self.model} ({sets}): {len(self.files)} files in {self.folder}, "
            f"{len(self.changed)} changed>"
        )


def written(
    source: ModelFolder,
    folder: Path,
    wanted: Sets | None = None,
    extras: Extras | None = None,
    note: Note = silent,
) -> GeneratedFiles:
    """Generate `source` into `folder`, all files or none."""
    from pfaffian.derive.generate_model import generate_model
    from pfaffian.derive.writer import check_target, write_generation

    with keywords():
        check_target(folder)
        made = generate_model(source, wanted, extras, note=note)
    return GeneratedFiles(
        model=made.model.name,
        folder=folder,
        changed=write_generation(made.generation, folder),
        files=tuple(path for path, _ in made.generation.files),
        sets=tuple(s.name for s in made.sets),
    )


def current_code(source: ModelFolder, model: LoweredModel, owner: object) -> GeneratedFolder:
    """Return code of these equations: the one that comes with this package, or a fresh one.

    A fresh one is in a folder of temporary files, which goes when `owner` does.
    """
    from pfaffian.derive.generate_model import Sets
    from pfaffian.runtime.code.generated_model import generated_models, open_generated

    if source.name in generated_models():
        known = open_generated(source.name)
        if known.manifest.model_sha256 == model.sha256 and _belongs(source):
            return known
    return fresh_code(source, owner, Sets(none=True))


def fresh_code(
    source: ModelFolder, owner: object, wanted: Sets, extras: Extras | None = None
) -> GeneratedFolder:
    """Return code of `source` in a folder of temporary files, which goes when `owner` does."""
    from pfaffian.runtime.code.generated_model import open_generated

    scratch = Path(tempfile.mkdtemp(prefix="pfaffian-"))
    weakref.finalize(owner, shutil.rmtree, scratch, ignore_errors=True)
    written(source, scratch / source.name, wanted, extras)
    return open_generated(str(scratch / source.name))


def _belongs(source: ModelFolder) -> bool:
    from pfaffian.derive.spec.library import library_models

    return source in library_models().values()
