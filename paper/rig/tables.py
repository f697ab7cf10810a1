"""The tables of section 6: laws and cases, swing-ups, rigs, rates and limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from pfaffian.paper.results.result import Table
from pfaffian.paper.rig.flights import WINDOW, Measures, Swing
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.twin.rig import Rigs
from pfaffian.runtime.twin.settings import TwinScenario
from pfaffian.runtime.twin.statistics import Statistics

#: A rig must be caught within so long [s].
WITHIN = 20.0
_FIGURES = ("IAE q₁ [rad s]", "IAE q₂ [rad s]", "MAE2 q₁ [rad]", "MAE2 q₂ [rad]")
_LATCHED = 3


def figure(value: float) -> str:
    """Return a number as it is printed."""
    return f"{value:.3g}" if np.isfinite(value) else "–"


def cells(found: Measures) -> tuple[str, ...]:
    """Return IAE and MAE2 of both links as they are printed."""
    return tuple(figure(v) for v in (*found.iae, *found.mae2))


def laws_table(found: Mapping[tuple[str, str], Measures], laws: Sequence[str]) -> Table:
    """Return the table of laws and cases by (case, law)."""
    rows = []
    for case in dict.fromkeys(case for case, _ in found):
        for law in laws:
            one = found[case, law]
            rows.append((case, law, figure(one.entered), *cells(one), figure(one.effort)))
    note = (
        f"IAE is over {WINDOW:.0f} s from the flight's last entry into BALANCE, so that the "
        "swing-up does not count; MAE2 is that of the flight's last 2 s. A dash: BALANCE did not "
        "last to the end. The cases are runtime/campaigns/section-6-laws.toml."
    )
    columns = ("case", "law", "in BALANCE from [s]", *_FIGURES, "∫τ² [N²m²s]")
    return Table("laws", "6", "Three laws on the same twin", columns, tuple(rows), note)


def exceptions(found: Mapping[tuple[str, str], Measures], ours: str, other: str) -> list[str]:
    """Return where `other` has the smaller figure, or is caught where `ours` is not."""
    texts = []
    for case in dict.fromkeys(case for case, _ in found):
        one, two = found[case, ours], found[case, other]
        if one.caught != two.caught:
            texts += [f"{case}: {other} alone is caught"] if two.caught else []
            continue
        for name, a, b in zip(_FIGURES, (*one.iae, *one.mae2), (*two.iae, *two.mae2), strict=True):
            if b < a:
                texts.append(f"{case}: {name.split(' [')[0]} {figure(b)} against {figure(a)}")
    return texts


def swings_table(found: Mapping[str, Swing]) -> Table:
    """Return planned and energy swing-up side by side."""
    rows = []
    for law, s in found.items():
        worst = " / ".join(figure(v) for v in s.following)
        rms = " / ".join(figure(v) for v in s.rms)
        made = (s.upright, s.peak, s.work, s.energy)
        rows.append((law, *(figure(v) for v in made), worst, rms))
    columns = (
        "swing-up",
        "in BALANCE from [s]",
        "peak torque [N m]",
        "positive work [J]",
        "∫|τ q₁′| [J]",
        "largest following error q₁ / q₂ [rad]",
        "RMS q₁ / q₂ [rad]",
    )
    note = "From hanging to the last entry into BALANCE. The energy law follows nothing."
    return Table("swing-ups", "6", "Planned swing-up and energy law", columns, tuple(rows), note)


def rigs_row(name: str, found: Statistics, faulty: bool) -> tuple[str, ...]:
    """Return the row of one swing-up in the table of rigs; a fault leaves none of them caught."""
    caught, count = caught_within(found), len(found.lost)
    times = np.sort(found.capture_time[found.captured])
    spread = [figure(times[round(q * (len(times) - 1))]) if len(times) else "–" for q in _SHARES]
    return (
        name,
        str(count),
        "–" if faulty else f"{int(caught.sum())} ({100 * caught.mean():.1f} %)",
        *spread,
        figure(float(found.peak_torque.max())),
        str(int(found.violations.sum())),
        str(int((found.first_fault != 0).sum())),
        str(len(left_fault(found))),
    )


_SHARES = (0.0, 0.5, 0.95, 1.0)


def caught_within(found: Statistics) -> Array:
    """Return which rigs were caught within `WITHIN` seconds and held to the end, bool (N,)."""
    return np.asarray(found.captured & (np.nan_to_num(found.capture_time, nan=np.inf) <= WITHIN))


def left_fault(found: Statistics) -> Array:
    """Return the rigs that had a fault and did not end in FAULT, though nobody reset them."""
    return np.flatnonzero((found.first_fault != 0) & (found.last_mode != _LATCHED))


def rigs_table(rows: Sequence[tuple[str, ...]]) -> Table:
    """Return the table of randomised rigs."""
    columns = (
        "swing-up",
        "rigs",
        f"caught within {WITHIN:.0f} s",
        "least [s]",
        "median [s]",
        "95 % [s]",
        "most [s]",
        "peak torque [N m]",
        "periods beyond the limit",
        "faulted",
        "left FAULT by itself",
    )
    note = (
        "Time to BALANCE with both errors within the tolerance to the flight's end. "
        "pfaffian campaign section-6-rigs flies the same."
    )
    return Table("rigs", "6", "Randomised rigs", columns, tuple(rows), note)


def drawn_parameters(scenario: TwinScenario, rigs: Rigs) -> dict[str, Array]:
    """Return what was drawn for each rig, by name, in half-widths from the middle (N,)."""
    found = {}
    for name, share in scenario.spread.items():
        middle = scenario.base.plant[name]
        found[name] = (rigs.params[name] / middle - 1.0) / share
    for k, (name, drive) in enumerate(scenario.drives.items()):
        if drive.delay_spread:
            found[f"delay {name}"] = (rigs.delays[:, k] - drive.delay) / drive.delay_spread
    return found


def grid_tables(found: Mapping[tuple[str, str, str], Statistics]) -> list[Table]:
    """Return time to capture by rate and limit, a table for each swing-up."""
    tables = []
    limits = list(dict.fromkeys(limit for _, limit, _ in found))
    for swing_up in dict.fromkeys(law for _, _, law in found):
        rows = []
        for rate in dict.fromkeys(r for r, _, _ in found):
            times = [float(found[rate, limit, swing_up].capture_time[0]) for limit in limits]
            rows.append((rate, *(figure(t) for t in times)))
        title = f"Time to capture [s] by sample rate and torque limit: {swing_up}"
        note = "BALANCE with both errors within 0.03 rad to the flight's end; a dash: not."
        columns = ("rate", *limits)
        tables.append(Table(f"grid-{swing_up}", "6", title, columns, tuple(rows), note))
    return tables
