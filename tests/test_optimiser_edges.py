"""Passes on small programs made for them, each against the exact value."""

import itertools
import math
from fractions import Fraction

import mpmath
import pytest
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.program import Instruction, Op, Program, Signal
from pfaffian.derive.ir.ranges import ranges, unbounded
from pfaffian.derive.optimise.angle_sums import reuse_angle_sums
from pfaffian.derive.optimise.bake import bake
from pfaffian.derive.optimise.choose_signs import add_negatives, choose_signs
from pfaffian.derive.optimise.fuse_multiply_adds import fuse_multiply_adds
from pfaffian.derive.optimise.parameter_products import gather_parameters, negate_parameters
from pfaffian.derive.optimise.passes import merge_equal_values
from pfaffian.derive.optimise.share_comparisons import share_comparisons
from pfaffian.derive.optimise.share_divisions import share_divisions
from test_optimiser import exactly

X, Y, P, R = (("x", "input"), ("y", "input"), ("p", "parameter"), ("r", "parameter"))
POINT = {"x": 0.7, "y": -1.3, "p": 2.5, "r": 0.3}


def program(inputs, instructions, results, group="output"):
    signals = tuple(Signal(n, "", "", g) for n, g in inputs)
    head = tuple(Instruction(Op.INPUT, name=n) for n, _ in inputs)
    outputs = tuple(Signal(f"out{k}", "", "", group) for k in range(len(results)))
    return Program("p", "", signals, (*head, *instructions), outputs, tuple(results))


def kept(done, before):
    """Return whether `done` has the exact values of `before` at a point."""
    one, other = exactly(done, POINT), exactly(before, POINT)
    return all(abs(one[n] - v) < mpmath.mpf(10) ** -40 for n, v in other.items())


def operations(done):
    return [i.op for i in done.instructions if i.op not in (Op.INPUT, Op.CONST)]


#: Products and quotients with a doubled factor, above and below the line: (inputs, tape, results).
DOUBLED = {
    "x / 2p": ([X, P], [(Op.ADD, 1, 1), (Op.DIV, 0, 2)]),
    "2x / p": ([X, P], [(Op.ADD, 0, 0), (Op.DIV, 2, 1)]),
    "x y / 2p": ([X, Y, P], [(Op.MUL, 0, 1), (Op.ADD, 2, 2), (Op.DIV, 3, 4)]),
    "(x 2p) r": ([X, P, R], [(Op.ADD, 1, 1), (Op.MUL, 0, 3), (Op.MUL, 4, 2)]),
    "x / (2p 2r)": (
        [X, P, R],
        [(Op.ADD, 1, 1), (Op.ADD, 2, 2), (Op.MUL, 3, 4), (Op.DIV, 0, 5)],
    ),
    "(x/p) / (2y)": ([X, Y, P], [(Op.DIV, 0, 2), (Op.ADD, 1, 1), (Op.DIV, 3, 4)]),
    "x / (p / 2y)": ([X, Y, P], [(Op.ADD, 1, 1), (Op.DIV, 2, 3), (Op.DIV, 0, 4)]),
    "x / (p/2r)": ([X, P, R], [(Op.ADD, 2, 2), (Op.DIV, 1, 3), (Op.DIV, 0, 4)]),
    "2x (p/(2y)) r": (
        [X, Y, P, R],
        [(Op.ADD, 0, 0), (Op.ADD, 1, 1), (Op.DIV, 2, 5), (Op.MUL, 4, 6), (Op.MUL, 7, 3)],
    ),
}


@pytest.mark.parametrize("name", DOUBLED)
def test_a_factor_of_two_stays_on_its_side_of_the_line(name):
    inputs, rows = DOUBLED[name]
    tape = [Instruction(op, tuple(args)) for op, *args in rows]
    before = program(inputs, tape, [len(inputs) + len(tape) - 1])
    done = gather_parameters(before)
    assert kept(done, before)


def test_what_is_prepared_by_a_rounded_function_is_not_baked():
    """The exponential of this machine may be another than the target's."""
    prepare = program(
        [P, R],
        [
            Instruction(Op.MUL, (0, 1)),
            Instruction(Op.EXP, (2,)),
            Instruction(Op.ADD, (3, 0)),
            Instruction(Op.SQRT, (0,)),
            Instruction(Op.DIV, (0, 1)),
        ],
        [2, 3, 4, 6],
        "prepared",
    )
    read = [(f"out{k}", "prepared") for k in range(4)]
    step = program([X, *read], [Instruction(Op.MUL, (0, k + 1)) for k in range(4)], [5, 6, 7, 8])
    baked = bake(step, prepare, {"p": 2.5, "r": 0.3})
    assert [s.name for s in baked.prepare.outputs] == ["out1", "out2"]
    assert dict(baked.constants) == {"out0": 2.5 * 0.3, "out3": 2.5 / 0.3}
    groups = {s.name: s.group for s in baked.step.inputs}
    assert (groups["out0"], groups["out1"], groups["out3"]) == ("baked", "prepared", "baked")


def test_only_a_neutral_value_is_dropped_when_a_set_is_folded_in():
    nothing = program([], [], [])
    step = program(
        [X, P, R],
        [
            Instruction(Op.SUB, (0, 1)),
            Instruction(Op.SUB, (1, 0)),
            Instruction(Op.MUL, (0, 2)),
            Instruction(Op.MUL, (1, 0)),
        ],
        [3, 4, 5, 6],
    )
    found = bake(step, nothing, {"p": 0.0, "r": 1.0}).step
    point = {"x": 0.7, "p": 0.0, "r": 1.0}
    assert evaluate(found, point) == {"out0": 0.7, "out1": -0.7, "out2": 0.7, "out3": 0.0}
    assert operations(found) == [Op.SUB, Op.MUL]
    same = bake(step, nothing, {"p": 1.0, "r": 0.0}).step
    assert len(operations(same)) == 3  # 1 x goes; x - 1, 1 - x and 0 x stay


BOXES = [(-0.3, 0.1), (0.1, 0.7), (-0.7, -0.1)]


@pytest.mark.parametrize("op", [Op.ADD, Op.SUB, Op.MUL, Op.FMA, Op.FMS, Op.FNMS])
def test_ranges_hold_the_exact_extremes_strictly(op):
    """Both ends are widened by a rounding: the extremes of a real operation are no doubles."""
    fused = op in (Op.FMA, Op.FMS, Op.FNMS)
    names = [X, Y, P] if fused else [X, Y]
    small = program(names, [Instruction(op, tuple(range(len(names))))], [len(names)])
    rules = {
        Op.ADD: lambda a, b: a + b,
        Op.SUB: lambda a, b: a - b,
        Op.MUL: lambda a, b: a * b,
        Op.FMA: lambda a, b, c: a * b + c,
        Op.FMS: lambda a, b, c: a * b - c,
        Op.FNMS: lambda a, b, c: c - a * b,
    }
    for boxes in itertools.product(BOXES, repeat=len(names)):
        low, high = ranges(small, dict(zip("xyp", boxes, strict=False)))[-1]
        corners = [rules[op](*map(Fraction, corner)) for corner in itertools.product(*boxes)]
        assert Fraction(low) < min(corners) or low == min(corners) == 0
        assert Fraction(high) > max(corners) or high == max(corners) == 0
        assert low > float(min(corners)) - 1e-14
        assert high < float(max(corners)) + 1e-14


def test_ranges_of_choices_squares_and_unknown_operations():
    tape = [
        Instruction(Op.MUL, (0, 0)),
        Instruction(Op.MAX, (0, 1)),
        Instruction(Op.MIN, (0, 1)),
        Instruction(Op.SIN, (0,)),
        Instruction(Op.DIV, (0, 1)),
        Instruction(Op.NEG, (1,)),
    ]
    found = ranges(program([X, Y], tape, [2]), {"x": (-2.0, 1.0), "y": (0.5, 3.0)})
    square, most, least, sine, quotient, minus = found[2:]
    assert -1e-300 <= square[0] <= 0.0
    assert 4.0 < square[1] < 4.0 + 1e-13
    for (low, high), (a, b) in ((most, (0.5, 3.0)), (least, (-2.0, 1.0)), (minus, (-3.0, -0.5))):
        assert a - 1e-13 < low <= a
        assert b <= high < b + 1e-13
    assert sine[0] <= -1.0
    assert sine[1] >= 1.0
    assert quotient == (-math.inf, math.inf)


def test_what_is_prepared_and_may_be_infinite_is_named():
    tape = [Instruction(Op.DIV, (0, 1)), Instruction(Op.MUL, (0, 1))]
    prepare = program([P, R], tape, [2, 3], "prepared")
    assert unbounded(prepare, {"p": (0.0, 1.0), "r": (0.0, 1.0)}) == ("out0",)
    assert unbounded(prepare, {"p": (0.0, 1.0)}) == ("out0", "out1")


def test_sums_and_differences_of_angles_keep_their_signs():
    for op, function in itertools.product((Op.ADD, Op.SUB), (Op.SIN, Op.COS)):
        tape = [
            Instruction(Op.SIN, (0,)),
            Instruction(Op.COS, (1,)),
            Instruction(op, (0, 1)),
            Instruction(function, (4,)),
        ]
        before = program([X, Y], tape, [2, 3, 5])
        done = reuse_angle_sums(before)
        assert op not in [i.op for i in done.instructions if set(i.args) == {0, 1}]
        assert kept(done, before)


def test_each_pass_does_what_it_is_for_and_keeps_the_value():
    cases = [
        (fuse_multiply_adds, [(Op.MUL, 0, 1), (Op.SUB, 3, 2)], Op.FMS),
        (fuse_multiply_adds, [(Op.MUL, 0, 1), (Op.SUB, 0, 3)], Op.FNMS),
        (fuse_multiply_adds, [(Op.MUL, 0, 1), (Op.ADD, 3, 2)], Op.FMA),
        (negate_parameters, [(Op.MUL, 2, 0), (Op.NEG, 3)], Op.NEG),
    ]
    for run, rows, wanted in cases:
        tape = [Instruction(op, tuple(args)) for op, *args in rows]
        before = program([X, Y, P], tape, [4])
        done = run(before)
        assert wanted in operations(done)
        assert kept(done, before)


def test_a_shared_divisor_is_inverted_once():
    tape = [Instruction(Op.DIV, (0, 2)), Instruction(Op.DIV, (1, 2))]
    before = program([X, Y, P], tape, [3, 4])
    done = share_divisions(before)
    assert operations(done).count(Op.DIV) == 1
    assert kept(done, before)
    one = program([X, Y, P], tape[:1], [3])
    assert operations(share_divisions(one)) == [Op.DIV]


def test_signs_and_comparisons_keep_every_bit_on_both_sides():
    tape = [
        Instruction(Op.LESS, (0, 1)),
        Instruction(Op.CONST, value=-1.0),
        Instruction(Op.CONST, value=1.0),
        Instruction(Op.SELECT, (3, 4, 5)),
        Instruction(Op.MUL, (6, 2)),
        Instruction(Op.MAX, (0, 1)),
        Instruction(Op.NEG, (2,)),
        Instruction(Op.SUB, (0, 2)),
    ]
    before = program([X, Y, P], tape, [3, 7, 8, 9, 10])
    for run, gone in ((choose_signs, Op.MUL), (share_comparisons, Op.MAX), (add_negatives, Op.SUB)):
        done = run(before)
        assert gone not in operations(done)
        for x, y in itertools.product((-1.5, 0.25, 2.0), repeat=2):
            point = {"x": x, "y": y, "p": 0.75}
            one, other = evaluate(done, point), evaluate(before, point)
            assert {n: v.hex() for n, v in one.items()} == {n: v.hex() for n, v in other.items()}


def test_an_angle_is_split_only_where_both_parts_are_there():
    """Else one more pair of sine and cosine would be computed to save one."""
    tape = [Instruction(Op.SIN, (0,)), Instruction(Op.ADD, (0, 1)), Instruction(Op.COS, (3,))]
    before = program([X, Y], tape, [2, 4])
    assert operations(reuse_angle_sums(before)) == [Op.SIN, Op.ADD, Op.COS]


def test_equal_values_are_merged_and_no_others():
    tape = [
        Instruction(Op.ADD, (0, 1)),
        Instruction(Op.ADD, (1, 0)),
        Instruction(Op.SUB, (0, 1)),
        Instruction(Op.SUB, (1, 0)),
        Instruction(Op.CONST, value=0.0),
        Instruction(Op.CONST, value=-0.0),
    ]
    done = merge_equal_values(program([X, Y], tape, [2, 3, 4, 5, 6, 7]))
    assert operations(done) == [Op.ADD, Op.SUB, Op.SUB]
    assert done.results[0] == done.results[1]
    found = evaluate(done, {"x": 2.0, "y": 5.0})
    assert [found[f"out{k}"] for k in range(4)] == [7.0, 7.0, -3.0, 3.0]
    assert [math.copysign(1.0, found[f"out{k}"]) for k in (4, 5)] == [1.0, -1.0]


def test_a_product_that_is_needed_elsewhere_is_not_fused_too():
    """Fused it would be computed twice: a multiplication more for an addition less."""
    tape = [Instruction(Op.MUL, (0, 1)), Instruction(Op.ADD, (3, 2))]
    assert operations(fuse_multiply_adds(program([X, Y, P], tape, [3, 4]))) == [Op.MUL, Op.ADD]
    assert operations(fuse_multiply_adds(program([X, Y, P], tape, [4]))) == [Op.FMA]
