"""How results and errors leave the command line: text for people, one JSON document for scripts."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from pfaffian.runtime.errors import CheckError, PfaffianError
from rich.console import Console
from rich.markup import escape
from rich.table import Table

#: A pipe has no width of its own; 80 columns would fold the tables.
_PIPE_WIDTH = None if sys.stdout.isatty() else 110

out = Console(highlight=False, width=_PIPE_WIDTH)
err = Console(stderr=True, highlight=False)


class FailedCheckError(CheckError):
    """A check that did not hold, with the document that shows it: JSON carries both in one."""

    def __init__(self, document: Mapping[str, Any], message: str, *, remedy: str = "") -> None:
        """Keep the document for `emit_error`."""
        super().__init__(message, remedy=remedy)
        self.document = document


def deliver(
    document: Mapping[str, Any],
    as_json: bool,
    show: Callable[[], None],
    failure: str = "",
    remedy: str = "",
) -> None:
    """Print `document`, as JSON or through `show`; raise `FailedCheckError` for a `failure`."""
    if not as_json:
        show()
    if failure:
        raise FailedCheckError(document, failure, remedy=remedy)
    if as_json:
        emit_json(document)


def emit_error(error: PfaffianError) -> None:
    """Print `error` as the one JSON document on standard output."""
    about = {"message": error.message, "remedy": error.remedy, "exit_code": error.exit_code}
    found = error.document if isinstance(error, FailedCheckError) else {}
    emit_json({**found, "error": about})


def emit_json(document: Mapping[str, Any]) -> None:
    """Print one JSON document on standard output; what is not finite becomes a string."""
    print(json.dumps(_plain(document), indent=1, ensure_ascii=False))


def _plain(value: Any) -> Any:
    if isinstance(value, complex):
        return [_plain(value.real), _plain(value.imag)]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return value


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table on standard output."""
    sheet = Table(title=title, title_justify="left", header_style="bold")
    for column in columns:
        sheet.add_column(escape(column), overflow="fold")
    for row in rows:
        sheet.add_row(*(escape(str(cell)) for cell in row))
    out.print(sheet)


def note(text: str) -> None:
    """Say on standard error what is being done."""
    err.print(f"[dim]{text}[/dim]")


@contextmanager
def progress(label: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar on standard error; the value is called with (done, total)."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=err) as bars:
        task = bars.add_task(label, total=1)

        def update(done: int, total: int) -> None:
            bars.update(task, completed=done, total=total)

        yield update


def figure(value: float) -> str:
    """Return `value` with four significant digits."""
    return f"{value:.4g}"
