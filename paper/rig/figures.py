"""The paper's Figures 17-20, and the swing-ups side by side, from flights on the twin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pfaffian.paper.results.drawing import Bars, Line, Row, bars, bars_csv, histories, histories_csv
from pfaffian.paper.results.result import Drawn
from pfaffian.paper.rig.flights import Measures
from pfaffian.runtime.twin.recording import Flight, entered_at

#: Names of the laws in the order of the campaign's axis.
PROPOSED, LQR = "proposed", "LQR"
#: The second column is drawn from this time to this one [s].
_HELD = (5.0, 15.0)
_EVERY = 5
_TITLES = ("swing-up and capture", "held: time counts from 5 s")
_LEVEL = {"q1": np.pi / 2, "q2": 0.0}


def outputs(flights: Mapping[str, Flight]) -> Drawn:
    """Draw Figure 17: both angles under both laws, whole and from 5 s."""
    rows = [
        ("q₁ [rad]", "q1", {"level": (_LEVEL["q1"], "setpoint")}),
        ("q₂ [rad]", "q2", {"level": (_LEVEL["q2"], "setpoint")}),
    ]
    caption = (
        " From hanging, on the twin: generated controller at 1 kHz, 5000 counts a turn, "
        "2 N m. Right: the same flights where they are held."
    )
    names = ("q1_rad", "q2_rad")
    return _histories(17, "Outputs of the experiment", caption, flights, rows, names)


def torque(flights: Mapping[str, Flight]) -> Drawn:
    """Draw Figure 18: the control input."""
    rows: list[Any] = [("τ [N m]", "tau", {})]
    caption = " Until the laws take over both flights are the same."
    return _histories(18, "Control input of the experiment", caption, flights, rows, ("tau_Nm",))


def _histories(
    number: int,
    title: str,
    caption: str,
    flights: Mapping[str, Flight],
    rows: Sequence[tuple[str, str, dict[str, Any]]],
    names: Sequence[str],
) -> Drawn:
    made = []
    for label, signal, options in rows:
        columns = []
        for first, last in ((0.0, _HELD[0]), _HELD):
            lines = [
                _line(flight, law, style, signal, first, last)
                for style, (law, flight) in enumerate(flights.items())
            ]
            columns.append(tuple(lines))
        made.append(Row(label, tuple(columns), **options))
    image = histories(_TITLES, made)
    csv = histories_csv(("swing-up", "held"), made, names)
    return Drawn(f"figure-{number}", number, "6", title, caption, image, csv)


def _line(flight: Flight, law: str, style: int, signal: str, first: float, last: float) -> Line:
    """Return a signal between two times; the time of the second column counts from its start."""
    time = flight.time[:, 0]
    part = np.flatnonzero((time >= first) & (time <= last))[::_EVERY]
    values = flight.signals[signal][part, 0]
    if signal in _LEVEL:
        goal = _LEVEL[signal]
        at = flight.signals[signal][max(entered_at(flight), 0), 0]
        values = values - 2 * np.pi * np.round((at - goal) / (2 * np.pi))
    return Line(law, style, time[part] - first, values)


def measure_bars(number: int, found: Mapping[str, Measures]) -> Drawn:
    """Draw Figure 19 (IAE) or 20 (MAE2)."""
    name, title, label = {
        19: ("iae", "Integral absolute error (IAE)", "IAE [rad s]"),
        20: ("mae2", "Maximal absolute error of the last 2 s (MAE2)", "MAE2 [rad]"),
    }[number]
    values = tuple(tuple(_bar(getattr(m, name)[k]) for k in range(2)) for m in found.values())
    panel = Bars("", label, ("q₁", "q₂"), tuple(found), values, log=False)
    caption = " No disturbance but the encoders. " + (
        "Over 10 s from entering BALANCE." if number == 19 else "Of a flight of 15 s."
    )
    image = bars((panel,))
    return Drawn(f"figure-{number}", number, "6", title, caption, image, bars_csv((panel,)))


def _bar(value: float) -> float | str:
    return value if np.isfinite(value) else "not caught"
