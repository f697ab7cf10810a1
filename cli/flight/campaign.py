"""`pfaffian campaign`: many rigs of many variants of a scenario."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from pfaffian.cli import output
from pfaffian.runtime.base.errors import InputError


def fly(
    reference: str, generated: Path | None, jobs: int, written: Path | None, as_json: bool
) -> None:
    """Fly the campaign `reference` and report a row a case; `written` takes them as CSV."""
    from pfaffian.runtime.base.files import check_output, write_outputs
    from pfaffian.runtime.twin.files.campaign import read_campaign

    check_output(written, "-o")
    if jobs < 1:
        raise InputError(f"--jobs: {jobs}", remedy="give 1 or more")
    campaign = read_campaign(reference)
    rows = fly_rows(reference, generated, jobs)
    if written:
        write_outputs({written: csv_of(rows).encode()})
    document = {"campaign": campaign.name, "title": campaign.title, "rows": rows}
    output.deliver(document, as_json, lambda: _show(campaign.title, rows))


def fly_rows(reference: str, generated: Path | None, jobs: int) -> list[dict[str, Any]]:
    """Fly the campaign called `reference` with a progress bar; return a row a case."""
    from pfaffian.runtime.twin.files.campaign import fly_campaign, read_campaign, row_of

    campaign, rows = read_campaign(reference), []
    with output.progress(f"flying {campaign.name}") as update:
        for result in fly_campaign(campaign, generated, jobs):
            coordinates = campaign.scenario(result.case, generated).coordinates
            rows.append(row_of(result, coordinates))
            update(len(rows), len(campaign.cases))
    return rows


def csv_of(rows: list[dict[str, Any]]) -> str:
    """Return `rows` as CSV: numbers read back to the bit, lists in one cell."""
    text = io.StringIO()
    names = list(dict.fromkeys(n for row in rows for n in row))
    sheet = csv.DictWriter(text, names, lineterminator="\n")
    sheet.writeheader()
    for row in rows:
        sheet.writerow({n: _cell(v) for n, v in row.items()})
    return text.getvalue()


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(map(str, value))
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)


def _show(title: str, rows: list[dict[str, Any]]) -> None:
    hidden = ("sha256", "failed", "seed", "capture_time_least")
    names = [n for n in rows[0] if n not in hidden]
    cells = [[_shown(row[n]) for n in names] for row in rows]
    output.table(title, [n.replace("_", " ") for n in names], cells)
    for row in rows:
        failed = row["failed"]
        if failed:
            more = f" and {len(failed) - 12} more" if len(failed) > 12 else ""
            which = ", ".join(map(str, failed[:12]))
            output.say(f"not captured (seed {row['seed']}): rigs {which}{more}")


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    return output.figure(value) if isinstance(value, float) else str(value)
