"""How small results show themselves: as text in a terminal, as a table in a notebook."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from html import escape
from typing import Protocol

from pfaffian.runtime.base.errors import PfaffianError

#: Told of what is going on: a line of text.
Note = Callable[[str], None]
#: Called with (done, total).
Update = Callable[[int, int], None]


class Teller(Protocol):
    """Who is told of what is going on: the command line, or nobody."""

    def note(self, text: str, /) -> None:
        """Say what is being done."""

    def progress(self, label: str, /) -> AbstractContextManager[Update]:
        """Show how far something is while the context lasts."""


class Silent:
    """Passes over everything: in Python nobody asked for it."""

    def note(self, text: str, /) -> None:
        """Pass over `text`."""

    @contextmanager
    def progress(self, label: str, /) -> Iterator[Update]:
        """Pass over `label` and what it is told."""
        yield lambda done, total: None


SILENT = Silent()
_OPTION = re.compile(r"--([a-z]+(?:-[a-z]+)*)")


def silent(line: str) -> None:
    """Pass over `line`: in Python nobody asked for progress."""


def figure(value: object) -> str:
    """Return a value as a table shows it: numbers with six digits."""
    return f"{value:.6g}" if isinstance(value, float | complex) else str(value)


def html_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table as HTML, everything in it escaped."""
    head = "".join(f"<th>{escape(c)}</th>" for c in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(figure(cell))}</td>" for cell in row) + "</tr>"
        for row in rows
    )
    caption = f"<caption>{escape(title)}</caption>"
    return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def text_table(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table as plain text, columns aligned."""
    cells = [list(columns), *([figure(c) for c in row] for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(columns))]
    lines = ("  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) for row in cells)
    return "\n".join(line.rstrip() for line in lines)


@contextmanager
def keywords() -> Iterator[None]:
    """Let messages about options of the command line speak of keyword arguments."""
    try:
        yield
    except PfaffianError as error:
        message, remedy = (_OPTION.sub(_keyword, t) for t in (error.message, error.remedy))
        if (message, remedy) == (error.message, error.remedy):
            raise
        raise type(error)(message, remedy=remedy, about=error.about) from error


def _keyword(option: re.Match[str]) -> str:
    return f"{option[1].replace('-', '_')}="
