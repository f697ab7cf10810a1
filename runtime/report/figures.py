"""What the report draws: figures as inline SVG, and the flights as data for its animation."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup, escape
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure as Canvas
from pfaffian.runtime.contract.manifest import Field, Manifest
from pfaffian.runtime.flight.closed_loop import Trajectory

_STYLE = Path(str(files("pfaffian.templates"))) / "report" / "figures.mplstyle"
_INK, _MUTED, _GRID, _BAND = "#1f2328", "#6a7079", "#dfe2e6", "#8c6d1f"
#: The cycle of the style file: colours that people with colour-vision deficiency can tell apart.
_FLIGHTS = ("#0072b2", "#d55e00", "#009e73", "#a0508a")
_MARKERS = ("o", "s", "^", "D")
#: Variables of the style sheet by the light-scheme colour that each stands for.
_VARIABLES = {_INK: "ink", _MUTED: "muted", _GRID: "grid", _BAND: "band"}
_VARIABLES |= {colour: f"flight-{k + 1}" for k, colour in enumerate(_FLIGHTS)}
_WIDTH, _HEIGHT = 5.0, 2.75
_TRANSIENT = 2.0
_LAST_SECONDS = 2.0
_FRAME_RATE = 60.0
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LETTERS = {"tau": "τ", "beta": "β", "adb": "ADB", "bound_estimate": "â"}


@dataclass(frozen=True)
class Figure:
    """A drawn figure: its inline SVG and the words below it."""

    name: str
    caption: str
    svg: Markup


def unit_text(unit: str) -> str:
    """Return a unit as it is printed: `1/(kg*m^2)` as 1/(kg m²), never broken."""
    raised = re.sub(r"\^(-?\d+)", lambda m: m[1].translate(_SUPERSCRIPTS), unit)
    return raised.replace("*", "\u00a0")


def symbol_text(name: str) -> str:
    """Return a signal's name as it is printed: `q1` as q₁, `tau` as τ."""
    word, digits = re.fullmatch(r"(.*?)(\d*)", name).groups()  # type: ignore[union-attr]
    return _LETTERS.get(word, word) + digits.translate(_SUBSCRIPTS)


def number_text(value: object, digits: int = 4, measured: bool = False) -> str:
    """Return a number to `digits` significant digits, with a typographic power of ten.

    A `measured` number keeps the zeros at its end.
    """
    if not isinstance(value, int | float) or isinstance(value, bool):
        return "–" if value is None else str(value)
    mantissa, _, exponent = f"{value:{'#' * measured}.{digits}g}".partition("e")
    text = mantissa.replace("-", "−")
    if exponent:
        power = str(int(exponent)).replace("-", "−")
        text += Markup("&#8239;·&#8239;10<sup>{}</sup>").format(power)
    return text


def count_text(value: object) -> str:
    """Return a whole number in groups of three digits."""
    return f"{value:,}".replace(",", "\u202f") if isinstance(value, int) else number_text(value)


def history_figures(flights: Sequence[Trajectory], labels: Sequence[str]) -> tuple[Figure, ...]:
    """Return the time histories of all flights, overlaid."""
    manifest = flights[0].scenario.folder.manifest
    with rc_context(fname=_STYLE):
        return tuple(_histories(_Plot(flights, labels), manifest))


@dataclass(frozen=True)
class _Plot:
    """Overlays one signal of every flight over time."""

    flights: Sequence[Trajectory]
    labels: Sequence[str]

    def figure(
        self,
        name: str,
        ylabel: str,
        caption: str,
        signal: Callable[[Trajectory], np.ndarray[Any, Any]],
        decorate: Callable[[Axes], None] = lambda axes: None,
    ) -> Figure:
        canvas = Canvas(figsize=(_WIDTH, _HEIGHT), layout="constrained")
        axes = canvas.add_subplot()
        for k, (flight, label) in enumerate(zip(self.flights, self.labels, strict=True)):
            axes.plot(flight.time, signal(flight), label=label, zorder=3 + k)
        axes.set_xlabel("time [s]")
        axes.set_ylabel(ylabel)
        axes.set_xlim(0.0, self.end())
        axes.margins(y=0.08)
        decorate(axes)
        _legend(axes)
        return Figure(name, caption, _inline_svg(canvas, name, caption, axes))

    def end(self) -> float:
        """Return the end of the last period of the longest flight, in seconds."""
        return max(f.scenario.steps * f.scenario.sample_time for f in self.flights)

    def values(self, key: str) -> tuple[float, ...]:
        """Return the different values of a controller parameter among the flights."""
        found = [f.scenario.controller[key] for f in self.flights if key in f.scenario.controller]
        return tuple(dict.fromkeys(found))


def _histories(plot: _Plot, manifest: Manifest) -> Iterator[Figure]:
    inputs = {f.name: f for f in manifest.structures["input"].fields}
    outputs = {f.name: f for f in manifest.structures["output"].fields}
    states = {f.name: f for f in manifest.structures["state"].fields}
    for q in manifest.coordinates:
        yield _coordinate(plot, inputs[q])
    for q in manifest.coordinates:
        yield _error(plot, inputs[q])
    for actuator in manifest.actuators:
        yield from _torque(plot, outputs[actuator])
    beta, bound, adb = (manifest.own(n) for n in ("beta", "bound_estimate", "adb"))
    if len(manifest.actuators) == 1:
        yield _plain(plot, outputs[beta], lambda f: f.output[beta])
    yield _plain(plot, states[bound], lambda f: f.state[bound])
    yield from _singular(plot, outputs[adb])


def _quantity(field: Field) -> str:
    return f"{symbol_text(field.name)} [{unit_text(field.unit)}]"


def _meaning(field: Field) -> str:
    """Return the symbol and description of a signal, without the numbers of equations."""
    words = re.sub(r", [(][0-9]+[)]", "", field.description)
    spelled = field.name.replace("_", " ") if words == "ahat" else words
    return f"{symbol_text(field.name)}, {spelled}"


def _coordinate(plot: _Plot, field: Field) -> Figure:
    goals = dict.fromkeys(f.scenario.setpoint[field.name] for f in plot.flights)

    def decorate(axes: Axes) -> None:
        for goal in goals:
            _level(axes, goal, f"setpoint {goal:.4g} {unit_text(field.unit)}")

    return plot.figure(
        f"history-{field.name}",
        _quantity(field),
        f"{_meaning(field)}.",
        lambda f: f.measured[field.name],
        decorate,
    )


def _error(plot: _Plot, field: Field) -> Figure:
    symbol = symbol_text(field.name)

    def decorate(axes: Axes) -> None:
        axes.set_yscale("log", nonpositive="mask")
        end = plot.end()
        axes.axvspan(max(end - _LAST_SECONDS, 0.0), end, color=_MUTED, alpha=0.13, linewidth=0)

    return plot.figure(
        f"error-{field.name}",
        f"|{symbol} − {symbol}d| [{unit_text(field.unit)}]",
        f"Distance of {symbol} from its setpoint, logarithmic; the shaded two seconds give MAE2.",
        lambda f: np.abs(f.errors()[field.name]),
        decorate,
    )


def _torque(plot: _Plot, field: Field) -> Iterator[Figure]:
    def limits(axes: Axes) -> None:
        for limit in plot.values("torque_limit"):
            _level(axes, limit, f"limit {limit:g} {unit_text(field.unit)}", below=True)
            _level(axes, -limit)

    def transient(axes: Axes) -> None:
        axes.set_xlim(0.0, min(_TRANSIENT, axes.get_xlim()[1]))

    symbol, signal = symbol_text(field.name), lambda f: f.output[field.name]
    yield plot.figure(
        f"history-{field.name}", _quantity(field), f"{_meaning(field)}.", signal, limits
    )
    yield plot.figure(
        f"transient-{field.name}",
        _quantity(field),
        f"The first {_TRANSIENT:g} seconds of {symbol}, on its own scale.",
        signal,
        transient,
    )


def _plain(
    plot: _Plot, field: Field, signal: Callable[[Trajectory], np.ndarray[Any, Any]]
) -> Figure:
    caption = f"{_meaning(field)}."
    still = not any(np.any(signal(f)) for f in plot.flights)
    if still:
        caption += " Zero throughout: nothing is estimated in these flights."

    def decorate(axes: Axes) -> None:
        if still:
            axes.set_ylim(-1.0, 1.0)

    return plot.figure(f"history-{field.name}", _quantity(field), caption, signal, decorate)


def _singular(plot: _Plot, field: Field) -> Iterator[Figure]:
    thresholds = plot.values("singular_threshold")

    def linear(axes: Axes) -> None:
        for threshold in thresholds:
            axes.axhspan(-threshold, threshold, color=_BAND, alpha=0.35, linewidth=0)
        _level(axes, 0.0, "ADB = 0: singular", below=True)

    def logarithmic(axes: Axes) -> None:
        axes.set_yscale("log", nonpositive="mask")
        least = min(thresholds, default=1.0)
        axes.set_ylim(bottom=least / 3)
        for threshold in thresholds:
            axes.axhspan(least / 3, threshold, color=_BAND, alpha=0.18, linewidth=0)
            _level(axes, threshold, f"threshold {threshold:g} {unit_text(field.unit)}")

    yield plot.figure(
        f"history-{field.name}",
        _quantity(field),
        f"{_meaning(field)}; the law divides by it, so it must keep its sign.",
        lambda f: f.output[field.name],
        linear,
    )
    yield plot.figure(
        f"distance-{field.name}",
        f"|{symbol_text(field.name)}| [{unit_text(field.unit)}]",
        "Distance from the singular set, logarithmic; below the threshold the law fades 1/ADB out.",
        lambda f: np.abs(f.output[field.name]),
        logarithmic,
    )


def _level(axes: Axes, value: float, text: str = "", below: bool = False) -> None:
    """Draw a horizontal line at `value` and name it at its right end."""
    axes.axhline(value, color=_INK, linewidth=0.8, linestyle=(0, (1, 1.6)), zorder=2)
    axes.annotate(
        text,
        (0.995, value),
        xycoords=("axes fraction", "data"),
        xytext=(0, -3 if below else 3),
        textcoords="offset points",
        ha="right",
        va="top" if below else "bottom",
        color=_INK,
        fontsize=7,
        zorder=9,
    )


def _legend(axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    columns = len(labels) if sum(map(len, labels)) < 70 else 1
    axes.legend(handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns)


def verification_figure(rows: Sequence[Mapping[str, Any]], limit: float) -> Figure | None:
    """Return a dot plot of the worst error by function and language, or nothing to plot."""
    if not rows:
        return None
    functions = list(dict.fromkeys(str(r["function"]) for r in rows))
    languages = list(dict.fromkeys(str(r["language"]) for r in rows))
    with rc_context(fname=_STYLE):
        canvas = Canvas(figsize=(_WIDTH, 0.9 + 0.36 * len(functions)), layout="constrained")
        axes = canvas.add_subplot()
        for k, language in enumerate(languages):
            own = [r for r in rows if str(r["language"]) == language]
            shift = 0.5 * (k - (len(languages) - 1) / 2) / max(len(languages) - 1, 1)
            errors = [float(r["worst_scaled_ulp"]) for r in own]
            heights = [functions.index(str(r["function"])) + shift for r in own]
            axes.plot(errors, heights, _MARKERS[k % len(_MARKERS)], label=language, zorder=3)
        axes.axvline(limit, color=_INK, linewidth=1.0, linestyle=(0, (1, 1.6)))
        axes.text(0.985 * limit, len(functions) - 0.6, f"limit {limit:g}", ha="right", fontsize=7)
        axes.set_yticks(range(len(functions)), functions)
        axes.set_ylim(len(functions) - 0.5, -0.5)
        axes.set_xlim(0.0, 1.1 * max(limit, *(float(r["worst_scaled_ulp"]) for r in rows)))
        axes.set_xlabel("worst error [scaled ulp]")
        _legend(axes)
        caption = "Worst error found of each generated function, by language."
        return Figure("verification", caption, _inline_svg(canvas, "verification", caption))


def _inline_svg(canvas: Canvas, name: str, caption: str, time_axes: Axes | None = None) -> Markup:
    """Return a figure as SVG for HTML: own ids, the page's colours and font, short numbers.

    With `time_axes` the root says where the time axis lies, for a cursor to find its place.
    """
    FigureCanvasSVG(canvas)
    buffer = io.StringIO()
    nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
    canvas.savefig(buffer, format="svg", metadata=nothing, transparent=True)
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*|<!--.*?-->\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\b(id="|href="#|url\(#)', rf"\g<1>{name}-", svg)
    svg = re.sub(r' d="[^"]*"', lambda m: re.sub(r"(\.\d\d)\d+", r"\1", m[0]), svg)
    svg = re.sub(r'font-family: [^;"]*(; )?', "", svg)
    svg = re.sub(r"(\d[\d.]*px) 'DejaVu Sans'", r"\1 var(--sans, sans-serif)", svg)
    for colour, variable in _VARIABLES.items():
        svg = svg.replace(colour, f"var(--{variable}, {colour})")
    width, height = (72.0 * size for size in canvas.get_size_inches())
    root = f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(caption)}"'
    axis = _time_axis(time_axes, width, height) if time_axes else ""
    return Markup(f"{root}{axis}{svg[svg.index('>') :]}")


def _time_axis(axes: Axes, width: float, height: float) -> str:
    """Return an attribute with x and y of the axes' corners, and the times at their ends."""
    box, (start, end) = axes.get_position(), axes.get_xlim()
    corners = (box.x0 * width, box.x1 * width, (1 - box.y1) * height, (1 - box.y0) * height)
    return f' data-axis="{" ".join(f"{v:.2f}" for v in (*corners, start, end))}"'


def two_link_lengths(flight: Trajectory) -> tuple[float, float] | None:
    """Return the lengths in metre to draw a planar two-link arm with, or None for other models.

    Link 1 is theta3/theta5 = l1. A drawing needs a length of link 2, which the dynamics do not
    have: twice its centre of mass, or, where only lumped parameters are known, the length of a
    uniform rod with the same theta2/theta5.
    """
    scenario = flight.scenario
    plant = scenario.plant
    known = {"theta2", "theta3", "theta5"} <= plant.keys()
    if len(scenario.folder.manifest.coordinates) != 2 or not known:
        return None
    centre = scenario.folder.parameters(scenario.set_name).get("lc2")
    rod = 1.5 * plant["theta2"] / plant["theta5"]
    return plant["theta3"] / plant["theta5"], 2.0 * centre if centre else rod


def animation_data(
    flights: Sequence[Trajectory], labels: Sequence[str]
) -> dict[str, object] | None:
    """Return the flights at about 60 frames a second, rounded, or None where no drawing exists."""
    rows = []
    for flight, label in zip(flights, labels, strict=True):
        links, scenario = two_link_lengths(flight), flight.scenario
        if links is None:
            return None
        stride = max(1, round(1.0 / (_FRAME_RATE * scenario.sample_time)))
        manifest = scenario.folder.manifest
        torque = next(
            f for f in manifest.structures["output"].fields if f.name == manifest.actuators[0]
        )
        rows.append(
            {
                "label": label,
                "names": [symbol_text(q) for q in manifest.coordinates],
                "unit": unit_text(torque.unit),
                "frame": stride * scenario.sample_time,
                "links": [float(f"{length:.4g}") for length in links],
                "setpoint": [round(scenario.setpoint[q], 4) for q in manifest.coordinates],
                "angles": [_rounded(flight.measured[q][::stride], 4) for q in manifest.coordinates],
                "torque": _rounded(flight.output[torque.name][::stride], 3),
            }
        )
    return {"flights": rows}


def _rounded(values: Iterable[float], digits: int) -> list[float | None]:
    return [round(float(v), digits) + 0.0 if np.isfinite(v) else None for v in values]
