"""One step of a check of the audit: what it compares, entry by entry."""

import sympy as sp
from pfaffian.paper.audit.check import equal

X = sp.Symbol("x", real=True)


def test_matrices_are_compared_in_every_entry():
    one = sp.Matrix([[X, 1], [2, sp.sin(X) ** 2]])
    assert equal("the same", one, sp.Matrix([[X, 1], [2, 1 - sp.cos(X) ** 2]])).holds
    for k in range(4):
        other = one.copy()
        other[k] += 1
        step = equal("another", one, other)
        assert not step.holds
        assert sp.expand(step.derived - step.printed) == 1
