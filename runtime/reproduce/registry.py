"""Which sections there are, which figures each holds, and who makes them."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass

from pfaffian.runtime.documents import suggestion
from pfaffian.runtime.errors import InputError, MissingToolError

ALL = "all"


@dataclass(frozen=True)
class Section:
    """A section of the paper: `provider` names a module with `make(name, request)`, which returns a
    `SectionResult`; figures are the paper's numbers."""

    name: str
    title: str
    figures: tuple[int, ...]
    provider: str

    @property
    def available(self) -> bool:
        """Return whether its provider is part of this version."""
        return importlib.util.find_spec(self.provider) is not None

    def maker(self) -> Callable[..., object]:
        """Return `make` of the provider; raise `MissingToolError` where there is none."""
        if not self.available:
            raise MissingToolError(
                f"{self.name} is not part of this version: there is no module {self.provider}",
                remedy="reproduce the sections that are: section-5.1, section-5.2, section-5.3",
            )
        maker: Callable[..., object] = importlib.import_module(self.provider).make
        return maker


_SIMULATIONS = "pfaffian.derive.reproduce.simulations"
SECTIONS = {
    s.name: s
    for s in (
        Section("section-5.1", "Matched constant uncertainty", (2, 3, 4, 5, 6), _SIMULATIONS),
        Section(
            "section-5.2", "Matched time-varying uncertainty", (7, 8, 9, 10, 11, 12), _SIMULATIONS
        ),
        Section(
            "section-5.3",
            "Matched and unmatched time-varying uncertainty",
            (13, 14, 15, 16),
            _SIMULATIONS,
        ),
        Section(
            "section-6", "Experiment", (17, 18, 19, 20), "pfaffian.derive.reproduce.experiment"
        ),
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
        return [Choice(s, s.figures, True) for s in SECTIONS.values() if s.available]
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


def left_out() -> list[str]:
    """Return the sections that `all` does without, and why."""
    return [
        f"{s.name}: not part of this version (no module {s.provider})"
        for s in SECTIONS.values()
        if not s.available
    ]
