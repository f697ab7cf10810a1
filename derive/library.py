"""Where models come from: the library in this package, or a folder of the user's own."""

from __future__ import annotations

import importlib.util
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pfaffian.runtime.documents import suggestion
from pfaffian.runtime.errors import InputError, PfaffianError

if TYPE_CHECKING:
    from pfaffian.derive.spec import ModelSpec

LIBRARY = Path(__file__).parent / "models"


@dataclass(frozen=True)
class ModelFolder:
    """A folder with `spec.py` (a function `model()`) and one TOML file a parameter set."""

    name: str
    path: Path

    @property
    def spec_file(self) -> Path:
        """Return the path of the specification."""
        return self.path / "spec.py"

    def sets(self) -> dict[str, Path]:
        """Return the parameter sets by name, sorted."""
        return {p.stem: p for p in sorted(self.path.glob("*.toml"))}

    def set_path(self, name: str) -> Path:
        """Return the file of the set called `name`; raise `InputError` if there is none."""
        sets = self.sets()
        if name not in sets:
            raise InputError(
                f"model {self.name} has no parameter set {name}",
                remedy=suggestion(name, sorted(sets)),
            )
        return sets[name]

    def load(self) -> ModelSpec:
        """Import `spec.py` and return its specification.

        Raises `InputError` naming the line of the user's file that raised.
        """
        found = importlib.util.spec_from_file_location(
            f"_pfaffian_model_{self.name.replace('-', '_')}", self.spec_file
        )
        if found is None or found.loader is None:
            raise InputError(f"{self.spec_file}: cannot be imported", remedy="check the path")
        module = importlib.util.module_from_spec(found)
        try:
            found.loader.exec_module(module)
            spec: ModelSpec = module.model()
        except PfaffianError:
            raise
        except Exception as error:
            lines = [
                f.lineno
                for f in traceback.extract_tb(error.__traceback__)
                if f.filename == str(self.spec_file)
            ]
            line = f":{lines[-1]}" if lines else ""
            raise InputError(
                f"{self.spec_file}{line}: {type(error).__name__}: {error}",
                remedy="mend the specification; it must define model() -> ModelSpec",
            ) from error
        return spec


def library_models() -> dict[str, ModelFolder]:
    """Return the models of the library by name, sorted."""
    return {
        p.parent.name: ModelFolder(p.parent.name, p.parent)
        for p in sorted(LIBRARY.glob("*/spec.py"))
    }


def find_model(reference: str) -> ModelFolder:
    """Return the model called `reference`, or the one in the folder of that path.

    Raises `InputError` naming the known models where there is neither.
    """
    library = library_models()
    if reference in library:
        return library[reference]
    folder = Path(reference)
    if folder.is_dir():
        if not (folder / "spec.py").is_file():
            raise InputError(f"{folder}: holds no spec.py", remedy="name the model's own folder")
        return ModelFolder(folder.resolve().name, folder.resolve())
    raise InputError(f"unknown model {reference}", remedy=suggestion(reference, sorted(library)))
