"""What the velocity estimators cost and give: phase lag and noise behind a quantising encoder.

Every figure is measured on the C module, fed by `Encoder`; nothing here uses their equations.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import CheckError, InputError
from pfaffian.runtime.code.sensing import OK, Encoder, SensingModule, SensingParameters
from pfaffian.runtime.contract.runtime_structs import ESTIMATORS

#: Bandwidths compared [rad/s].
BANDWIDTHS = (20.0, 30.0, 50.0, 70.0, 100.0, 140.0, 200.0, 300.0, 400.0, 600.0, 800.0, 1000.0)
#: Frequencies at which the lag is measured [rad/s]: where the balance law works, and above it.
LAG_FREQUENCIES = (5.0, 20.0)
#: Largest delay at the upper of them that the proposal allows [s]: 5.7 degrees at 20 rad/s.
ALLOWED_DELAY = 5e-3
_AMPLITUDE = 0.5  # of the sinusoid, rad: 398 counts
_SETTLING = 2.0  # s; the slowest estimator has forgotten its start to e^-28
_SINUSOID_TURNS = 20
_SPEEDS = 24
_SPEED_RANGE = (1.0, 10.0)  # rad/s: up to 8 counts a period
_SLOW_SPEED = 0.05  # rad/s: a count every 25 periods
_NOISE_TIME = 4.0  # s a run
_SEED = 20


@dataclass(frozen=True)
class EstimatorFigures:
    """One estimator at one bandwidth [rad/s]: lags by frequency, RMS velocity errors [rad/s].

    `lag_deg` and `delay_ms` go by `LAG_FREQUENCIES`. `moving` is the mean over speeds from 1 to
    10 rad/s, `standstill` with the shaft on the edge between two counts, so that each reading is
    one or the other at random, `slow` at 0.05 rad/s.
    """

    estimator: str
    bandwidth: float
    lag_deg: tuple[float, ...]
    delay_ms: tuple[float, ...]
    moving: float
    standstill: float
    slow: float

    @property
    def noise(self) -> float:
        """Return the largest of the three RMS errors [rad/s]."""
        return max(self.moving, self.standstill, self.slow)


def measured_estimators(
    module: SensingModule,
    base: SensingParameters,
    bandwidths: Sequence[float] = BANDWIDTHS,
    tell: Callable[[str], None] = lambda text: None,
) -> tuple[EstimatorFigures, ...]:
    """Return the figures of both estimators at each of `bandwidths`, otherwise as in `base`."""
    channels = [replace(base, estimator=e, bandwidth=b) for e in ESTIMATORS for b in bandwidths]
    encoder = _encoder_of(base)
    run = partial(_velocities, module, channels)
    lags = []
    for frequency in LAG_FREQUENCIES:
        tell(f"lag at {frequency:g} rad/s")
        lags.append(_lags(run, encoder, base.sample_time, frequency))
    tell("noise at constant speed")
    moving = [_constant_speed(run, encoder, base.sample_time, v) for v in _speeds()]
    tell("noise between two counts and at slow motion")
    standstill = _standstill(run, encoder, base.sample_time)
    slow = _constant_speed(run, encoder, base.sample_time, _SLOW_SPEED)
    rms_moving = np.sqrt(np.mean(np.square(moving), axis=0))
    return tuple(
        EstimatorFigures(
            channel.estimator,
            channel.bandwidth,
            tuple(math.degrees(lag[k]) for lag in lags),
            tuple(1e3 * lag[k] / w for lag, w in zip(lags, LAG_FREQUENCIES, strict=True)),
            float(rms_moving[k]),
            float(standstill[k]),
            float(slow[k]),
        )
        for k, channel in enumerate(channels)
    )


def proposed_estimator(
    figures: Sequence[EstimatorFigures], allowed_delay: float = ALLOWED_DELAY
) -> EstimatorFigures:
    """Return the quietest of `figures` that delays by at most `allowed_delay` [s].

    The delay is that at the highest of `LAG_FREQUENCIES`. Raises `InputError` if none is so quick.
    """
    quick = [f for f in figures if f.delay_ms[-1] <= 1e3 * allowed_delay]
    if not quick:
        least = min(f.delay_ms[-1] for f in figures)
        raise InputError(
            f"no estimator delays by less than {1e3 * allowed_delay:g} ms",
            remedy=f"allow {least:.3g} ms or more, or add bandwidths",
        )
    return min(quick, key=lambda f: f.noise)


def _encoder_of(base: SensingParameters) -> Encoder:
    """Return the encoder that `base` reads without bias: its offset is the middle of a count."""
    width = 2.0 * math.pi / base.counts_per_turn
    begins = base.offset - 0.5 * width * base.direction
    return Encoder(
        base.counts_per_turn, begins, base.counter_bits, base.counter_zero, base.direction
    )


def _velocities(module: SensingModule, channels: Sequence[SensingParameters], raw: Array) -> Array:
    """Return the estimates (n, k) of fresh `channels` for the readings `raw` (n,)."""
    sensed = module.run(module.init(channels), raw[:, None])
    if (sensed.status != OK).any():
        raise CheckError("a reading of the benchmark was refused", remedy="allow a larger jump")
    return sensed.velocity


def _speeds() -> list[float]:
    """Return speeds spread evenly by the golden ratio: none stands in a whole ratio to counts."""
    least, most = _SPEED_RANGE
    golden = (math.sqrt(5.0) - 1.0) / 2.0
    return [least + (most - least) * ((k * golden) % 1.0) for k in range(1, _SPEEDS + 1)]


def _lags(
    run: Callable[[Array], Array], encoder: Encoder, period: float, frequency: float
) -> list[float]:
    """Return by how much [rad] each estimate lags the velocity of a sinusoid."""
    settling = round(_SETTLING / period)
    count = settling + round(_SINUSOID_TURNS * 2.0 * math.pi / (frequency * period))
    phase = frequency * period * np.arange(count)
    found = run(encoder.raw(_AMPLITUDE * np.sin(phase)))[settling:]
    # The velocity is a cosine: correlate with it and with the sine, by least squares, as the
    # window is a whole number of turns only to half a period.
    waves = np.column_stack([np.cos(phase), np.sin(phase), np.ones(count)])[settling:]
    inphase, quadrature, _ = np.linalg.lstsq(waves, found, rcond=None)[0]
    return [-cmath.phase(complex(c, -s)) for c, s in zip(inphase, quadrature, strict=True)]


def _constant_speed(
    run: Callable[[Array], Array], encoder: Encoder, period: float, speed: float
) -> Array:
    """Return the RMS error (k,) of each estimate at constant `speed` [rad/s]."""
    settling = round(_SETTLING / period)
    time = period * np.arange(settling + round(_NOISE_TIME / period))
    return _rms(run(encoder.raw(speed * time))[settling:] - speed)


def _standstill(run: Callable[[Array], Array], encoder: Encoder, period: float) -> Array:
    """Return the RMS estimate (k,) while readings toggle between two counts at random."""
    settling = round(_SETTLING / period)
    count = settling + round(_NOISE_TIME / period)
    side = np.random.default_rng(_SEED).integers(0, 2, count) - 0.5
    edge = encoder.offset
    return _rms(run(encoder.raw(edge + 0.5 * encoder.quantum * side))[settling:])


def _rms(values: Array) -> Array:
    result: Array = np.sqrt(np.mean(np.square(values), axis=0))
    return result
