"""The figure of `pfaffian bench sensing`: velocity noise against delay, a curve an estimator."""

from __future__ import annotations

import io
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from pfaffian.benchmarks.sensing import LAG_FREQUENCIES, EstimatorFigures
from pfaffian.runtime.contract.runtime_structs import ESTIMATORS

_STYLE = Path(str(files("pfaffian.templates"))) / "report" / "figures.mplstyle"
_PANELS = {
    "moving": "moving at 1 to 10 rad/s",
    "standstill": "at rest between two counts",
    "slow": "moving at 0.05 rad/s",
}
_MARKERS = {"tracking": "o", "difference": "s"}
_NAMES = {"tracking": "tracking loop", "difference": "filtered difference"}
#: Where the bandwidths stand: beside the lower curve below it, beside the upper one above.
_LABELS = {"tracking": ((-3, -3), "right", "top"), "difference": ((3, 2), "left", "bottom")}
_LABELLED = (50.0, 100.0, 200.0, 300.0, 600.0, 1000.0)
_INK = "#1f2328"
_SIZE = (8.4, 3.2)


def noise_svg(figures: Sequence[EstimatorFigures], chosen: EstimatorFigures) -> bytes:
    """Return the SVG, with `chosen` marked; no date, so the same figures give the same bytes."""
    with rc_context(fname=_STYLE):
        canvas = Figure(figsize=_SIZE, layout="constrained")
        FigureCanvasSVG(canvas)
        panels = canvas.subplots(1, len(_PANELS), sharex=True, sharey=True)
        for axes, (kind, title) in zip(panels, _PANELS.items(), strict=True):
            _draw(axes, figures, kind)
            axes.plot(
                chosen.delay_ms[-1],
                getattr(chosen, kind),
                linestyle="none",
                marker="D",
                markersize=8,
                markerfacecolor="none",
                markeredgecolor=_INK,
                label="chosen",
                zorder=4,
            )
            axes.set_title(title, loc="left", color=_INK, fontsize=8)
        canvas.supxlabel(f"delay at {LAG_FREQUENCIES[-1]:g} rad/s [ms]", fontsize=8)
        panels[0].set_ylabel("RMS velocity error [rad/s]")
        panels[0].legend(loc="lower left")
        buffer = io.BytesIO()
        canvas.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def _draw(axes: Axes, figures: Sequence[EstimatorFigures], kind: str) -> None:
    for estimator in ESTIMATORS:
        rows = [f for f in figures if f.estimator == estimator]
        offset, horizontal, vertical = _LABELS[estimator]
        axes.plot(
            [f.delay_ms[-1] for f in rows],
            [getattr(f, kind) for f in rows],
            marker=_MARKERS[estimator],
            markersize=3,
            label=_NAMES[estimator],
        )
        for f in rows:
            if f.bandwidth in _LABELLED:
                axes.annotate(
                    f"{f.bandwidth:g}",
                    (f.delay_ms[-1], getattr(f, kind)),
                    xytext=offset,
                    textcoords="offset points",
                    horizontalalignment=horizontal,
                    verticalalignment=vertical,
                    fontsize=6,
                    color=_INK,
                )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_major_formatter("{x:g}")
