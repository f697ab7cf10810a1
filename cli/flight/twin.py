"""`pfaffian simulate` and `pfaffian pil` of a scenario on the twin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pfaffian.cli import output


def twin_document(
    reference: str, mode: str, set_name: str | None, generated: Path | None
) -> dict[str, Any]:
    """Fly a scenario with a [twin] table and say how far it is; return its document."""
    from pfaffian.api.flights import twin_document as fly

    return fly(reference, mode, set_name, generated, output)
