"""Sensing in C: counts that never wrap, velocities as theory says, faults told, the same bits."""

import cmath
import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.sensing import (
    BAD_PARAMETER,
    JUMP,
    LOST,
    MISSING,
    NOT_STANDING,
    OK,
    STALE,
    Encoder,
    SensingParameters,
    host_sensing,
    ppc750_sensing,
)
from pfaffian.runtime.contract.runtime_structs import ESTIMATORS

HOST = host_sensing()
PAPER = SensingParameters()
QUANTUM = 2.0 * math.pi / 5000.0
PERIOD = PAPER.sample_time
BOTH = pytest.mark.parametrize("estimator", ESTIMATORS)


def run(parameters, raw, valid=True):
    """Run one channel through readings (n,); outputs have shape (n, 1)."""
    raw = np.asarray(raw, np.int64)
    shown = (raw & ((1 << parameters.counter_bits) - 1)).astype(np.uint32)
    valid = valid if isinstance(valid, bool) else np.asarray(valid)[:, None]
    return HOST.run(HOST.init([parameters]), shown[:, None], valid)


@pytest.mark.parametrize("bits", [16, 24, 32])
@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1), drift=st.floats(-1.0, 1.0), direction=st.sampled_from([1, -1])
)
def test_count_goes_on_while_the_counter_wraps_in_either_direction(bits, seed, drift, direction):
    rng = np.random.default_rng(seed)
    jump = min((1 << (bits - 1)) - 1, (1 << 24) - 1)
    zero = int(rng.integers(0, 1 << bits))
    moves = np.clip(np.rint(jump * (drift + rng.normal(0.0, 0.5, 2000))), -jump, jump)
    start = rng.integers(-jump, jump + 1)
    counts = start + np.concatenate([[0], np.cumsum(moves.astype(np.int64))])
    channel = replace(
        PAPER, counter_bits=bits, counter_zero=zero, largest_jump=jump, longest_gap=0,
        direction=direction, offset=0.25,
    )  # fmt: skip
    found = run(channel, counts + zero)
    assert (found.status == OK).all()
    assert (found.count[:, 0] == counts).all()
    np.testing.assert_allclose(
        found.angle[:, 0], 0.25 + direction * counts * QUANTUM, rtol=1e-15, atol=1e-15
    )


@pytest.mark.parametrize("bits", [16, 24, 32])
@pytest.mark.parametrize("sign", [1, -1])
def test_counter_wraps_many_times_one_way(bits, sign):
    jump = min((1 << (bits - 1)) - 1, (1 << 24) - 1)
    channel = replace(PAPER, counter_bits=bits, largest_jump=jump, longest_gap=0)
    counts = sign * jump * np.arange(6000, dtype=np.int64)
    assert abs(int(counts[-1])) > 20 * (1 << bits)
    assert (run(channel, counts).count[:, 0] == counts).all()


@settings(deadline=None, max_examples=50)
@given(
    angle=st.floats(-1e4, 1e4),
    bits=st.sampled_from([16, 24, 32]),
    zero=st.integers(0, 2**16 - 1),
    direction=st.sampled_from([1, -1]),
)
def test_encoder_and_channel_give_the_angle_to_half_a_count(angle, bits, zero, direction):
    begins = 0.125
    middle = begins + 0.5 * QUANTUM * direction
    common = {"counter_bits": bits, "counter_zero": zero, "direction": direction}
    encoder = Encoder(offset=begins, **common)
    channel = replace(PAPER, offset=middle, **common)
    # The first reading gives the angle within half the counter's range, later ones any angle.
    walk = np.linspace(begins, angle, 2 + int(abs(angle - begins) / (90 * QUANTUM)))
    found = HOST.run(HOST.init([channel]), encoder.raw(walk)[:, None])
    assert (found.status == OK).all()
    assert (found.count[:, 0] == encoder.counts(walk)).all()
    assert np.abs(found.angle[:, 0] - walk).max() <= 0.5 * QUANTUM + 1e-11


@BOTH
@pytest.mark.parametrize("bandwidth", [0.1, 20.0, 300.0, 1000.0])
@pytest.mark.parametrize("counts", [-7, 1, 30])
def test_constant_velocity_is_tracked_without_error(estimator, bandwidth, counts):
    channel = replace(PAPER, estimator=estimator, bandwidth=bandwidth)
    channel = replace(channel, sample_time=0.1 if bandwidth < 1.0 else PERIOD)
    steps = int(60.0 / (bandwidth * channel.sample_time)) + 100
    found = run(channel, counts * np.arange(steps, dtype=np.int64)).velocity[-1, 0]
    exact = counts * QUANTUM / channel.sample_time
    # The recurrence rests where gain r rounds away: r < ulp/(2 gain), so |v - exact| <
    # (1 - kept)/(gain T) ulp/2, which is damping/(w T) ulp, and a few roundings of r itself.
    ulps = 2.0 * max(channel.damping, 1.0) / (bandwidth * channel.sample_time) + 8.0
    assert abs(found - exact) <= ulps * np.spacing(abs(exact))


def theory(channel, z):
    """Velocity estimate over angle at `z`, from what the estimators are to be.

    A difference quotient, the poles of the continuous estimator by the trapezoidal rule, and gain 1
    at constant velocity.
    """
    w, d = channel.bandwidth, channel.damping
    poles = [-w] if channel.estimator == "difference" else np.roots([1.0, 2.0 * d * w, w * w])
    half = 0.5 * channel.sample_time
    gain = (1.0 - 1.0 / z) / channel.sample_time
    for pole in poles:
        place = (1.0 + pole * half) / (1.0 - pole * half)
        gain = gain * (1.0 - place) / (1.0 - place / z)
    return gain


@BOTH
@pytest.mark.parametrize("damping", [0.5, math.sqrt(0.5), 1.0])
@pytest.mark.parametrize("bandwidth", [30.0, 300.0, 1000.0])
@pytest.mark.parametrize("steps", [1257, 314, 63])  # a turn: 5, 20 and 100 rad/s
def test_frequency_response_is_the_theoretical_one(estimator, damping, bandwidth, steps):
    channel = replace(PAPER, estimator=estimator, bandwidth=bandwidth, damping=damping)
    amplitude, turns = 0.6, 3 + math.ceil(4000 / steps)
    wave = 2.0 * math.pi / steps * np.arange(turns * steps)
    raw = Encoder().raw(amplitude * np.sin(wave))
    found = HOST.run(HOST.init([channel]), raw[:, None])
    assert (found.status == OK).all()
    last = slice(-steps, None)
    measured = 2j / steps * np.sum(found.velocity[last, 0] * np.exp(-1j * wave[last]))
    expected = amplitude * theory(channel, cmath.exp(2j * math.pi / steps))
    # Rounding to counts adds at most half a count to each reading (and a constant): at this
    # frequency (2/N) sum |cos| half a count, and sum |cos| < (2/pi) N + 2. What is left of the
    # start after 4 s is below e^-60.
    added = (2.0 / math.pi + 2.0 / steps) * QUANTUM
    assert abs(measured - expected) <= added / amplitude * abs(expected)


@BOTH
def test_raw_difference_is_quantised_and_the_estimate_is_not(estimator):
    speed = 0.3  # rad/s, a quarter of the 1.257 rad/s that one count a period stands for
    raw = Encoder().raw(speed * PERIOD * np.arange(4000))
    differences = np.diff(raw.astype(np.int64)) * QUANTUM / PERIOD
    assert set(np.round(differences, 3)) == {0.0, 1.257}
    found = run(replace(PAPER, estimator=estimator, bandwidth=50.0), raw).velocity[2000:, 0]
    assert np.abs(found - speed).max() < 0.25 * 1.257


def test_jump_is_reported_held_over_and_forgotten_when_it_was_a_glitch():
    counts = 20 * np.arange(300, dtype=np.int64)
    spoiled = counts.copy()
    spoiled[200:203] += [5000, -3000, 101 * 3]
    clean, found = run(PAPER, counts), run(PAPER, spoiled)
    assert found.status[199:204, 0].tolist() == [OK, JUMP, JUMP, JUMP, OK]
    assert (found.angle[200:203] == found.angle[199]).all()
    assert (found.velocity[200:203] == found.velocity[199]).all()
    assert (found.count[203:] == clean.count[203:]).all()
    np.testing.assert_allclose(found.velocity[203:], clean.velocity[203:], rtol=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
def test_largest_jump_itself_is_taken_and_one_more_count_is_not(sign):
    assert run(PAPER, [0, sign * 100]).status[:, 0].tolist() == [OK, OK]
    assert run(PAPER, [0, sign * 101]).status[:, 0].tolist() == [OK, JUMP]
    bridged = run(PAPER, [0, 0, sign * 200, sign * 301], valid=[True, False, True, True])
    assert bridged.status[:, 0].tolist() == [OK, MISSING, OK, JUMP]


@BOTH
def test_gap_at_constant_velocity_is_bridged(estimator):
    counts = 12 * np.arange(2000, dtype=np.int64)
    valid = np.random.default_rng(3).random(2000) > 0.4
    valid[0] = valid[-1] = True
    gaps = np.diff(np.flatnonzero(valid)).max() - 1
    channel = replace(PAPER, estimator=estimator, longest_gap=int(gaps))
    found = run(channel, np.where(valid, counts, 77), valid)
    assert set(found.status[:, 0]) == {OK, MISSING}
    assert found.count[-1, 0] == counts[-1]
    np.testing.assert_allclose(found.velocity[-1, 0], 12 * QUANTUM / PERIOD, rtol=1e-12)


def test_same_value_again_and_again_is_no_fault_but_no_reading_is():
    assert (run(PAPER, np.full(1000, 9)).status == OK).all()
    raw, valid = np.arange(40), np.ones(40, bool)
    valid[10:19] = False  # nine periods, one more than may be bridged
    state = HOST.init([PAPER])
    found = HOST.run(state, raw.astype(np.uint32)[:, None], valid[:, None])
    assert found.status[9:19, 0].tolist() == [OK, *[MISSING] * 8, STALE]
    assert (found.status[19:] == STALE).all()
    assert (found.count[10:] == found.count[9]).all()
    assert (run(PAPER, raw).status == OK).all()  # after another init


@pytest.mark.parametrize("shift", [101, 150, 250, 50_000])
def test_a_jump_that_stays_is_a_lost_position_and_never_motion(shift):
    """A shift within reach of two or more periods was taken as motion a period later."""
    moving = 3 * np.arange(60)
    found = run(PAPER, moving + np.where(np.arange(60) < 20, 0, shift))
    assert found.status[20:, 0].tolist() == [JUMP, *[LOST] * 39]
    assert (found.count[20:] == moving[19]).all()
    assert (found.velocity[20:] == found.velocity[19]).all()


def test_a_counter_that_comes_back_later_is_as_lost_as_before():
    found = run(PAPER, [0, 0, 5000, 5000, 0, 0, 0])
    assert found.status[:, 0].tolist() == [OK, OK, JUMP, LOST, LOST, LOST, LOST]


def test_a_jump_behind_which_no_reading_follows_is_a_lost_position():
    found = run(PAPER, [0, 0, 5000, 0, 0], valid=[True, True, True, False, True])
    assert found.status[:, 0].tolist() == [OK, OK, JUMP, LOST, LOST]


@pytest.mark.parametrize("lost", [LOST, STALE])
def test_a_position_is_known_again_where_it_is_said_and_nowhere_else(lost):
    state, angle = HOST.init([PAPER]), -0.5 * math.pi
    gone = [np.r_[np.full(5, 7), np.full(5, 9000)], np.ones(10)]
    if lost == STALE:
        gone = [np.full(20, 7), np.r_[1, np.zeros(19)]]
    found = HOST.run(state, gone[0].astype(np.uint32)[:, None], gone[1].astype(np.uint32)[:, None])
    assert found.status[-1, 0] == lost
    rest = np.array([9000, 9001, 9000, 9000, 9001], np.uint32)[:, None]
    assert (HOST.run(state, rest).status == lost).all()
    before = state.copy()
    assert HOST.rezero(state, [angle], 50).tolist() == [NOT_STANDING]
    for bad in (math.nan, math.inf, -1000.1, 1e300):
        assert HOST.rezero(state, [bad], 1).tolist() == [BAD_PARAMETER]
    assert HOST.rezero(state, [angle], 0).tolist() == [NOT_STANDING]
    assert state.tobytes() == before.tobytes()
    assert HOST.rezero(state, [angle], 5).tolist() == [OK]
    after = HOST.run(state, np.arange(9002, 9012, dtype=np.uint32)[:, None])
    assert (after.status == OK).all()
    assert after.count[:, 0].tolist() == list(range(-1249, -1239))
    assert after.angle[0, 0] == pytest.approx(angle + QUANTUM, abs=1e-12)


def test_readings_that_move_or_are_missing_are_not_at_rest():
    for raw, valid in (
        ([0, 1, 2, 3, 4, 5], True),
        ([0, 0, 0, 0, 2, 2], True),
        ([0, 0, 0, 0, 0, 0], [True] * 4 + [False, True]),
        ([0, 0, 0, 0, 0, 0], [True] * 5 + [False]),
    ):
        state = HOST.init([PAPER])
        given = np.asarray(valid)[:, None] if isinstance(valid, list) else valid
        HOST.run(state, np.array(raw, np.uint32)[:, None], given)
        assert HOST.rezero(state, [0.0], 4).tolist() == [NOT_STANDING]


@pytest.mark.target
def test_the_target_sets_the_same_position():
    rng = np.random.default_rng(8)
    channels = [
        replace(PAPER, counts_per_turn=float(n), offset=float(o), direction=int(d))
        for n, o, d in zip(
            10.0 ** rng.uniform(1.0, 9.6, 200), rng.normal(0.0, 9.0, 200),
            rng.choice([-1, 1], 200), strict=True,
        )
    ]  # fmt: skip
    angles, raw = rng.uniform(-1000.0, 1000.0, 200), np.full((3, 200), 77, np.uint32)
    rows = []
    for module in (HOST, ppc750_sensing()):
        state = module.init(channels)
        module.run(state, raw)
        assert (module.rezero(state, angles, 3) == OK).all()
        rows.append(module.run(state, raw[:1]))
    exact = (angles - [c.offset for c in channels]) / [
        2 * math.pi / c.counts_per_turn for c in channels
    ]
    exact = exact * [c.direction for c in channels]
    assert (np.abs(rows[0].count[0] - exact) <= 0.5 + 1e-9 * np.abs(exact)).all()
    assert rows[0].count.tobytes() == rows[1].count.tobytes()
    assert rows[0].angle.tobytes() == rows[1].angle.tobytes()


def test_another_angle_of_a_count_starts_the_velocity_afresh():
    """Else it stood in the old unit, or had the old sign."""
    state = HOST.init([PAPER])
    HOST.run(state, (10 * np.arange(500)).astype(np.uint32)[:, None])
    assert state["velocity"][0] > 10.0
    for change, kept in (({"bandwidth": 100.0}, True), ({"direction": -1}, False)):
        before = float(state["velocity"][0])
        assert HOST.retune(state, [replace(PAPER, **change)]).tolist() == [OK]
        assert float(state["velocity"][0]) == (before if kept else 0.0)


_BAD = [
    *(("counts_per_turn", v) for v in (3.9, -5000.0, 2.0**33)),
    *(("offset", v) for v in (1001.0, -1001.0)),
    *(("sample_time", v) for v in (0.0, -1e-3, 9e-7, 1.1)),
    *(("bandwidth", v) for v in (0.0, -300.0, 0.09, 1001.0, 1e308)),
    *(("damping", v) for v in (0.49, 2.01, -0.7)),
    *((n, v) for n in ("counts_per_turn", "offset", "sample_time", "bandwidth", "damping")
      for v in (math.nan, math.inf, -math.inf)),
    *(("estimator", v) for v in (2, 2**32 - 1)),
    *(("counter_bits", v) for v in (0, 7, 33, 2**32 - 1)),
    *(("counter_zero", v) for v in (2**16, 2**32 - 1)),
    *(("largest_jump", v) for v in (0, 3641, 2**32 - 1)),  # 3640 * 9 < 2^15
    *(("longest_gap", v) for v in (65, 327, 2**32 - 1)),
    *(("direction", v) for v in (0, 2, -2, -(2**31))),
]  # fmt: skip
GOOD = {**asdict(PAPER), "estimator": 0, "counter_bits": 16}


@pytest.mark.parametrize(("name", "value"), _BAD)
def test_bad_parameter_is_refused_and_the_channel_stays_dead(name, value):
    state, status = HOST.init_records([GOOD, {**GOOD, name: value}])
    assert status.tolist() == [OK, BAD_PARAMETER]
    assert state[1].tobytes() == bytes(state.dtype.itemsize)
    found = HOST.run(state, np.full((3, 1), 5, np.uint32))
    assert (found.status[:, 1] == BAD_PARAMETER).all()
    for signal in (found.angle, found.velocity, found.count):
        assert not signal[:, 1].any()


@pytest.mark.parametrize(("name", "value"), [("bandwidth", 1e4), ("estimator", "kalman")])
def test_python_says_which_channel_is_bad(name, value):
    with pytest.raises(InputError) as error:
        HOST.init([PAPER, replace(PAPER, **{name: value})])
    assert "kalman" in str(error.value) or "bandwidth=10000.0" in str(error.value)
    assert error.value.remedy


#: Corners of what the parameter check admits.
CORNERS = [
    replace(PAPER, estimator=e, bandwidth=x / t, sample_time=t, damping=d, counts_per_turn=n,
            counter_bits=b, largest_jump=min((1 << (b - 1)) - 1, 2**18) // (g + 1), longest_gap=g,
            offset=-1000.0)
    for e in ESTIMATORS for x in (1.01e-4, 0.99) for t in (1e-6, 1.0) for d in (0.5, 2.0)
    for n in (4.0, 2.0**32) for b, g in ((8, 0), (16, 64), (32, 64))
]  # fmt: skip


def garbage(count, channels, seed):
    rng = np.random.default_rng(seed)
    shape = (count, channels)
    raw = rng.integers(0, 2**32, shape, dtype=np.uint32)
    near = np.cumsum(rng.integers(-300, 301, shape), axis=0).astype(np.uint32)
    kind = rng.random(shape)
    raw = np.where(kind < 0.8, near, np.where(kind < 0.9, raw & 0xFF, raw))
    valid = np.where(rng.random(shape) < 0.7, 1, rng.integers(0, 2**32, shape) & ~1)
    return raw, valid.astype(np.uint32)


@pytest.mark.parametrize("seed", range(4))
def test_garbage_gives_finite_and_bounded_outputs(seed):
    raw, valid = garbage(3000, len(CORNERS), seed)
    found = HOST.run(HOST.init(CORNERS), raw, valid)
    assert set(np.unique(found.status)) <= {OK, MISSING, JUMP, STALE, LOST}
    assert np.isfinite(found.angle).all()
    # A change of more than largest_jump a period is never let in; with damping 0.5 or more the
    # estimators pass on at most 1/tanh(0.907) = 1.39 times the largest velocity they see.
    fastest = np.array(
        [c.largest_jump * 2 * math.pi / c.counts_per_turn / c.sample_time for c in CORNERS]
    )
    assert (np.abs(found.velocity) <= 1.5 * fastest).all()


@pytest.mark.parametrize(
    "spoiled",
    [
        {"missed": 2**32 - 2, "longest_gap": 2**32 - 1},
        {"missed": 65, "longest_gap": 2**32 - 1},
        {"count": 2**62 + 1},
        {"count": -(2**62) - 1},
        {"count": -(2**63)},
    ],
)
def test_a_memory_that_was_overwritten_is_stale_at_once(spoiled):
    """A gap of 2^32 periods was bridged period by period, for half a minute."""
    state = HOST.init([PAPER])
    HOST.run(state, np.zeros((1, 1), np.uint32))
    for name, value in spoiled.items():
        state[name] = value
    found = HOST.run(state, np.ones((3, 1), np.uint32))
    assert (found.status == STALE).all()
    assert np.isfinite(found.angle).all()


@pytest.mark.target
@pytest.mark.parametrize("toolchain", ["zig", "gcc"])
def test_host_and_powerpc_give_the_same_bits(toolchain):
    from pfaffian.runtime.base.errors import MissingToolError

    try:
        target = ppc750_sensing(toolchain)
    except MissingToolError as error:
        pytest.skip(str(error))
    channels = [
        replace(PAPER, estimator=e, bandwidth=b, counter_bits=bits, counts_per_turn=n, direction=d)
        for e in ESTIMATORS for b in (20.0, 300.0)
        for bits, n, d in ((16, 5000.0, 1), (24, 4096.0, -1))
    ]  # fmt: skip
    rng = np.random.default_rng(11)
    walk = np.cumsum(rng.integers(-40, 61, (20_000, len(channels))), axis=0)
    valid = rng.random(walk.shape) > 0.05
    hit = rng.random(walk.shape) < 0.01
    hit[1:] &= ~hit[:-1]  # a glitch of one period, and a reading behind it
    walk[hit] += 5000
    valid[1:] |= hit[:-1]
    here = HOST.run(HOST.init(channels), walk.astype(np.uint32), valid)
    there = target.run(target.init(channels), walk.astype(np.uint32), valid)
    assert set(np.unique(here.status)) == {OK, MISSING, JUMP}
    assert here.count[-1, 0] > 2 * 2**16
    for name in ("angle", "velocity", "count", "status"):
        assert getattr(here, name).tobytes() == getattr(there, name).tobytes(), name


def test_garbage_gives_the_same_bits_with_another_compiler():
    pytest.importorskip("ziglang", reason="needs the package ziglang")
    other = host_sensing("zig")
    raw, valid = garbage(500, len(CORNERS), 9)
    here, there = (m.run(m.init(CORNERS), raw, valid) for m in (HOST, other))
    assert here.velocity.tobytes() == there.velocity.tobytes()
    assert here.angle.tobytes() == there.angle.tobytes()
