"""What an audit consists of: rows for equations, findings for the prose around them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TypeAlias

import sympy as sp

PROVED, REPAIRED, DIFFERS = "proved", "repaired", "differs"
NOT_CHECKABLE = "not-checkable"
STATUSES = (PROVED, REPAIRED, DIFFERS, NOT_CHECKABLE)

#: A form as shown: a SymPy object, or words where the source makes a statement.
Form: TypeAlias = "sp.Basic | str"


@dataclass(frozen=True)
class Counterexample:
    """A point at which the source's value and the derived one disagree.

    `printed` and `derived` are expressions; `values` evaluates both at `point`. `meaning` says
    what the two numbers are.
    """

    point: tuple[tuple[sp.Symbol, sp.Expr], ...]
    printed: sp.Expr
    derived: sp.Expr
    meaning: str = "the printed and the derived form"

    def values(self) -> tuple[sp.Expr, sp.Expr]:
        """Return the two values at the point, exact."""
        at = dict(self.point)
        return sp.sympify(self.printed).subs(at), sp.sympify(self.derived).subs(at)

    def disagrees(self) -> bool:
        """Return whether both values are finite numbers and differ."""
        numbers = [sp.N(v, 30) for v in self.values()]
        if not all(n.is_number and n.is_finite and n.is_real for n in numbers):
            return False
        return bool(abs(numbers[0] - numbers[1]) > sp.Float("1e-12"))


@dataclass(frozen=True)
class Verdict:
    """How a check ended: status, why, both forms and the counter-example of a difference.

    What is `repaired` fails as printed, by the counter-example, and is proved with `repair`.
    """

    status: str
    note: str
    printed: Form
    derived: Form
    counterexample: Counterexample | None = None
    checks: tuple[str, ...] = ()
    repair: str = ""


@dataclass(frozen=True)
class Row:
    """One numbered equation. `about` is what the verdict is on: the equation, or its claim."""

    number: int
    verdict: Verdict
    about: str = "equation"


@dataclass(frozen=True)
class Finding:
    """A verdict on a statement without a number, and `place`, where the source makes it.

    `equations` are the numbers it bears on.
    """

    name: str
    place: str
    claim: str
    verdict: Verdict
    equations: tuple[int, ...] = ()


@dataclass(frozen=True)
class Audit:
    """All rows and findings on one model's source."""

    model: str
    source: str
    rows: tuple[Row, ...]
    findings: tuple[Finding, ...]

    def summary(self) -> dict[str, dict[str, int]]:
        """Return how many rows and findings have each status."""
        rows = Counter(r.verdict.status for r in self.rows)
        findings = Counter(f.verdict.status for f in self.findings)
        return {
            "equations": {s: rows[s] for s in STATUSES},
            "findings": {s: findings[s] for s in STATUSES},
        }
