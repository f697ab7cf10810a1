"""Lowering on small expressions: each has the value of the symbolic one, at edges too."""

import itertools
import math

import mpmath
import pytest
import sympy as sp
from pfaffian.derive.elementary.fit import to_single
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.program import Instruction, Op
from pfaffian.derive.lower.to_program import _without_dead, lower
from pfaffian.derive.symbolic.block import BlockBuilder
from pfaffian.derive.symbolic.functions import side

X, Y, Z = sp.symbols("x y z", real=True)


def lowered(expression):
    builder = BlockBuilder("one", "")
    for symbol in (X, Y, Z):
        builder.take(symbol, "", "", "input")
    builder.give("f", builder.define("f", expression, ""), "", "")
    return lower(builder.build())


def value_of(expression, **at):
    program = lowered(expression)
    known = {s.name: at[s.name] for s in program.inputs}
    return evaluate(program, known)["f"]


EXPRESSIONS = [
    X / Y,
    X / (Y * Z),
    X**3 * Y,
    X**5,
    Y**-2,
    X * Y**-3,
    1 / X + 1 / (X * Y),
    sp.Rational(5, 6) * X,
    sp.Rational(3, 8) * X / Y,
    sp.Rational(-7, 12) * X * Y / Z,
    2 * X + Y,
    (X + X) * Y,
    -X - Y + Z,
    -(X * Y) / Z,
    sp.sqrt(X**2 + Y**2),
    sp.sin(X) * sp.cos(Y) - sp.tanh(Z),
    sp.exp(-X) / (1 + sp.exp(Y)),
    sp.atan(X * Y) * 2 / sp.pi,
    sp.Abs(X - 3) ** 2,
]


@pytest.mark.parametrize("expression", EXPRESSIONS, ids=str)
def test_a_lowered_expression_has_the_value_of_the_symbolic_one(expression):
    at = {"x": 1.37, "y": -0.61, "z": 2.9}
    exact = expression.subs({s: sp.Float(at[s.name], 40) for s in (X, Y, Z)}).evalf(30)
    assert value_of(expression, **at) == pytest.approx(float(exact), rel=4e-16)


#: A choice, and the same in Python.
CHOICES = [
    (sp.Piecewise((1, X > Y), (2, True)), lambda x, y: 1 if x > y else 2),
    (sp.Piecewise((1, X >= Y), (2, True)), lambda x, y: 1 if x >= y else 2),
    (sp.Piecewise((1, X < Y), (2, True)), lambda x, y: 1 if x < y else 2),
    (sp.Piecewise((1, X <= Y), (2, True)), lambda x, y: 1 if x <= y else 2),
    (
        sp.Piecewise((X, X > 1), (Y, Y > 0), (X * Y + 5, True)),
        lambda x, y: x if x > 1 else y if y > 0 else x * y + 5,
    ),
    (
        sp.Piecewise((3, (X > 0) | (Y > 0)), (4, True)),
        lambda x, y: 3 if x > 0 or y > 0 else 4,
    ),
    (
        sp.Piecewise((3, (X > 0) & (Y > 0)), (4, True)),
        lambda x, y: 3 if x > 0 and y > 0 else 4,
    ),
    (sp.Max(X, Y, 1), lambda x, y: max(x, y, 1)),
    (sp.Min(X, Y, 1), lambda x, y: min(x, y, 1)),
    (side(X) * (Y + 4), lambda x, y: (-1 if x < 0 else 1) * (y + 4)),
    (sp.sign(X) * (Y + 4), lambda x, y: ((x > 0) - (x < 0)) * (y + 4)),
]


@pytest.mark.parametrize(("expression", "plain"), CHOICES, ids=[str(e) for e, _ in CHOICES])
def test_choices_are_lowered_with_their_sides_and_edges(expression, plain):
    program = lowered(expression)
    for x, y in itertools.product((-2.0, -0.5, 0.0, 0.5, 1.0, 2.0), repeat=2):
        known = {"x": x, "y": y}
        found = evaluate(program, {s.name: known[s.name] for s in program.inputs})["f"]
        assert found == plain(x, y), (x, y)


def test_constants_keep_their_signs():
    """-1/3, 1/3 and -1/3 again are two constants: each is kept once, with its own sign."""
    tape = [
        *(Instruction(Op.CONST, value=v) for v in (-1 / 3, 1 / 3, -1 / 3, 0.0, -0.0)),
        Instruction(Op.SUB, (1, 0)),
        Instruction(Op.ADD, (5, 2)),
        Instruction(Op.MUL, (3, 4)),
    ]
    kept, results = _without_dead(tape, (6, 7, 3, 4))
    constants = [i.value.hex() for i in kept if i.op is Op.CONST]
    assert constants == [v.hex() for v in (-1 / 3, 1 / 3, 0.0, -0.0)]
    assert [kept[r].op for r in results] == [Op.ADD, Op.MUL, Op.CONST, Op.CONST]
    difference, again = kept[results[0]].args
    assert [kept[a].value for a in kept[difference].args] == [1 / 3, -1 / 3]
    assert kept[again].value == -1 / 3
    assert [math.copysign(1.0, kept[r].value) for r in results[2:]] == [1.0, -1.0]


def test_an_unknown_function_is_refused_by_its_name():
    with pytest.raises(NotImplementedError, match="zeta"):
        lowered(sp.zeta(X))


def test_a_value_near_a_tie_is_rounded_to_single_once():
    """1 + 2^-24 + 2^-60 is above the middle of two singles; as a double it is the middle."""
    with mpmath.workdps(60):
        value = 1 + mpmath.mpf(2) ** -24 + mpmath.mpf(2) ** -60
        assert to_single(value) == 1.0 + 2.0**-23
        assert to_single(1 + mpmath.mpf(2) ** -24) == 1.0
        assert to_single(-value) == -(1.0 + 2.0**-23)
        assert to_single(mpmath.mpf(0)) == 0.0
    assert math.isclose(to_single(mpmath.mpf("0.1")), 0.1, rel_tol=1e-7)
