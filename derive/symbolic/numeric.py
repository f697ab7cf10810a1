"""SymPy expressions as Python functions, whatever their symbols are called.

`lambdify` writes Python text: an argument called as a function of it (`sin`), a constant (`pi`) or
a word of its own would hide that. Such a symbol is called otherwise inside; all others keep their
names, and with them SymPy's order of terms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import sympy as sp

#: What the text may refer to: functions of expressions, under all their names, and what modules
#: and printers have besides.
_REFERRED = frozenset(
    """
    Abs DiracDelta E I Max Min Piecewise abs absolute acos acosh amax amin arccos arccosh arcsin
    arcsinh arctan arctan2 arctanh array asin asinh atan atan2 atanh bool ceil ceiling copysign cos
    cosh e equal exp expm1 fabs float floor greater greater_equal hypot inf int less less_equal log
    log10 log1p log2 logical_and logical_not logical_or math max maximum min minimum mod mpc mpf
    mpmath nan not_equal numpy pi pow power scipy select side sign sin sinh sqrt tan tanh where
    zeros
    """.split()  # noqa: SIM905
)


def safe_symbols(symbols: Iterable[sp.Symbol]) -> dict[sp.Symbol, sp.Symbol]:
    """Return what stands in for those of `symbols` that text of Python would misunderstand."""
    found = list(symbols)
    names = {s.name for s in found}
    stand_ins = {}
    for symbol in found:
        if symbol.name in _REFERRED:
            name = f"{symbol.name}_argument"
            while name in names:
                name += "_"
            stand_ins[symbol] = sp.Symbol(name, real=True)
    return stand_ins


def function_of(
    arguments: Sequence[sp.Symbol], expression: Any, modules: Any, *, cse: bool = False
) -> Callable[..., Any]:
    """Return the function of `arguments`, by position, that evaluates `expression`.

    The expression is one, or a list of them; `modules` and `cse` are those of `lambdify`.
    """
    stand_ins = safe_symbols(arguments)
    many = isinstance(expression, list)
    values = [e.xreplace(stand_ins) for e in (expression if many else [expression])]
    made: Callable[..., Any] = sp.lambdify(
        [stand_ins.get(a, a) for a in arguments],
        values if many else values[0],
        modules=modules,
        cse=cse,
    )
    return made
