"""Checks that run: equalities by normal form, inequalities by a nonnegative certificate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.audit.counterexample import smallest_counterexample
from pfaffian.derive.audit.row import (
    DIFFERS,
    NOT_CHECKABLE,
    PROVED,
    Counterexample,
    Form,
    Verdict,
)
from pfaffian.derive.normal_form import is_zero
from sympy.core.function import AppliedUndef

_OPAQUE = (sp.atan, sp.Abs, sp.Max, sp.tanh, sp.exp, sp.sign, AppliedUndef)


@dataclass(frozen=True)
class Step:
    """One step of a check: what it shows, whether it holds, and the two sides it compared."""

    name: str
    holds: bool
    printed: sp.Expr
    derived: sp.Expr
    relation: str = "="


def vanishes(expression: sp.Expr) -> bool:
    """Return whether `expression` is identically zero, functions such as atan kept opaque."""
    if sp.expand(expression) == 0:
        return True
    regular = expression.replace(sp.atan, lambda x: sp.atan(sp.expand(x)))
    roots = {p for p in regular.atoms(sp.Pow) if not p.exp.is_integer}
    opaque = sorted(regular.atoms(*_OPAQUE) | roots, key=sp.default_sort_key)
    names = {f: sp.Dummy(f"f{k}", real=True) for k, f in enumerate(opaque)}
    return is_zero(regular.xreplace(names))


def equal(name: str, printed: sp.Basic, derived: sp.Basic) -> Step:
    """Compare two scalars or matrices by normal form."""
    if not isinstance(printed, sp.MatrixBase):
        return Step(name, vanishes(printed - derived), printed, derived)
    pairs = list(zip(printed, derived, strict=True))
    wrong = next((p for p in pairs if not vanishes(p[0] - p[1])), None)
    return Step(name, wrong is None, *(wrong or pairs[0]))


def at_most(name: str, left: sp.Expr, right: sp.Expr, certificate: sp.Expr) -> Step:
    """Show left <= right: their difference is `certificate`, and that is never negative."""
    holds = vanishes(right - left - certificate) and bool(certificate.is_nonnegative)
    return Step(name, holds, right, left, "<=")


def true(name: str, fact: object) -> Step:
    """Take a fact that was computed, such as a sign or a limit."""
    return Step(name, fact is True or fact is sp.true, sp.S.Zero, sp.S.One)


def decide(
    steps: Sequence[Step],
    note: str,
    printed: Form,
    derived: Form,
    fixed: Mapping[sp.Symbol, sp.Expr] | None = None,
) -> Verdict:
    """Return "proved" if every step holds, else "differs" with a point where the first fails."""
    failed = next((s for s in steps if not s.holds), None)
    checks = tuple(s.name for s in steps)
    if failed is None:
        return Verdict(PROVED, note, printed, derived, None, checks)
    violates = (lambda right, left: bool(left > right)) if failed.relation == "<=" else None
    found = smallest_counterexample(
        failed.printed, failed.derived, fixed, f"the two sides of: {failed.name}", violates
    )
    return Verdict(
        DIFFERS, f"fails: {failed.name}. {note}".strip(), printed, derived, found, checks
    )


def refute(
    steps: Sequence[Step], note: str, printed: Form, derived: Form, found: Counterexample
) -> Verdict:
    """Return "differs", given that `steps` hold and `found` really disagrees.

    Raises `ValueError` where the refutation itself fails: an audit must not accuse wrongly.
    """
    failed = [s.name for s in steps if not s.holds]
    if failed or not found.disagrees():
        raise ValueError(f"refutation does not stand: {failed or found}")
    return Verdict(DIFFERS, note, printed, derived, found, tuple(s.name for s in steps))


def unchecked(note: str, printed: Form, derived: Form = "") -> Verdict:
    """Return "not-checkable" with its reason."""
    return Verdict(NOT_CHECKABLE, note, printed, derived)
