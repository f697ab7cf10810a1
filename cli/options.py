"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

#: More would not end, or not fit into memory.
MOST_SAMPLES = 10_000_000

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Model = Annotated[str, typer.Argument(help="A model of the library, or the folder of your own.")]
SetName = Annotated[str | None, typer.Option("--set", help="Parameter set of the model.")]
FlightSet = Annotated[
    str | None, typer.Option("--set", help="Parameter set to fly instead of the scenario's.")
]
Params = Annotated[Path | None, typer.Option("--params", help="Parameter set in a TOML file.")]
Generated = Annotated[
    Path | None, typer.Option("--generated", help="Folder of generated code to use instead.")
]
