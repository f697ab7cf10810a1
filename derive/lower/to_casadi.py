"""SymPy expressions as CasADi graphs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any

import casadi as ca
import sympy as sp
from pfaffian.derive.symbolic.functions import side
from pfaffian.derive.symbolic.supported import is_dyadic, remedy_for
from sympy.codegen.cfunctions import expm1
from sympy.core.relational import Relational

_UNARY: dict[type, Callable[[Any], Any]] = {
    sp.sin: ca.sin,
    sp.cos: ca.cos,
    sp.atan: ca.atan,
    sp.tanh: ca.tanh,
    sp.exp: ca.exp,
    expm1: ca.expm1,
    sp.log: ca.log,
    sp.asin: ca.asin,
    sp.acos: ca.acos,
    sp.sinh: ca.sinh,
    sp.cosh: ca.cosh,
    sp.Abs: ca.fabs,
    sp.sign: ca.sign,
    side: lambda x: ca.if_else(x < 0, -1.0, 1.0),
}
#: What is written in other functions before it is lowered. The slope of a jump is zero wherever it
#: exists, as for `sign`.
_REWRITTEN: dict[type, Callable[..., sp.Expr]] = {
    sp.tan: lambda x: sp.sin(x) / sp.cos(x),
    sp.cot: lambda x: sp.cos(x) / sp.sin(x),
    sp.sec: lambda x: 1 / sp.cos(x),
    sp.csc: lambda x: 1 / sp.sin(x),
    sp.sinc: lambda x: sp.Piecewise((1, sp.Eq(x, 0)), (sp.sin(x) / x, True)),
    sp.acot: lambda x: sp.atan(1 / x),
    sp.coth: lambda x: 1 / sp.tanh(x),
    sp.sech: lambda x: 1 / sp.cosh(x),
    sp.csch: lambda x: 1 / sp.sinh(x),
    sp.Heaviside: lambda x, at_zero=sp.S.Half: sp.Piecewise(
        (0, x < 0), (1, x > 0), (at_zero, True)
    ),
    sp.DiracDelta: lambda *_: sp.S.Zero,
}
_RELATION: dict[type, Callable[[Any, Any], Any]] = {
    sp.StrictGreaterThan: lambda a, b: b < a,
    sp.GreaterThan: lambda a, b: b <= a,
    sp.StrictLessThan: lambda a, b: a < b,
    sp.LessThan: lambda a, b: a <= b,
    # Compilers warn of == between numbers that were rounded.
    sp.Equality: lambda a, b: ca.logic_and(a <= b, b <= a),
    sp.Unequality: lambda a, b: ca.logic_or(a < b, b < a),
}


class NoLoweringError(NotImplementedError):
    """Raised for an expression that cannot be computed; `remedy` says what to write instead."""

    def __init__(self, what: str, part: sp.Basic) -> None:
        """Say what has no lowering."""
        super().__init__(f"no lowering for {what}")
        self.remedy = remedy_for(part)


class ToCasadi:
    """Walks SymPy expressions, sharing what it has already built."""

    def __init__(self, known: Mapping[sp.Basic, Any] | None = None) -> None:
        """Start with the graphs of the symbols in `known`."""
        self.known: dict[sp.Basic, Any] = dict(known or {})

    def __call__(self, expression: sp.Basic) -> Any:
        """Return the graph of `expression`."""
        if expression not in self.known:
            self.known[expression] = self._build(expression)
        return self.known[expression]

    def _build(self, e: sp.Basic) -> Any:
        if e.is_Number or e.is_NumberSymbol:
            return ca.SX(float(e.evalf(25)))
        if e.is_Add:
            return self._sum(e)
        if e.is_Mul:
            return self._product(e)
        if e.is_Pow:
            return self._power(e)
        if isinstance(e, sp.Piecewise):
            return self._piecewise(e)
        if isinstance(e, sp.Max | sp.Min):
            pick = ca.fmax if isinstance(e, sp.Max) else ca.fmin
            return reduce(pick, (self(a) for a in e.args))
        if isinstance(e, Relational) and type(e) in _RELATION:
            return _RELATION[type(e)](self(e.lhs), self(e.rhs))
        if isinstance(e, sp.And | sp.Or):
            join = ca.logic_and if isinstance(e, sp.And) else ca.logic_or
            return reduce(join, (self(a) for a in e.args))
        if isinstance(e, sp.Not):
            return ca.logic_not(self(e.args[0]))
        if isinstance(e, sp.atan2):
            return self._angle(*(self(a) for a in e.args))
        if type(e) in _REWRITTEN:
            return self(_REWRITTEN[type(e)](*e.args))
        if type(e) in _UNARY and len(e.args) == 1:
            return _UNARY[type(e)](self(e.args[0]))
        raise NoLoweringError(f"{type(e).__name__}: {e}", e)

    def _sum(self, e: sp.Add) -> Any:
        """Add terms in SymPy's order, subtracting where a term carries a minus sign."""
        terms = sorted(e.args, key=lambda t: t.could_extract_minus_sign())
        total = self(terms[0])
        for term in terms[1:]:
            negative = term.could_extract_minus_sign()
            total = total - self(-term) if negative else total + self(term)
        return total

    def _product(self, e: sp.Mul) -> Any:
        """Multiply numerator and denominator apart, so that there is one division."""
        if e.args[0] == -1:
            return -self(-e)
        above: list[Any] = []
        below: list[Any] = []
        for factor in e.args:
            base, exponent = factor.as_base_exp()
            if exponent.is_Number and exponent.is_negative:
                below.append(self(base ** (-exponent)))
            elif factor.is_Rational and not factor.is_Integer:
                above.extend(self(part) for part in self._exact_parts(factor, below))
            else:
                above.append(self(factor))
        top = reduce(lambda a, b: a * b, above, ca.SX(1))
        return top / reduce(lambda a, b: a * b, below) if below else top

    def _exact_parts(self, factor: sp.Rational, below: list[Any]) -> list[sp.Basic]:
        """Keep a power of two in the denominator as an exact factor; divide by the rest."""
        twos = sp.Integer(2) ** sp.multiplicity(2, factor.q)
        if factor.q != twos:
            below.append(self(sp.Integer(factor.q / twos)))
        return [sp.Float(sp.Rational(factor.p) / twos, 17)]

    def _power(self, e: sp.Pow) -> Any:
        base, exponent = e.args
        if exponent == sp.Rational(1, 2):
            return ca.sqrt(self(base))
        if exponent.is_Integer and exponent > 0:
            value = self(base)
            return reduce(lambda a, _: a * value, range(int(exponent) - 1), value)
        if exponent.is_negative:
            return 1 / self(base ** (-exponent))
        if is_dyadic(exponent):
            return self._dyadic_power(base, exponent)
        if e.is_number and e.is_real:
            return ca.SX(float(e.evalf(25)))
        raise NoLoweringError(f"the power {e}", e)

    def _dyadic_power(self, base: sp.Expr, exponent: sp.Rational) -> Any:
        """Return b^(p/2^k) as b^n sqrt b, b^n sqrt b sqrt(sqrt b) and so on: roots are exact."""
        whole, rest = divmod(exponent, 1)
        factors = [self(base**whole)] if whole else []
        root = self(base)
        while rest:
            root, rest = ca.sqrt(root), 2 * rest
            if rest >= 1:
                factors.append(root)
                rest -= 1
        return reduce(lambda a, b: a * b, factors)

    @staticmethod
    def _angle(y: Any, x: Any) -> Any:
        """Return atan2(y, x) by the arctangent of the smaller over the larger of the two."""
        flat = ca.fabs(y) <= ca.fabs(x)
        turn = ca.if_else(x < 0, ca.if_else(y < 0, -math.pi, math.pi), 0.0)
        quarter = ca.if_else(y < 0, -math.pi / 2, math.pi / 2)
        ratio = ca.if_else(flat, y, -x) / ca.if_else(flat, x, y)
        return ca.if_else(flat, turn, quarter) + ca.atan(ratio)

    def _piecewise(self, e: sp.Piecewise) -> Any:
        *branches, last = e.args
        if last.cond != sp.true:
            raise NoLoweringError(f"a Piecewise without a final branch (value, True): {e}", e)
        value = self(last.expr)
        for branch in reversed(branches):
            value = ca.if_else(self(branch.cond), self(branch.expr), value)
        return value
