"""Checksum, limits and whole turns of the supervisor's module."""

import math
import sys
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pfaffian.runtime.base.checksum import checksum_of
from pfaffian.runtime.code.supervision import ppc750_supervisor
from support_supervisor import HOST

ANY = st.floats()
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
LIMITS = st.floats(0.0, sys.float_info.max)
ANGLES = st.one_of(st.floats(-1e4, 1e4), st.floats(-3e9, 3e9), st.floats(-10.0, 10.0))
MANY = settings(deadline=None, max_examples=500)


def one(function, *values):
    """Return `function` of one row of doubles."""
    return float(function(*(np.array([v], np.float64) for v in values))[0])


def test_every_flipped_bit_of_a_block_changes_its_checksum():
    rng = np.random.default_rng(60)
    block = rng.normal(0.0, 1e3, 60)
    blocks = np.repeat(block[None].view(np.uint64), 3840 + 1, axis=0)
    bits = np.arange(3840)
    blocks[bits, bits // 64] ^= np.uint64(1) << (bits % 64).astype(np.uint64)
    sums = HOST.checksums(blocks.view(np.float64))
    assert sums[-1] == checksum_of(block.tolist())
    assert not (sums[:-1] == sums[-1]).any()
    assert len(set(sums.tolist())) == len(sums)  # nor do any two flips cancel each other


def test_flipped_signs_of_two_members_do_not_cancel():
    block = np.random.default_rng(62).normal(0.0, 1e3, 60)
    rows = [block]
    for i in range(60):
        for k in range(i):
            row = block.copy()
            row[[i, k]] *= -1.0
            rows.append(row)
    sums = HOST.checksums(np.array(rows))
    assert len(set(sums.tolist())) == len(rows)


def test_every_change_of_one_word_changes_the_checksum():
    rng = np.random.default_rng(61)
    words = np.repeat(rng.integers(0, 2**32, (1, 120), np.uint32), 20_001, axis=0)
    where = rng.integers(0, 120, 20_000)
    words[np.arange(20_000), where] += rng.integers(1, 2**32, 20_000, np.uint32)
    sums = HOST.checksums(words.view(np.float64))
    assert not (sums[:-1] == sums[-1]).any()


@MANY
@given(st.lists(ANY, min_size=1, max_size=8))
@example([math.nan, -0.0, 0.0, -math.inf, 5e-324])
def test_checksum_is_that_of_the_generator(values):
    assert int(HOST.checksums(np.array([values]))[0]) == checksum_of(values)


def test_order_and_sign_of_zero_count_in_the_checksum():
    sums = HOST.checksums(np.array([[1.0, 2.0], [2.0, 1.0], [0.0, 0.0], [-0.0, 0.0]]))
    assert len(set(sums.tolist())) == 4


@MANY
@given(value=ANY, limit=ANY)
def test_limited_is_within_the_limit_and_changes_nothing_that_is(value, limit):
    found = one(HOST.limited, value, limit)
    if not 0.0 <= limit < math.inf or math.isnan(value):
        assert found == 0.0
    else:
        assert found == min(max(value, -limit), limit)


@MANY
@given(value=ANY, previous=ANY, step=ANY, limit=ANY)
def test_slewed_is_finite_and_within_the_limit_for_any_bits(value, previous, step, limit):
    found = one(HOST.slewed, value, previous, step, limit)
    assert abs(found) <= (limit if 0.0 <= limit < math.inf else 0.0)


@MANY
@given(value=ANY, share=st.floats(-1.0, 1.0), step=LIMITS, limit=LIMITS)
@example(value=2.0, share=1.0, step=1e-17, limit=1.0)
def test_slewed_moves_towards_the_value_by_no_more_than_a_step(value, share, step, limit):
    previous = share * limit
    found = one(HOST.slewed, value, previous, step, limit)
    wanted = one(HOST.limited, value, limit)
    assert previous - step <= found <= previous + step  # as rounded: exact were it exact
    assert abs(Fraction(found) - Fraction(previous)) <= Fraction(step) + Fraction(
        math.ulp(max(abs(previous), abs(found))) / 2.0
    )
    assert min(previous, wanted) <= found <= max(previous, wanted)
    if abs(Fraction(wanted) - Fraction(previous)) <= Fraction(step):
        assert found == wanted


@MANY
@given(value=NUMBERS, previous=NUMBERS, step=LIMITS, limit=LIMITS)
def test_slewed_from_beyond_the_limit_goes_no_further_than_the_limit_needs(
    value, previous, step, limit
):
    found = one(HOST.slewed, value, previous, step, limit)
    nearest = min(max(previous, -limit), limit)
    most = Fraction(step) + Fraction(math.ulp(max(abs(previous), step)))
    assert abs(Fraction(found) - Fraction(nearest)) <= most


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -1.0])
def test_slewed_without_a_usable_step_or_previous_value_is_limited_alone(bad):
    assert one(HOST.slewed, 5.0, 0.0, bad, 3.0) == 3.0
    assert one(HOST.slewed, 1.0, 0.0, bad, 3.0) == 1.0
    if bad != -1.0:
        assert one(HOST.slewed, 5.0, bad, 0.1, 3.0) == 3.0


def turned(angle, reference, found):
    """Return (error of the turns, distance from the reference) with 60 digits, and M."""
    with mpmath.workdps(60):
        turn = 2 * mpmath.pi
        whole = mpmath.nint((mpmath.mpf(angle) - mpmath.mpf(found)) / turn)
        error = abs(mpmath.mpf(found) - (mpmath.mpf(angle) - whole * turn))
        return error, abs(mpmath.mpf(found) - reference), max(abs(angle), abs(reference))


@MANY
@given(angle=ANGLES, reference=ANGLES)
@example(angle=math.pi, reference=0.0)
@example(angle=3.1e9, reference=-3.1e9)
@example(angle=math.pi * (2e5 + 1.0), reference=0.0)
def test_nearest_turn_is_within_its_bounds_of_exact_turns(angle, reference):
    found = one(HOST.nearest_turn, angle, reference)
    if abs(angle - reference) > 6.28e9:
        return
    error, distance, size = turned(angle, reference, found)
    assert error <= 2.0**-51 * (size + 2.0)
    with mpmath.workdps(60):
        assert distance <= mpmath.pi + 2.0**-49 * (mpmath.mpf(size) + 1)


@MANY
@given(angle=st.floats(-100.0, 100.0), share=st.floats(-0.999999, 0.999999))
def test_an_angle_within_half_a_turn_of_the_reference_is_left_alone(angle, share):
    assert one(HOST.nearest_turn, angle, angle + share * math.pi) == angle


@pytest.mark.parametrize(
    ("angle", "reference"),
    [(math.nan, 0.0), (1.0, math.nan), (math.inf, 1.0), (1.0, -math.inf), (7e9, 0.0),
     (1e308, -1e308), (-1e300, 1.0)],
)  # fmt: skip
def test_what_is_too_many_turns_away_or_no_number_is_left_alone(angle, reference):
    found = one(HOST.nearest_turn, angle, reference)
    assert found == angle or (math.isnan(found) and math.isnan(angle))


@pytest.mark.target
def test_target_computes_the_same_bits():
    rng, target = np.random.default_rng(5), ppc750_supervisor()
    words = rng.integers(0, 2**64, (4, 20_000), np.uint64)
    bits = words.view(np.float64)
    near = rng.normal(0.0, 10.0, (4, 20_000))
    columns = np.where(rng.random((4, 20_000)) < 0.3, bits, near)
    for module in ("limited", "slewed", "nearest_turn"):
        rows = columns[: {"limited": 2, "slewed": 4, "nearest_turn": 2}[module]]
        host, there = (getattr(m, module)(*rows) for m in (HOST, target))
        number = ~np.isnan(host)
        assert (np.isnan(there) == ~number).all()
        assert (host.view(np.uint64)[number] == there.view(np.uint64)[number]).all()
    blocks = bits[:, :6000].reshape(-1, 60)
    assert (HOST.checksums(blocks) == target.checksums(blocks)).all()
    assert HOST.checksums(blocks)[7] == checksum_of(blocks[7].tolist())
