"""Energies in the form they are evaluated in: as they were written, or better.

Expanding k (x - y)^2 makes terms of k x^2 that cancel each other's digits where x and y are close.
The equations of motion are derived from expanded energies all the same: what is derived does not
depend on the form, what is computed does.
"""

from __future__ import annotations

from collections.abc import Iterable

import sympy as sp
from pfaffian.derive.normal_form import trigonometric_sum


def grouped(expression: sp.Expr, moving: Iterable[sp.Symbol]) -> sp.Expr:
    """Return `expression` with each sum's terms of one product of parameters as a product.

    `moving` are the symbols that are no parameters. k x^2 - 2 k x y + k y^2 becomes k (x - y)^2,
    a dq^2 sin(q)^2 + a dq^2 cos(q)^2 becomes a dq^2, and (a s + b t) dq + b t dp becomes
    a s dq + b t (dq + dp). A sum without such terms stays as it was written.
    """
    own = frozenset(moving)
    if not expression.args:
        return expression
    arguments = [grouped(a, own) if isinstance(a, sp.Expr) else a for a in expression.args]
    rebuilt = expression.func(*arguments)
    return _grouped_sum(rebuilt, own) if rebuilt.is_Add else rebuilt


def _grouped_sum(total: sp.Add, moving: frozenset[sp.Symbol]) -> sp.Expr:
    """Group the terms of `total`, multiplied out one level where that makes them no more."""
    found = _collected(total.args, moving)
    opened = sp.Add(*(sp.expand_mul(term, deep=False) for term in total.args))
    if opened != total and opened.is_Add:
        other = _collected(opened.args, moving)
        if len(sp.Add.make_args(other)) <= len(sp.Add.make_args(found)):
            return other
    return found


def _collected(terms: Iterable[sp.Expr], moving: frozenset[sp.Symbol]) -> sp.Expr:
    groups: dict[sp.Expr, list[sp.Expr]] = {}
    for term in terms:
        number, rest = term.as_coeff_Mul()
        fixed, moved = rest.as_independent(*moving, as_Add=False)
        groups.setdefault(fixed, []).append(number * moved)
    return sp.Add(*(
        part
        for fixed, moved in groups.items()
        for part in sp.Add.make_args(_multiplied(fixed, sp.Add(*moved), moving))
    ))  # fmt: skip


def _multiplied(fixed: sp.Expr, value: sp.Expr, moving: frozenset[sp.Symbol]) -> sp.Expr:
    """Return `fixed` times `value` as one product where `value` is one, else term by term."""
    if value.is_Add and value.free_symbols <= moving:
        plain = trigonometric_sum(value)
        if not plain.atoms(sp.sin, sp.cos):
            value = plain
        factors = sp.factor(value)
        value = value if factors.is_Add else factors
    return sp.Add(*(fixed * term for term in sp.Add.make_args(value)))
