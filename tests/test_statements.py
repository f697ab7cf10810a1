"""Text of programs means the program: infix with its parentheses, and what vouches for what."""

import itertools
import math

import pytest
from pfaffian.derive.emit.finiteness import values_to_check
from pfaffian.derive.emit.precision import DOUBLE, SINGLE
from pfaffian.derive.emit.statements import statements_of
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.program import Instruction, Op, Program, Signal

INFIX = (Op.ADD, Op.SUB, Op.MUL, Op.DIV)
AT = {"x": 0.7, "y": -1.3, "z": 2.9}


def program(*instructions):
    signals = tuple(Signal(n, "", "", "input") for n in AT)
    head = tuple(Instruction(Op.INPUT, name=n) for n in AT)
    tape = (*head, *instructions)
    return Program("p", "", signals, tape, (Signal("f", "", "", "output"),), (len(tape) - 1,))


def meant(small):
    """Evaluate the text of a program of +, -, *, / as Python reads it: C reads it alike."""
    _, results = statements_of(small, DOUBLE.dialect)
    return eval(results["f"], {}, AT)


@pytest.mark.parametrize(("inner", "outer"), list(itertools.product(INFIX, repeat=2)))
def test_infix_text_means_the_program(inner, outer):
    """(x o y) o z and x o (y o z), each also negated, to the bit: the order of operations too."""
    for first, second in (((0, 1), (3, 2)), ((1, 2), (0, 3))):
        plain = program(Instruction(inner, first), Instruction(outer, second))
        assert meant(plain) == evaluate(plain, AT)["f"]
        negated = program(Instruction(inner, first), Instruction(Op.NEG, (3,)))
        assert meant(negated) == evaluate(negated, AT)["f"]
        negated = program(Instruction(Op.NEG, (1,)), Instruction(outer, (0, 3)))
        assert meant(negated) == evaluate(negated, AT)["f"]


def test_a_quotient_vouches_for_what_it_divides_alone():
    """1/infinity is 0: a finite quotient says nothing of its divisor."""
    small = program(Instruction(Op.ADD, (0, 1)), Instruction(Op.DIV, (2, 3)))
    both = Program(
        "p", "", small.inputs, small.instructions,
        tuple(Signal(n, "", "", "output") for n in ("sum", "quotient")), (3, 4),
    )  # fmt: skip
    assert values_to_check(both) == (3, 4)
    wild = evaluate(both, {"x": math.inf, "y": 1.0, "z": 1.0})
    assert math.isinf(wild["sum"])
    assert wild["quotient"] == 0.0


def test_each_precision_takes_its_bounds_inwards():
    """What passes a rounded bound passes the exact one: 0.1 and 1e-6 are no singles."""
    for bound in (0.1, 1e-6, 0.3, 1e5 + 0.1):
        low, high = SINGLE.at_least(bound), SINGLE.at_most(bound)
        assert high < bound < low
        assert low - high <= 2.0**-22 * bound
        assert -SINGLE.at_least(-bound) == SINGLE.at_most(bound)
        assert DOUBLE.at_least(bound) == DOUBLE.at_most(bound) == bound
