"""Sums in the form they are evaluated in: as they were written, or better.

Expanding k (x - y)^2 makes terms of k x^2 that cancel each other's digits where x and y are close,
and so does a (1 - cos 2q) for 2 a sin(q)^2 where q is small. The equations of motion are derived
from expanded energies all the same: what is derived does not depend on the form, what is computed
does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import sympy as sp
from pfaffian.derive.symbolic.normal_form import trigonometric_sum


def splits_up(expression: sp.Expr, moving: Iterable[sp.Symbol]) -> bool:
    """Return whether `expression` is a polynomial in the symbols `moving` and their sines, cosines.

    Others, with a root or a quotient of what moves, are left as they were written: multiplied out
    and brought over one denominator their terms are many, and cancel.
    """
    own = set(moving)
    for part in expression.atoms(sp.Pow, sp.Function):
        if part.free_symbols.isdisjoint(own) or isinstance(part, sp.sin | sp.cos):
            continue
        if not (part.is_Pow and part.exp.is_Integer and part.exp.is_positive):
            return False
    return True


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
            found = other
    return _gathered(found, moving)


def _gathered(total: sp.Expr, moving: frozenset[sp.Symbol]) -> sp.Expr:
    """Return a x + b x as (a + b) x where a and b are products of positive parameters.

    Their sum loses no digits, and is computed once from the parameters.
    """
    shares: dict[sp.Expr, list[sp.Expr]] = {}
    for term in sp.Add.make_args(total):
        fixed, moved = term.as_independent(*moving, as_Add=False)
        key = moved if fixed.is_positive and moved != 1 else term
        shares.setdefault(key, []).append(term / key)
    return sp.Add(*(sp.Add(*parts) * key for key, parts in shares.items()))


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
        products = (p for p in map(sp.factor, _same(value)) if not p.is_Add)
        value = next((p for p in products if _is_short(p)), value)
    return sp.Add(*(fixed * term for term in sp.Add.make_args(value)))


def _same(value: sp.Expr) -> Iterator[sp.Expr]:
    """Yield `value` in other forms: as it is, its angles added up, in sines or cosines alone."""
    yield value
    if not value.atoms(sp.sin, sp.cos):
        return
    plain = trigonometric_sum(value)
    if not plain.atoms(sp.sin, sp.cos):
        yield plain
    single = value.replace(_is_double(sp.cos), _cosine_of_double)
    for kept, gone in ((sp.sin, sp.cos), (sp.cos, sp.sin)):
        yield sp.expand(single.replace(_is_square(gone), _square_by(kept)))


def _is_short(product: sp.Expr) -> bool:
    """Return whether no factor of `product` is a sum with a sine or cosine in it."""
    bases = (factor.as_base_exp()[0] for factor in sp.Mul.make_args(product))
    return not any(base.is_Add and base.atoms(sp.sin, sp.cos) for base in bases)


def _is_double(function: type[sp.Function]) -> Callable[[sp.Basic], bool]:
    return lambda e: isinstance(e, function) and e.args[0].as_coeff_Mul()[0] == 2


def _cosine_of_double(cosine: sp.cos) -> sp.Expr:
    half = cosine.args[0] / 2
    return sp.cos(half) ** 2 - sp.sin(half) ** 2


def _is_square(function: type[sp.Function]) -> Callable[[sp.Basic], bool]:
    return lambda e: e.is_Pow and isinstance(e.base, function) and e.exp == 2


def _square_by(kept: type[sp.Function]) -> Callable[[sp.Pow], sp.Expr]:
    return lambda square: 1 - kept(square.base.args[0]) ** 2
