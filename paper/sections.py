"""Which sections there are, which figures each holds, and who makes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.toml import suggestion

if TYPE_CHECKING:
    from pfaffian.paper.results.result import Request, SectionResult

ALL = "all"

Maker = Callable[[str, "Request"], "SectionResult"]


@dataclass(frozen=True)
class Section:
    """A section of the paper: `maker` imports and returns what makes it, a function of its name and
    the request; figures are the paper's numbers."""

    name: str
    title: str
    figures: tuple[int, ...]
    maker: Callable[[], Maker]


def _simulations() -> Maker:
    from pfaffian.paper.verdicts.section_5 import make

    return make


def _experiment() -> Maker:
    from pfaffian.paper.rig.section_6 import make

    return make


SECTIONS = {
    s.name: s
    for s in (
        Section("section-5.1", "Matched constant uncertainty", (2, 3, 4, 5, 6), _simulations),
        Section(
            "section-5.2", "Matched time-varying uncertainty", (7, 8, 9, 10, 11, 12), _simulations
        ),
        Section(
            "section-5.3",
            "Matched and unmatched time-varying uncertainty",
            (13, 14, 15, 16),
            _simulations,
        ),
        Section("section-6", "Experiment", (17, 18, 19, 20), _experiment),
    )
}


@dataclass(frozen=True)
class Choice:
    """One section to make, with the figures of it that are wanted; `whole` asks for its tables."""

    section: Section
    figures: tuple[int, ...]
    whole: bool


def choices(reference: str) -> list[Choice]:
    """Return what `reference` asks for: `all`, a section ("section-5.1", "5.1"), or a figure
    ("figure-7", "7"). Raises `InputError` for anything else.
    """
    if reference == ALL:
        return [Choice(s, s.figures, True) for s in SECTIONS.values()]
    name = reference if reference.startswith("section-") else f"section-{reference}"
    if name in SECTIONS and reference != "6":
        section = SECTIONS[name]
        return [Choice(section, section.figures, True)]
    number = reference.removeprefix("figure-")
    for section in SECTIONS.values():
        if number.isdecimal() and int(number) in section.figures:
            return [Choice(section, (int(number),), False)]
    known = [ALL, *SECTIONS, *(f"figure-{n}" for s in SECTIONS.values() for n in s.figures)]
    raise InputError(
        f"there is no {reference} to reproduce",
        remedy=f"{suggestion(reference, known)}; figures are 2 to 20",
    )
