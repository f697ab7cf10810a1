"""The precision of generated C: its type, literals, bounds and the functions it calls.

What a dialect of C writes in double is written in single by the type `float`, literals with an `f`
and functions whose names end in `f`. NumPy is not needed for it: a warm generation imports none.
"""

from __future__ import annotations

import math
import re
import struct
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from pfaffian.derive.emit.local_names import C_LOCALS
from pfaffian.derive.emit.statements import Dialect
from pfaffian.derive.ir.parameter import Parameter
from pfaffian.derive.ir.program import Op
from pfaffian.derive.sets.parameter_set import ParameterSet
from pfaffian.runtime.base.errors import InputError

#: Least and largest magnitude that single precision holds with all of its 24 bits.
LEAST_SINGLE, LARGEST_SINGLE = 2.0**-126, 2.0**128 - 2.0**104
#: The sampled law keeps |bhat| from 0 by 2^-500, which is 0 in single: 2^-60 stands in for it. The
#: squares in |bhat| are subnormal below 2^-63, so it has no digits there anyway, and ahat Pi over
#: 2^-60 does not overflow before (ahat Pi)^2/epsilon does.
STAND_INS: Mapping[float, float] = {2.0**-500: 2.0**-60}


def c_literal(value: float) -> str:
    """Return a C literal of double that reads back to the same bits."""
    text = repr(value)
    return text if any(c in text for c in ".en") else f"{text}.0"


def to_single(value: float) -> float:
    """Return `value` rounded once to single; infinite where it is beyond the largest."""
    try:
        rounded: float = struct.unpack("=f", struct.pack("=f", value))[0]
    except OverflowError:
        return math.copysign(math.inf, value)
    return rounded


def single_at_most(value: float) -> float:
    """Return the largest finite single not above `value`, of which there must be one.

    Subnormal singles, which have lost digits, are left out.
    """
    nearest = to_single(value)
    if abs(nearest) < LEAST_SINGLE:
        return 0.0 if value >= 0.0 else -LEAST_SINGLE
    if nearest <= value and not math.isinf(nearest):
        return nearest
    (bits,) = struct.unpack("=I", struct.pack("=f", nearest))
    below: float = struct.unpack("=f", struct.pack("=I", bits + (1 if nearest < 0.0 else -1)))[0]
    return below


def single_at_least(value: float) -> float:
    """Return the least finite single not below `value`, likewise."""
    return -single_at_most(-value) + 0.0  # a zero without its sign


def single_literal(value: float) -> str:
    """Return a C literal of float for `value`, rounded once, with as few digits as read back.

    Raises `InputError` where single precision cannot hold the value.
    """
    value = STAND_INS.get(value, value)
    single = to_single(value)
    if not _fits(value):
        raise InputError(
            f"the constant {value:g} is out of what single precision holds",
            remedy="scale the model's units, or generate with --precision double",
        )
    for digits in range(1, 10):
        text = f"{single:.{digits}g}"
        # A hair to either side: the compiler rounds the digits once, not by way of double.
        if all(to_single(float(text) * (1.0 + s * 2.0**-50)) == single for s in (-1, 0, 1)):
            break
    return f"{c_literal(float(text))}f"


def _fits(value: float) -> bool:
    return value == 0.0 or LEAST_SINGLE <= abs(to_single(value)) <= LARGEST_SINGLE


@dataclass(frozen=True)
class Precision:
    """How C is written in one precision.

    `real` is the type and `suffix` ends literals and names of functions. `dialect` calls the
    elementary functions, `inline` is what the control step uses. `at_least` and `at_most` round a
    bound inwards: what passes it would pass the exact one.
    """

    name: str
    real: str
    suffix: str
    literal: Callable[[float], str]
    at_least: Callable[[float], float]
    at_most: Callable[[float], float]
    dialect: Dialect
    inline: Dialect
    step_header: str
    elementary_files: tuple[str, ...]
    further_header: str

    def names(self) -> dict[str, str]:
        """Return what templates write the precision with."""
        return {
            "real": self.real,
            "f": self.suffix,
            "guard_f": self.suffix.upper(),
            "step_header": self.step_header,
            "bits": "32" if self.suffix else "64",
            "largest": self.literal(LARGEST_SINGLE if self.suffix else sys.float_info.max),
        }

    def check_set(self, parameters: tuple[Parameter, ...], values: ParameterSet) -> None:
        """Refuse a set whose values this precision cannot hold within their bounds."""
        if self.real == "double":
            return
        known = values.as_dict()
        for p in parameters:
            value = known[p.name]
            low, high = self.at_least(p.lower), self.at_most(p.upper)
            above = to_single(value) > low if p.lower_open else to_single(value) >= low
            if _fits(value) and above and to_single(value) <= high:
                continue
            raise InputError(
                f"parameter set {values.name}: {p.name} = {value:g} {p.unit} is, in single "
                f"precision, out of its bounds {low:g} to {high:g}",
                remedy="move it inwards by a part in ten million, or generate in double",
            )


_DOUBLE_DIALECT = Dialect(
    patterns={
        Op.FMA: "pf_fma({0}, {1}, {2})",
        Op.FMS: "pf_fms({0}, {1}, {2})",
        Op.FNMS: "pf_fnms({0}, {1}, {2})",
        Op.ABS: "pf_abs({0})",
        Op.SIGN: "pf_sign({0})",
        Op.MIN: "pf_min({0}, {1})",
        Op.MAX: "pf_max({0}, {1})",
        Op.SQRT: "pf_sqrt({0})",
        Op.SIN: "pf_sin({0})",
        Op.COS: "pf_cos({0})",
        Op.ATAN: "pf_atan({0})",
        Op.EXP: "pf_exp({0})",
        Op.EXPM1: "pf_expm1({0})",
        Op.TANH: "pf_tanh({0})",
        Op.LOG: "pf_log({0})",
        Op.ASIN: "pf_asin({0})",
        Op.ACOS: "pf_acos({0})",
        Op.SINH: "pf_sinh({0})",
        Op.COSH: "pf_cosh({0})",
        Op.LESS: "({0} < {1})",
        Op.LESS_EQUAL: "({0} <= {1})",
        Op.NOT: "(!{0})",
        Op.AND: "({0} && {1})",
        Op.OR: "({0} || {1})",
        Op.SELECT: "({0} ? {1} : {2})",
    },
    literal=c_literal,
    sincos="pf_sincos",
    truths={"engaged": ""},
    reserved=C_LOCALS,
)

#: The step calls what it needs often as inline functions: same bits, no call.
_DOUBLE_INLINE = replace(
    _DOUBLE_DIALECT,
    patterns={
        **_DOUBLE_DIALECT.patterns,
        Op.SQRT: "pf_sqrt_inline({0})",
        Op.ATAN: "pf_atan_inline({0})",
    },
    sincos="pf_sincos_inline",
    plain={Op.SQRT: "pf_sqrt_normal_inline({0})"},
    plain_sincos="pf_sincos_within_inline",
)

#: Single has ordinary forms alone: the ranges that let double take plain ones are not single's.
_SINGLE_DIALECT = replace(
    _DOUBLE_DIALECT,
    patterns={
        op: re.sub(r"^(pf_\w+)", r"\1f", pattern)
        for op, pattern in _DOUBLE_DIALECT.patterns.items()
    },
    literal=single_literal,
    real="float",
    sincos="pf_sincosf",
)

DOUBLE = Precision(
    name="double",
    real="double",
    suffix="",
    literal=c_literal,
    at_least=lambda bound: bound,
    at_most=lambda bound: bound,
    dialect=_DOUBLE_DIALECT,
    inline=_DOUBLE_INLINE,
    step_header="pf_elementary_inline.h",
    elementary_files=("pf_elementary.c", "pf_elementary.h", "pf_elementary_inline.h"),
    further_header="pf_elementary_further.h",
)
SINGLE = Precision(
    name="single",
    real="float",
    suffix="f",
    literal=single_literal,
    at_least=single_at_least,
    at_most=single_at_most,
    dialect=_SINGLE_DIALECT,
    inline=_SINGLE_DIALECT,
    step_header="pf_elementaryf.h",
    elementary_files=("pf_elementaryf.c", "pf_elementaryf.h"),
    further_header="pf_elementary_furtherf.h",
)
PRECISIONS: Mapping[str, Precision] = {p.name: p for p in (DOUBLE, SINGLE)}


def precision_named(name: str) -> Precision:
    """Return the precision called `name`; raise `InputError` if there is none."""
    if name not in PRECISIONS:
        raise InputError(f"unknown precision {name}", remedy=f"known: {', '.join(PRECISIONS)}")
    return PRECISIONS[name]
