"""Normal forms in which equality is decided, not guessed: no heuristic simplification."""

from __future__ import annotations

import sympy as sp
from sympy.simplify.fu import TR8


def trigonometric_sum(expression: sp.Expr) -> sp.Expr:
    """Rewrite products of sines and cosines as sums over multiple angles, and collect.

    In this form cos(q1) cos(q1 + q2) + sin(q1) sin(q1 + q2) is cos(q2).
    """
    return sp.expand(TR8(sp.expand(expression)))


def zero_residual(expression: sp.Expr) -> sp.Expr:
    """Return 0 if `expression` is identically zero, else its reduced numerator.

    Rational in the parameters and polynomial in sines and cosines: the numerator is expanded over
    sin and cos of the single angles and reduced modulo sin^2 + cos^2 = 1, which is canonical.
    """
    numerator = sp.fraction(sp.together(expression))[0]
    expanded = sp.expand(sp.expand_trig(sp.expand(numerator)))
    angles = sorted({f.args[0] for f in expanded.atoms(sp.sin, sp.cos)}, key=sp.default_sort_key)
    for index, angle in enumerate(angles):
        sine, cosine = sp.Dummy(f"s{index}"), sp.Dummy(f"c{index}")
        polynomial = sp.Poly(
            expanded.subs({sp.sin(angle): sine, sp.cos(angle): cosine}), sine, cosine
        )
        reduced = sp.rem(polynomial, sp.Poly(sine**2 + cosine**2 - 1, sine, cosine))
        expanded = sp.expand(reduced.as_expr().subs({sine: sp.sin(angle), cosine: sp.cos(angle)}))
    return expanded


def is_zero(expression: sp.Expr) -> bool:
    """Return whether `expression` is identically zero, decided by normal form."""
    return bool(zero_residual(expression) == 0)


def zero_matrix(matrix: sp.Matrix) -> bool:
    """Return whether every entry of `matrix` is identically zero."""
    return all(is_zero(entry) for entry in matrix)
