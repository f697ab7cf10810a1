"""The unit errors are counted in, and the inputs that can be compared, for each precision."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pfaffian.derive.emit.precision import LARGEST_SINGLE, LEAST_SINGLE, PRECISIONS
from pfaffian.derive.ir.parameter import Parameter
from pfaffian.runtime.base.arrays import Array


@dataclass(frozen=True)
class UlpUnit:
    """Units in the last place of the generated C.

    `digits` are the bits of its significand, `least` the exponent of its last subnormal bit.
    Inputs are rounded to it before anyone sees them. Samples are compared only where every value
    on the way lies within `span` or is zero: beyond, digits are lost whatever the formulas.
    A comparison decided by less than `tie`, relative, may fall the other way. An angle that is a
    sum counts up to `angle` radians: rounding a larger one moves its cosine by more than half a
    unit in second order, of which a scale made of derivatives knows nothing.
    """

    precision: str
    digits: int
    least: int
    span: tuple[float, float]
    tie: float
    angle: float

    def last_place(self, scale: Array) -> Array:
        """Return one unit in the last place of each entry of `scale`, shape (N,)."""
        exponents = np.where(scale == 0.0, self.least, np.frexp(scale)[1] - self.digits)
        units: Array = np.ldexp(1.0, np.maximum(exponents, self.least))
        return units

    def bounds(self, parameter: Parameter) -> tuple[float, float]:
        """Return the bounds of `parameter` as the generated code checks them."""
        precision = PRECISIONS[self.precision]
        return precision.at_least(parameter.lower), precision.at_most(parameter.upper)

    def below(self, bound: float) -> float:
        """Return the largest magnitude that the generated code takes below `bound`."""
        if self.precision == "double":
            return float(np.nextafter(bound, 0.0))
        single = np.float32(PRECISIONS[self.precision].at_most(bound))
        return float(np.nextafter(single, np.float32(0.0)))

    def rounded(self, values: Array) -> Array:
        """Return float64 values that this precision holds exactly."""
        if self.precision == "double":
            return values
        with np.errstate(over="ignore"):
            return values.astype(np.float32).astype(float)

    def holds(self, values: Sequence[Array]) -> Array:
        """Return the samples of which every value is zero or within the span, shape (N,)."""
        low, high = self.span
        sizes = np.abs(np.stack(values))
        inside: Array = ((sizes == 0.0) | ((sizes >= low) & (sizes <= high))).all(axis=0)
        return inside


DOUBLE_UNIT = UlpUnit("double", 53, -1074, (0.0, np.inf), 2.0**-40, np.inf)
SINGLE_UNIT = UlpUnit("single", 24, -149, (LEAST_SINGLE, LARGEST_SINGLE), 2.0**-11, 2.0**13)
UNITS: Mapping[str, UlpUnit] = {u.precision: u for u in (DOUBLE_UNIT, SINGLE_UNIT)}
