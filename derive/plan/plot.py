"""A plan as an SVG: coordinates, rates and torques against time, with the limits."""

from __future__ import annotations

import io
import math

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pfaffian.derive.plan.planner import Plan
from pfaffian.derive.plan.reference import Curve

Array = NDArray[np.float64]

_STYLE = {
    "svg.hashsalt": "pfaffian",
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#6a7079",
    "axes.grid": True,
    "axes.titlesize": 10.0,
    "grid.color": "#dfe2e6",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
}
#: Told apart with colour-vision deficiency, and by their dashes in grey.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
_DASHES = ("-", "--", "-.", ":")
_LIMIT, _INK = "#9aa0a8", "#1f2328"
#: Points drawn an interval.
_POINTS = 6


def plan_svg(plan: Plan, title: str) -> bytes:
    """Return the SVG of `plan`; no date, the same bytes again. Units are the plan's own."""
    problem, path = plan.problem, plan.trajectory
    n = problem.order
    slopes = np.hstack([path.states[:, n:], plan.accelerations])
    curve = Curve(path.times, path.states, slopes)
    fine = np.linspace(0.0, path.end_time, _POINTS * (len(path.times) - 1) + 1)
    states = np.array([curve(float(t)) for t in fine])
    with rc_context(_STYLE):
        figure = Figure(figsize=(6.4, 6.2), layout="constrained")
        FigureCanvasSVG(figure)
        above, middle, below = figure.subplots(3, 1, sharex=True)
        for i, (name, _) in enumerate(problem.coordinates):
            _draw(above, fine, states[:, i], i, name)
            above.plot(path.end_time, problem.goal[i], "o", color=_colour(i), markersize=4)
            _draw(middle, fine, states[:, n + i], i, f"d{name}/dt")
            _limits(middle, problem.speed_limits[i], states[:, n + i])
        for i, (name, _) in enumerate(problem.actuators):
            _draw(below, path.times, path.torques[:, i], i, name)
            _limits(below, problem.torque_limits[i], path.torques[:, i])
        units = [unit for _, unit in problem.coordinates]
        _label(above, "position", units)
        _label(middle, "rate", [f"{u}/s" for u in units])
        _label(below, "actuator", [unit for _, unit in problem.actuators])
        below.set_xlabel("time [s]")
        below.set_xlim(0.0, path.end_time * 1.005)
        above.set_title(title, loc="left", color=_INK)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def _colour(i: int) -> str:
    return _COLOURS[i % len(_COLOURS)]


def _draw(axes: Axes, times: Array, values: Array, i: int, label: str) -> None:
    style = _DASHES[i % len(_DASHES)]
    axes.plot(times, values, style, color=_colour(i), label=label)


def _limits(axes: Axes, limit: float, values: Array) -> None:
    """Draw a limit that the values come near; a far one would only squeeze the curve."""
    if math.isfinite(limit) and float(np.max(np.abs(values))) > limit / 4.0:
        for side in (-limit, limit):
            axes.axhline(side, color=_LIMIT, linewidth=1.0, linestyle=(0, (1, 2)))


def _label(axes: Axes, what: str, units: list[str]) -> None:
    kinds = list(dict.fromkeys(units))
    shown = ", ".join(k.replace("*", " ") for k in kinds)
    axes.set_ylabel(f"{what} [{shown}]")
    axes.legend(loc="best", ncols=3)
