"""Lagrangian dynamics M q'' + C q' + G + F = B tau from kinetic and potential energy, (1)."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp
from pfaffian.derive.mechanics.dynamics import SMALL, Dynamics
from pfaffian.derive.spec.model_spec import Matrix, ModelSpec
from pfaffian.derive.symbolic.forms import grouped, splits_up
from pfaffian.derive.symbolic.normal_form import trigonometric_sum
from pfaffian.runtime.base.errors import InputError


def lagrangian_dynamics(spec: ModelSpec) -> Dynamics:
    """Derive the dynamics of `spec`, in its lumped parameters where it has any.

    C is in Christoffel form, so that M' - 2 C is skew-symmetric. Raises `InputError` where T is
    not a quadratic form of the velocities, or the lumped parameters do not span the dynamics.
    """
    q, dq = sp.Matrix(spec.positions), sp.Matrix(spec.velocities)
    kinetic = _lumped(_summed(spec.kinetic_energy, spec.positions), spec, "kinetic energy")
    potential = _lumped(_summed(spec.potential_energy, spec.positions), spec, "potential energy")
    mass = mass_matrix(kinetic, spec.velocities, f"model {spec.name}")
    check_mass_matrix(spec, mass)
    gravity = sp.Matrix([potential]).jacobian(q).T.applyfunc(lambda g: grouped(g, spec.positions))
    forms = [
        grouped(expanded if spec.lumping else written, (*spec.positions, *spec.velocities))
        for expanded, written in (
            (kinetic, spec.kinetic_energy),
            (potential, spec.potential_energy),
        )
    ]
    coriolis = christoffel_matrix(mass, q, dq)
    force = (
        (coriolis * dq).applyfunc(lambda c: sp.factor(c) if splits_up(c, spec.positions) else c)
        if len(q) <= SMALL
        else velocity_forces(mass, list(q), list(dq))
    )
    return Dynamics(
        mass_matrix=Matrix(mass),
        coriolis_matrix=Matrix(coriolis),
        coriolis_force=Matrix(force),
        gravity=Matrix(gravity),
        input_matrix=Matrix(spec.input_matrix),
        uncertain_force=Matrix(spec.uncertain_force),
        kinetic_energy=kinetic,
        potential_energy=potential,
        kinetic_form=forms[0],
        potential_form=forms[1],
    )


def _summed(energy: sp.Expr, positions: Sequence[sp.Symbol]) -> sp.Expr:
    """Return `energy` as a sum over multiple angles, roots and quotients as they were written."""
    terms = sp.Add.make_args(energy)
    kept = [term for term in terms if not splits_up(term, positions)]
    return sp.Add(trigonometric_sum(sp.Add(*(t for t in terms if t not in kept))), *kept)


def mass_matrix(kinetic: sp.Expr, rates: Sequence[sp.Symbol], where: str) -> sp.Matrix:
    """Return M (n, n) of T = q'^T M q'/2; raise `InputError` where T is not such a form.

    What of T is no polynomial in coordinates, sines and cosines is differentiated as it stands.
    """
    n, moving = len(rates), kinetic.free_symbols
    terms = sp.Add.make_args(kinetic)
    kept = sp.Add(*(term for term in terms if not splits_up(term, moving)))
    mass = sp.hessian(kept, rates) if kept != 0 else sp.zeros(n, n)
    form = sp.Matrix(rates).T * mass * sp.Matrix(rates) / 2
    if mass.free_symbols & {*rates} or sp.expand(form[0] - kept) != 0:
        raise _not_quadratic(where)
    try:
        polynomial = sp.Poly(kinetic - kept, *rates).terms() if kinetic != kept else []
    except sp.PolynomialError as error:
        raise _not_quadratic(where) from error
    for powers, coefficient in polynomial:
        used = [k for k, power in enumerate(powers) for _ in range(power)]
        if len(used) != 2:
            raise _not_quadratic(where)
        i, j = used
        entry = sp.factor_terms(2 * coefficient if i == j else coefficient)
        mass[i, j] = mass[j, i] = mass[i, j] + entry
    return mass


def _not_quadratic(where: str) -> InputError:
    return InputError(
        f"{where}: the kinetic energy is not a quadratic form of the velocities",
        remedy="write T as a sum of m v^2/2 and I w^2/2 terms",
        about="kinetic_energy",
    )


def velocity_forces(mass: sp.Matrix, q: Sequence[sp.Symbol], dq: Sequence[sp.Symbol]) -> sp.Matrix:
    """Return C(q, q') q' (n, 1) without forming C: (d_k M_ij - d_i M_jk / 2) q'_j q'_k summed."""
    n = len(q)
    slope = [[[mass[i, j].diff(q[k]) for k in range(n)] for j in range(n)] for i in range(n)]

    def row(i: int) -> sp.Expr:
        return sp.Add(*(
            (slope[i][j][k] - slope[j][k][i] / 2) * dq[j] * dq[k]
            for j in range(n) for k in range(n)
        ))  # fmt: skip

    return sp.Matrix(n, 1, lambda i, _: sp.expand_mul(row(i), deep=False))


def christoffel_matrix(mass: sp.Matrix, q: sp.Matrix, dq: sp.Matrix) -> sp.Matrix:
    """Return C(q, q') (n, n): C_ij = sum_k (d_k M_ij + d_j M_ik - d_i M_jk) q'_k / 2."""
    n = len(q)

    def entry(i: int, j: int) -> sp.Expr:
        return sp.factor_terms(
            sum(
                (mass[i, j].diff(q[k]) + mass[i, k].diff(q[j]) - mass[j, k].diff(q[i])) * dq[k] / 2
                for k in range(n)
            )
        )

    return sp.Matrix(n, n, entry)


def _lumped(energy: sp.Expr, spec: ModelSpec, what: str) -> sp.Expr:
    """Rewrite `energy` in the lumped parameters by solving their relations."""
    if not spec.lumping:
        return energy
    relations = [combination - symbol for symbol, combination in spec.lumping]
    solved = sp.solve(relations, list(spec.eliminated), dict=True)
    if len(solved) != 1:
        raise InputError(
            f"model {spec.name}: the lumping relations do not determine "
            f"{', '.join(s.name for s in spec.eliminated)}",
            remedy="give one relation for each eliminated symbol",
        )
    rewritten = sp.collect(
        sp.expand(sp.cancel(sp.expand(energy.subs(solved[0])))),
        [symbol for symbol, _ in spec.lumping],
    )
    physical = {p.name for p in spec.parameters_in("physical")}
    left = sorted(s.name for s in rewritten.free_symbols if s.name in physical)
    if left:
        raise InputError(
            f"model {spec.name}: the {what} still depends on {', '.join(left)} after lumping",
            remedy="add a lumped parameter for the missing combination",
        )
    return rewritten


def check_mass_matrix(spec: ModelSpec, mass: sp.Matrix) -> None:
    """Raise `InputError` where M is singular at a point with nothing special about it.

    The point has rational coordinates, so that the determinant is exact but for sines and cosines.
    """
    symbols = sorted(mass.free_symbols, key=lambda s: s.name)
    point = {s: sp.Rational(sp.prime(k + 5), sp.prime(k + 6)) for k, s in enumerate(symbols)}
    numbers = mass.subs(point).evalf(40)
    scale = sp.Mul(*[max(abs(x) for x in numbers[i, :]) for i in range(mass.rows)])
    if abs(numbers.det()) <= scale * sp.Float("1e-25"):
        raise InputError(
            f"model {spec.name}: M is singular: the kinetic energy does not hold all velocities "
            f"apart",
            remedy="leave out a coordinate that follows from the others, or add its inertia",
            about="kinetic_energy",
        )
