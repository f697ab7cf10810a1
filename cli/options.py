"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from pfaffian.runtime.base.errors import InputError

#: More would not end, or not fit into memory.
MOST_SAMPLES = 10_000_000


def _named(value: str | None) -> str | None:
    """Refuse a name that is empty: it is no way of leaving the option out."""
    if value is not None and not value.strip():
        raise InputError("--set is empty", remedy="name a parameter set, or leave the option out")
    return value


def _file(value: Path | None) -> Path | None:
    """Refuse an empty path, which is the folder one is in."""
    if value == Path():
        raise InputError("--params names no file", remedy="name one, or leave the option out")
    return value


Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Model = Annotated[str, typer.Argument(help="A model of the library, or the folder of your own.")]
SetName = Annotated[
    str | None, typer.Option("--set", help="Parameter set of the model.", callback=_named)
]
FlightSet = Annotated[
    str | None,
    typer.Option("--set", help="Parameter set to fly instead of the scenario's.", callback=_named),
]
Params = Annotated[
    Path | None,
    typer.Option("--params", help="Parameter set in a TOML file.", callback=_file),
]
Generated = Annotated[
    Path | None, typer.Option("--generated", help="Folder of generated code to use instead.")
]
