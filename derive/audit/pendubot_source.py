"""The Pendubot paper's equations as printed, in SymPy, and the derivation at its setpoint.

Symbols of the plant and the gains are those of the model; the others are defined here. J1, J2 and
Ja stand for the integrals of (6): of q1 - pi/2, of q2 and of the arctan.
"""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.derivation import Derivation
from pfaffian.derive.models.pendubot.spec import PARAMETERS
from pfaffian.derive.spec import symbols_of

P = symbols_of(PARAMETERS)
HALF = sp.Rational(1, 2)


def real(names: str) -> tuple[sp.Symbol, ...]:
    """Return real symbols."""
    return tuple(sp.symbols(names, real=True, seq=True))


def positive(names: str) -> tuple[sp.Symbol, ...]:
    """Return positive symbols."""
    return tuple(sp.symbols(names, positive=True, seq=True))


def nonnegative(names: str) -> tuple[sp.Symbol, ...]:
    """Return nonnegative symbols."""
    return tuple(sp.symbols(names, nonnegative=True, seq=True))


q1, q2, dq1, dq2, ddq1, ddq2 = real("q1 q2 dq1 dq2 ddq1 ddq2")
q10, q20, dq10, dq20 = real("q10 q20 dq10 dq20")
J1, J2, Ja = real("J1 J2 Ja")
f1, f2, tau = real("f1 f2 tau")
#: Scalars of the Lyapunov proof: ADB, beta, Fhat; the rest is positive by definition.
adb, beta, fhat = real("ADB beta Fhat")
lower, alpha, regressor = positive("lambda_min alpha Pi")
(estimate,) = positive("ahat")

SETPOINT = {P.q1d: sp.pi / 2, P.q2d: sp.S.Zero}
#: Simple values that make M positive definite and ADB nonzero at q2 = 0.
PLAIN = {P.theta1: sp.Integer(2), P.theta2: sp.S.One, P.theta3: sp.S.One}

e1, e2 = q1 - sp.pi / 2, q2
ARC = sp.atan(P.lam * dq1 + P.lam * P.lam1 * e1 + dq2 + P.lam2 * q2)
DET = P.theta1 * P.theta2 - P.theta3**2 * sp.cos(q2) ** 2

MASS = sp.Matrix(
    [
        [P.theta1 + P.theta2 + 2 * P.theta3 * sp.cos(q2), P.theta2 + P.theta3 * sp.cos(q2)],
        [P.theta2 + P.theta3 * sp.cos(q2), P.theta2],
    ]
)
CORIOLIS = sp.Matrix([[-P.theta3 * dq2, -P.theta3 * (dq2 + dq1)], [P.theta3 * dq1, 0]]) * sp.sin(q2)
_FAR = P.theta5 * P.g * sp.cos(q1 + q2)
GRAVITY = sp.Matrix([P.theta4 * P.g * sp.cos(q1) + _FAR, _FAR])
INPUT = sp.Matrix([1, 0])

RESIDUAL = P.lam * (dq1 + P.lam1 * e1) + (dq2 + P.lam2 * e2)  # (3)
_S_OF_5 = P.lam * dq1 + P.lam * P.lam1 * e1 + dq2 + P.lam2 * q2
SECOND_ORDER = (  # (5), left minus right
    P.lam * ddq1
    + P.lam * P.lam1 * dq1
    + ddq2
    + P.lam2 * dq2
    + P.sigma * _S_OF_5
    + 2 * P.eta / sp.pi * ARC
)
INTEGRAL = (  # (6), left minus right
    P.lam * (dq1 - dq10)
    + P.lam * P.lam1 * (q1 - q10)
    + (dq2 - dq20)
    + P.lam2 * (q2 - q20)
    + P.sigma * P.lam * (q1 - q10)
    + P.sigma * P.lam * P.lam1 * J1
    + P.sigma * (q2 - q20)
    + P.sigma * P.lam2 * J2
    + 2 * P.eta / sp.pi * Ja
)
ROW = sp.Matrix([[P.lam, 1]])  # A
RIGHT = (  # b
    -P.lam * P.lam1 * dq1 - P.lam2 * dq2 - P.sigma * _S_OF_5 - 2 * P.eta / sp.pi * ARC
)
FIRST_INTEGRAL = (  # c
    P.lam * dq10
    - P.lam * P.lam1 * (q1 - q10)
    + dq20
    - P.lam2 * (q2 - q20)
    - P.sigma * P.lam * (q1 - q10)
    - P.sigma * (q2 - q20)
    - P.sigma * P.lam * P.lam1 * J1
    - P.sigma * P.lam2 * J2
    - 2 * P.eta / sp.pi * Ja
)
INPUT_GAIN = P.lam * P.theta2 / DET  # (10)
REGRESSOR = (sp.sqrt(dq1**2 + dq2**2) + 1) ** 2 + (sp.sqrt(e1**2 + e2**2) + 1) ** 2  # (47)
GAIN_IN_48 = P.theta2 / DET


def friction(rate: sp.Symbol) -> sp.Expr:
    """Return the friction torque printed in sections 5.2 and 5.3."""
    return (
        sp.Rational("4.18")
        * (sp.tanh(sp.Rational("1.59") * rate) - sp.tanh(sp.Rational("3.15") * rate))
        + sp.Rational("0.09") * sp.tanh(sp.Rational("3.52") * rate)
        + sp.Rational("0.021") * rate
    )


def upright(expression: sp.Basic) -> sp.Basic:
    """Return `expression` with the setpoint of (4) put in."""
    return expression.subs(SETPOINT)


def rate(expression: sp.Expr) -> sp.Expr:
    """Return the time derivative by the chain rule, J1, J2 and Ja included."""
    rates = {q1: dq1, q2: dq2, dq1: ddq1, dq2: ddq2, J1: e1, J2: q2, Ja: ARC}
    return sum((expression.diff(x) * dx for x, dx in rates.items()), sp.S.Zero)


def nominal_gain(derivation: Derivation) -> tuple[sp.Matrix, sp.Expr]:
    """Return AD (1, 2) and ADB from the derived M, A and B."""
    mass = derivation.dynamics.mass_matrix
    ad = derivation.constraint.jacobian * mass.adjugate() / mass.det()
    return ad, (ad * derivation.dynamics.input_matrix)[0]


def bias(derivation: Derivation) -> sp.Matrix:
    """Return C q' + G, derived."""
    dynamics = derivation.dynamics
    return dynamics.coriolis_matrix * sp.Matrix([dq1, dq2]) + dynamics.gravity


def law(derivation: Derivation, name: str) -> sp.Expr:
    """Return the definition of `name` in the derived continuous law, setpoint put in."""
    definitions = derivation.block("continuous").definitions
    found = next(d.expression for d in definitions if d.symbol.name == name)
    return upright(found)


def law_expanded(derivation: Derivation, name: str) -> sp.Expr:
    """Return `name` of the derived continuous law in its inputs alone, setpoint put in."""
    block = derivation.block("continuous")
    symbol = next(d.symbol for d in block.definitions if d.symbol.name == name)
    return upright(block.expanded(symbol))
