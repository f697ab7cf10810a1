"""How results and errors leave the command line: text for people, one JSON document for scripts."""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TextIO, cast

from pfaffian.cli.sheet import print_table
from pfaffian.runtime.base.errors import EXIT_BROKEN_PIPE, CheckError, InputError, PfaffianError
from rich.console import Console
from rich.text import Text

#: A pipe has no width of its own; 80 columns would fold the tables.
_PIPE_WIDTH = 110


class _Output:
    """Standard output, except that a disk or device that is full is an error of ours."""

    def write(self, text: str) -> int:
        """Write `text`; return its length."""
        with _said():
            return sys.stdout.write(text)

    def flush(self) -> None:
        """Flush what was written."""
        with _said():
            sys.stdout.flush()

    def __getattr__(self, name: str) -> Any:
        """Leave all else to standard output."""
        return getattr(sys.stdout, name)


@contextmanager
def _said() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        _give_up(sys.stdout)
        raise InputError(
            f"standard output: cannot be written ({error.strerror})",
            remedy="make room where it leads to, or send it elsewhere",
        ) from error


class _Progress:
    """Standard error, except that one that is full or closed ends nothing: it is given up."""

    def write(self, text: str) -> int:
        """Write `text`; return its length in any case."""
        try:
            return sys.stderr.write(text)
        except OSError:
            _give_up(sys.stderr)
            return len(text)

    def flush(self) -> None:
        """Flush what was written."""
        try:
            sys.stderr.flush()
        except OSError:
            _give_up(sys.stderr)

    def __getattr__(self, name: str) -> Any:
        """Leave all else to standard error."""
        return getattr(sys.stderr, name)


def _give_up(stream: TextIO) -> None:
    """Let what is still buffered lead nowhere, so that Python does not try again at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class _Console(Console):
    """A console on which square brackets are text, and which leaves a closed pipe to `main`."""

    def on_broken_pipe(self) -> None:
        """Raise the error again: it is being handled where this is called."""
        raise


_output, _progress = cast(TextIO, _Output()), cast(TextIO, _Progress())
out = _Console(file=_output, highlight=False, markup=False, emoji=False)
err = _Console(file=_progress, stderr=True, highlight=False, markup=False, emoji=False)


def width() -> int:
    """Return the width of tables: of the terminal, or as COLUMNS says, or that of a pipe."""
    asked = os.environ.get("COLUMNS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else _PIPE_WIDTH


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
    write(f"{json.dumps(_plain(document), indent=1, ensure_ascii=False)}\n")


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
    out.width = width()
    print_table(out, title, columns, [[str(cell) for cell in row] for row in rows], out.width)


def write(text: str) -> None:
    """Put `text` on standard output as it is."""
    _output.write(text)


def finish() -> None:
    """Write what is still buffered: at the end of the process it could only fail unsaid."""
    _output.flush()


def read_no_further() -> int:
    """Say nothing more to a reader that went away; return the exit code."""
    _give_up(sys.stdout)
    return EXIT_BROKEN_PIPE


def say(text: str) -> None:
    """Print `text` on standard output as it is, however long its lines."""
    out.print(text, soft_wrap=True)


def note(text: str) -> None:
    """Say on standard error what is being done."""
    err.print(Text(text, style="dim"), soft_wrap=True)


def leave(error: PfaffianError, as_json: bool) -> int:
    """Say what was wrong, in JSON too where it is asked for; return the exit code."""
    if as_json:
        emit_error(error)
    return complain(error)


def complain(error: PfaffianError) -> int:
    """Say on standard error what was wrong, and what to do; return the exit code."""
    err.print(Text.assemble(("error:", "bold red"), f" {error.message}"), soft_wrap=True)
    if error.remedy:
        err.print(Text(f"  {error.remedy}"), soft_wrap=True)
    return error.exit_code


@contextmanager
def progress(label: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar on standard error; the value is called with (done, total)."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}", markup=False),
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
