"""A source as data: the text of its equations by number and part, and what it says beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from pfaffian.paper.audit.notation import Operand, read


@dataclass(frozen=True)
class Paper:
    """The equations of a source as printed, in the notation of `notation`.

    `equations` holds the parts of each number by name; `said` what stands between them: values
    with their units, statements, references, by name.
    """

    equations: Mapping[int, Mapping[str, str]]
    said: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def form(self, number: int, part: str, names: Mapping[str, Operand]) -> object:
        """Return a part of equation `number`, read with `names`."""
        return read(self.equations[number][part], names)

    def altered(self, number: int, old: str, new: str, part: str = "") -> Paper:
        """Return this source with a misprint: `old` replaced by `new` in equation `number`, in
        `part` of it or wherever it stands. Raises `ValueError` where it stands nowhere.
        """
        parts = self.equations[number]
        wanted = {part} if part else set(parts)
        changed = {n: t.replace(old, new) if n in wanted else t for n, t in parts.items()}
        if changed == dict(parts):
            raise ValueError(f"({number}) does not hold {old!r}: {dict(parts)}")
        return replace(self, equations={**self.equations, number: changed})
