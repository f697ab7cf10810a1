"""The judge of generated code: what it must condemn, and what it must not."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.verify import compare
from pfaffian.derive.verify.compare import LIMIT_ULP, errors_of, in_units, verify
from pfaffian.derive.verify.condition import Condition
from pfaffian.derive.verify.sampling import draw, measured_domain
from pfaffian.derive.verify.subjects import CompiledUnderTest
from pfaffian.derive.verify.ulp_unit import DOUBLE_UNIT, SINGLE_UNIT
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.generated_model import host_model, open_generated


@pytest.fixture(scope="module")
def source():
    folder = find_model("pendubot")
    model = lowered_model(folder)
    return derivation_of(folder), model, [s.as_dict() for s in library_sets(model, folder)]


@pytest.fixture(scope="module")
def host():
    return CompiledUnderTest(host_model(open_generated("pendubot")), "c-host")


class Spoilt:
    """The host's answers with one of them changed."""

    def __init__(self, host, function, output, change, name="c-host"):
        self.host, self.function, self.output, self.change = host, function, output, change
        self.name = name

    def evaluate(self, function, values):
        outputs = self.host.evaluate(function, values)
        if function == self.function:
            outputs[self.output] = self.change(outputs[self.output].copy(), values)
        return outputs


def judged(source, subject, target=None, samples=120):
    only = (getattr(subject, "function", "energy"),)
    count = samples if target else 0
    return verify(*source, [subject], target, samples, count, functions=only)


def at_one(value):
    def change(column, values):
        column[7] = value
        return column

    return change


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("function", ["step", "energy"])
def test_one_answer_that_is_no_number_is_an_infinite_error(source, host, function, value):
    output = {"step": "tau", "energy": "energy"}[function]
    found = judged(source, Spoilt(host, function, output, at_one(value)))
    assert found.worst_scaled_ulp == math.inf
    assert not found.passed
    (row,) = [r for r in found.functions if r.function == function]
    assert row.output == output
    assert row.worst_input_scaled_ulp == math.inf


def test_answers_that_are_all_no_number_are_an_infinite_error(source, host):
    found = judged(source, Spoilt(host, "energy", "energy", lambda c, _: np.full_like(c, np.nan)))
    assert found.worst_scaled_ulp == math.inf


def test_no_unit_and_no_answer_make_an_error_small():
    errors = np.array([0.0, 1.0, np.inf, 1.0, np.nan])
    units = np.array([np.nan, np.nan, np.inf, 0.0, 1.0])
    with np.errstate(all="ignore"):
        assert in_units(errors, units).tolist() == [0.0, math.inf, math.inf, math.inf, math.inf]


def test_a_comparison_too_close_to_call_does_not_excuse_an_answer_that_is_no_number():
    column, exact = np.array([np.nan, 2.0, np.nan]), [1.0, 1.0, math.nan]
    judged_, answered = np.zeros(3, bool), np.array([True, True, False])
    assert errors_of(column, exact, judged_, answered).tolist() == [math.inf, 0.0, 0.0]


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("function", "output", "size"),
    [("prepare", "adaptation_step", 3e-15), ("energy", "energy", 1e-14), ("step", "beta", 1e-13)],
)
def test_a_coefficient_off_by_a_few_units_in_the_last_place_is_condemned(
    source, host, function, output, size, sign
):
    """Beyond the limit, and far below a hundred times as much."""
    found = judged(source, Spoilt(host, function, output, lambda c, _: c * (1.0 + sign * size)))
    assert LIMIT_ULP < found.worst_scaled_ulp < 100 * LIMIT_ULP
    assert not found.passed


def test_the_limit_is_four_units():
    assert compare.LIMIT_ULP == 4.0
    row = compare.FunctionResult("step", "c", 10, 4.0, "tau", {}, 4.0, 4.0)
    passing = compare.Verification(10, 4.0, 10, 0, 0, (row,), {})
    assert passing.passed
    assert not compare.Verification(10, 4.0001, 10, 0, 0, (row,), {}).passed
    assert not compare.Verification(10, 4.0, 10, 1, 0, (row,), {}).passed


def test_a_swapped_sign_is_condemned(source, host):
    found = judged(source, Spoilt(host, "acceleration", "ddq1", lambda c, _: -c))
    assert found.worst_scaled_ulp > 1e10


def test_an_answer_that_is_off_only_far_from_the_sets_is_condemned(source, host):
    far = measured_domain(source[1], DOUBLE_UNIT)["q1"] / 2

    def change(column, values):
        return np.where(np.abs(values["q1"]) > far, column * (1 + 1e-13), column)

    found = judged(source, Spoilt(host, "energy", "energy", change))
    assert not found.passed
    assert found.worst_scaled_ulp > 100.0
    (row,) = [r for r in found.functions if r.function == "energy"]
    assert row.worst_scaled_ulp_near_sets < 1.0


def test_an_answer_that_is_off_only_at_rest_or_at_the_edge_is_condemned(source, host):
    edge = measured_domain(source[1], DOUBLE_UNIT)["dq1"]
    for value in (0.0, edge, -edge):

        def change(column, values, value=value):
            return np.where(values["dq1"] == value, column + 1.0 + np.abs(column), column)

        found = judged(source, Spoilt(host, "energy", "energy", change), samples=400)
        assert not found.passed, value


def test_zeros_of_different_sign_are_different_bits(source, host):
    def positive(column, values):
        column[3] = 0.0
        return column

    def negative(column, values):
        column[3] = -0.0
        return column

    here = Spoilt(host, "step", "s", positive)
    there = Spoilt(host, "step", "s", negative, "target")
    assert judged(source, here, there).target_mismatches == 1
    assert judged(source, here, Spoilt(host, "step", "s", positive, "t")).target_mismatches == 0


def test_bits_that_are_no_number_on_both_sides_agree(source, host):
    nan = Spoilt(host, "step", "s", at_one(math.nan))
    same = Spoilt(host, "step", "s", at_one(math.nan), "target")
    assert judged(source, nan, same).target_mismatches == 0


def test_a_function_that_could_not_be_judged_is_not_verified(source, host, monkeypatch):
    monkeypatch.setattr(Condition, "close_calls", lambda self, v, unit: np.ones(120, bool))
    found = judged(source, host)
    assert all(r.undecided == 120 for r in found.functions)
    assert found.worst_scaled_ulp == 0.0
    assert not found.passed


def test_the_named_scale_is_the_sum_over_inputs_and_named_values(source):
    """By hand for E = T + V of the pendubot: nothing is counted twice, nothing ten times."""
    derivation, model, sets = source
    block = derivation.block("energy")
    values = draw(model, block.inputs, sets, 50, np.random.default_rng(3)).values
    named, by_input = Condition(block)(values)
    t = {n: v for n, v in values.items() if n.startswith("theta")}
    q1, q2, dq1, dq2 = (values[n] for n in ("q1", "q2", "dq1", "dq2"))
    g, both = values["g"], q1 + q2
    parts = [
        t["theta1"] * dq1**2 / 2,
        t["theta2"] * (dq1 + dq2) ** 2 / 2,
        t["theta3"] * np.cos(q2) * dq1 * (dq1 + dq2),
        t["theta4"] * g * np.sin(q1),
        t["theta5"] * g * np.sin(both),
    ]
    kinetic, potential = sum(parts[:3]), sum(parts[3:])
    slope1 = (
        t["theta1"] * dq1 + t["theta2"] * (dq1 + dq2) + t["theta3"] * np.cos(q2) * (2 * dq1 + dq2)
    )
    slope2 = t["theta2"] * (dq1 + dq2) + t["theta3"] * np.cos(q2) * dq1
    pull1 = t["theta4"] * g * np.cos(q1) + t["theta5"] * g * np.cos(both)
    pull2 = t["theta5"] * g * np.cos(both) - t["theta3"] * np.sin(q2) * dq1 * (dq1 + dq2)
    inputs = [*parts, dq1 * slope1, dq2 * slope2, q1 * pull1, q2 * pull2, potential]
    own = [kinetic, potential, kinetic + potential, parts[2], parts[3], parts[4]]
    own.append(both * t["theta5"] * g * np.cos(both))
    wanted = sum(np.abs(x) for x in inputs)
    assert by_input["energy"] == pytest.approx(wanted, rel=1e-9)
    assert named["energy"] == pytest.approx(wanted + sum(np.abs(x) for x in own), rel=1e-9)


@pytest.mark.parametrize("unit", [DOUBLE_UNIT, SINGLE_UNIT], ids=["double", "single"])
@pytest.mark.parametrize("bound", [0.1, 1.0, 1000.0])
def test_measurements_are_drawn_within_their_bounds_and_all_over_them(source, bound, unit):
    from dataclasses import replace

    derivation, model, sets = source
    narrow = replace(
        model,
        coordinates=tuple(replace(c, bound=bound, rate_bound=2 * bound) for c in model.coordinates),
    )
    for function in ("step", "swing_up", "energy"):
        inputs = derivation.block(function).inputs
        values = draw(narrow, inputs, sets, 4000, np.random.default_rng(1), unit).values
        for name, most in (("q1", bound), ("dq2", 2 * bound)):
            sizes = np.abs(values[name])
            assert sizes.max() < most
            assert sizes.max() > most * (1 - 1e-6), "the edge itself"
            assert (sizes == 0.0).sum() > 20
            assert ((sizes > 0) & (sizes < 1e-5 * most)).sum() > 50
            assert ((sizes > most / 3) & (sizes < most / 2)).sum() > 100
            assert (values[name] > 0).any()
            assert (values[name] < 0).any()


def test_what_is_folded_into_the_code_is_drawn_with_its_one_value(source):
    derivation, model, sets = source
    inputs = derivation.block("step").inputs
    fixed = dict(sets[0])
    values = draw(model, inputs, sets, 50, np.random.default_rng(1), fixed=fixed).values
    for signal in inputs:
        if signal.group == "parameter":
            assert set(values[signal.name]) == {fixed[signal.name]}
        elif signal.group == "input":
            assert len(set(values[signal.name])) > 20


def test_a_set_folded_into_the_code_refuses_to_be_drawn_around_another():
    from pfaffian.api.checking import baked_set

    manifest = SimpleNamespace(baked="rig", parameter_sets={"rig": {"a": 1.0}})
    code = SimpleNamespace(path="here", manifest=manifest)
    assert baked_set(code, ()) == {"a": 1.0}
    assert baked_set(code, ("rig",)) == {"a": 1.0}
    with pytest.raises(InputError, match="set rig is folded"):
        baked_set(code, ("rig", "sim"))
