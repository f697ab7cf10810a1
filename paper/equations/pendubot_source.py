"""The Pendubot paper beside the derivation: what the names of its formulas stand for.

Three readings of one text: *explicit*, with the derived matrices of the plant; *general*, with free
matrices of the same shapes, for identities of matrices; *scalar*, with A D B one number, for the
inequalities of the proof, where one constraint makes it so.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import sympy as sp
from pfaffian.derive.derivation.derive import Derivation
from pfaffian.derive.models.pendubot.spec import PARAMETERS
from pfaffian.derive.spec.model_spec import symbols_of
from pfaffian.paper.audit.notation import INTEGRAL, Operand, read
from pfaffian.paper.audit.paper import Paper

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
tau, beta, dbeta, bhat, mu, gamma, fhat, dahat = real("tau beta dbeta bhat mu gamma Fhat dahat")
p1, p2, p3, adb, estimate = real("p1 p2 p3 ADB ahat")
(rho,) = real("rho")
lower, alpha, regressor = positive("lambda_min alpha Pi")
#: The factor of (16) and (22), ahat Pi, of whatever sign.
(effort,) = real("effort")

#: A number with its unit.
_MEASURED = re.compile(r"^([-\d.]+) (.+)$")
SETPOINT = {P.q1d: sp.pi / 2, P.q2d: sp.S.Zero}
#: Simple values that make M positive definite and ADB nonzero at q2 = 0.
PLAIN = {P.theta1: sp.Integer(2), P.theta2: sp.S.One, P.theta3: sp.S.One}
#: A point of the singular set, with q2 = pi/3: ADB = 0 with M positive definite.
SINGULAR = {P.theta1: sp.Integer(5), P.theta2: sp.S.One, P.theta3: sp.Integer(2), P.lam: sp.S(2)}
e1, e2 = q1 - sp.pi / 2, q2

_MOTION = {
    "q1": q1,
    "q2": q2,
    "dq1": dq1,
    "dq2": dq2,
    "ddq1": ddq1,
    "ddq2": ddq2,
    "q10": q10,
    "q20": q20,
    "dq10": dq10,
    "dq20": dq20,
    "dq": sp.Matrix([dq1, dq2]),
    "ddq": sp.Matrix([ddq1, ddq2]),
    "e": sp.Matrix([e1, e2]),
}
_SCALARS = {
    "tau": tau,
    "p1": p1,
    "p2": p2,
    "p3": p3,
    "beta": beta,
    "dbeta": dbeta,
    "bhat": bhat,
    "mu": mu,
    "gamma": gamma,
    "ahat": estimate,
    "dahat": dahat,
    "alpha": alpha,
    "Pi": regressor,
    "lower": lower,
    "rho": rho,
}


def upright(expression: Any) -> Any:
    """Return `expression` with the setpoint of (4) put in."""
    return expression.subs(SETPOINT)


def rate(expression: sp.Expr) -> sp.Expr:
    """Return the time derivative by the chain rule; that of an integral is its integrand."""
    integrals = sorted(expression.atoms(INTEGRAL), key=sp.default_sort_key)
    names = {z: sp.Dummy(f"z{k}", real=True) for k, z in enumerate(integrals)}
    flat = expression.xreplace(names)
    rates = {q1: dq1, q2: dq2, dq1: ddq1, dq2: ddq2} | {d: z.args[0] for z, d in names.items()}
    moved = sum((flat.diff(x) * dx for x, dx in rates.items()), sp.S.Zero)
    return moved.xreplace({d: z for z, d in names.items()})


def at_start(expression: sp.Expr) -> sp.Expr:
    """Return `expression` at t = 0: initial values, integrals empty."""
    empty = dict.fromkeys(expression.atoms(INTEGRAL), sp.S.Zero)
    return expression.xreplace(empty).xreplace({q1: q10, q2: q20, dq1: dq10, dq2: dq20})


@dataclass(frozen=True)
class Case:
    """A source and the derivation that it is compared with."""

    paper: Paper
    derivation: Derivation

    def of(self, paper: Paper) -> Case:
        """Return the same derivation beside another text; what follows from it alone is kept."""
        other = Case(paper, self.derivation)
        vars(other).update({n: v for n, v in vars(self).items() if n in _DERIVED})
        return other

    def explicit(self, number: int, part: str, **given: Operand) -> Any:
        """Return a part of an equation with the derived matrices; `given` names come first."""
        return self.paper.form(number, part, {**self.names, **given})

    def general(self, number: int, part: str, **given: Operand) -> Any:
        """Return it with free matrices."""
        return self.paper.form(number, part, {**self.free_names, **given})

    def scalar(self, number: int, part: str, **given: Operand) -> Any:
        """Return it with numbers: ADB, beta, Fhat and ahat are real, alpha and Pi positive."""
        return self.paper.form(number, part, {**_parameters(), **_SCALARS, **_ONE, **given})

    @cached_property
    def names(self) -> Mapping[str, Operand]:
        """What the names of formulas stand for in the derivation, at the setpoint of (4)."""
        found = self.derivation
        split, dynamics = found.decomposition, found.dynamics
        return {
            **_parameters(),
            **_MOTION,
            **_SCALARS,
            "M": dynamics.mass_matrix,
            "C": dynamics.coriolis_matrix,
            "G": dynamics.gravity,
            "B": dynamics.input_matrix,
            "D": self.inverse,
            "A": found.constraint.jacobian,
            "b": upright(found.constraint.acceleration[0]),
            "F": split.force,
            "Fhat": split.matched,
            "dF": split.mismatched,
        }

    @cached_property
    def free_names(self) -> Mapping[str, Operand]:
        """The same names with free matrices; q'' is what (1) makes of them."""
        (d11, d12, d22, b0) = real("D11 D12 D22 b")
        drift, force, speed = (sp.Matrix(real(f"{n}1 {n}2")) for n in ("G", "F", "v"))
        inverse = sp.Matrix([[d11, d12], [d12, d22]])
        coriolis = sp.Matrix(2, 2, real("C11 C12 C21 C22"))
        row, column = sp.Matrix([real("A1 A2")]), sp.Matrix(real("B1 B2"))
        torque = p1 + p2 + p3
        moved = inverse * (column * torque - coriolis * speed - drift - force)
        return {
            **_parameters(),
            **_SCALARS,
            "A": row,
            "B": column,
            "C": coriolis,
            "D": inverse,
            "F": force,
            "G": drift,
            "M": inverse.adjugate() / inverse.det(),
            "b": b0,
            "dq": speed,
            "ddq": moved,
        }

    @cached_property
    def inverse(self) -> Any:
        """D = M^-1, derived."""
        mass = self.derivation.dynamics.mass_matrix
        return mass.adjugate() / mass.det()

    @cached_property
    def reach(self) -> tuple[sp.Matrix, sp.Expr]:
        """AD (1, 2) and ADB from the derived M, A and B."""
        ad = self.derivation.constraint.jacobian * self.inverse
        return ad, (ad * self.derivation.dynamics.input_matrix)[0]

    @cached_property
    def bias(self) -> sp.Matrix:
        """C q' + G, derived."""
        dynamics = self.derivation.dynamics
        return dynamics.coriolis_matrix * sp.Matrix([dq1, dq2]) + dynamics.gravity

    @cached_property
    def residual(self) -> sp.Expr:
        """s of (3), derived, at the setpoint."""
        return upright(self.derivation.constraint.residual[0])

    @cached_property
    def second_order(self) -> sp.Expr:
        """A q'' - b, derived."""
        constraint = self.derivation.constraint
        moved = constraint.jacobian * sp.Matrix([ddq1, ddq2]) - constraint.acceleration
        return upright(moved[0])

    def following(self) -> sp.Expr:
        """Return A q' - c with c of (7) as printed."""
        return self.explicit(8, "first", c=self.explicit(7, "c"))

    def law(self, name: str) -> sp.Expr:
        """Return the definition of `name` in the derived continuous law, setpoint put in."""
        definitions = self.derivation.block("continuous").definitions
        found = next(d.expression for d in definitions if d.symbol.name == name)
        return upright(found)

    def law_expanded(self, name: str) -> sp.Expr:
        """Return `name` of the derived continuous law in its inputs alone, setpoint put in."""
        block = self.derivation.block("continuous")
        symbol = next(d.symbol for d in block.definitions if d.symbol.name == name)
        return upright(block.expanded(symbol))

    def in_terms(self, name: str, **given: sp.Expr) -> sp.Expr:
        """Return the law's definition of `name` with its symbols replaced by `given`."""
        found = self.law(name)
        return found.xreplace({s: given[s.name] for s in found.free_symbols if s.name in given})

    @cached_property
    def layer(self) -> sp.Expr:
        """Return gamma of the derived law, -p3/(mu ahat Pi), in `mu`."""
        found = self.in_terms("p3", mu=mu, effort=effort)
        return -found / (mu * effort)

    def value(self, where: str, name: str, **names: Operand) -> Any:
        """Return a value that the text prints, without its unit."""
        text = self.paper.said[where][name]
        return read(_MEASURED.sub(r"\1", text), names)

    def unit(self, where: str, name: str) -> str:
        """Return the unit that the text prints with a value."""
        return _MEASURED.sub(r"\2", self.paper.said[where][name])

    @cached_property
    def plant(self) -> Mapping[sp.Symbol, sp.Expr]:
        """theta1 ... theta5 and g of section 5, exact, from what is printed there."""
        where = "plant of section 5"
        physical = {n: self.value(where, n) for n in self.paper.said[where]}
        lumped = {
            getattr(P, f"theta{k}"): self.paper.form(1, f"theta{k}", physical) for k in range(1, 6)
        }
        return lumped | {P.g: physical["g"]}

    @cached_property
    def gains(self) -> Mapping[sp.Symbol, sp.Expr]:
        """lam, lam1 and lam2 of section 5.1, exact."""
        where = "gains of section 5.1"
        return {getattr(P, n): self.value(where, n) for n in self.paper.said[where]}


#: What a `Case` holds that does not depend on its text.
_DERIVED = frozenset(
    ("names", "free_names", "inverse", "reach", "bias", "residual", "second_order", "layer")
)


def _parameters() -> Mapping[str, Operand]:
    return dict(vars(P))


#: The scalar reading: A carries ADB, D and B are 1.
_ONE: Mapping[str, Operand] = {
    "A": adb,
    "D": sp.S.One,
    "B": sp.S.One,
    "Fhat": fhat,
    "bhat": adb * beta,
}
