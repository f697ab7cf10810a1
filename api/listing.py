"""The models of the library: what `pfaffian models` lists."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pfaffian.api.display import html_table, text_table

_COLUMNS = ("model", "sets", "scenarios")


@dataclass(frozen=True, kw_only=True)
class ModelRow:
    """One model: its name, its parameter sets and its scenarios, by name."""

    name: str
    sets: tuple[str, ...]
    scenarios: tuple[str, ...]


@dataclass(frozen=True)
class ModelTable:
    """The models that come with this package; iterates over its rows."""

    rows: tuple[ModelRow, ...]

    def __iter__(self) -> Iterator[ModelRow]:
        """Return the rows in order."""
        return iter(self.rows)

    def __len__(self) -> int:
        """Return how many models there are."""
        return len(self.rows)

    def __repr__(self) -> str:
        """Return the table as text."""
        return text_table(_COLUMNS, self._cells())

    def _repr_html_(self) -> str:
        return html_table("models", _COLUMNS, self._cells())

    def _cells(self) -> list[tuple[str, str, str]]:
        return [(r.name, ", ".join(r.sets), ", ".join(r.scenarios)) for r in self.rows]


def models() -> ModelTable:
    """Return the models of the library with their parameter sets and scenarios."""
    from pfaffian.derive.spec.library import library_models
    from pfaffian.runtime.flight.scenario_files import scenarios_of

    return ModelTable(
        tuple(
            ModelRow(
                name=name,
                sets=tuple(folder.sets()),
                scenarios=tuple(scenarios_of(name, folder.scenarios())),
            )
            for name, folder in library_models().items()
        )
    )
