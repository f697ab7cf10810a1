"""Writing a model down: a plant in about thirty lines.

The builder declares coordinates, parameters and the gains and limits that every control law of this
package has, so that a specification holds only what is particular to the plant: its energies, and
its servo-constraints where they are not the standard one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import sympy as sp
from pfaffian.derive.ir.parameter import Parameter
from pfaffian.derive.spec.exact_numbers import exact_expression
from pfaffian.derive.spec.model_spec import (
    Actuator,
    Coordinate,
    Matrix,
    ModelSpec,
    ServoConstraint,
    StabilityCondition,
    standard_law,
    standard_swing_up,
    symbol_of,
    symbols_of,
)
from pfaffian.derive.spec.reserved_names import objection
from pfaffian.derive.spec.residuals import holonomic, second_order
from pfaffian.derive.spec.source_line import about_constraint
from pfaffian.derive.spec.standard_parameters import (
    Domain,
    SwingUpGains,
    friction_force,
    friction_parameters,
    law_parameters,
    limit_names,
    swing_up_parameters,
)
from pfaffian.derive.symbolic.supported import check_supported
from pfaffian.derive.symbolic.units import check_unit, unit_product
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.given_names import given_away


@dataclass(frozen=True)
class _Residual:
    """One servo-constraint: s, and its drift where that is not (2)."""

    name: str
    unit: str
    value: sp.Expr
    drift: sp.Expr | None = None


class ModelBuilder:
    """Collects a plant and hands out its frozen `ModelSpec`."""

    def __init__(self, name: str, title: str, source: str, *, domain: Domain | None = None) -> None:
        """Start a model; `source` says where its parameters and its constraint come from.

        `domain` bounds what states no bound of its own; without one nothing is bounded but its
        sign, and the parameter sets give the scale.
        """
        self._domain = domain or Domain()
        self._name, self._title, self._source = name, title, source
        self._coordinates: list[Coordinate] = []
        self._parameters: list[Parameter] = []
        self._actuators: list[Actuator] = []
        self._columns: list[list[sp.Expr]] = []
        self._own_gains: list[Parameter] = []
        self._own_uncertain: list[Parameter] = []
        self._own_friction: list[tuple[sp.Expr, sp.Expr]] = []
        self._residuals: list[_Residual] = []
        self._references: list[sp.Expr] = []
        self._swing_up: tuple[Parameter, ...] = ()

    def coordinate(
        self, name: str, unit: str, description: str, *, bound: float, rate_bound: float
    ) -> tuple[sp.Symbol, sp.Symbol]:
        """Declare a coordinate with the domain the controller accepts; return (q, q')."""
        self._check_name(name, f"d{name}", f"dd{name}", f"{name}d", member=True)
        made = Coordinate(name, unit, description, bound, rate_bound)
        self._coordinates.append(made)
        return made.position, made.velocity

    def parameter(
        self, name: str, unit: str, description: str, *, upper: float | None = None, latex: str = ""
    ) -> sp.Symbol:
        """Declare a positive parameter of the plant and return its symbol."""
        most = self._domain.plant if upper is None else upper
        self._check_name(name)
        made = Parameter(name, unit, description, "plant", 0.0, most, True, latex=latex)
        self._parameters.append(made)
        return symbol_of(made)

    def uncertain(
        self, name: str, unit: str, description: str, *, bound: float | None = None, latex: str = ""
    ) -> sp.Symbol:
        """Declare a parameter of the uncertain force, zero unless given; return its symbol."""
        self._check_name(name)
        most = self._domain.uncertain if bound is None else bound
        made = Parameter(
            name, unit, description, "uncertainty", -most, most, default=0.0, latex=latex
        )
        self._own_uncertain.append(made)
        return symbol_of(made)

    def friction(self, along: sp.Expr, force: sp.Expr) -> None:
        """Add a force that takes the power `force` times the rate `along`, linear in q'.

        `along` is q_i' for a joint, q_i' - q_j' between two bodies; `force`, any function of the
        rate, stands on the left-hand side of (1). With friction of its own a plant does not get
        the standard load, viscous and Coulomb friction on each coordinate.
        """
        rate, rates = self._exact(along, "friction"), [c.velocity for c in self._coordinates]
        if any(rate.diff(v).has(*rates) for v in rates) or rate.subs(dict.fromkeys(rates, 0)) != 0:
            raise InputError(
                f"model {self._name}: friction along {rate}, which is not linear in the velocities",
                remedy="give q' of a joint, or a difference of two; put the law into the force",
            )
        given = self._exact(force, "friction")
        check_supported(given, f"model {self._name}: the friction along {rate}")
        self._own_friction.append((rate, given))

    def setpoint(self, coordinate: sp.Symbol) -> sp.Symbol:
        """Return the symbol of the setpoint of a declared coordinate, for constraints of one's own.

        The setpoint of `x` is the gain `xd`, in the unit of x and zero unless a set gives it.
        """
        return symbol_of(self._setpoint(self._declared(coordinate, "its setpoint")))

    def gain(
        self, name: str, unit: str, description: str, *, bound: float | None = None, latex: str = ""
    ) -> sp.Symbol:
        """Declare a gain of the servo-constraint, within +-`bound`, and return its symbol."""
        self._check_name(name)
        most = self._domain.gain if bound is None else bound
        made = Parameter(name, unit, description, "synthesised", -most, most, latex=latex)
        self._own_gains.append(made)
        return symbol_of(made)

    def actuator(self, name: str, unit: str, description: str, on: Mapping[str, sp.Expr]) -> None:
        """Declare an actuator; `on` gives its generalised force on each coordinate by name."""
        self._check_name(name, member=True)
        self._actuators.append(Actuator(name, unit, description))
        unknown = sorted(set(on) - {c.name for c in self._coordinates})
        if unknown:
            raise InputError(
                f"model {self._name}: actuator {name} acts on {unknown[0]}, which is no coordinate",
                remedy="declare the coordinates before the actuator",
            )
        self._columns.append([sp.sympify(on.get(c.name, 0)) for c in self._coordinates])

    def swing_up(self, *, kP: float, kD: float, kE: float, kV: float) -> None:
        """Give the plant the energy swing-up law, with these gains unless a set names others.

        The plant needs one actuator, which acts on one coordinate: it is declared before this.
        """
        on = [c for k, c in enumerate(self._coordinates) for row in self._columns if row[k] != 0]
        if len(on) != 1:
            raise InputError(
                f"model {self._name}: the energy swing-up law needs one actuator on one "
                f"coordinate, but {len(on)} are acted on",
                remedy="declare that actuator before the swing-up, or leave the swing-up out",
                about="swing_up",
            )
        self._swing_up = swing_up_parameters(on[0].unit, SwingUpGains(kP, kD, kE, kV))

    def first_order(self, name: str, unit: str, residual: sp.Expr) -> None:
        """Add the servo-constraint s(q, q', t) = 0, its residual s in `unit`."""
        self._add(_Residual(name, unit, self._expression(name, residual)))

    def holonomic(self, name: str, unit: str, phi: sp.Expr, rate: sp.Expr) -> None:
        """Add phi(q, t) = 0, phi in `unit`, approached at `rate` in 1/s: s = phi' + rate phi."""
        self._check_unit(name, unit)
        value, speed = self._expression(name, phi), self._expression(name, rate)
        residual = holonomic(value, speed, self._coordinates)
        self.first_order(name, unit_product((unit, 1), ("s", -1)), residual)
        self._references.append(value)

    def second_order(self, name: str, unit: str, psi: sp.Expr) -> None:
        """Add psi = A(q, q', t) q'' - b(q, q', t) = 0, psi in `unit`, written in accelerations."""
        self._check_unit(name, unit)
        residual, drift = second_order(self._expression(name, psi), self._coordinates)
        self._add(_Residual(name, unit_product((unit, 1), ("s", 1)), residual, drift))

    def _check_name(self, *names: str, member: bool = False) -> None:
        """Refuse a name that is reserved, at the line that declares it.

        The names after the first follow from it. What two things are called is found later.
        """
        for k, name in enumerate(names):
            reason = objection(name, self._name, member=member and k == 0)
            if reason:
                follows = "" if k == 0 else f", which follows from {names[0]},"
                raise InputError(
                    f"model {self._name}: {name}{follows} {reason}",
                    remedy="take another name; docs/own-plant.md lists what is reserved",
                    about=names[0],
                )

    def _check_unit(self, name: str, unit: str) -> None:
        check_unit(unit, f"model {self._name}: the servo-constraint {name}")

    def _expression(self, name: str, value: sp.Expr) -> sp.Expr:
        found = self._exact(value, f"servo-constraint {name}", about_constraint(name))
        if not isinstance(found, sp.Expr):
            raise InputError(
                f"model {self._name}: the servo-constraint {name} is {value!r}, no SymPy "
                "expression",
                remedy="give each constraint by a call of its own, in the symbols declared",
            )
        check_supported(found, f"model {self._name}: the servo-constraint {name}")
        return found

    def _exact(self, value: Any, what: str, about: str = "") -> Any:
        """Return `value` in SymPy, its floats as the exact numbers they stand for."""
        where = f"model {self._name}: the {what}"
        return exact_expression(sp.sympify(value), where, about or what)

    def _add(self, made: _Residual) -> None:
        self._check_unit(made.name, made.unit)
        if made.name in {r.name for r in self._residuals}:
            raise InputError(
                f"model {self._name}: two servo-constraints are called {made.name}",
                remedy="rename one of them",
            )
        self._residuals.append(made)

    def acceleration(self, coordinate: sp.Symbol) -> sp.Symbol:
        """Return the symbol of q'' of a declared coordinate, for second-order constraints."""
        return self._declared(coordinate, "its acceleration").acceleration

    def _declared(self, coordinate: sp.Symbol, wanted: str) -> Coordinate:
        found = [c for c in self._coordinates if c.position == coordinate]
        if not found:
            raise InputError(
                f"model {self._name}: {coordinate} is not a coordinate",
                remedy=f"declare it before {wanted} is used",
            )
        return found[0]

    def build(
        self,
        *,
        kinetic_energy: sp.Expr,
        potential_energy: sp.Expr,
        stability: tuple[StabilityCondition, ...] = (),
        errors: Mapping[str, sp.Expr] | None = None,
        force_bound: float | None = None,
    ) -> ModelSpec:
        """Return the specification.

        Without constraints of its own, a plant with one actuator gets s = sum_i w_i (q_i' + r_i
        e_i). The weight w of the last coordinate is 1; the others and the rates r are the gains
        that wanted zero-dynamics poles determine: `weight_q`, `rate_q`. The setpoint of q is `qd`;
        `errors` replaces e = q - qd by coordinate, for a reference that moves.
        """
        self._check_complete()
        domain = self._domain
        if force_bound is not None:
            domain = replace(domain, force=force_bound)
        own = bool(self._own_friction)
        parameters = self._all_parameters(domain)
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
            input_matrix=Matrix(self._columns).T,
            uncertain_force=Matrix(
                [self._own_force(c) if own else friction_force(p, c) for c in self._coordinates]
            ),
            constraint=self._constraint(p, dict(errors or {})),
            law=standard_law(p, *(getattr(p, name) for name in limit_names(self._actuators))),
            stability=stability,
            swing_up=standard_swing_up(p) if self._swing_up else None,
        )

    def _check_complete(self) -> None:
        if not self._actuators:
            raise InputError(
                f"model {self._name}: no actuator is declared",
                remedy="declare it before build, with the coordinates it acts on",
            )
        if not self._residuals and len(self._actuators) > 1:
            raise InputError(
                f"model {self._name}: {len(self._actuators)} actuators and no servo-constraint",
                remedy="add one for each: first_order, holonomic or second_order",
            )

    def _all_parameters(self, domain: Domain) -> tuple[Parameter, ...]:
        """Return the plant's own parameters, and those that every plant and law have."""
        standard = () if self._own_friction else self._coordinates
        friction = (p for c in standard for p in friction_parameters(c, domain.uncertain))
        law = law_parameters(
            self._actuators,
            [r.unit for r in self._residuals] or [self._residual_unit()],
            domain,
            [r.unit for r in self._residuals if r.drift is None] if self._residuals else None,
        )
        return (
            *self._parameters,
            *(self._own_gains if self._residuals else self._gains()),
            *law,
            *self._swing_up,
            *self._setpoints(),
            *friction,
            *self._own_uncertain,
        )

    def _own_force(self, coordinate: Coordinate) -> sp.Expr:
        rate = coordinate.velocity
        return sp.Add(*(force * along.diff(rate) for along, force in self._own_friction))

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
                -self._domain.gain,
                self._domain.gain,
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
                -self._domain.gain,
                self._domain.gain,
                latex=f"r_{{{c.name}}}",
            )
            for c in self._coordinates
        )
        return (*weights, *rates)

    def _setpoints(self) -> tuple[Parameter, ...]:
        return tuple(self._setpoint(c) for c in self._coordinates)

    def _setpoint(self, c: Coordinate) -> Parameter:
        text = f"setpoint of {c.name}"
        most = self._domain.setpoint
        return Parameter(f"{c.name}d", c.unit, text, "gain", -most, most, default=0.0)

    def _constraint(self, p: SimpleNamespace, own: dict[str, sp.Expr]) -> ServoConstraint:
        motion = {f"{d}{c.name}" for c in self._coordinates for d in ("", "d", "dd")}
        names = frozenset({*motion, *vars(p), *(a.name for a in self._actuators)})
        unknown = sorted(set(own) - {c.name for c in self._coordinates})
        if unknown:
            raise InputError(
                f"model {self._name}: an error is given for {unknown[0]}, which is no coordinate",
                remedy="name errors by their coordinates",
            )
        errors = [
            sp.sympify(own.get(c.name, c.position - getattr(p, f"{c.name}d")))
            for c in self._coordinates
        ]
        residuals = self._residuals or [self._standard_residual(p, errors, names)]
        symbols = [sp.Symbol(r.name, real=True) for r in residuals]
        drift = [
            p.sigma * s + 2 * p.eta / sp.pi * sp.atan(s) if r.drift is None else r.drift
            for r, s in zip(residuals, symbols, strict=True)
        ]
        return ServoConstraint(
            residual=Matrix([r.value for r in residuals]),
            residual_symbols=tuple(symbols),
            residual_units=tuple(r.unit for r in residuals),
            drift=Matrix(drift),
            errors=Matrix(errors),
            setpoint=tuple(getattr(p, f"{c.name}d") for c in self._coordinates),
            references=tuple(self._references),
        )

    def _standard_residual(
        self, p: SimpleNamespace, errors: list[sp.Expr], taken: frozenset[str]
    ) -> _Residual:
        weights = [*(getattr(p, f"weight_{c.name}") for c in self._coordinates[:-1]), sp.S.One]
        value = sum(
            w * (c.velocity + getattr(p, f"rate_{c.name}") * e)
            for w, c, e in zip(weights, self._coordinates, errors, strict=True)
        )
        return _Residual(given_away("s", taken), self._residual_unit(), value)
