"""A parameter: its name, unit, bounds and meaning."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pfaffian.runtime.base.errors import InputError


@dataclass(frozen=True)
class Parameter:
    """One declared parameter: name, coherent SI unit, meaning, closed bounds and group.

    Groups: `physical` (masses, lengths) or `lumped` (what they combine to), `plant` (needed in
    either form, such as g), `gain`, `synthesised` (gains that wanted poles may replace), `target`
    (sample time, limits), `swing_up` (gains of the energy law) and `uncertainty` (what only the
    simulated plant knows).
    `lower_open` makes the lower bound strict. A parameter with a `default` may be left out.
    """

    name: str
    unit: str
    description: str
    group: str
    lower: float
    upper: float
    lower_open: bool = False
    default: float | None = None
    latex: str = ""

    @property
    def drops_angles(self) -> bool:
        """Return whether the unit was computed, radians dropped, and not written by hand.

        By hand are written those of the plant, and of set-points, which have a default.
        """
        computed = ("gain", "synthesised", "target")
        return self.group == "swing_up" or (self.group in computed and self.default is None)

    def check(self, value: float, where: str) -> float:
        """Return `value` if it lies within the bounds; raise `InputError` naming `where`."""
        above = value > self.lower if self.lower_open else value >= self.lower
        if above and value <= self.upper:
            return value
        relation = "greater than" if self.lower_open else "at least"
        raise InputError(
            f"{where}: {self.name} = {value:g} {self.unit} is out of bounds ({self.description})",
            remedy=f"give a value {relation} {self.lower:g}"
            + (f" and at most {self.upper:g}" if self.upper < math.inf else "")
            + (f" {self.unit}" if self.unit else ""),
        )
