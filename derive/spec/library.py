"""Where models come from: the library in this package, or a folder of the user's own."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from pfaffian.runtime.base.errors import InputError, PfaffianError
from pfaffian.runtime.base.toml import shown, suggestion
from pfaffian.runtime.flight.scenario_files import is_scenario

if TYPE_CHECKING:
    from pfaffian.derive.spec.model_spec import ModelSpec

LIBRARY = Path(__file__).parent.parent / "models"


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
        return {p.stem: p for p in sorted(self.path.glob("*.toml")) if not is_scenario(p)}

    def scenarios(self) -> dict[str, Path]:
        """Return the scenarios in this folder and in `scenarios` below it by name, sorted."""
        beside = [p for p in sorted(self.path.glob("*.toml")) if is_scenario(p)]
        return {p.stem: p for p in (*beside, *sorted(self.path.glob("scenarios/*.toml")))}

    def set_path(self, name: str) -> Path:
        """Return the file of the set called `name`; raise `InputError` if there is none."""
        sets = self.sets()
        if name not in sets:
            raise InputError(
                f"model {self.name} has no parameter set {name}",
                remedy=suggestion(name, sorted(sets))
                if sets
                else f"write one: {self.path / name}.toml, or name a file with --params",
            )
        return sets[name]

    def load(self) -> ModelSpec:
        """Run `spec.py` and return its specification.

        It is compiled from its text each time: bytecode left beside it would write into the
        user's folder, and could be older than the text. Raises `InputError` naming the line of
        the user's file that raised.
        """
        from pfaffian.derive.spec.check import check_spec
        from pfaffian.derive.spec.exact_numbers import exact_spec
        from pfaffian.derive.spec.model_spec import ModelSpec

        module = ModuleType(f"_pfaffian_model_{self.name.replace('-', '_')}")
        module.__file__ = str(self.spec_file)
        remedy = "mend the specification; it must define model() -> ModelSpec"
        try:
            text = self.spec_file.read_bytes()
            exec(compile(text, module.__file__, "exec", dont_inherit=True), vars(module))
            spec: Any = module.model()
        except PfaffianError as error:
            line = self._line_of(error)
            if line:
                raise InputError(
                    f"{self.spec_file}{line}: {error.message}", remedy=error.remedy
                ) from error
            raise
        except (Exception, SystemExit) as error:
            raise InputError(
                f"{self.spec_file}{self._line_of(error)}: {type(error).__name__}: {error}",
                remedy=remedy,
            ) from error
        if not isinstance(spec, ModelSpec):
            raise InputError(f"{self.spec_file}: model() returned {shown(spec)}", remedy=remedy)
        _check_shapes(spec, self.spec_file)
        exact = exact_spec(spec)
        check_spec(exact)
        return exact

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Let errors about this model name its file, and the line where it can be found."""
        try:
            yield
        except NotImplementedError as error:
            remedy = getattr(error, "remedy", "write it in the functions of docs/own-plant.md")
            raise InputError(f"{self.spec_file}: {error}", remedy=remedy) from error
        except InputError as error:
            if not error.message.startswith("model "):
                raise
            from pfaffian.derive.spec.source_line import line_about  # loads SymPy: only to explain

            text = self.spec_file.read_text(encoding="utf-8")
            line = next((n for a in error.about.split() if (n := line_about(text, a))), None)
            where = f"{self.spec_file}:{line}" if line else str(self.spec_file)
            raise InputError(f"{where}: {error.message}", remedy=error.remedy) from error

    def _line_of(self, error: BaseException) -> str:
        """Return `:LINE` of the user's file where `error` came from, or nothing."""
        if isinstance(error, SyntaxError) and error.filename == str(self.spec_file):
            return f":{error.lineno}"
        frames = traceback.extract_tb(error.__traceback__)
        lines = [f.lineno for f in frames if f.filename == str(self.spec_file)]
        return f":{lines[-1]}" if lines else ""


def _check_shapes(spec: ModelSpec, path: Path) -> None:
    """Raise `InputError` unless the shapes in `spec` fit its coordinates and actuators."""
    from pfaffian.derive.spec.source_line import about_constraint

    n, m, constraint = len(spec.coordinates), len(spec.actuators), spec.constraint
    names = [s.name for s in constraint.residual_symbols]
    if len(names) != m:
        raise InputError(
            f"model {spec.name}: {len(names)} servo-constraints ({', '.join(names)}) for {m} "
            "actuators",
            remedy="give one constraint for each actuator, so that ADB is square",
            about=about_constraint(names[m]) if len(names) > m else spec.actuators[-1].name,
        )
    wanted = {
        "input_matrix": (spec.input_matrix, (n, m)),
        "uncertain_force": (spec.uncertain_force, (n, 1)),
        "constraint.residual": (constraint.residual, (m, 1)),
        "constraint.drift": (constraint.drift, (m, 1)),
        "constraint.residual_symbols": (constraint.residual_symbols, (m,)),
        "constraint.residual_units": (constraint.residual_units, (m,)),
        "constraint.errors": (constraint.errors, (n, 1)),
        "constraint.setpoint": (constraint.setpoint, (n,)),
    }
    for name, (value, shape) in wanted.items():
        have = (len(value),) if isinstance(value, tuple) else getattr(value, "shape", None)
        if have != shape:
            raise InputError(
                f"{path}: {name} has shape {have}, but {shape} is needed for {n} coordinates and "
                f"{m} actuators",
                remedy="mend it; a constraint is needed for each actuator, so that ADB is square",
            )


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
