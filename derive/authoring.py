"""Writing a model down: a plant with one actuator in about thirty lines.

The builder declares coordinates, parameters and the gains and limits that every control law of this
package has, so that a specification holds only what is particular to the plant: its energies.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace

import sympy as sp
from pfaffian.derive.dimensions import force_unit, unit_product
from pfaffian.derive.parameters import Parameter
from pfaffian.derive.spec import (
    Actuator,
    Coordinate,
    Matrix,
    ModelSpec,
    ServoConstraint,
    StabilityCondition,
    standard_law,
    symbol_of,
    symbols_of,
)
from pfaffian.runtime.errors import InputError

_LARGE = 1e4


class ModelBuilder:
    """Collects a plant and hands out its frozen `ModelSpec`."""

    def __init__(self, name: str, title: str, source: str) -> None:
        """Start a model; `source` says where its parameters and its constraint come from."""
        self._name, self._title, self._source = name, title, source
        self._coordinates: list[Coordinate] = []
        self._parameters: list[Parameter] = []
        self._actuators: list[Actuator] = []
        self._input_matrix: list[sp.Expr] = []

    def coordinate(
        self, name: str, unit: str, description: str, *, bound: float, rate_bound: float
    ) -> tuple[sp.Symbol, sp.Symbol]:
        """Declare a coordinate with the domain the controller accepts; return (q, q')."""
        made = Coordinate(name, unit, description, bound, rate_bound)
        self._coordinates.append(made)
        return made.position, made.velocity

    def parameter(
        self, name: str, unit: str, description: str, *, upper: float = _LARGE, latex: str = ""
    ) -> sp.Symbol:
        """Declare a positive parameter of the plant and return its symbol."""
        made = Parameter(name, unit, description, "plant", 0.0, upper, True, latex=latex)
        self._parameters.append(made)
        return symbol_of(made)

    def actuator(self, name: str, unit: str, description: str, on: Mapping[str, sp.Expr]) -> None:
        """Declare the actuator; `on` gives its generalised force on each coordinate by name."""
        self._actuators.append(Actuator(name, unit, description))
        unknown = sorted(set(on) - {c.name for c in self._coordinates})
        if unknown:
            raise InputError(
                f"model {self._name}: actuator {name} acts on {unknown[0]}, which is no coordinate",
                remedy="declare the coordinates before the actuator",
            )
        self._input_matrix = [sp.sympify(on.get(c.name, 0)) for c in self._coordinates]

    def build(
        self,
        *,
        kinetic_energy: sp.Expr,
        potential_energy: sp.Expr,
        stability: tuple[StabilityCondition, ...] = (),
        force_bound: float = _LARGE,
    ) -> ModelSpec:
        """Return the specification, with the constraint s = sum_i w_i (q_i' + r_i e_i).

        The weight w of the last coordinate is 1; the others and the rates r are the gains that
        wanted zero-dynamics poles determine: `weight_q`, `rate_q`. The setpoint of q is `qd`.
        """
        if not self._actuators:
            raise InputError(
                f"model {self._name}: no actuator is declared",
                remedy="declare it before build, with the coordinates it acts on",
            )
        friction = [_friction(c) for c in self._coordinates]
        gains = self._gains()
        law = self._law(force_bound)
        parameters = (
            *self._parameters,
            *gains,
            *law,
            *self._setpoints(),
            *(p for f in friction for p in f),
        )
        p = symbols_of(parameters)
        return ModelSpec(
            name=self._name,
            title=self._title,
            source=self._source,
            coordinates=tuple(self._coordinates),
            actuators=tuple(self._actuators),
            parameters=parameters,
            kinetic_energy=sp.sympify(kinetic_energy),
            potential_energy=sp.sympify(potential_energy),
            input_matrix=Matrix(self._input_matrix),
            uncertain_force=Matrix([_force(p, c) for c in self._coordinates]),
            constraint=self._constraint(p),
            law=standard_law(p, p.torque_limit),
            stability=stability,
        )

    def _residual_unit(self) -> str:
        return f"{self._coordinates[-1].unit}/s"

    def _gains(self) -> tuple[Parameter, ...]:
        last = self._coordinates[-1]
        weights = tuple(
            Parameter(
                f"weight_{c.name}",
                unit_product((last.unit, 1), (c.unit, -1)),
                f"weight of {c.name} in the servo-constraint",
                "synthesised",
                -_LARGE,
                _LARGE,
                latex=f"w_{{{c.name}}}",
            )
            for c in self._coordinates[:-1]
        )
        rates = tuple(
            Parameter(
                f"rate_{c.name}",
                "1/s",
                f"rate of the error of {c.name} in the servo-constraint",
                "synthesised",
                -_LARGE,
                _LARGE,
                latex=f"r_{{{c.name}}}",
            )
            for c in self._coordinates
        )
        return (*weights, *rates)

    def _setpoints(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{c.name}d", c.unit, f"setpoint of {c.name}", "gain", -1e3, 1e3, default=0.0)
            for c in self._coordinates
        )

    def _law(self, force_bound: float) -> tuple[Parameter, ...]:
        """Return the gains of (15)-(23) and the target's limits, in the units of this plant."""
        force, residual = self._actuators[0].unit, self._residual_unit()
        gain = unit_product((residual, 1), ("s", -1), (force, -1))
        scaled = unit_product((gain, 1), (residual, 1))

        def row(
            name: str,
            unit: str,
            text: str,
            lower: float = 0.0,
            group: str = "gain",
            *,
            opened: bool = True,
            upper: float = 1e6,
            latex: str = "",
        ) -> Parameter:
            return Parameter(name, unit, text, group, lower, upper, opened, latex=latex)

        return (
            row("sigma", "1/s", "decay rate of the servo-constraint, (2)", latex="\\varsigma"),
            row(
                "eta",
                unit_product((residual, 1), ("s", -1)),
                "bound of the arctan term, (2)",
                opened=False,
                latex="\\eta",
            ),
            row(
                "kappa", unit_product((force, 1), (scaled, -1)), "gain of p2, (18)", latex="\\kappa"
            ),
            row(
                "epsilon",
                unit_product((scaled, 1), (force, 1)),
                "layer of p3, (23)",
                latex="\\varepsilon",
            ),
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
            row(
                "sample_time",
                "s",
                "period of the controller",
                1e-6,
                "target",
                opened=False,
                upper=1.0,
                latex="T",
            ),
            row(
                "torque_limit",
                force,
                "largest force or torque commanded",
                group="target",
                upper=force_bound,
                latex="\\tau_{\\max}",
            ),
            row(
                "singular_threshold",
                gain,
                "least |ADB| the law divides by",
                1e-9,
                "target",
                opened=False,
                latex="\\underline{a}",
            ),
        )

    def _constraint(self, p: SimpleNamespace) -> ServoConstraint:
        errors = [c.position - getattr(p, f"{c.name}d") for c in self._coordinates]
        weights = [*(getattr(p, f"weight_{c.name}") for c in self._coordinates[:-1]), sp.S.One]
        residual = sum(
            w * (c.velocity + getattr(p, f"rate_{c.name}") * e)
            for w, c, e in zip(weights, self._coordinates, errors, strict=True)
        )
        s = sp.Symbol("s", real=True)
        return ServoConstraint(
            residual=Matrix([residual]),
            residual_symbols=(s,),
            residual_units=(self._residual_unit(),),
            drift=Matrix([p.sigma * s + 2 * p.eta / sp.pi * sp.atan(s)]),
            errors=Matrix(errors),
            setpoint=tuple(getattr(p, f"{c.name}d") for c in self._coordinates),
        )


def _friction(coordinate: Coordinate) -> tuple[Parameter, ...]:
    """Return load, viscous and Coulomb friction of one coordinate; all zero unless given."""
    force, name = force_unit(coordinate.unit), coordinate.name
    rows = (
        ("load", force, "constant load"),
        ("viscous", unit_product((force, 1), ("s", 1), (coordinate.unit, -1)), "viscous friction"),
        ("coulomb", force, "Coulomb friction, smoothed by tanh"),
        ("coulomb_slope", unit_product(("s", 1), (coordinate.unit, -1)), "slope of that tanh"),
    )
    return tuple(
        Parameter(
            f"{name}_{kind}", unit, f"{text} on {name}", "uncertainty", -1e3, 1e3, default=0.0
        )
        for kind, unit, text in rows
    )


def _force(p: SimpleNamespace, coordinate: Coordinate) -> sp.Expr:
    """Return f(q') of one coordinate, on the left-hand side of (1)."""
    load, viscous, coulomb, slope = (
        getattr(p, f"{coordinate.name}_{kind}")
        for kind in ("load", "viscous", "coulomb", "coulomb_slope")
    )
    rate = coordinate.velocity
    return load + viscous * rate + coulomb * sp.tanh(slope * rate)
