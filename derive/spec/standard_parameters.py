"""The parameters that every control law and every plant of the builder has, in the plant's units.

They are the gains of (15)-(23), the limits of the target, and the standard load and friction of a
coordinate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace

import sympy as sp
from pfaffian.derive.ir.parameter import Parameter
from pfaffian.derive.spec.model_spec import Actuator, Coordinate
from pfaffian.derive.symbolic.units import force_unit, unit_product


@dataclass(frozen=True)
class Domain:
    """How large parameters may be that state no bound of their own, and how small some of them.

    Without bounds a plant has the scale that its parameter sets give it: what double precision
    holds is taken, and code is verified around the sets. `sample_time` and `threshold` have lower
    bounds, which they must exceed where these are zero.
    """

    plant: float = math.inf
    gain: float = math.inf
    law: float = math.inf
    force: float = math.inf
    uncertain: float = math.inf
    setpoint: float = math.inf
    sample_time: tuple[float, float] = (0.0, math.inf)
    threshold: float = 0.0


#: What stands on a table: the domain that the models of the library are verified on.
LABORATORY = Domain(1e4, 1e4, 1e6, 1e4, 1e3, 1e3, (1e-6, 1.0), 1e-9)


def limit_names(actuators: Sequence[Actuator]) -> tuple[str, ...]:
    """Return the names of the limits of the actuators: `torque_limit` where there is one."""
    if len(actuators) == 1:
        return ("torque_limit",)
    return tuple(f"{a.name}_limit" for a in actuators)


def law_parameters(
    actuators: Sequence[Actuator],
    residual_units: Sequence[str],
    domain: Domain,
    stabilised: Sequence[str] | None = None,
) -> tuple[Parameter, ...]:
    """Return the gains of (15)-(23) and the target's limits.

    What runs over all constraints takes the units of the first. `stabilised` are the units of
    those that (2) stabilises, unless these are all; where it is empty, (2) has no gains.
    """
    row = partial(_row, domain)
    force, scaled = actuators[0].unit, _scaled_gain_unit(actuators, residual_units)
    some = stabilised is None or stabilised
    return (
        *(_stabilisation(row, (stabilised or residual_units)[0]) if some else ()),
        row("kappa", unit_product((force, 1), (scaled, -1)), "gain of p2, (18)", latex="\\kappa"),
        row(
            "epsilon",
            unit_product((scaled, 1), (force, 1)),
            "layer of p3, (23)",
            latex="\\varepsilon",
        ),
        *_adaptation(row, force, scaled),
        *_limits(row, actuators, residual_units, domain),
    )


def _row(
    domain: Domain,
    name: str,
    unit: str,
    text: str,
    lower: float = 0.0,
    group: str = "gain",
    *,
    opened: bool = True,
    upper: float | None = None,
    latex: str = "",
) -> Parameter:
    most = domain.law if upper is None else upper
    return Parameter(name, unit, text, group, lower, most, opened, latex=latex)


def _scaled_gain_unit(actuators: Sequence[Actuator], residual_units: Sequence[str]) -> str:
    """Return the unit of ADB s."""
    gain = unit_product((residual_units[0], 1), ("s", -1), (actuators[0].unit, -1))
    return unit_product((gain, 1), (residual_units[0], 1))


def _stabilisation(row: Callable[..., Parameter], unit: str) -> tuple[Parameter, ...]:
    """Return the gains of (2), of constraints in `unit`."""
    return (
        row("sigma", "1/s", "decay rate of the servo-constraint, (2)", latex="\\varsigma"),
        row(
            "eta",
            unit_product((unit, 1), ("s", -1)),
            "bound of the arctan term, (2)",
            opened=False,
            latex="\\eta",
        ),
    )


def _adaptation(row: Callable[..., Parameter], force: str, scaled: str) -> tuple[Parameter, ...]:
    """Return the gains of (15)."""
    return (
        row(
            "k1",
            unit_product((force, 1), ("s", -1), (scaled, -1)),
            "adaptation rate, (15)",
            opened=False,
            latex="\\kappa_1",
        ),
        row("k2", "1/s", "leakage rate, (15)", latex="\\kappa_2"),
        row(
            "bound_initial",
            force,
            "initial estimate of the uncertainty bound, (15)",
            opened=False,
            latex="\\hat\\alpha(t_0)",
        ),
    )


def _limits(
    row: Callable[..., Parameter],
    actuators: Sequence[Actuator],
    residual_units: Sequence[str],
    domain: Domain,
) -> tuple[Parameter, ...]:
    """Return the period, the largest commands and the least |ADB|."""
    several = len(actuators) > 1
    shortest, longest = domain.sample_time
    return (
        row(
            "sample_time",
            "s",
            "period of the controller",
            shortest,
            "target",
            opened=shortest == 0.0,
            upper=longest,
            latex="T",
        ),
        *(
            row(
                name,
                actuator.unit,
                f"largest {actuator.name if several else 'force or torque'} commanded",
                group="target",
                upper=domain.force,
                latex="" if several else "\\tau_{\\max}",
            )
            for name, actuator in zip(limit_names(actuators), actuators, strict=True)
        ),
        row(
            "singular_threshold",
            _determinant_unit(actuators, residual_units),
            f"least |{'det ' if several else ''}ADB| the law divides by",
            domain.threshold,
            "target",
            opened=domain.threshold == 0.0,
            latex="\\underline{a}",
        ),
    )


@dataclass(frozen=True)
class SwingUpGains:
    """Values that a model gives the gains of its energy swing-up law, in SI units."""

    position: float
    rate: float
    energy: float
    damping: float


def swing_up_parameters(coordinate_unit: str, gains: SwingUpGains) -> tuple[Parameter, ...]:
    """Return kP, kD, kE and kV of the energy swing-up law, whose function V_L has no unit.

    `coordinate_unit` is that of the coordinate the actuator acts on; `gains` are the defaults.
    """
    square = (coordinate_unit, -2)
    rows = (
        ("kP", unit_product(square), "weight of the position in V_L", gains.position),
        ("kD", unit_product(("s", 2), square), "weight of the rate in V_L", gains.rate),
        ("kE", "1/J^2", "weight of the energy in V_L", gains.energy),
        ("kV", unit_product(("s", 1), square), "V_L falls by it times rate^2", gains.damping),
    )
    return tuple(
        Parameter(
            name,
            unit,
            f"swing-up: {text}",
            "swing_up",
            0.0,
            1e9,
            lower_open=True,
            default=default,
            latex=f"k_{name[1]}",
        )
        for name, unit, text, default in rows
    )


def _determinant_unit(actuators: Sequence[Actuator], residual_units: Sequence[str]) -> str:
    pairs = zip(residual_units, actuators, strict=False)
    return unit_product(*(f for unit, a in pairs for f in ((unit, 1), ("s", -1), (a.unit, -1))))


def friction_parameters(coordinate: Coordinate, most: float) -> tuple[Parameter, ...]:
    """Return load, viscous and Coulomb friction of one coordinate, each zero unless given.

    They lie within +-`most`.
    """
    force, name = force_unit(coordinate.unit), coordinate.name
    rows = (
        ("load", force, "constant load"),
        ("viscous", unit_product((force, 1), ("s", 1), (coordinate.unit, -1)), "viscous friction"),
        ("coulomb", force, "Coulomb friction, smoothed by tanh"),
        ("coulomb_slope", unit_product(("s", 1), (coordinate.unit, -1)), "slope of that tanh"),
    )
    return tuple(
        Parameter(
            f"{name}_{kind}", unit, f"{text} on {name}", "uncertainty", -most, most, default=0.0
        )
        for kind, unit, text in rows
    )


def friction_force(p: SimpleNamespace, coordinate: Coordinate) -> sp.Expr:
    """Return f(q') of one coordinate, on the left-hand side of (1)."""
    load, viscous, coulomb, slope = (
        getattr(p, f"{coordinate.name}_{kind}")
        for kind in ("load", "viscous", "coulomb", "coulomb_slope")
    )
    rate = coordinate.velocity
    return load + viscous * rate + coulomb * sp.tanh(slope * rate)
