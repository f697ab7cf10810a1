"""The paper's Figures 2-16, each from the runs of its section, in three columns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from pfaffian.paper.results.drawing import (
    Bars,
    Image,
    Line,
    Row,
    bars,
    bars_csv,
    histories,
    histories_csv,
)
from pfaffian.paper.results.result import Drawn
from pfaffian.paper.simulations.cases import COLUMNS, DERIVED, DESIGNED, LQR, PRINTED, TERMS
from pfaffian.paper.simulations.fly import Run
from pfaffian.paper.simulations.measures import accumulated, measures
from pfaffian.runtime.base.arrays import Array

Runs = Mapping[str, Run]

#: What the columns are called.
NAMES = {
    PRINTED: "as printed",
    DERIVED: "as derived, paper's gains",
    DESIGNED: "as designed, poles at −6",
    LQR: "LQR",
}
_ENTRIES = ("as printed", "as derived", "as designed", "LQR")
_ANGLES = ("q₁ [rad]", "q₂ [rad]")
_TERMS = {"5.1": TERMS[1], "5.2": TERMS[2], "5.3": TERMS[2]}


@dataclass(frozen=True)
class FigureSpec:
    """A figure that can be drawn: `draw` takes the runs of its section by name."""

    number: int
    section: str
    title: str
    caption: str
    draw: Callable[[Runs], tuple[Image, bytes]]

    def drawn(self, runs: Runs) -> Drawn:
        """Draw it."""
        image, csv = self.draw(runs)
        name = f"figure-{self.number:02d}"
        return Drawn(name, self.number, self.section, self.title, self.caption, image, csv)


def proposed(runs: Runs, section: str, column: str, terms: str = "") -> Run:
    """Return the run of the proposed law in `section` and `column`."""
    return runs[f"{section}-{column}-{terms or _TERMS[section]}"]


def duration_text(seconds: float) -> str:
    """Return a time as it is printed: 0.949 ms, 0.667 s."""
    return f"{1e3 * seconds:.3g} ms" if seconds < 0.1 else f"{seconds:.3g} s"


def _titles(runs: Runs, section: str, beside: str = "") -> list[str]:
    """Return the columns' titles, with when the runs end that do not reach the end."""
    titles = []
    for column in COLUMNS:
        shown = {"": proposed(runs, section, column)}
        if beside:
            shown = {"p₁ + p₂ ": shown[""], "p₁ ": proposed(runs, section, column, beside)}
        word = "to" if beside else "ends at"
        ends = [f"{n}{word} {duration_text(r.end)}" for n, r in shown.items() if r.ended]
        titles.append(f"{NAMES[column]}\n{', '.join(ends)}")
    return titles


def _line(run: Run, label: str, style: int, values: Array) -> Line:
    return Line(label, style, run.time, values, bool(run.ended))


def _compared(
    runs: Runs,
    section: str,
    rows: Sequence[tuple[str, str, Callable[[Run], Array], dict[str, Any]]],
    baseline: bool = True,
) -> tuple[Image, bytes]:
    """Draw signals of the proposed law, and of the LQR beside it, in three columns."""
    chosen: list[list[tuple[Run, str, int]]] = []
    for column in COLUMNS:
        law = proposed(runs, section, column)
        beside = [(law, "proposed", 0)]
        if baseline and column != PRINTED:
            beside.append((runs[f"{section}-{LQR}"], "LQR", 1))
        chosen.append(beside)
    made = [
        Row(
            label,
            tuple(tuple(_line(r, n, k, signal(r)) for r, n, k in panel) for panel in chosen),
            **options,
        )
        for label, _, signal, options in rows
    ]
    names = [name for _, name, _, _ in rows]
    return histories(_titles(runs, section), made), histories_csv(COLUMNS, made, names)


def _angle(k: int) -> Callable[[Run], Array]:
    return lambda run: run.state[:, k]


def _outputs(section: str, runs: Runs, baseline: bool = True) -> tuple[Image, bytes]:
    levels = ({"level": (np.pi / 2, "setpoint")}, {"level": (0.0, "setpoint")})
    rows: list[Any] = [(_ANGLES[k], f"q{k + 1}_rad", _angle(k), levels[k]) for k in range(2)]
    return _compared(runs, section, rows, baseline)


def _parts(runs: Runs) -> tuple[Image, bytes]:
    """Draw p1 alone beside p1 + p2, Figure 3."""
    levels = ((np.pi / 2, "setpoint"), (0.0, "setpoint"))
    rows = []
    for k in range(2):
        panels = tuple(
            tuple(
                _line(run, label, style, run.state[:, k])
                for run, label, style in (
                    (proposed(runs, "5.1", column), "p₁ + p₂", 0),
                    (proposed(runs, "5.1", column, TERMS[0]), "p₁ alone", 1),
                )
            )
            for column in COLUMNS
        )
        rows.append(Row(_ANGLES[k], panels, level=levels[k]))
    image = histories(_titles(runs, "5.1", TERMS[0]), rows)
    return image, histories_csv(COLUMNS, rows, ("q1_rad", "q2_rad"))


def _measured(key: str, label: str, section: str, log: bool, runs: Runs) -> tuple[Image, bytes]:
    """Draw bars of one measure of both angles."""
    shown = [*(proposed(runs, section, c) for c in COLUMNS), runs[f"{section}-{LQR}"]]
    values = tuple(
        tuple(
            f"ends at {duration_text(run.end)}" if run.ended else measures(run)[f"{key}_{q}"]
            for q in ("q1", "q2")
        )
        for run in shown
    )
    panel = Bars("", label, ("q₁", "q₂"), _ENTRIES, values, log)
    return bars([panel]), bars_csv([panel])


def _signal(name: str) -> Callable[[Run], Array]:
    return lambda run: run.signals[name]


def _squared_gain(section: str, runs: Runs) -> tuple[Image, bytes]:
    label = "(ADB)² [1/(kg m²)²]"
    signal = partial(_power, "adb")
    row = (label, "adb_squared", signal, {"level": (0.0, "(ADB)² = 0: singular")})
    return _compared(runs, section, [row], baseline=False)


def _power(name: str, run: Run) -> Array:
    return run.signals[name] ** 2


def _beta(section: str, runs: Runs, baseline: bool = True) -> tuple[Image, bytes]:
    row = ("|β| [rad/s]", "beta_size", lambda r: np.abs(r.signals["beta"]), {"log": True})
    return _compared(runs, section, [row], baseline)


def _beta_sum(runs: Runs) -> tuple[Image, bytes]:
    def total(run: Run) -> Array:
        return accumulated(run.time, np.abs(run.signals["beta"]))

    row = ("∫ |β| dt [rad]", "beta_sum_rad", total, {"log": True, "floor": 1e-6})
    return _compared(runs, "5.2", [row])


def _torque(runs: Runs) -> tuple[Image, bytes]:
    def effort(run: Run) -> Array:
        return accumulated(run.time, run.signals["tau"] ** 2)

    rows: list[Any] = [
        ("τ [N m]", "tau_Nm", _signal("tau"), {"pale": True}),
        ("∫ τ² dt [N² m² s]", "effort", effort, {}),
    ]
    return _compared(runs, "5.2", rows)


def _controls(runs: Runs) -> tuple[Image, bytes]:
    rows: list[Any] = [
        (f"{p[0]}{'₁₂₃'[int(p[1]) - 1]} [N m]", f"{p}_Nm", _signal(p), {})
        for p in ("p1", "p2", "p3")
    ]
    return _compared(runs, "5.3", rows, baseline=False)


def _spec(
    number: int, section: str, title: str, draw: Callable[[Runs], Any], caption: str = ""
) -> FigureSpec:
    return FigureSpec(number, section, title, caption, draw)


_FAST = (
    " The band in the middle column is a fast oscillation, drawn through its least and greatest "
    "values."
)
#: Figures 2-16 by their number in the paper.
FIGURES: dict[int, FigureSpec] = {
    f.number: f
    for f in (
        _spec(2, "5.1", "Outputs under LQR and the proposed control", partial(_outputs, "5.1")),
        _spec(3, "5.1", "Outputs under p₁ and p₁ + p₂", _parts),
        _spec(
            4,
            "5.1",
            "Integral absolute error (IAE)",
            partial(_measured, "iae", "IAE [rad s]", "5.1", True),
        ),
        _spec(
            5,
            "5.1",
            "Maximal absolute error (MAE)",
            partial(_measured, "mae", "MAE [rad]", "5.1", False),
        ),
        _spec(
            6,
            "5.1",
            "Maximal absolute error of the last 2 s (MAE2)",
            partial(_measured, "mae2", "MAE2 [rad]", "5.1", True),
        ),
        _spec(7, "5.2", "History of ADB BᵀDAᵀ", partial(_squared_gain, "5.2")),
        _spec(8, "5.2", "Outputs under LQR and the proposed control", partial(_outputs, "5.2")),
        _spec(
            9,
            "5.2",
            "Maximal absolute error of the last 2 s (MAE2)",
            partial(_measured, "mae2", "MAE2 [rad]", "5.2", True),
        ),
        _spec(10, "5.2", "Constraint-following error |β|", partial(_beta, "5.2")),
        _spec(11, "5.2", "Accumulated |β|", _beta_sum),
        _spec(12, "5.2", "Control input, and the effort it adds up to", _torque),
        _spec(13, "5.3", "History of ADB BᵀDAᵀ", partial(_squared_gain, "5.3")),
        _spec(
            14, "5.3", "Outputs of the proposed control", partial(_outputs, "5.3", baseline=False)
        ),
        _spec(
            15,
            "5.3",
            "Constraint-following error |β|",
            partial(_beta, "5.3", baseline=False),
            _FAST,
        ),
        _spec(16, "5.3", "The parts p₁, p₂, p₃ of the control", _controls, _FAST),
    )
}
