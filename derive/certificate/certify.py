"""The certificate as a whole: region, assumptions, Theorem 1, and a flight to compare with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pfaffian.derive.certificate.region import Region, region_around
from pfaffian.derive.certificate.theorem import Pursuit, Theorem, Ultimate, product
from pfaffian.derive.certificate.uncertainty import (
    DETERMINANT,
    assumption_program,
    following_program,
)
from pfaffian.derive.derivation.derive import Derivation
from pfaffian.derive.ir.evaluate_arrays import evaluate_at
from pfaffian.derive.ir.extrema import Extremum, greatest, least, objective_of
from pfaffian.derive.ir.program import Program
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.flight.continuous import ABSOLUTE, ContinuousFlight
from pfaffian.runtime.flight.scenario import Scenario

#: dbar in units of dunder: any factor above 1 will do, and T grows without bound towards 1.
DBAR_FACTOR = 1.1
#: Shares of the hull of a flight by which the default region is wider, the first that is regular.
_MARGINS = (0.2, 0.1, 0.05, 0.02, 0.0)
#: What the solver's error may add to a value seen in flight, relative.
_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Assumptions:
    """Assumptions 1 and 2 over `region`: least |ADB| [1/(kg m^2)], greatest |Fhat| [N m], alpha =
    sup |Fhat|/Pi [N m] and sup |Fhat|/(kappa |ADB|) [rad/s]. All bounds are rigorous.

    With several actuators |ADB| is the least singular value of ADB and |Fhat| a length.
    """

    region: Region
    gain: Extremum
    force: Extremum
    alpha: Extremum
    pursuit: Extremum

    @property
    def lmin(self) -> float:
        """Return the least (ADB)^2, or eigenvalue of ADB (ADB)^T, of (13), rounded down."""
        return self.gain.bound**2 * (1.0 - 1e-15)


@dataclass(frozen=True)
class Claim:
    """A bound beside what a flight showed: `form` is `printed`, `scaled` or `p2`.

    `bound` holds for all time, `ultimate` after `settling` seconds; `largest` and `late` are the
    greatest values seen at any time and after that (`late` absent where the flight is shorter).
    Numbers in rad/s, for `printed` mixed with N m.
    """

    form: str
    start: float
    bound: float
    ultimate: float
    settling: float
    largest: float
    late: float | None

    def broken(self) -> str:
        """Return what the flight showed beyond the bounds and what it resolves, or nothing."""
        if self.largest > self.bound * (1.0 + _TOLERANCE) + ABSOLUTE:
            return f"{self.form}: {self.largest:.4g} passes the bound {self.bound:.4g}"
        if self.late is not None and self.late > self.ultimate * (1.0 + _TOLERANCE) + ABSOLUTE:
            return f"{self.form}: {self.late:.4g} passes the ultimate bound {self.ultimate:.4g}"
        return ""


@dataclass(frozen=True)
class Certificate:
    """Theorem 1 (`theorem`, absent where k1 = 0) and the bound by p2 alone for one scenario.

    `samples` of a flight stand beside it: `claims` compares each bound, `least_slack` is the
    least of bound - V' in 1/s^3, `left` says where the flight left the region, if it did.
    """

    scenario: Scenario
    assumptions: Assumptions
    theorem: Theorem | None
    pursuit: Pursuit
    claims: tuple[Claim, ...]
    samples: int
    least_slack: float
    left: str

    def failure(self) -> str:
        """Return why the flight does not bear the certificate out, or nothing."""
        if self.left:
            return self.left
        if self.least_slack < 0.0:
            return f"V' passed its bound by {-self.least_slack:.3g} 1/s^3 in flight"
        return next((c.broken() for c in self.claims if c.broken()), "")


def check_nominal(scenario: Scenario) -> None:
    """Raise `CheckError` where the plant's inertias or gravity are not the controller's.

    p1 of (17) cancels exactly only then; F of (1) covers forces of q and q', not inertias.
    """
    shared = [n for n in scenario.controller if n in scenario.plant]
    differing = [n for n in shared if scenario.controller[n] != scenario.plant[n]]
    if differing:
        name = differing[0]
        raise CheckError(
            f"{scenario.name}: the plant has {name} = {scenario.plant[name]:g}, the controller "
            f"{scenario.controller[name]:g}: Theorem 1 covers no error in it",
            remedy=f"take plant.{name} out of the scenario",
        )


def check_assumptions(program: Program, scenario: Scenario, region: Region) -> Assumptions:
    """Check assumptions 1 and 2 over `region`.

    Raises `CheckError` naming the place where ADB vanishes.
    """
    fixed = {**scenario.plant, **scenario.controller}
    box = region.box
    gain = least(objective_of(program, "adb", "", fixed), box)
    if not gain.bound > 0.0:
        where = ", ".join(f"{n} = {v:.4g}" for n, v in gain.at.items())
        value = f"|ADB| = {gain.attained:.2g} 1/(kg m^2)"
        if _several(program):
            value = f"ADB has the least singular value {gain.attained:.2g}"
        raise CheckError(
            f"assumption 1 fails: {value} at {where}, within the region {region.text()}",
            remedy="take a smaller --region, or gains with a wider regular region",
        )
    force, alpha, pursuit = (
        greatest(objective_of(program, "fhat", below, fixed), box)
        for below in ("", "regressor", "restraint")
    )
    return Assumptions(region, gain, force, alpha, pursuit)


def _several(program: Program) -> bool:
    """Return whether the assumptions are those of a plant with several actuators."""
    return any(o.name == DETERMINANT for o in program.outputs)


def channels(flight: ContinuousFlight) -> dict[str, Array]:
    """Return q and q' of `flight` by name, each (N,)."""
    names = flight.scenario.folder.manifest.coordinates
    columns = np.hstack([flight.position, flight.rate]).T
    return dict(zip([*names, *(f"d{n}" for n in names)], columns, strict=True))


def default_region(
    program: Program, flight: ContinuousFlight, sides: Mapping[str, tuple[float, float]]
) -> Region:
    """Return the box around `flight` and the setpoint, with the widest margin that is regular.

    `sides` replaces sides of it. Regular means |ADB| (|det ADB| with several actuators) at least
    `singular_threshold`; where no margin is, the box has none and assumption 1 is left to fail.
    """
    scenario = flight.scenario
    fixed = {**scenario.plant, **scenario.controller}
    gain = objective_of(program, DETERMINANT if _several(program) else "adb", "", fixed)
    points = {n: np.append(v, scenario.setpoint.get(n, 0.0)) for n, v in channels(flight).items()}
    for margin in _MARGINS:
        region = Region({**region_around(points, margin).box, **sides})
        if least(gain, region.box).bound >= scenario.controller["singular_threshold"]:
            break
    return region


def beta_rate(program: Program, flight: ContinuousFlight) -> Array:
    """Return beta' = A q'' - b (N,) in 1/s^2 from the accelerations of the plant, (26).

    With m > 1 actuators it has the shape (N, m).
    """
    scenario = flight.scenario
    fixed = {**scenario.plant, **scenario.controller}
    found = evaluate_at(program, {**fixed, **channels(flight)})
    names = scenario.folder.manifest.coordinates

    def row(mark: str) -> Array:
        moved = sum(found[f"a{mark}_{n}"] * flight.acceleration[:, k] for k, n in enumerate(names))
        return np.asarray(moved + found[f"along{mark}"])

    if flight.beta.ndim == 1:
        return row("") + flight.drift
    return np.stack([row(str(r + 1)) for r in range(flight.beta.shape[1])], 1) + flight.drift


def certify(
    derivation: Derivation,
    flight: ContinuousFlight,
    sides: Mapping[str, tuple[float, float]] | None = None,
) -> Certificate:
    """Return the certificate of the flown scenario over a region, compared with the flight.

    `sides` are the sides of the region given by the user; the others are taken around the flight.
    Raises `CheckError` where an assumption fails.
    """
    scenario = flight.scenario
    check_nominal(scenario)
    program = assumption_program(derivation)
    region = default_region(program, flight, sides or {})
    assumptions = check_assumptions(program, scenario, region)
    law, gains, theorem = derivation.spec.law, scenario.controller, None
    kappa, epsilon, k1, k2 = (
        gains[s.name] for s in (law.kappa, law.epsilon, law.adaptation_rate, law.leakage_rate)
    )
    if k1 > 0.0:
        theorem = Theorem(kappa, epsilon, k1, k2, assumptions.lmin, assumptions.alpha.bound)
    pursuit = Pursuit(assumptions.pursuit.bound, kappa, assumptions.lmin, assumptions.force.bound)
    rate = beta_rate(following_program(derivation), flight)
    return Certificate(
        scenario=scenario,
        assumptions=assumptions,
        theorem=theorem,
        pursuit=pursuit,
        claims=_claims(theorem, pursuit, flight),
        samples=len(flight.time),
        least_slack=float(slack(theorem, pursuit, flight, rate).min()),
        left=_leaving(flight, region),
    )


def _claims(
    theorem: Theorem | None, pursuit: Pursuit, flight: ContinuousFlight
) -> tuple[Claim, ...]:
    """Compare every bound with `flight`."""

    def claim(form: str, of: Ultimate | Pursuit, dunder: float, size: Array) -> Claim:
        r, dbar = float(size[0]), DBAR_FACTOR * dunder
        settling = of.settling(dbar, r)
        late = size[flight.time >= settling]
        greatest_late = float(late.max()) if len(late) else None
        return Claim(form, r, of.d(r), dbar, settling, float(size.max()), greatest_late)

    claims = [claim("p2", pursuit, pursuit.ultimate, flight.beta_size)]
    if theorem is not None:
        x = flight.bound - theorem.alpha
        for form, of, y in (
            ("printed", theorem.printed(), x),
            ("scaled", theorem.scaled(), x / math.sqrt(theorem.k1)),
        ):
            claims.append(claim(form, of, of.dunder, np.hypot(flight.beta_size, y)))
    return tuple(claims)


def slack(
    theorem: Theorem | None, pursuit: Pursuit, flight: ContinuousFlight, rate: Array
) -> Array:
    """Return bound - V' (N,) in 1/s^3, the least over all forms; `rate` is beta', as `beta`.

    What rounding may take is added: a negative value is a broken bound.
    """
    fall, size = 2.0 * product(flight.beta, rate), flight.beta_size
    left = pursuit.rate_bound(size) - fall
    rounding = product(np.abs(flight.beta), np.abs(rate) + np.abs(flight.drift)) + 1e-12
    if theorem is not None:
        x = flight.bound - theorem.alpha
        fall = theorem.lyapunov_rate(flight.beta, rate, flight.bound, flight.bound_rate)
        left = np.minimum(left, theorem.rate_bound(size, x) - fall)
        for of, y in (
            (theorem.printed(), x),
            (theorem.scaled(), x / math.sqrt(theorem.k1)),
        ):
            left = np.minimum(left, of.rate_bound(np.hypot(size, y)) - fall)
        rounding = rounding + np.abs(x * flight.bound_rate) / theorem.k1
    return np.asarray(left + 1e-9 * rounding)


def _leaving(flight: ContinuousFlight, region: Region) -> str:
    """Return where `flight` left `region` or ended early, or nothing."""
    points = channels(flight)
    inside = region.contains(points)
    if not inside.all():
        k = int(np.argmin(inside))
        name = next(n for n, (a, b) in region.box.items() if not a <= points[n][k] <= b)
        return (
            f"the flight left the region at {flight.time[k]:.4g} s: {name} = "
            f"{points[name][k]:.4g} is outside [{region.box[name][0]:.4g}, "
            f"{region.box[name][1]:.4g}]"
        )
    return f"the flight ended early: {flight.ended}" if flight.ended else ""
