"""Coefficients of the elementary functions of single precision, by the methods of double.

Tables are those of the same centres, moved until their values fit a single; polynomials are
shorter; pi/16 and ln 2 are split so that the same steps of the reductions are exact in 24 bits.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import mpmath
from pfaffian.derive.elementary.coefficients import SINCOS_MAX, horner, literal
from pfaffian.derive.elementary.fit import (
    DIGITS,
    Polynomial,
    fit_atan,
    fit_exp,
    fit_sin,
    fit_versine,
    split,
    to_single,
)
from pfaffian.derive.elementary.further import FURTHER_ULP_BOUNDS_SINGLE, further_context
from pfaffian.derive.elementary.tables import (
    ATAN_OFFSET,
    ATAN_ROWS_PER_OCTAVE,
    SINCOS_ROWS,
    SINGLE,
    SQRT_SEED_BITS,
    AtanRow,
    SincosRow,
    atan_reach,
    atan_rows,
    sincos_reach,
    sincos_rows,
    sqrt_seeds,
)

#: Bit pattern of the one NaN of single precision the emitted functions ever return.
QUIET_NAN_BITS_SINGLE = 0x7FC00000

#: Error in units in the last place of a single that each function stays below (tested).
ULP_BOUNDS_SINGLE: dict[str, float] = {
    "sqrt": 0.5,
    "sin": 0.95,
    "cos": 0.95,
    "atan": 0.95,
    "exp": 0.8,
    "expm1": 0.95,
    "tanh": 0.9,
    **FURTHER_ULP_BOUNDS_SINGLE,
}

_ROUND_SHIFT = 1.5 * 2.0**23

#: From here on expm1 and exp agree to 2^-28, and expm1(-x) and -1 likewise.
_EXPM1_SPLIT = 20.0

#: tanh differs from 1 by less than 2^-26 from here on; twice it must not exceed the split of expm1.
_TANH_ONE = 9.5

_SLACK = 1 + 2.0**-10


@dataclass(frozen=True)
class SingleCoefficients:
    """Every number the functions of single precision hold; see `ElementaryCoefficients`."""

    steps: float
    step: tuple[float, ...]
    sin: Polynomial
    versine: Polynomial
    sincos_rows: tuple[SincosRow, ...]
    atan: Polynomial
    atan_rows: tuple[AtanRow, ...]
    half_pi: tuple[float, ...]
    log2_e: float
    ln2: tuple[float, ...]
    exp: Polynomial
    exp_overflow: float
    exp_underflow: float


@functools.cache
def single_coefficients() -> SingleCoefficients:
    """Compute all coefficients of single precision; each is the double of a single's value."""
    with mpmath.workdps(DIGITS):
        reach, interval = mpmath.mpf(sincos_reach()) * _SLACK, mpmath.mpf(atan_reach()) * _SLACK
        ln2, step = mpmath.log(2), 2 * mpmath.pi / SINCOS_ROWS
        return SingleCoefficients(
            steps=to_single(1 / step),
            step=split(step, 3, to_single),
            sin=fit_sin(reach, 2, to_single),
            versine=fit_versine(reach, 2, to_single),
            sincos_rows=sincos_rows(SINGLE),
            atan=fit_atan(interval, 3, to_single),
            atan_rows=atan_rows(SINGLE),
            half_pi=split(mpmath.pi / 2, 2, to_single),
            log2_e=to_single(1 / ln2),
            ln2=split(ln2, 2, to_single),
            exp=fit_exp(ln2 / 2 * _SLACK, 6, to_single),
            exp_overflow=_single_below(mpmath.log(mpmath.mpf(2) ** 128 - mpmath.mpf(2) ** 103)),
            exp_underflow=-_single_below(150 * ln2),
        )


def single_render_context() -> dict[str, object]:
    """Return all that the two `pf_elementaryf` templates read, except their `header`."""
    c = single_coefficients()
    first_row = int(math.log2(ATAN_OFFSET) + 127) * ATAN_ROWS_PER_OCTAVE
    seeds, _ = sqrt_seeds()

    def number(value: float) -> dict[str, str]:
        return literal(value, "f")

    return {
        "sincos_max": repr(SINCOS_MAX),
        "sincos_end": number(_single_after(SINCOS_MAX)),
        "nan_bits": f"0x{QUIET_NAN_BITS_SINGLE:08x}",
        "ulp": {name: f"{bound:g}" for name, bound in ULP_BOUNDS_SINGLE.items()},
        "round_shift": number(_ROUND_SHIFT),
        "steps": number(c.steps),
        "step": [number(-part) for part in c.step],
        "sin": horner(c.sin, "f"),
        "versine": horner(c.versine, "f"),
        "sincos_rows": [
            {name: number(getattr(r, name)) for name in ("offset", "sine", "cosine")}
            for r in c.sincos_rows
        ],
        "atan": horner(c.atan, "f"),
        "atan_offset": number(ATAN_OFFSET),
        "atan_first_row": str(first_row),
        "atan_rows": [
            {"tangent": number(r.tangent), "angle": number(r.angle)} for r in c.atan_rows
        ],
        "half_pi": [number(part) for part in c.half_pi],
        "log2_e": number(c.log2_e),
        "ln2": [number(-part) for part in c.ln2],
        "exp": horner(c.exp, "f"),
        "exp_overflow": number(c.exp_overflow),
        "exp_infinite": number(_single_after(c.exp_overflow)),
        "exp_underflow": number(c.exp_underflow),
        "expm1_split": number(_EXPM1_SPLIT),
        "tanh_one": number(_TANH_ONE),
        "half": number(0.5),
        "sqrt_seeds": [f"0x{seed:08x}u" for seed in seeds],
        "sqrt_seed_shift": str(24 - SQRT_SEED_BITS),
        "two_72": number(2.0**72),
        "two_minus_36": number(2.0**-36),
        "further": further_context(number, lambda p: horner(p, "f"), single=True),
    }


def _single_after(value: float) -> float:
    """Return the least single above a positive single."""
    return value + 2.0 ** (math.frexp(value)[1] - 24)


def _single_below(value: mpmath.mpf) -> float:
    """Return the largest single not above a positive `value`."""
    nearest = to_single(value)
    return nearest if nearest <= value else nearest - 2.0 ** (math.frexp(nearest)[1] - 24)
