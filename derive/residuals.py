"""Constraints of any order as residuals of first order: differentiated for the person who writes.

A holonomic constraint phi(q, t) = 0 is differentiated once, a second-order one psi(q, q', q'', t)
is integrated once: both become s(q, q', t) with s' + drift = 0, the one form the law is derived
from.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp
from pfaffian.derive.spec import TIME, Coordinate
from pfaffian.runtime.errors import InputError


def time_derivative(value: sp.Expr, coordinates: Sequence[Coordinate]) -> sp.Expr:
    """Return d/dt of `value`(q, t): (d value/dq) q' + d value/dt."""
    moved = (value.diff(c.position) * c.velocity for c in coordinates)
    return sp.Add(*moved) + value.diff(TIME)


def holonomic(phi: sp.Expr, rate: sp.Expr, coordinates: Sequence[Coordinate]) -> sp.Expr:
    """Return s = phi' + `rate` phi, so that s = 0 takes phi(q, t) to zero at `rate` in 1/s.

    Raises `InputError` where phi depends on velocities: then it is no holonomic constraint.
    """
    moving = [c.velocity.name for c in coordinates if c.velocity in phi.free_symbols]
    if moving:
        raise InputError(
            f"a holonomic constraint depends on the velocity {moving[0]}",
            remedy="give it as a first-order constraint, s(q, q', t) = 0",
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
    scaled = {v: share * v for v in rates}
    path = sp.Add(*(a.subs(scaled, simultaneous=True) * v for a, v in zip(row, rates, strict=True)))
    found = sp.integrate(sp.expand(path), (share, 0, 1))
    if found.has(sp.Integral):
        raise InputError(
            "the coefficients of a second-order constraint cannot be integrated in closed form",
            remedy="give the first-order constraint s(q, q', t) itself",
        )
    return sp.expand(found)
