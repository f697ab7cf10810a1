"""Zero dynamics: what moves while s = 0, linearised at the setpoint; and gains from its poles."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.constraint import Constraint
from pfaffian.derive.lagrange import Dynamics
from pfaffian.derive.linearisation import linearise
from pfaffian.derive.spec import Matrix, ModelSpec, symbol_of
from pfaffian.runtime.errors import InputError

POLE = sp.Symbol("p")


@dataclass(frozen=True)
class ZeroDynamics:
    """Coefficients of the characteristic polynomial (highest first) and the gains it determines.

    `wanted` are the symbols c_(k-1) ... c_0 of a monic polynomial, `gains` the synthesised gains
    in terms of them.
    """

    coefficients: tuple[sp.Expr, ...]
    wanted: tuple[sp.Symbol, ...]
    gains: tuple[tuple[sp.Symbol, sp.Expr], ...]


def zero_dynamics(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> ZeroDynamics:
    """Linearise the zero dynamics of s at the setpoint and solve for the gains.

    The zeros of the output s are the roots p of det [[M p^2 + D p + K, -B], [S1 p + S0, 0]], with
    K = dG/dq, D = dF/dq' and S1, S0 = ds/dq', ds/dq at the setpoint at rest.
    """
    linear = linearise(spec, dynamics, constraint)
    plant = linear.mass * POLE**2 + linear.damping * POLE + linear.stiffness
    row = linear.rate_row * POLE + linear.position_row
    m = len(spec.actuators)
    pencil = sp.Matrix(
        sp.BlockMatrix([[Matrix(plant), -linear.input], [Matrix(row), sp.zeros(m, m)]])
    )
    polynomial = sp.Poly(sp.expand(pencil.det()), POLE)
    if polynomial.is_zero:
        raise InputError(
            f"model {spec.name}: ADB is identically zero, the actuators do not move s",
            remedy="choose a servo-constraint that the actuators reach",
        )
    coefficients = tuple(sp.factor(c) for c in polynomial.all_coeffs())
    wanted = tuple(sp.Symbol(f"c{k}", real=True) for k in reversed(range(len(coefficients) - 1)))
    return ZeroDynamics(coefficients, wanted, _synthesise(spec, coefficients, wanted))


def _synthesise(
    spec: ModelSpec, coefficients: tuple[sp.Expr, ...], wanted: tuple[sp.Symbol, ...]
) -> tuple[tuple[sp.Symbol, sp.Expr], ...]:
    """Solve for the gains that give the wanted polynomial on the frictionless plant."""
    gains = [symbol_of(p) for p in spec.parameters_in("synthesised")]
    if len(spec.actuators) > 1:
        return ()  # one polynomial does not determine the gains of several constraints
    still = {symbol_of(p): 0 for p in spec.parameters_in("uncertainty")}
    lead = coefficients[0].subs(still)
    equations = [c.subs(still) - lead * w for c, w in zip(coefficients[1:], wanted, strict=True)]
    solutions = sp.solve(equations, gains, dict=True) if gains else []
    if len(solutions) != 1:
        return ()
    return tuple((gain, sp.factor(solutions[0][gain])) for gain in gains)
