"""A flight as an animated SVG: the links move by SMIL, and the torque is drawn under them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.twin.recording import Flight, entered_at

_FRAMES = 20.0  # a second
_LENGTH = 4.0  # seconds of the flight that are shown
_PAUSE = 1.0  # seconds it rests at the end, so that a loop is seen to begin again
_WIDTH, _HEIGHT = 640, 400
_PIVOT = (170.0, 200.0)
_LINKS = (84.0, 84.0)
#: Left, right, middle and half height of each strip.
_LEFT, _RIGHT = 380.0, 612.0
_STRIPS = (("q₁ − π/2", 92.0), ("q₂", 202.0), ("τ", 312.0))
_HALF = 38.0
_STYLE = """
.film{font:13px system-ui,sans-serif;--ink:#1f2328;--muted:#656d76;--grid:#d0d7de;
--one:#0072b2;--two:#d55e00}
@media(prefers-color-scheme:dark){
.film{--ink:#e6edf3;--muted:#8d96a0;--grid:#3d444d;--one:#58a6ff;--two:#f0883e}}
.film text{fill:var(--ink)}.film .m{fill:var(--muted);font-size:11px}
.film .g{stroke:var(--grid);fill:none}.film .l{stroke-width:9;stroke-linecap:round}
.film .c{fill:none;stroke-width:1.4}
"""


def animated_flight(flight: Flight, seconds: float = _LENGTH) -> bytes:
    """Return the first `seconds` of a flight of one rig of the Pendubot as an SVG that loops."""
    step = round(1.0 / (_FRAMES * flight.scenario.base.sample_time))
    last = min(len(flight.time) - 1, round(seconds / flight.scenario.base.sample_time))
    picked = np.arange(0, last + 1, step)
    time = flight.time[picked, 0]
    end = float(time[-1])
    q1, q2 = (flight.signals[n][picked, 0] for n in ("q1", "q2"))
    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" class="film" role="img" '
        f'viewBox="0 0 {_WIDTH} {_HEIGHT}" '
        'aria-label="The Pendubot swings up from hanging and is held upright">',
        f"<style>{_STYLE}</style>",
        _links(q1, q2, end),
        *_strips(flight, last, end),
        *_captions(flight, end),
        "</svg>\n",
    ]
    return "\n".join(parts).encode()


def shown_csv(flight: Flight, seconds: float = _LENGTH) -> bytes:
    """Return what the animation shows as CSV: time [s], angles [rad], torque [N m] and mode."""
    last = round(seconds / flight.scenario.base.sample_time)
    names = ("q1", "q2", "tau", "mode")
    columns = [flight.time[: last + 1, 0], *(flight.signals[n][: last + 1, 0] for n in names)]
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return "\n".join(
        [",".join(("t", *names)), *(",".join(map(repr, r)) for r in rows), ""]
    ).encode()


def _timing(end: float) -> str:
    return f'dur="{end + _PAUSE:g}s" repeatCount="indefinite"'


def _times(count: int, end: float) -> str:
    moving = end / (end + _PAUSE)
    return ";".join(f"{moving * k / (count - 1):.4f}" for k in range(count)) + ";1"


def _turning(angles: Array, end: float, about: tuple[float, float]) -> str:
    """Return the rotation through `angles` (rad, up is positive, as SVG counts down)."""
    x, y = about
    degrees = [f"{-np.degrees(a):.1f} {x:g} {y:g}" for a in (*angles, angles[-1])]
    return (
        f'<animateTransform attributeName="transform" type="rotate" {_timing(end)} '
        f'keyTimes="{_times(len(angles), end)}" values="{";".join(degrees)}"/>'
    )


def _links(q1: Array, q2: Array, end: float) -> str:
    (x, y), (one, two) = _PIVOT, _LINKS
    reach = one + two
    return (
        f'<circle class="g" cx="{x:g}" cy="{y:g}" r="{reach:g}" stroke-dasharray="2 5"/>'
        f'<path class="g" d="M{x - 30:g} {y:g}h60"/>'
        f'<g transform="rotate({-np.degrees(q1[0]):.1f} {x:g} {y:g})">{_turning(q1, end, _PIVOT)}'
        f'<path class="l" stroke="var(--one)" d="M{x:g} {y:g}h{one:g}"/>'
        f'<g transform="rotate({-np.degrees(q2[0]):.1f} {x + one:g} {y:g})">'
        f"{_turning(q2, end, (x + one, y))}"
        f'<path class="l" stroke="var(--two)" d="M{x + one:g} {y:g}h{two:g}"/></g>'
        f'<circle cx="{x + one:g}" cy="{y:g}" r="4" fill="var(--ink)"/></g>'
        f'<circle cx="{x:g}" cy="{y:g}" r="6" fill="var(--ink)"/>'
    )


def _strips(flight: Flight, last: int, end: float) -> list[str]:
    """Return the curves of both errors and the torque, and a line that runs through them."""
    picked = np.arange(0, last + 1, 10)
    goal = (np.pi / 2, 0.0)
    curves = [flight.signals[n][picked, 0] - g for n, g in zip(("q1", "q2"), goal, strict=True)]
    curves.append(flight.signals["tau"][picked, 0])
    units, colours = ("rad", "rad", "N m"), ("var(--one)", "var(--two)", "var(--ink)")
    parts = []
    for (name, middle), values, unit, colour in zip(_STRIPS, curves, units, colours, strict=True):
        most = float(np.ceil(np.abs(values).max() * 10) / 10)
        parts += [
            f'<path class="g" d="M{_LEFT:g} {middle:g}H{_RIGHT:g}"/>',
            f'<text x="{_LEFT:g}" y="{middle - _HALF - 6:g}">{name}</text>',
            f'<text class="m" x="{_RIGHT:g}" y="{middle - _HALF - 6:g}" text-anchor="end">'
            f"±{most:g} {unit}</text>",
            f'<path class="c" stroke="{colour}" d="{_path(values, middle, most)}"/>',
        ]
    bottom = _STRIPS[-1][1] + _HALF
    parts.append(
        f'<path stroke="var(--muted)" d="M{_LEFT:g} {_STRIPS[0][1] - _HALF:g}V{bottom:g}">'
        f'<animateTransform attributeName="transform" type="translate" {_timing(end)} '
        f'keyTimes="0;{end / (end + _PAUSE):.4f};1" '
        f'values="0 0;{_RIGHT - _LEFT:g} 0;{_RIGHT - _LEFT:g} 0"/></path>'
    )
    parts.append(f'<text class="m" x="{_LEFT:g}" y="{bottom + 16:g}">0 s</text>')
    parts.append(
        f'<text class="m" x="{_RIGHT:g}" y="{bottom + 16:g}" text-anchor="end">{end:g} s</text>'
    )
    return parts


def _path(values: Array, middle: float, most: float) -> str:
    xs = np.linspace(_LEFT, _RIGHT, len(values))
    points = [f"{x:.1f} {middle - _HALF * v / most:.1f}" for x, v in zip(xs, values, strict=True)]
    return "M" + "L".join(points)


def _captions(flight: Flight, end: float) -> list[str]:
    """Return the names of the modes, each shown while it lasts."""
    first = entered_at(flight)
    since = float(flight.time[first, 0]) if first >= 0 else end
    spans: Sequence[tuple[str, float, float]] = (
        ("SWING_UP", 0.0, since),
        ("BALANCE", since, end + _PAUSE),
    )
    parts = ['<text class="m" x="28" y="30">mode</text>']
    for name, start, stop in spans:
        keys, values = _shown(start / (end + _PAUSE), stop / (end + _PAUSE))
        parts.append(
            f'<text x="64" y="30" opacity="{values[0]}" font-weight="600">{name}<animate '
            f'attributeName="opacity" calcMode="discrete" {_timing(end)} keyTimes="{keys}" '
            f'values="{values}"/></text>'
        )
    parts.append(f'<text class="m" x="28" y="388">BALANCE from {since:.2f} s; real time</text>')
    return parts


def _shown(start: float, stop: float) -> tuple[str, str]:
    if start == 0.0:
        return f"0;{stop:.4f}", "1;0"
    return f"0;{start:.4f}", "0;1"
