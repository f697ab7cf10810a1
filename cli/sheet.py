"""Tables as text: a grid where every word fits into the width, else a column for each row."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

#: What a grid needs beside its cells: a rule and two spaces for each column, and the last rule.
_BETWEEN, _AROUND = 3, 1
#: From so many columns on, a row that is alone is easier to read downwards.
_WIDE = 3

Cells = Sequence[str]


def print_table(
    console: Console, title: str, columns: Cells, rows: Sequence[Cells], width: int
) -> None:
    """Print a table of at most `width` characters, the console's, no word of it cut.

    Where the words of a row do not fit beside each other, and where there is but one row, each
    row is printed downwards as names and values; a single word wider than that runs over.
    """
    alone = len(rows) == 1 and len(columns) >= _WIDE
    if not alone and _least([columns, *rows]) <= width:
        sheet = Table(header_style="bold")
        _fill(sheet, [columns, *rows], width)
    else:
        blocks = [_pairs(columns, row) for row in rows]
        pairs = [pair for block in blocks for pair in block]
        if not pairs or _least(pairs) > width:
            _print_lines(console, title, blocks, columns)
            return
        sheet = Table(show_header=False)
        _fill(sheet, [("", ""), *pairs], width)
        for k in range(len(columns) - 1, len(pairs), len(columns)):
            sheet.rows[k].end_section = len(columns) >= _WIDE
    _print_title(console, title, width)
    console.print(sheet)


def _pairs(columns: Cells, row: Cells) -> list[tuple[str, str]]:
    """Return the names and values of `row`; one of two cells is such a pair already."""
    if len(columns) == _WIDE - 1:
        return [(row[0], row[1])]
    return list(zip(columns, row, strict=True))


def _fill(sheet: Table, cells: Sequence[Cells], width: int) -> None:
    for name, size in zip(cells[0], _widths(cells, width), strict=True):
        sheet.add_column(Text(name), width=size, overflow="fold")
    for row in cells[1:]:
        sheet.add_row(*map(Text, row))


def _print_title(console: Console, title: str, width: int) -> None:
    for line in textwrap.wrap(title, width, break_long_words=False, break_on_hyphens=False):
        console.print(Text(line, style="italic"), soft_wrap=True)


def _print_lines(
    console: Console, title: str, blocks: Sequence[Sequence[Cells]], columns: Cells
) -> None:
    """Print names and values on lines of their own, however long."""
    console.print(Text(title, style="italic"), soft_wrap=True)
    if not blocks:
        console.print(Text(", ".join(columns)), soft_wrap=True)
    for block in blocks:
        for name, value in block:
            console.print(Text.assemble((name, "bold"), ": ", value), soft_wrap=True)


def _widths(cells: Sequence[Cells], width: int) -> list[int]:
    """Return the widths of the columns: the widest give way until the grid fits into `width`."""
    least = _longest(cells, _words)
    widths = _longest(cells, str.splitlines)
    while _total(widths) > width:
        widest = max((size, k) for k, size in enumerate(widths) if size > least[k])[1]
        widths[widest] -= 1
    return widths


def _least(cells: Sequence[Cells]) -> int:
    """Return the width of the narrowest grid that cuts no word."""
    return _total(_longest(cells, _words))


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + _BETWEEN * len(widths) + _AROUND


def _words(text: str) -> list[str]:
    return text.split()


def _longest(cells: Sequence[Cells], parts: Callable[[str], list[str]]) -> list[int]:
    """Return the width of the longest part of each column's cells."""
    return [
        max((cell_len(part) for cell in column for part in parts(cell)), default=0)
        for column in zip(*cells, strict=True)
    ]
