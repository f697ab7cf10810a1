"""The trade-off curve as an SVG: decay rate of the zero dynamics against the way to ADB = 0."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from pfaffian.derive.design.assess import Design
from pfaffian.derive.design.tradeoff import TradeoffPoint
from pfaffian.runtime.base.errors import InputError

_STYLE = {
    "svg.hashsalt": "pfaffian",
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#6a7079",
    "axes.grid": True,
    "grid.color": "#dfe2e6",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
}
#: Family: (label, colour, marker); colours that people with colour-vision deficiency tell apart.
_FAMILIES = {
    "poles": ("all poles at -p", "#0072b2", "o"),
    "riccati": ("Riccati rows, weights of the rates scaled", "#d55e00", "s"),
}
_INK = "#1f2328"
_SIZE = (6.4, 4.2)


def tradeoff_svg(
    title: str,
    points: Sequence[TradeoffPoint],
    marked: Sequence[tuple[str, Design]],
) -> bytes:
    """Return the SVG of `points`, with the designs in `marked` by name; no date, same bytes again.

    Radians are drawn in degrees. Designs that are unstable or have no singular set lie outside
    the axes and are left out. Raises `InputError` where ADB keeps its sign in all of `points`.
    """
    units = [p.singular_unit for p in points if math.isfinite(p.singular_distance_rad)]
    if not units:
        raise InputError(
            "--plot: ADB keeps its sign along every coordinate, so there is no distance to draw",
            remedy="leave --plot out: here fast poles cost nothing of the way to ADB = 0",
        )
    scale, unit = (math.degrees(1.0), "deg") if units[0] == "rad" else (1.0, units[0])
    with rc_context(_STYLE):
        figure = Figure(figsize=_SIZE, layout="constrained")
        FigureCanvasSVG(figure)
        axes = figure.add_subplot()
        _draw_families(axes, points, scale)
        _mark(axes, points, marked, scale)
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("decay rate of the slowest zero-dynamics pole [1/s]")
        axes.set_ylabel(f"offset from the setpoint to ADB = 0 [{unit}]")
        axes.set_title(title, loc="left", color=_INK)
        axes.legend(loc="lower left")
        buffer = io.BytesIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def _draw_families(axes: Axes, points: Sequence[TradeoffPoint], scale: float) -> None:
    for family, (label, colour, marker) in _FAMILIES.items():
        line = [
            (p.decay_rate, p.singular_distance_rad * scale)
            for p in points
            if p.family == family and math.isfinite(p.singular_distance_rad)
        ]
        if line:
            x, y = zip(*line, strict=True)
            axes.plot(x, y, color=colour, marker=marker, markersize=3, label=label)


def _mark(
    axes: Axes,
    points: Sequence[TradeoffPoint],
    marked: Sequence[tuple[str, Design]],
    scale: float,
) -> None:
    """Mark designs; the name stands outside the curves where the design is on the outermost."""
    for name, design in marked:
        if not (design.stable and math.isfinite(design.singular_distance_rad)):
            continue
        rate, distance = design.decay_rate, design.singular_distance_rad
        axes.plot(rate, distance * scale, color=_INK, marker="D", markersize=6, zorder=3)
        beaten = any(
            p.decay_rate >= rate and p.singular_distance_rad > 1.02 * distance for p in points
        )
        axes.annotate(
            name,
            (rate, distance * scale),
            xytext=(0, -8) if beaten else (7, 5),
            textcoords="offset points",
            horizontalalignment="center" if beaten else "left",
            verticalalignment="top" if beaten else "bottom",
            color=_INK,
            zorder=4,
        )
