"""What a section of the paper comes to: figures, tables, and claims with their verdicts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pfaffian.paper.results.drawing import Image

#: Verdicts on a claim of the paper.
HOLDS, PARTLY, FAILS, ADDED = "holds", "holds in part", "does not hold", "not in the paper"

Update = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Drawn:
    """A figure as measured here: `number` is the paper's, 0 for one of ours; `name` that of its
    files."""

    name: str
    number: int
    section: str
    title: str
    caption: str
    image: Image
    csv: bytes

    @property
    def kinds(self) -> tuple[str, ...]:
        """Return the kinds of its files."""
        return ("svg", "csv") if self.image.pdf is None else ("svg", "pdf", "csv")


@dataclass(frozen=True)
class Claim:
    """A statement of the paper beside what was measured; `evidence` names tables and tests."""

    section: str
    figures: tuple[str, ...]
    says: str
    measured: str
    verdict: str
    evidence: str

    @property
    def command(self) -> str:
        """Return what reproduces the measurement."""
        return f"pfaffian reproduce section-{self.section}"


@dataclass(frozen=True)
class Table:
    """A table of the page; cells are words and numbers as they are printed."""

    name: str
    section: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


@dataclass(frozen=True)
class SectionResult:
    """Everything of one section; `failures` says which of our own checks did not hold, `skipped`
    what could not be done here and why."""

    figures: tuple[Drawn, ...]
    tables: tuple[Table, ...] = ()
    claims: tuple[Claim, ...] = ()
    failures: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()


@dataclass(frozen=True)
class Request:
    """What to make: `figures` are the numbers wanted, `studies` asks for tables and claims too;
    `update` is called with a label, done and total."""

    figures: tuple[int, ...]
    studies: bool
    update: Update
