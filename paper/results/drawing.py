"""How the figures are drawn: time histories in three columns, and bars; SVG, PDF and CSV."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import NullFormatter
from pfaffian.runtime.base.arrays import Array

_STYLE = Path(str(files("pfaffian.templates"))) / "report" / "figures.mplstyle"
_WIDTH, _ROW, _TOP = 7.4, 1.45, 0.95
_INK, _MUTED = "#1f2328", "#6a7079"
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#a0508a")
_LINES = ("-", (0, (5, 1.6)), (0, (6, 1.5, 1, 1.5)), (0, (1, 1.2)))
_HATCHES = ("", "////", "....", "xxxx")
#: Points of a line; a longer one is drawn through the least and greatest value of each bin.
_MOST_POINTS = 1200
#: A run shorter than this is drawn over milliseconds.
_SHORT = 0.3


@dataclass(frozen=True)
class Line:
    """One run in one panel: `values` (N,) over `time` (N,) in s; `style` numbers colour and dash.

    `ended` marks a run that ended early.
    """

    label: str
    style: int
    time: Array
    values: Array
    ended: bool = False


@dataclass(frozen=True)
class Row:
    """A row of panels: what its axis says, and `lines` of each column. `log` draws decades down to
    `floor`; with `pale` all lines but the first style stand back; `level` is a horizontal line with
    its name."""

    label: str
    lines: tuple[tuple[Line, ...], ...]
    log: bool = False
    floor: float = 1e-9
    pale: bool = False
    level: tuple[float, str] | None = None


@dataclass(frozen=True)
class Bars:
    """A panel of bars: `values[k][j]` of entry k in group j, or a word where there is no value."""

    title: str
    label: str
    groups: tuple[str, ...]
    entries: tuple[str, ...]
    values: tuple[tuple[float | str, ...], ...]
    log: bool = True


@dataclass(frozen=True)
class Image:
    """A drawn figure in two vector formats, the same bytes for the same data; a moving one has no
    `pdf`."""

    svg: bytes
    pdf: bytes | None


def histories(titles: Sequence[str], rows: Sequence[Row]) -> Image:
    """Draw `rows` of time histories, one column for each of `titles`."""
    with rc_context(fname=_STYLE):
        canvas = Canvas((_WIDTH, _TOP + _ROW * len(rows)), layout="constrained")
        panels = canvas.subplots(len(rows), len(titles), squeeze=False)
        for i, row in enumerate(rows):
            for j, lines in enumerate(row.lines):
                _panel(panels[i][j], row, lines, first=j == 0, last=i == len(rows) - 1)
                if i == 0:
                    panels[i][j].set_title(titles[j], loc="left", fontsize=8, color=_INK)
        _legend(canvas, rows)
        return _saved(canvas)


def _panel(axes: Axes, row: Row, lines: Sequence[Line], *, first: bool, last: bool) -> None:
    end = max((float(line.time[-1]) for line in lines), default=1.0)
    scale, unit = (1e3, "ms") if end < _SHORT else (1.0, "s")
    for line in lines:
        look: dict[str, Any] = {"color": _COLOURS[line.style], "linestyle": _LINES[line.style]}
        if row.pale and line.style:
            look |= {"alpha": 0.4, "linewidth": 0.8}
        values = np.maximum(np.abs(line.values), row.floor) if row.log else line.values
        x, y = thinned(line.time * scale, values)
        axes.plot(x, y, **look, zorder=6 - line.style)
        if line.ended:
            axes.plot(x[-1:], y[-1:], "x", color=_COLOURS[line.style], markersize=5)
    if row.log:
        axes.set_yscale("log")
        axes.yaxis.set_minor_formatter(NullFormatter())
    _limit(axes, row, lines)
    if row.level:
        axes.axhline(row.level[0], color=_MUTED, linewidth=0.8, linestyle=(0, (2, 2)), zorder=2)
    room = 0.02 if any(line.ended and line.time[-1] == end for line in lines) else 0.0
    axes.set_xlim(0.0, end * scale * (1.0 + room))
    axes.ticklabel_format(axis="x", useOffset=False)
    if not row.log:
        axes.ticklabel_format(axis="y", useMathText=True, scilimits=(-3, 5))
    if last:
        axes.set_xlabel(f"time [{unit}]")
    if first:
        axes.set_ylabel(row.label)


def _limit(axes: Axes, row: Row, lines: Sequence[Line]) -> None:
    """Fit the axis to the runs that went to the end, where there is one: others leave the panel."""
    whole = [line for line in lines if not line.ended] or list(lines)
    values = np.concatenate([line.values for line in whole]) if whole else np.zeros(1)
    if row.log:
        sizes = np.abs(values)
        sizes = sizes[sizes > row.floor]
        top = float(sizes.max()) if len(sizes) else 1.0
        axes.set_ylim(max(row.floor, float(sizes.min()) / 2 if len(sizes) else 0.1), 3 * top)
        return
    if row.level:
        values = np.append(values, row.level[0])
    low, high = float(values.min()), float(values.max())
    margin = (0.08 if len(whole) == len(lines) else 0.35) * (high - low) or 0.1
    axes.set_ylim(low - margin, high + margin)


def thinned(time: Array, values: Array) -> tuple[Array, Array]:
    """Return a line through the least and greatest value of each of `_MOST_POINTS`/2 bins."""
    count = len(time)
    if count <= _MOST_POINTS:
        return time, values
    edges = np.linspace(0, count, _MOST_POINTS // 2 + 1).astype(int)
    kept = {0, count - 1}
    for a, b in pairwise(edges):
        kept |= {a + int(np.argmin(values[a:b])), a + int(np.argmax(values[a:b]))}
    index = np.array(sorted(kept))
    return time[index], values[index]


def _legend(canvas: Canvas, rows: Sequence[Row]) -> None:
    styles: dict[str, int] = {}
    for row in rows:
        for lines in row.lines:
            for line in lines:
                styles.setdefault(line.label, line.style)
    handles = [
        Line2D([], [], color=_COLOURS[k], linestyle=_LINES[k], label=label)
        for label, k in styles.items()
    ]
    levels = dict.fromkeys(row.level[1] for row in rows if row.level)
    handles += [
        Line2D([], [], color=_MUTED, linewidth=0.8, linestyle=(0, (2, 2)), label=text)
        for text in levels
    ]
    if any(line.ended for row in rows for lines in row.lines for line in lines):
        handles.append(
            Line2D([], [], color=_MUTED, marker="x", linestyle="none", label="ends early")
        )
    canvas.legend(handles=handles, loc="outside upper left", ncols=len(handles))


def bars(panels: Sequence[Bars]) -> Image:
    """Draw panels of bars beside each other, of one kind of entries."""
    with rc_context(fname=_STYLE):
        canvas = Canvas((_WIDTH, 2.5), layout="constrained")
        for axes, panel in zip(
            canvas.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
        ):
            _bars(axes, panel)
        entries = panels[0].entries
        handles = [
            Patch(facecolor=_COLOURS[k], hatch=_HATCHES[k], edgecolor="white", label=entry)
            for k, entry in enumerate(entries)
        ]
        canvas.legend(handles=handles, loc="outside upper left", ncols=len(handles))
        return _saved(canvas)


def _bars(axes: Axes, panel: Bars) -> None:
    width = 0.8 / len(panel.entries)
    numbers = [v for row in panel.values for v in row if not isinstance(v, str)]
    low, high = min(numbers), max(numbers)
    floor = low / 5 if panel.log else 0.0
    if panel.log:
        axes.set_yscale("log")
        axes.set_ylim(floor, high * 8)
    else:
        axes.set_ylim(0.0, high * 1.15)
    for k, row in enumerate(panel.values):
        for j, value in enumerate(row):
            place = j + (k - (len(panel.entries) - 1) / 2) * width
            if isinstance(value, str):
                _word(axes, place, value, floor, panel.log)
                continue
            axes.bar(
                place, value, 0.92 * width, color=_COLOURS[k], hatch=_HATCHES[k], edgecolor="white"
            )
            axes.annotate(
                f"{value:.3g}",
                (place, value),
                xytext=(0, 2),
                textcoords="offset points",
                ha="center",
                fontsize=6.5,
                color=_INK,
            )
    axes.set_xticks(range(len(panel.groups)), panel.groups)
    axes.set_xlim(-0.5, len(panel.groups) - 0.5)
    axes.grid(visible=False, axis="x")
    axes.set_ylabel(panel.label)
    if panel.title:
        axes.set_title(panel.title, loc="left", fontsize=8, color=_INK)


def _word(axes: Axes, place: float, word: str, floor: float, log: bool) -> None:
    axes.annotate(
        word,
        (place, floor * 1.25 if log else 0.0),
        xytext=(0, 3),
        textcoords="offset points",
        ha="center",
        va="bottom",
        rotation=90,
        fontsize=6.5,
        color=_INK,
    )


def _saved(canvas: Canvas) -> Image:
    svg, pdf = io.BytesIO(), io.BytesIO()
    FigureCanvasSVG(canvas)
    canvas.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    FigureCanvasPdf(canvas)
    nothing = {"CreationDate": None, "Creator": None, "Producer": None}
    canvas.savefig(pdf, format="pdf", metadata=nothing)
    return Image(svg.getvalue(), pdf.getvalue())


def histories_csv(columns: Sequence[str], rows: Sequence[Row], names: Sequence[str]) -> bytes:
    """Return the data of `histories`: column, run, time_s, and a value of each row in `names`."""
    lines = [",".join(("column", "run", "time_s", *names))]
    for j, column in enumerate(columns):
        for k, line in enumerate(rows[0].lines[j]):
            values = [row.lines[j][k].values for row in rows]
            for point in zip(line.time, *values, strict=True):
                lines.append(",".join((column, line.label, *(f"{v:.9g}" for v in point))))
    return ("\n".join(lines) + "\n").encode()


def bars_csv(panels: Sequence[Bars]) -> bytes:
    """Return the data of `bars`: panel, group, entry, value."""
    lines = ["panel,group,entry,value"]
    for p in panels:
        for entry, row in zip(p.entries, p.values, strict=True):
            for group, value in zip(p.groups, row, strict=True):
                text = value.replace("\n", " ") if isinstance(value, str) else f"{value:.9g}"
                lines.append(f"{p.label},{group},{entry},{text}")
    return ("\n".join(lines) + "\n").encode()
