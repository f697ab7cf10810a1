"""Numbers with a decimal point in a specification: read as the exact numbers that were meant.

A float in an expression is rounded already, and rounds whatever it meets in SymPy. 0.5, 1.0 and
9.81 are fractions that a person wrote down; 0.3333333333333333 is what is left of one.
"""

from __future__ import annotations

from dataclasses import fields, replace
from fractions import Fraction
from typing import Any

import sympy as sp
from pfaffian.derive.spec.model_spec import Matrix, ModelSpec, ServoConstraint, StabilityCondition
from pfaffian.runtime.base.errors import InputError

#: Decimals of so many digits are read back from a double as they were written.
_MOST_DIGITS = 15
#: Fractions of up to this power of two are taken as they are: 1/3 is none of them.
_MOST_HALVINGS = 30


def exact_number(value: float) -> sp.Rational | None:
    """Return the short decimal or dyadic fraction that `value` is, if it is one."""
    text = repr(value)
    digits = text.lower().split("e")[0].replace("-", "").replace(".", "").strip("0")
    if len(digits) <= _MOST_DIGITS:
        return sp.Rational(text)
    halves = Fraction(value)
    if halves.denominator <= 2**_MOST_HALVINGS:
        return sp.Rational(halves.numerator, halves.denominator)
    return None


def exact_expression(value: Any, what: str, about: str) -> Any:
    """Return the expression or matrix `value` with its floats as the exact numbers they are.

    Raises `InputError` for a float that is none, saying that `what` holds it.
    """
    if not isinstance(value, sp.Basic | sp.MatrixBase):
        return value
    known = {}
    for number in value.atoms(sp.Float):
        exact = exact_number(float(number))
        if exact is None:
            raise InputError(
                f"{what} holds {float(number)!r}, which is no exact number",
                remedy=_remedy(float(number)),
                about=f"number:{float(number)!r} {about}",
            )
        known[number] = exact
    return value.xreplace(known) if known else value


def _remedy(value: float) -> str:
    simple = sp.nsimplify(value, [sp.pi], tolerance=1e-14, full=True)
    near = simple if len(str(simple)) <= 12 else None
    meant = f"write {_as_written(near)} where that is meant, or " if near is not None else ""
    return f"{meant}declare it as a parameter, or give a decimal of at most {_MOST_DIGITS} digits"


def _as_written(value: sp.Expr) -> str:
    if value.is_Rational:
        return f"sp.Rational({value.p}, {value.q})"
    return str(value).replace("pi", "sp.pi").replace("sqrt", "sp.sqrt")


def exact_spec(spec: ModelSpec) -> ModelSpec:
    """Return `spec` with every float in its expressions as an exact number."""

    def exact(value: Any, name: str) -> Any:
        return exact_expression(value, f"model {spec.name}: the {name.replace('_', ' ')}", name)

    constraint = {
        f.name: exact(getattr(spec.constraint, f.name), f.name) for f in fields(ServoConstraint)
    }
    constraint["setpoint"] = tuple(exact(v, "setpoint") for v in spec.constraint.setpoint)
    plain = ("kinetic_energy", "potential_energy", "input_matrix", "uncertain_force")
    return replace(
        spec,
        **{name: exact(getattr(spec, name), name) for name in plain},
        constraint=replace(
            spec.constraint,
            **{n: Matrix(v) if isinstance(v, sp.MatrixBase) else v for n, v in constraint.items()},
        ),
        lumping=tuple((s, exact(v, "lumping")) for s, v in spec.lumping),
        stability=tuple(
            StabilityCondition(c.text, exact(c.margin, "stability")) for c in spec.stability
        ),
    )
