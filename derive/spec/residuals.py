"""Constraints of any order as residuals of first order: differentiated for the person who writes.

A holonomic constraint phi(q, t) = 0 is differentiated once, a second-order one psi(q, q', q'', t)
is integrated once: both become s(q, q', t) with s' + drift = 0, the one form the law is derived
from.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp
from pfaffian.derive.spec.model_spec import TIME, Coordinate
from pfaffian.runtime.base.errors import InputError

#: What an integral that the generated code could not compute, or that diverges, contains.
_NO_CLOSED_FORM = (sp.Integral, sp.Piecewise, sp.erf, sp.erfi, sp.I, sp.oo, sp.zoo, sp.nan)


def time_derivative(value: sp.Expr, coordinates: Sequence[Coordinate]) -> sp.Expr:
    """Return d/dt of `value`(q, t): (d value/dq) q' + d value/dt."""
    moved = (value.diff(c.position) * c.velocity for c in coordinates)
    return sp.Add(*moved) + value.diff(TIME)


def holonomic(phi: sp.Expr, rate: sp.Expr, coordinates: Sequence[Coordinate]) -> sp.Expr:
    """Return s = phi' + `rate` phi, so that s = 0 takes phi(q, t) to zero at `rate` in 1/s.

    Raises `InputError` where phi depends on velocities or accelerations: then it is no holonomic
    constraint.
    """
    for c in coordinates:
        for symbol, what, order in (
            (c.velocity, "velocity", "first-order constraint, s(q, q', t) = 0"),
            (c.acceleration, "acceleration", "second-order constraint, A q'' - b = 0"),
        ):
            if symbol in phi.free_symbols:
                raise InputError(
                    f"a holonomic constraint depends on the {what} {symbol.name}",
                    remedy=f"give it as a {order}",
                )
    return time_derivative(phi, coordinates) + rate * phi


def second_order(psi: sp.Expr, coordinates: Sequence[Coordinate]) -> tuple[sp.Expr, sp.Expr]:
    """Return (s, drift) with s' + drift = psi, for psi = A(q, q', t) q'' - b(q, q', t).

    s is the integral of A over the velocities, A q' where A does not depend on them. Raises
    `InputError` where psi is not affine in the accelerations or A is no gradient in q'.
    """
    rates = [c.velocity for c in coordinates]
    row = [sp.expand(psi).diff(c.acceleration) for c in coordinates]
    faster = [c for c in coordinates if any(c.acceleration in e.free_symbols for e in row)]
    if faster:
        raise InputError(
            f"a second-order constraint is not affine in the acceleration of {faster[0].name}",
            remedy="write it as A(q, q', t) q'' - b(q, q', t)",
        )
    still = psi.subs({c.acceleration: 0 for c in coordinates})
    residual = _integrated(row, rates)
    own = sp.Add(*(residual.diff(c.position) * c.velocity for c in coordinates))
    return residual, sp.expand(still - own - residual.diff(TIME))


def _integrated(row: Sequence[sp.Expr], rates: Sequence[sp.Symbol]) -> sp.Expr:
    """Return s with ds/dq' = `row`, from s = 0 at rest."""
    for i, left in enumerate(rates):
        for j, right in enumerate(rates[:i]):
            if sp.simplify(row[i].diff(right) - row[j].diff(left)) != 0:
                raise InputError(
                    f"no s(q, q', t) has this second-order constraint as its rate: the "
                    f"coefficients of the accelerations of {left.name[1:]} and {right.name[1:]} "
                    "are no gradient in the velocities",
                    remedy="multiply the constraint by an integrating factor, or let A depend on "
                    "q and time only",
                )
    if not any(entry.has(*rates) for entry in row):
        return sp.Add(*(a * v for a, v in zip(row, rates, strict=True)))
    share = sp.Dummy("share", positive=True)
    # Rates that are not zero spare SymPy a case for zero, where s is continued.
    moving = {v: sp.Dummy(v.name, real=True, nonzero=True) for v in rates}
    scaled = {v: share * moving[v] for v in rates}
    path = sp.Add(
        *(a.subs(scaled, simultaneous=True) * moving[v] for a, v in zip(row, rates, strict=True))
    )
    found = sp.expand(sp.integrate(sp.expand(path), (share, 0, 1)))
    found = found.xreplace({held: v for v, held in moving.items()})
    if found.has(*_NO_CLOSED_FORM) or not _has_gradient(found, row, rates):
        raise InputError(
            "the coefficients of a second-order constraint cannot be integrated over the "
            "velocities in closed form, from rest",
            remedy="give the first-order constraint s(q, q', t) itself",
        )
    return found


def _has_gradient(found: sp.Expr, row: Sequence[sp.Expr], rates: Sequence[sp.Symbol]) -> bool:
    """Return whether ds/dq' is `row` at a point with nothing special about it.

    An integral from rest need not exist, and what SymPy finds for one is worth a second look.
    """
    symbols = sorted(
        found.free_symbols.union(*(a.free_symbols for a in row)), key=lambda s: str(s.name)
    )
    point = {s: sp.Rational(sp.prime(k + 5), sp.prime(k + 6)) for k, s in enumerate(symbols)}
    return all(
        abs((found.diff(v) - a).subs(point).evalf(30)) < sp.Float("1e-20")
        for a, v in zip(row, rates, strict=True)
    )
