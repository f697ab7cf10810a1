"""Theorem 1 in numbers: from lmin, alpha and the gains to d(r), dunder and T(dbar, r).

`delta = (beta, ahat - alpha)`, `V = |beta|^2 + (ahat - alpha)^2/k1`. With rho = 0, (39) and (40)
give

    V' <= -2 kappa lmin |beta|^2 + eps/2 - 2 (k2/k1) x^2 + 2 (k2/k1) alpha |x|,  x = ahat - alpha,
       <= -K1 |delta|^2 + K2 |delta| + K3.

The printed |delta| adds rad/s to N m, so its bounds depend on the units chosen. In `z = (beta,
x/sqrt(k1))`, both in rad/s, V = |z|^2 and the same argument needs no gm, gM: that is the second
form given here.

With several actuators beta and bhat = (ADB)^T beta are vectors, |.| is the Euclidean length and
lmin the least eigenvalue of ADB (ADB)^T: |bhat|^2 >= lmin |beta|^2 is all the proof asks of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pfaffian.runtime.base.arrays import Array


def product(left: Array, right: Array) -> Array:
    """Return the product of two signals (N,), or the inner one of two vectors (N, m) a sample."""
    found = left * right
    return np.asarray(found if found.ndim == 1 else found.sum(axis=1))


@dataclass(frozen=True)
class Ultimate:
    """Constants of V' <= -K1 x^2 + K2 x + K3 with gm x^2 <= V <= gM x^2, (42)-(44)."""

    K1: float
    K2: float
    K3: float
    gm: float
    gM: float  # noqa: N815

    @property
    def R(self) -> float:  # noqa: N802
        """Return the positive root of K1 R^2 = K2 R + K3, (43)."""
        return (self.K2 + math.sqrt(self.K2**2 + 4.0 * self.K1 * self.K3)) / (2.0 * self.K1)

    @property
    def dunder(self) -> float:
        """Return what the ultimate bound must exceed, (45)."""
        return math.sqrt(self.gM / self.gm) * self.R

    def d(self, r: float) -> float:
        """Return the bound for all time of a start with |delta| <= r, (43)."""
        return math.sqrt(self.gM / self.gm) * max(self.R, r)

    def rate_bound(self, size: Array) -> Array:
        """Return the bound of V' at |delta| = `size`, shape (N,), (41)."""
        return np.asarray(-self.K1 * size**2 + self.K2 * size + self.K3)

    def settling_printed(self, dbar: float, r: float) -> float:
        """Return T(dbar, r) of (46) in seconds: V falls at its slowest rate all the way."""
        inner = dbar * math.sqrt(self.gm / self.gM)
        if r <= inner:
            return 0.0
        fall = self.K1 * inner**2 - self.K2 * inner - self.K3
        return (self.gM * r**2 - self.gm * inner**2) / fall if fall > 0.0 else math.inf

    def settling(self, dbar: float, r: float) -> float:
        """Return the time in seconds after which |delta| <= dbar, by the comparison principle.

        With w = sqrt(V/gM) <= |delta|: 2 gM w w' <= -K1 (w - R)(w + S), S = K3/(K1 R), from w = r
        down to w = dbar sqrt(gm/gM), which holds |delta| <= dbar from then on. The integral is
        closed; it never exceeds `settling_printed`.
        """
        inner = dbar * math.sqrt(self.gm / self.gM)
        if r <= inner:
            return 0.0
        if inner <= self.R:
            return math.inf
        other = self.K2 / -self.K1 + self.R  # the roots R and -S add up to K2/K1
        logs = self.R * math.log((r - self.R) / (inner - self.R))
        logs += other * math.log((r + other) / (inner + other))
        return 2.0 * self.gM / self.K1 * logs / (self.R + other)


@dataclass(frozen=True)
class Theorem:
    """Theorem 1 for one set of gains, `lmin` in 1/(kg m^2)^2 and `alpha` in N m."""

    kappa: float
    epsilon: float
    k1: float
    k2: float
    lmin: float
    alpha: float

    def printed(self) -> Ultimate:
        """Return the constants for |delta| as printed, its numbers in SI units, (42)-(44)."""
        leak = 2.0 * self.k2 / self.k1
        return Ultimate(
            K1=min(2.0 * self.kappa * self.lmin, leak),
            K2=leak * self.alpha,
            K3=self.epsilon / 2.0,
            gm=min(1.0, 1.0 / self.k1),
            gM=max(1.0, 1.0 / self.k1),
        )

    def scaled(self) -> Ultimate:
        """Return the constants for z = (beta, x/sqrt(k1)) in rad/s, where V = |z|^2."""
        return Ultimate(
            K1=min(2.0 * self.kappa * self.lmin, 2.0 * self.k2),
            K2=2.0 * self.k2 * self.alpha / math.sqrt(self.k1),
            K3=self.epsilon / 2.0,
            gm=1.0,
            gM=1.0,
        )

    def rate_bound(self, beta: Array, x: Array) -> Array:
        """Return the bound of V' before |delta| is introduced, first line of (41), 1/s^3.

        `beta` is |beta| (N,), or beta itself with one actuator.
        """
        leak = 2.0 * self.k2 / self.k1
        fall = 2.0 * self.kappa * self.lmin * beta**2 + leak * x**2
        return np.asarray(self.epsilon / 2.0 + leak * self.alpha * np.abs(x) - fall)

    def lyapunov_rate(
        self, beta: Array, beta_rate: Array, bound: Array, bound_rate: Array
    ) -> Array:
        """Return V' = 2 beta beta' + (2/k1)(ahat - alpha) ahat', (25), 1/s^3.

        `beta` and its rate have the shape (N,), or (N, m) with m > 1 actuators.
        """
        return np.asarray(
            2.0 * product(beta, beta_rate) + 2.0 / self.k1 * (bound - self.alpha) * bound_rate
        )


@dataclass(frozen=True)
class Pursuit:
    """p2 against Fhat, with p3 or without: |beta|' <= -kappa lmin (|beta| - b) where |beta| > b.

    p3 always opposes beta ((34): 2 beta ADB p3 = -2 gamma mu^2), so this holds for the whole law,
    and for k1 = 0, where Theorem 1 divides by zero. `ultimate` is b = sup |Fhat|/(kappa |ADB|) in
    rad/s, at most `coarse`; `kappa` in N m s kg m^2, `lmin` in 1/(kg m^2)^2, `fbar` in N m. For
    several actuators ADB's least singular value stands for |ADB|.
    """

    ultimate: float
    kappa: float
    lmin: float
    fbar: float

    @property
    def coarse(self) -> float:
        """Return fbar/(kappa sqrt(lmin)) in rad/s, the bound from the two extrema apart."""
        return self.fbar / (self.kappa * math.sqrt(self.lmin))

    @property
    def rate(self) -> float:
        """Return kappa lmin in 1/s, the rate at which |beta| - b falls at least."""
        return self.kappa * self.lmin

    def rate_bound(self, beta: Array) -> Array:
        """Return the bound of (beta^2)' in 1/s^3: 2 |ADB beta| fbar is split by Young."""
        return np.asarray(self.fbar**2 / self.kappa - self.rate * beta**2)

    def d(self, r: float) -> float:
        """Return the bound of |beta| for all time from |beta(0)| <= r, rad/s."""
        return max(r, self.ultimate)

    def settling(self, dbar: float, r: float) -> float:
        """Return the time in seconds after which |beta| <= dbar."""
        if r <= dbar:
            return 0.0
        if dbar <= self.ultimate:
            return math.inf
        return math.log((r - self.ultimate) / (dbar - self.ultimate)) / self.rate
