"""Why a rig was not caught: the same rig flown again without one of its deviations."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from pfaffian.paper.results.result import Table
from pfaffian.paper.rig.flights import PLAN_PHASE, fly_recorded
from pfaffian.paper.rig.tables import WITHIN, caught_within, figure
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.twin.settings import TwinScenario
from pfaffian.runtime.twin.statistics import Statistics

#: So long is a rig flown again [s]: the plan takes 1.5 s, and nearly all captures are by then.
AGAIN = 4.0
#: The passive joint's equation holds the inertias in these ratios alone.
RATIOS = (("theta3", "theta2"), ("theta5", "theta2"))


@dataclass(frozen=True)
class Reflown:
    """One rig again: `left` [s] is when it left the plan's tolerance, NaN if it did not;
    `identified` and `undelayed` [s] are the times to capture with the inertias the controller was
    told, and without delay of the drive; NaN where it is not caught within `AGAIN` seconds."""

    left: float
    identified: float
    undelayed: float


def reflown(scenario: TwinScenario) -> Reflown:
    """Fly a scenario of one rig again for `AGAIN` seconds: as it is, and twice less perturbed."""
    base = scenario.base
    short = replace(scenario, base=replace(base, steps=round(AGAIN / base.sample_time)))
    flight = fly_recorded(short, signals=("phase",))
    on = np.flatnonzero(flight.signals["phase"][:, 0] == PLAN_PHASE)
    left = float(flight.time[on[-1], 0]) if len(on) else float("nan")
    inertias = {n: v for n, v in short.spread.items() if not n.startswith("theta")}
    drives = {n: replace(d, delay=0.0, delay_spread=0.0) for n, d in short.drives.items()}
    told = fly_recorded(replace(short, spread=inertias), signals=("mode",)).statistics
    undelayed = fly_recorded(replace(short, drives=drives), signals=("mode",)).statistics
    return Reflown(left, float(told.capture_time[0]), float(undelayed.capture_time[0]))


def fly_again(
    scenario: TwinScenario, rigs: Sequence[int], jobs: int, update: Callable[[int, int], None]
) -> list[Reflown]:
    """Fly each of `rigs` of a scenario again, `jobs` at a time, in order."""
    wanted = [scenario.alone(int(k)) for k in rigs]
    with ProcessPoolExecutor(jobs) as pool:
        found = []
        for one in pool.map(reflown, wanted):
            found.append(one)
            update(len(found), len(wanted))
    return found


def ratios_off(scenario: TwinScenario, params: Array) -> Array:
    """Return by how much each of `RATIOS` is off in every rig, relative, shape (N, 2)."""
    told = scenario.base.plant
    off = [params[a] / params[b] / (told[a] / told[b]) - 1.0 for a, b in RATIOS]
    return np.stack(off, 1)


def failures_table(
    seed: int, found: Statistics, off: Array, delays: Array, again: Sequence[Reflown]
) -> Table:
    """Return every rig that was not caught in time, and with what changed it would have been.

    `off` (N, 2) is that of `ratios_off`, `delays` (N,) in seconds, `again` one entry a failure.
    """
    rows = []
    for k, one in zip(np.flatnonzero(~caught_within(found)), again, strict=True):
        rows.append(
            (
                str(int(k)),
                str(seed),
                *(f"{100 * v:+.1f}" for v in off[k]),
                f"{1e3 * delays[k]:.1f}",
                figure(one.left),
                str(int(found.last_mode[k])),
                " / ".join(figure(float(v)) for v in found.mae2[k]),
                figure(one.identified),
                figure(one.undelayed),
            )
        )
    columns = (
        "rig",
        "seed",
        *(f"{a}/{b} off [%]" for a, b in RATIOS),
        "delay [ms]",
        "plan left at [s]",
        "last mode",
        "MAE2 q₁ / q₂ [rad]",
        "caught with the identified inertias at [s]",
        "caught without delay at [s]",
    )
    note = (
        "The passive joint's equation holds the inertias in these two ratios alone: no torque "
        "makes up for them. A flight that leaves the plan goes on by the energy law, which comes "
        "to rest with link 1 up and link 2 hanging (MAE2 of q₂ near 3.14) or turning. "
        f"Flown again for {AGAIN:g} s; a dash: not caught, or the plan was followed to its end."
    )
    title = f"Rigs not caught within {WITHIN:.0f} s along the plan"
    return Table("failures", "6", title, columns, tuple(rows), note)


def distinguishing(drawn: Mapping[str, Array], failed: Array) -> list[tuple[str, float, float]]:
    """Return (name, coefficient, mean of the failed) of a regression of failure, largest first.

    Coefficients are of the standardised draws, in standard deviations of the 0/1 outcome.
    """
    if not failed.any() or failed.all():
        return []
    x = np.stack([(v - v.mean()) / (v.std() or 1.0) for v in drawn.values()], 1)
    y = failed.astype(float)
    weights = np.linalg.lstsq(x, (y - y.mean()) / y.std(), rcond=None)[0]
    rows = [
        (n, round(float(w), 3), round(float(v[failed].mean()), 3))
        for (n, v), w in zip(drawn.items(), weights, strict=True)
    ]
    return sorted(rows, key=lambda row: -abs(row[1]))


def distinguishing_table(swing_up: str, rows: Sequence[tuple[str, float, float]]) -> Table:
    """Return what distinguishes the rigs that failed."""
    title = f"What the failures have in common: {swing_up}"
    columns = ("drawn", "coefficient", "mean of the failed [half-widths]")
    note = (
        "Linear regression of failure on the draws, both standardised; "
        "a mean of 0 is no preference."
    )
    made = tuple((n, f"{c:+.3f}", f"{m:+.3f}") for n, c, m in rows)
    return Table(f"failures-{swing_up}-why", "6", title, columns, made, note)
