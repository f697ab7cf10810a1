"""`pfaffian bench sensing`: two velocity estimators behind an encoder, phase lag against noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.cli import output

if TYPE_CHECKING:
    from pfaffian.benchmarks.sensing import EstimatorFigures


def bench_sensing(
    delay: str, damping: float | None, plot: Path | None, force: bool, as_json: bool
) -> None:
    """Measure both estimators over a range of bandwidths; print the table, draw it if asked."""
    from dataclasses import replace

    from pfaffian.benchmarks.sensing import measured_estimators, proposed_estimator
    from pfaffian.runtime.base.files import check_output, write_outputs
    from pfaffian.runtime.base.quantity import parse_quantity
    from pfaffian.runtime.code.sensing import SensingParameters, host_sensing

    check_output(plot, "--plot", ".svg", force=force)
    allowed = parse_quantity(delay, "s", "--delay")
    base = SensingParameters()
    if damping is not None:
        base = replace(base, damping=damping)
    figures = measured_estimators(host_sensing(), base, tell=output.note)
    chosen = proposed_estimator(figures, allowed)
    if plot is not None:
        from pfaffian.benchmarks.sensing_plot import noise_svg

        write_outputs({plot: noise_svg(figures, chosen)}, "--plot")
    document = {
        "counts_per_turn": base.counts_per_turn,
        "sample_time": base.sample_time,
        "damping": base.damping,
        "allowed_delay": allowed,
        "rows": [_row(f) for f in figures],
        "proposed": _row(chosen),
        "plot": str(plot) if plot else None,
    }
    output.deliver(document, as_json, lambda: _print(document, figures, chosen))


def _row(figures: EstimatorFigures) -> dict[str, Any]:
    from pfaffian.benchmarks.sensing import LAG_FREQUENCIES

    row = asdict(figures)
    for key in ("lag_deg", "delay_ms"):
        values = zip(LAG_FREQUENCIES, row.pop(key), strict=True)
        row |= {f"{key}_at_{w:g}": value for w, value in values}
    return row


def _print(
    document: Mapping[str, Any], figures: Sequence[EstimatorFigures], chosen: EstimatorFigures
) -> None:
    from pfaffian.benchmarks.sensing import LAG_FREQUENCIES

    lags = [t for w in LAG_FREQUENCIES for t in (f"lag at {w:g} [deg]", "[ms]")]
    rows = []
    for f in figures:
        pairs = zip(f.lag_deg, f.delay_ms, strict=True)
        cells = [cell for lag, delay in pairs for cell in (f"{lag:.2f}", f"{delay:.2f}")]
        noise = [f"{v:.4f}" for v in (f.moving, f.standstill, f.slow)]
        mark = "*" if f == chosen else ""
        rows.append([f.estimator, f"{f.bandwidth:g}{mark}", *cells, *noise])
    output.table(
        f"{document['counts_per_turn']:g} counts a turn, {1.0 / document['sample_time']:g} Hz, "
        f"damping {document['damping']:.3g}: phase lag, RMS velocity error [rad/s]",
        ("estimator", "w [rad/s]", *lags, "moving", "standstill", "slow"),
        rows,
    )
    output.say(
        f"* proposed: {chosen.estimator}, {chosen.bandwidth:g} rad/s, the least noise of those "
        f"that delay {LAG_FREQUENCIES[-1]:g} rad/s by at most "
        f"{1e3 * document['allowed_delay']:g} ms"
    )
