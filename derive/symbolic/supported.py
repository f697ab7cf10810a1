"""Which functions energies, servo-constraints and forces may hold, and how to write what has none.

Lowering can compute these, and whatever their derivatives bring with them. The check needs no
CasADi, so that a specification is judged as soon as it is read.
"""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.symbolic.functions import side
from pfaffian.runtime.base.errors import InputError
from sympy.codegen.cfunctions import expm1
from sympy.core.function import AppliedUndef

#: Functions of one argument that the target has.
EMITTED = (
    *(sp.sin, sp.cos, sp.atan, sp.tanh, sp.exp, expm1, sp.Abs, sp.sign, side),
    *(sp.log, sp.asin, sp.acos, sp.sinh, sp.cosh),
)
#: Functions that are written in those.
WRITTEN_OUT = (
    *(sp.tan, sp.cot, sp.sec, sp.csc, sp.acot, sp.atan2, sp.coth, sp.sech, sp.csch, sp.sinc),
    *(sp.Max, sp.Min, sp.Piecewise, sp.Heaviside, sp.DiracDelta),
)
#: All of them, as a person writes them.
FUNCTIONS = (
    "sqrt, Abs, sign, Max, Min, Piecewise, Heaviside, sin, cos, tan, cot, sec, csc, asin, acos, "
    "atan, acot, atan2, sinh, cosh, tanh, coth, sech, csch, sinc, exp, log"
)
_POWERS = "powers with exponents of whole numbers, halves, quarters, eighths, ..."
_REMEDIES = {
    "asinh": "log(x + sqrt(x**2 + 1)), for x >= 0",
    "acosh": "log(x + sqrt(x - 1)*sqrt(x + 1))",
    "atanh": "log((1 + x)/(1 - x))/2",
    "acoth": "log((x + 1)/(x - 1))/2",
    "asec": "acos(1/x)",
    "acsc": "asin(1/x)",
}


def remedy_for(part: sp.Basic) -> str:
    """Return what to write in place of `part`, which has no lowering."""
    other = _REMEDIES.get(type(part).__name__)
    if other:
        return f"write {other} for it"
    if isinstance(part, sp.Piecewise):
        return "end it with a branch for all the rest: (value, True)"
    if part.is_Pow:
        return (
            f"write it with {_POWERS}; for a positive base b**x is exp(x*log(b)), with the "
            "rounding errors of both"
        )
    return f"write it in sums, products, {_POWERS}, and {FUNCTIONS}"


def is_dyadic(exponent: sp.Expr) -> bool:
    """Return whether an exponent is a whole number of halves, quarters, eighths and so on."""
    return bool(exponent.is_Rational) and exponent.q & (exponent.q - 1) == 0


def first_unsupported(expression: sp.Basic) -> sp.Basic | None:
    """Return the outermost part of `expression` that cannot be computed, the first in its order.

    Functions that nobody defined are left to the check of symbols.
    """
    for part in sp.preorder_traversal(expression):
        if part.is_Pow:
            known = is_dyadic(part.exp) or part.is_number or part.base == sp.E
        elif isinstance(part, sp.Piecewise):
            known = part.args[-1].cond == sp.true
        elif isinstance(part, sp.Function) and not isinstance(part, AppliedUndef):
            known = isinstance(part, EMITTED + WRITTEN_OUT)
        else:
            known = True
        if not known:
            return part
    return None


def check_supported(value: sp.Basic, what: str, about: str = "") -> None:
    """Raise `InputError` naming `what` where `value` holds a function without a lowering."""
    part = first_unsupported(value)
    if part is None:
        return
    text = str(part)
    shown = text if len(text) < 80 else text[:77] + "..."
    raise InputError(
        f"{what} contains {shown}, which has no lowering",
        remedy=remedy_for(part),
        about=about,
    )
