"""Parameter sets as Python holds them: complete, judged, by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from pfaffian.api.display import html_table
from pfaffian.runtime.base.errors import InputError

if TYPE_CHECKING:
    from pfaffian.derive.ir.lowered import LoweredModel
    from pfaffian.derive.sets.parameter_set import ParameterSet
    from pfaffian.derive.sets.raw_set import RawSet
    from pfaffian.derive.spec.library import ModelFolder


@dataclass(frozen=True, kw_only=True, eq=False)
class Parameters(Mapping[str, float]):
    """All parameters of one plant and its law by name, in SI units, complete and judged.

    `units` gives the unit of each. `notes` say what was changed on the way: set-points that were
    solved for.
    """

    model: str
    name: str
    title: str
    values_in_si: Mapping[str, float]
    units: Mapping[str, str]
    notes: tuple[str, ...] = ()
    _set: ParameterSet = field(repr=False)
    _raw: RawSet = field(repr=False)

    def __getitem__(self, name: str) -> float:
        """Return the value of parameter `name` in its SI unit."""
        return self.values_in_si[name]

    def __iter__(self) -> Iterator[str]:
        """Return the names, in the order in which they are declared."""
        return iter(self.values_in_si)

    def __len__(self) -> int:
        """Return how many parameters there are."""
        return len(self.values_in_si)

    def __repr__(self) -> str:
        """Return one line."""
        return f"<parameters {self.name} of {self.model}: {len(self)} values>"

    def _repr_html_(self) -> str:
        rows = [(n, f"{v:.6g}", self.units[n]) for n, v in self.items()]
        return html_table(f"{self.model}, {self.name}", ("parameter", "value", "unit"), rows)


def read_parameters(
    model: LoweredModel,
    folder: ModelFolder,
    chosen: str | Path | None,
    changes: Mapping[str, object],
) -> Parameters:
    """Return the set called `chosen`, or in that file, or the first one, with `changes`.

    Raises `InputError` for what is not known, or judged to be no working design.
    """
    from pfaffian.derive.sets.parameter_set import resolve_set

    raw = raw_set(model, folder, chosen, changes)
    return wrapped(model, resolve_set(model, raw), raw)


def raw_set(
    model: LoweredModel,
    folder: ModelFolder,
    chosen: str | Path | None,
    changes: Mapping[str, object],
) -> RawSet:
    """Return a set as it stands in its file, with `changes`, neither completed nor judged."""
    from pfaffian.derive.sets.raw_set import changed_set, read_set

    raw = read_set(_path(folder, chosen), model.parameters, folder.sets())
    return changed_set(raw, changes, model.parameters) if changes else raw


def wrapped(model: LoweredModel, found: ParameterSet, raw: RawSet) -> Parameters:
    """Return `found`, completed from `raw`, as the public face shows it."""
    units = {p.name: p.unit for p in model.parameters}
    values = found.as_dict()
    return Parameters(
        model=model.name,
        name=found.name,
        title=found.title,
        values_in_si=values,
        units={n: units[n] for n in values},
        notes=found.notes,
        _set=found,
        _raw=raw,
    )


def _path(folder: ModelFolder, chosen: str | Path | None) -> Path:
    """Return the file of the set: by its name, as a path that ends in .toml, or the first."""
    sets = folder.sets()
    if chosen is None:
        if not sets:
            raise InputError(
                f"model {folder.name} has no parameter set",
                remedy=f"write one beside {folder.spec_file}, or name a file; "
                "pfaffian template prints one to fill in",
            )
        return next(iter(sets.values()))
    if isinstance(chosen, Path) or str(chosen).endswith(".toml"):
        return Path(chosen)
    return folder.set_path(chosen)


def changed_parameters(
    model: LoweredModel, parameters: Parameters, changes: Mapping[str, object]
) -> Parameters:
    """Return `parameters` of this model with `changes`, completed and judged anew."""
    from pfaffian.derive.sets.parameter_set import resolve_set
    from pfaffian.derive.sets.raw_set import changed_set

    if parameters.model != model.name:
        raise InputError(
            f"{parameters!r} is not of model {model.name}",
            remedy=f"take parameters of {model.name}",
        )
    if not changes:
        return parameters
    raw = changed_set(parameters._raw, changes, model.parameters)
    return wrapped(model, resolve_set(model, raw), raw)
