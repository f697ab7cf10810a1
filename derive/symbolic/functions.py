"""Functions of the control laws that SymPy does not have."""

from __future__ import annotations

from typing import Any

import sympy as sp


class side(sp.Function):  # type: ignore[misc]  # noqa: N801  (named as SymPy names functions)
    """side(x) = -1 for x < 0, else 1: the sign with a side for zero too.

    The target takes it as a branch, where `sign` would need two.
    """

    @classmethod
    def eval(cls, x: sp.Expr) -> sp.Expr | None:
        """Evaluate at numbers."""
        return (sp.S.NegativeOne if x < 0 else sp.S.One) if x.is_Number else None

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """Return the derivative, zero wherever there is one."""
        return sp.S.Zero

    def _eval_is_real(self) -> bool:
        return True

    def _eval_rewrite_as_Piecewise(  # noqa: N802  (SymPy looks it up by this name)
        self, x: sp.Expr, **_: Any
    ) -> sp.Piecewise:
        return sp.Piecewise((-1, x < 0), (1, True))
