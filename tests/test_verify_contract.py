"""What `verify` promises, each part at its edge: the limit, the scale, the bits, the answers."""

import math

import gmpy2
import numpy as np
import pytest
import sympy as sp
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.symbolic.block import BlockBuilder
from pfaffian.derive.verify import compare
from pfaffian.derive.verify.compare import Verification, verify
from pfaffian.derive.verify.condition import Condition
from pfaffian.derive.verify.oracle import Oracle, absolute_error
from pfaffian.derive.verify.subjects import CompiledUnderTest
from pfaffian.derive.verify.ulp_unit import DOUBLE_UNIT, SINGLE_UNIT
from pfaffian.runtime.code.generated_model import host_model, open_generated


@pytest.fixture(scope="module")
def source():
    folder = find_model("pendubot")
    model = lowered_model(folder)
    return derivation_of(folder), model, [s.as_dict() for s in library_sets(model, folder)]


@pytest.fixture(scope="module")
def host():
    return host_model(open_generated("pendubot"))


class Moved(CompiledUnderTest):
    """Generated code whose ADB is off by `units` last places of its condition scale."""

    def __init__(self, model, block, units):
        super().__init__(model, "c-host")
        self.condition, self.units = Condition(block), units

    def evaluate(self, function, values):
        outputs = super().evaluate(function, values)
        if function == "continuous":
            scale = np.maximum(np.abs(outputs["adb"]), self.condition(values)[0]["adb"])
            outputs["adb"] = outputs["adb"] + self.units * np.spacing(scale)
        return outputs


@pytest.mark.parametrize(("units", "passes"), [(2.0, True), (7.0, False), (-7.0, False)])
def test_an_error_of_a_few_scaled_units_passes_and_one_of_seven_does_not(
    source, host, units, passes
):
    subject = Moved(host, source[0].block("continuous"), units)
    found = verify(*source, [subject], None, 60, 0, functions=("continuous",))
    assert found.passed is passes
    assert abs(found.worst_scaled_ulp - abs(units)) < 2.0


def test_the_limit_is_four_scaled_units_and_one_mismatch_is_too_many():
    def judged(worst, mismatches):
        return Verification(9, worst, 9, mismatches, 0, (), {}).passed

    assert judged(4.0, 0)
    assert not judged(math.nextafter(4.0, 5.0), 0)
    assert not judged(0.0, 1)
    assert not judged(math.inf, 0)
    assert not judged(math.nan, 0)


def by_hand():
    """Return the block a = x y, b = a - z; b leaves."""
    builder = BlockBuilder("by_hand", "")
    x, y, z = (builder.take(sp.Symbol(n, real=True), "", "", "input") for n in "xyz")
    a = builder.define("a", x * y, "")
    builder.give("b", builder.define("b", a - z, ""), "", "")
    return builder.build()


def test_the_scales_are_those_of_a_product_less_a_number_by_hand():
    """|x y| twice and |z| for the inputs; |a| and |b| besides for what is named."""
    x, y, z = np.array([3.0, -1e6, 0.0]), np.array([0.5, 1.0, 7.0]), np.array([1.4, -1e6, -2.0])
    named, by_input = Condition(by_hand())({"x": x, "y": y, "z": z})
    inputs = 2.0 * np.abs(x * y) + np.abs(z)
    np.testing.assert_allclose(by_input["b"], inputs, rtol=1e-15)
    np.testing.assert_allclose(named["b"], inputs + np.abs(x * y) + np.abs(x * y - z), rtol=1e-15)


def test_values_of_functions_that_cancel_count_as_their_terms():
    """tanh(4 x) - tanh(2 x) where both are nearly 1: each is rounded, the difference is not."""
    builder = BlockBuilder("by_hand", "")
    x = builder.take(sp.Symbol("x", real=True), "", "", "input")
    builder.give("d", builder.define("d", sp.tanh(4 * x) - sp.tanh(2 * x), ""), "", "")
    at = np.array([4.0, 0.0])
    named, by_input = Condition(builder.build())({"x": at})
    slope = np.abs(at * (4.0 / np.cosh(4.0 * at) ** 2 - 2.0 / np.cosh(2.0 * at) ** 2))
    terms = np.tanh(4.0 * at) + np.tanh(2.0 * at)
    np.testing.assert_allclose(by_input["d"], slope, rtol=1e-9, atol=1e-20)
    difference = np.abs(np.tanh(4.0 * at) - np.tanh(2.0 * at))
    np.testing.assert_allclose(named["d"], slope + terms + difference, rtol=1e-9, atol=1e-20)


def test_an_oracle_without_an_answer_is_no_agreement():
    with gmpy2.context(precision=200):
        exact = [gmpy2.nan(), gmpy2.mpfr(2), gmpy2.mpfr(2), gmpy2.inf(), gmpy2.mpfr(2)]
    computed = np.array([1.0, math.nan, math.inf, 1.0, 2.5])
    assert absolute_error(computed, exact).tolist() == [math.inf] * 4 + [0.5]


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_an_answer_that_is_not_finite_fails(source, host, wrong):
    class Silent(CompiledUnderTest):
        def evaluate(self, function, values):
            outputs = super().evaluate(function, values)
            outputs["adb"][7] = wrong
            return outputs

    found = verify(*source, [Silent(host, "c-host")], None, 30, 0, functions=("continuous",))
    assert found.worst_scaled_ulp == math.inf
    assert not found.passed


def test_zeros_of_two_signs_and_two_nans_are_differing_bits():
    other_nan = np.array([0x7FF8000000000001], np.uint64).view(float)[0]
    here = {"a": np.array([0.0, 1.0, math.nan, 2.0]), "b": np.zeros(4)}
    there = {"a": np.array([-0.0, 1.0, other_nan]), "b": np.zeros(3)}
    assert compare._differing(here, there).tolist() == [True, False, True]
    assert compare._differing(here, here).tolist() == [False] * 4
    assert compare._differing(here, there | {"b": np.array([0.0, -0.0, 0.0])}).all()


def test_a_difference_that_the_witness_knows_is_counted_apart_and_no_other(source, host):
    class Nudged(CompiledUnderTest):
        def __init__(self, name, rows):
            super().__init__(host, name)
            self.rows = rows

        def evaluate(self, function, values):
            outputs = super().evaluate(function, values)
            outputs["adb"].view(np.uint64)[self.rows] ^= np.uint64(1)
            return outputs

    found = verify(
        *source,
        [Nudged("c-host", [])],
        Nudged("target", [1, 4]),
        samples=20,
        target_samples=20,
        witness=Nudged("witness", [4]),
        functions=("continuous",),
    )
    assert (found.emulator_roundings, found.target_mismatches) == (1, 1)


def test_units_in_the_last_place_are_those_of_both_formats():
    sizes = np.array([0.0, 1.0, 1.9, 2.0, 1e-45, 3e5])
    single = np.spacing(sizes.astype(np.float32)).astype(float)
    assert (DOUBLE_UNIT.last_place(sizes) == np.spacing(sizes)).all()
    assert (SINGLE_UNIT.last_place(sizes) == single).all()


def test_the_worst_sample_is_the_one_that_is_named(source, host):
    subject = Moved(host, source[0].block("continuous"), np.where(np.arange(40) == 23, 50.0, 0.0))
    found = verify(*source, [subject], None, 40, 0, functions=("continuous",))
    (result,) = found.functions
    assert result.output == "adb"
    assert 48.0 < result.worst_scaled_ulp < 52.0
    drawn = compare.draw(
        source[1],
        source[0].block("continuous").inputs,
        source[2],
        40,
        np.random.default_rng([compare._SEED, 0]),
        block=source[0].block("continuous"),
    )
    assert result.at == {n: float(v[23]) for n, v in drawn.values.items()}


def test_the_scales_follow_every_path_from_input_to_output():
    """a = x y, b = a + x: x moves b directly and by a, which add up with their signs."""
    builder = BlockBuilder("paths", "")
    x, y = (builder.take(sp.Symbol(n, real=True), "", "", "input") for n in "xy")
    a = builder.define("a", x * y, "")
    builder.give("b", builder.define("b", a + x, ""), "", "")
    at = {"x": np.array([3.0, 3.0]), "y": np.array([2.0, -0.5])}
    _, by_input = Condition(builder.build())(at)
    x, y = at["x"], at["y"]
    np.testing.assert_allclose(by_input["b"], np.abs(x * (y + 1.0)) + np.abs(x * y), rtol=1e-15)


def test_a_comparison_is_clear_unless_rounding_may_decide_it():
    """(x + y > 1 ? x : -x): decided where x + y is a millionth away from 1, not at 1e-14."""
    builder = BlockBuilder("choice", "")
    x, y = (builder.take(sp.Symbol(n, real=True), "", "", "input") for n in "xy")
    total = builder.define("total", x + y, "")
    builder.give("f", builder.define("f", sp.Piecewise((x, total > 1), (-x, True)), ""), "", "")
    oracle = Oracle(builder.build())
    for gap, clear in ((1e-6, True), (-1e-6, True), (1e-11, True), (1e-14, False), (0.0, False)):
        outputs, decided = oracle({"x": 0.5, "y": 0.5 + gap})
        assert decided is clear
        assert float(outputs[0]) == (0.5 if gap > 0.0 else -0.5)
    assert oracle({"x": 0.0, "y": 1.0})[1]  # both branches give the same
