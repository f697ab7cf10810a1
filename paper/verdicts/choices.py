"""What the paper leaves open and we chose, ahat(t0) and the length of a run: how figures move."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from pfaffian.paper.results.result import ADDED, Claim, Table
from pfaffian.paper.simulations.cases import DERIVED, DESIGNED, LQR
from pfaffian.paper.simulations.fly import Run
from pfaffian.paper.simulations.measures import measures
from pfaffian.paper.simulations.runs import LONGER, OTHER_ESTIMATES, SHORTER
from pfaffian.paper.verdicts.evidence import SMALL, TESTS, Evidence
from pfaffian.paper.verdicts.tables import end_text, label, number

_KEYS = ("iae_q1", "iae_q2", "mae_q1", "mae_q2", "mae2_q1", "mae2_q2", "beta_end")


def cut(run: Run, duration: float) -> Run:
    """Return the first `duration` seconds of `run` as a run of that length."""
    kept = run.time <= duration * (1.0 + 1e-12)
    case = replace(run.case, duration=duration)
    ended = run.ended if run.end <= duration else ""
    over = run.over_limit
    return replace(
        run,
        task=replace(run.task, case=case),
        time=run.time[kept],
        state=run.state[kept],
        signals={n: v[kept] for n, v in run.signals.items()},
        ended=ended,
        end=min(run.end, duration),
        over_limit=over if over is not None and over <= duration else None,
    )


def _rows(seen: Evidence, column: str) -> Iterator[Run]:
    """Yield the run of the figures of `column`, then those with other choices."""
    main = seen.run(column)
    yield main
    yield cut(main, SHORTER)
    if column == LQR:
        return
    yield seen.other(column, f"{LONGER:g}-s")
    if seen.section != "5.1":
        yield from (seen.other(column, f"ahat-{a:g}") for a in OTHER_ESTIMATES)


def choices_table(seen: Evidence) -> Table:
    """Return the figures of the proposed law and of the LQR for other choices."""
    rows = []
    for column in (DERIVED, DESIGNED, LQR):
        for k, run in enumerate(_rows(seen, column)):
            case, m = run.case, measures(run)
            acts = column != LQR and seen.section != "5.1"
            estimate = f"{case.controller['bound_initial']:g}" if acts else "–"
            name = label(seen.run(column)) if k == 0 else ""
            length = end_text(run) if run.ended else f"{case.duration:g} s"
            rows.append((name, estimate, length, *(number(m[key], 3) for key in _KEYS)))
    columns = (
        "run",
        "α̂(t₀) [N m]",
        "length",
        "IAE q₁",
        "IAE q₂",
        "MAE q₁",
        "MAE q₂",
        "MAE2 q₁",
        "MAE2 q₂",
        "|β| of the last 2 s",
    )
    note = (
        "The first row of each run is that of the figures. The paper asks for α̂(t₀) > 0 and calls "
        "the length t_f; it prints no number for either. In section 5.1 there is no adaptation, "
        "so α̂ does not act."
    )
    title = "What the paper leaves open: α̂(t₀) and the length of a run"
    return Table(f"choices-{seen.section}", seen.section, title, columns, tuple(rows), note)


def choices_claim(seen: Evidence) -> Claim:
    """Say what is ours, and how far the figures hang on it."""
    parts = [_moves(seen, column) for column in (DERIVED, DESIGNED)]
    what = "10 s are" if seen.section == "5.1" else "α̂(t₀) = 0.1 N m and 10 s are"
    return seen.claim(
        "",
        "α̂(t₀) > 0, and the interval [0, t_f]: the paper prints a number for neither.",
        f"{what} ours. {'; '.join(parts)}.",
        ADDED,
        f"choices-{seen.section}; {TESTS}",
    )


def _moves(seen: Evidence, column: str) -> str:
    main = seen.run(column)
    lengths = [cut(main, SHORTER), main, seen.other(column, f"{LONGER:g}-s")]
    words = [
        f"{number(_both(r, 'iae'), 3)} rad s and {number(_both(r, 'mae2'), 2)} rad "
        f"({'small' if _both(r, 'mae2') < SMALL else 'not small'}) in {r.case.duration:g} s"
        for r in lengths
    ]
    text = f"{column}: the larger IAE and MAE2 are {', '.join(words)}"
    if seen.section == "5.1":
        return text
    others = {a: seen.other(column, f"ahat-{a:g}") for a in OTHER_ESTIMATES}
    moved = [
        " and ".join(f"{number(100 * _change(r, main, key), 2)} %" for key in ("iae", "mae2"))
        + f" with α̂(t₀) = {a:g} N m"
        for a, r in others.items()
    ]
    return f"{text}; they change by {', by '.join(moved)}"


def _both(run: Run, key: str) -> float:
    m = measures(run)
    return max(m[f"{key}_q1"], m[f"{key}_q2"])


def _change(run: Run, main: Run, key: str) -> float:
    """Return the change of a measure; below a microradian MAE2 is what the tolerances leave."""
    one, other = _both(run, key), _both(main, key)
    return abs(one - other) / max(other, 1e-6)
