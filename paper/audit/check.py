"""Checks that run: equalities by normal form, inequalities by a nonnegative certificate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TypeAlias

import sympy as sp
from pfaffian.derive.symbolic.normal_form import is_zero
from pfaffian.paper.audit.counterexample import smallest_counterexample
from pfaffian.paper.audit.notation import INTEGRAL
from pfaffian.paper.audit.row import (
    DIFFERS,
    NOT_CHECKABLE,
    PROVED,
    REPAIRED,
    Counterexample,
    Form,
    Verdict,
)
from sympy.core.function import AppliedUndef

#: Symbols of whose values both signs are tried.
Signs: TypeAlias = Sequence[sp.Symbol]
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
    regular = regular.replace(INTEGRAL, lambda x: INTEGRAL(sp.expand(x)))
    roots = {p for p in regular.atoms(sp.Pow) if not p.exp.is_integer}
    opaque = sorted(regular.atoms(*_OPAQUE) | roots, key=sp.default_sort_key)
    names = {f: sp.Dummy(f"f{k}", real=True) for k, f in enumerate(opaque)}
    return is_zero(regular.xreplace(names))


def equal(name: str, printed: sp.Basic, derived: sp.Basic) -> Step:
    """Compare two scalars or matrices by normal form."""
    if not isinstance(printed, sp.MatrixBase):
        one, other = sp.sympify(printed), sp.sympify(derived)
        return Step(name, vanishes(one - other), one, other)
    pairs = list(zip(printed, derived, strict=True))
    wrong = next((p for p in pairs if not vanishes(p[0] - p[1])), None)
    return Step(name, wrong is None, *(wrong or pairs[0]))


def at_most(
    name: str, left: sp.Expr, right: sp.Expr, square: sp.Expr = sp.S.Zero, signs: Signs = ()
) -> Step:
    """Show left <= right: their difference less `square`, expanded, is visibly nonnegative.

    `square` has to be nonnegative itself. Of each symbol in `signs` both signs are tried: with
    its magnitude in its place the magnitudes of products come out.
    """
    held = True
    for case in _cases(signs):
        part = sp.sympify(square).subs(case)
        difference = sp.expand(sp.sympify(right - left).subs(case) - part)
        held = held and bool(part.is_nonnegative and difference.is_nonnegative)
    return Step(name, held, sp.sympify(right), sp.sympify(left), "<=")


def _cases(signs: Signs) -> list[dict[sp.Symbol, sp.Expr]]:
    sizes = [sp.Dummy(f"{s.name}_size", positive=True) for s in signs]
    return [
        {s: sign * size for s, sign, size in zip(signs, chosen, sizes, strict=True)}
        for chosen in product((1, -1), repeat=len(signs))
    ]


def resolved(expression: sp.Expr) -> sp.Expr:
    """Return `expression` with each Min and Max of two decided by the sign of the difference."""

    def chosen(least: bool, *args: sp.Expr) -> sp.Expr:
        function = sp.Min if least else sp.Max
        if len(args) != 2:
            return function(*args)
        difference = sp.factor(sp.together(args[0] - args[1]))
        if difference.is_nonnegative:
            return args[1] if least else args[0]
        if difference.is_nonpositive:
            return args[0] if least else args[1]
        return function(*args)

    found = sp.sympify(expression)
    found = found.replace(sp.Min, lambda *a: chosen(True, *a))
    return found.replace(sp.Max, lambda *a: chosen(False, *a))


def true(name: str, fact: object) -> Step:
    """Take a fact that was computed, such as a sign or a limit."""
    return Step(name, fact is True or fact is sp.true, sp.S.Zero, sp.S.One)


def above(right: sp.Expr, left: sp.Expr) -> bool:
    """Return whether a left-hand side exceeds its bound, where both are numbers."""
    return bool(sp.N(left - right, 30) > 0)


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
    violates = above if failed.relation == "<=" else None
    found = smallest_counterexample(
        failed.printed, failed.derived, fixed, f"the two sides of: {failed.name}", violates
    )
    return Verdict(
        DIFFERS, f"fails: {failed.name}. {note}".strip(), printed, derived, found, checks
    )


def refute(
    steps: Sequence[Step], note: str, printed: Form, derived: Form, found: Counterexample
) -> Verdict:
    """Return "differs" where `steps` hold and `found` really disagrees, "not-checkable" otherwise.

    An audit must not accuse wrongly: what is neither refuted nor proved is open.
    """
    failed = [s.name for s in steps if not s.holds]
    if failed or not found.disagrees():
        why = failed[0] if failed else "the two sides agree at its point"
        return unchecked(f"neither proved nor refuted: the refutation fails: {why}", printed)
    return Verdict(DIFFERS, note, printed, derived, found, tuple(s.name for s in steps))


def judge(
    refuting: Sequence[Step],
    found: Counterexample,
    proving: Sequence[Step],
    note: str,
    printed: Form,
    derived: Form,
) -> Verdict:
    """Return "proved" where `proving` holds, else what `refute` finds."""
    if all(s.holds for s in proving):
        names = tuple(s.name for s in proving)
        return Verdict(PROVED, "holds as written", printed, derived, None, names)
    return refute(refuting, note, printed, derived, found)


def repaired(
    found: Counterexample | None,
    repair: str,
    steps: Sequence[Step],
    note: str,
    printed: Form,
    derived: Form,
) -> Verdict:
    """Return "repaired" where `steps` hold with `repair` and fail without it, by `found`.

    Where nothing fails without it the verdict is "proved", where `steps` fail "differs".
    """
    verdict = decide(steps, note, printed, derived)
    if verdict.status != PROVED or found is None or not found.disagrees():
        return verdict
    return replace(verdict, status=REPAIRED, counterexample=found, repair=repair)


def unchecked(note: str, printed: Form, derived: Form = "") -> Verdict:
    """Return "not-checkable" with its reason."""
    return Verdict(NOT_CHECKABLE, note, printed, derived)
