"""The notation of printed formulas: text read into SymPy, with matrices, norms and integrals.

`(A*D*B)**-1*(b + A*D*(C*dq + G))` is written as it is printed. What each name stands for is given
by the reader, so that the same text is evaluated with explicit matrices or with scalars.
"""

# ruff: noqa: D105 - operators do what they do in print

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import sympy as sp
from sympy.matrices.exceptions import NonSquareMatrixError, ShapeError
from sympy.parsing.sympy_parser import auto_number, parse_expr, rationalize

#: Integral from 0 to t of its argument; `pendubot_source.rate` differentiates it.
INTEGRAL = sp.Function("integral", real=True)


class Term:
    """A matrix or a number of a formula; a product that is 1 x 1 counts as a number."""

    __slots__ = ("matrix",)

    def __init__(self, value: Operand) -> None:
        """Wrap a SymPy expression, a matrix, or a term."""
        self.matrix: sp.ImmutableMatrix
        if isinstance(value, Term):
            self.matrix = value.matrix
        elif isinstance(value, sp.MatrixBase):
            self.matrix = sp.ImmutableMatrix(value)
        else:
            self.matrix = sp.ImmutableMatrix([[sp.sympify(value)]])

    @property
    def value(self) -> Any:
        """Return a SymPy expression for a number, a matrix otherwise."""
        return self.matrix[0, 0] if self.is_number else self.matrix

    @property
    def is_number(self) -> bool:
        """Return whether this is 1 x 1."""
        return bool(self.matrix.shape == (1, 1))

    @property
    def T(self) -> Term:  # noqa: N802 - as printed
        """Return the transpose."""
        return Term(self.matrix.T)

    def __add__(self, other: Operand) -> Term:
        return Term(self.matrix + Term(other).matrix)

    def __radd__(self, other: Operand) -> Term:
        return Term(other) + self

    def __neg__(self) -> Term:
        return Term(-self.matrix)

    def __sub__(self, other: Operand) -> Term:
        return self + -Term(other)

    def __rsub__(self, other: Operand) -> Term:
        return Term(other) - self

    def __mul__(self, other: Operand) -> Term:
        given = Term(other)
        if self.is_number:
            return Term(self.value * given.matrix)
        return Term(self.matrix * (given.value if given.is_number else given.matrix))

    def __rmul__(self, other: Operand) -> Term:
        return Term(other) * self

    def __pow__(self, power: Operand) -> Term:
        exponent = Term(power).value
        if self.is_number:
            return Term(self.value**exponent)
        if exponent != -1:
            raise TypeError(f"a matrix to the power {exponent}")
        return Term(self.matrix.adjugate() / self.matrix.det())

    def __truediv__(self, other: Operand) -> Term:
        return self * Term(other) ** -1

    def __rtruediv__(self, other: Operand) -> Term:
        return Term(other) / self


Operand: TypeAlias = "Term | sp.Basic | sp.MatrixBase | int"


def norm(term: Operand) -> Term:
    """Return the Euclidean norm; of a number its magnitude."""
    entries = list(Term(term).matrix)
    if len(entries) == 1:
        return Term(sp.Abs(entries[0]))
    return Term(sp.sqrt(sum((x**2 for x in entries), sp.S.Zero)))


def rows(*given: list[Operand]) -> Term:
    """Return the matrix with these rows."""
    return Term(sp.Matrix([[Term(x).value for x in row] for row in given]))


def _lifted(function: Any) -> Any:
    return lambda *given: Term(function(*(Term(x).value for x in given)))


#: What every formula may use.
_COMMON: Mapping[str, Any] = {
    "norm": norm,
    "rows": rows,
    "eigenvalue": Term,  # of a number: itself
    "pi": Term(sp.pi),
    **{f.__name__: _lifted(f) for f in (sp.sin, sp.cos, sp.atan, sp.tanh, sp.Min, sp.Max)},
    "sqrt": _lifted(sp.sqrt),
    "integral": _lifted(INTEGRAL),
}
_NUMBERS = {"Integer": sp.Integer, "Float": sp.Float, "Rational": sp.Rational}


def read(text: str, names: Mapping[str, Operand]) -> Any:
    """Return the expression or matrix that `text` is with `names`.

    Raises `ValueError` for a name that has no meaning and for shapes that do not fit.
    """
    given = {**_COMMON, **{name: Term(value) for name, value in names.items()}}
    how = (auto_number, rationalize)
    try:
        found = parse_expr(text, given, how, global_dict=dict(_NUMBERS))
    except (NameError, TypeError, ShapeError, NonSquareMatrixError) as error:
        raise ValueError(f"{text!r} cannot be read: {error}") from error
    return Term(found).value
