"""The model specification: what a person writes to describe a plant and its servo-constraint."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace

import sympy as sp
from pfaffian.derive.ir.names import TIME_NAME
from pfaffian.derive.ir.own_names import OwnNames, own_names
from pfaffian.derive.ir.parameter import Parameter

Matrix = sp.ImmutableDenseMatrix

#: The time in seconds that a time-varying constraint is written in; the caller of the generated
#: step supplies it as a measurement, so that a lost period does not shift the reference.
TIME = sp.Symbol(TIME_NAME, real=True)


@dataclass(frozen=True)
class Coordinate:
    """One generalised coordinate q with its velocity q', and the domain the controller accepts.

    `bound` and `rate_bound` are the largest |q| (in `unit`) and |q'| (in `unit`/s) taken as a
    measurement; what lies beyond is a fault, not a state.
    """

    name: str
    unit: str
    description: str
    bound: float
    rate_bound: float

    @property
    def position(self) -> sp.Symbol:
        """Return the symbol of q."""
        return sp.Symbol(self.name, real=True)

    @property
    def velocity(self) -> sp.Symbol:
        """Return the symbol of q'."""
        return sp.Symbol(f"d{self.name}", real=True)

    @property
    def acceleration(self) -> sp.Symbol:
        """Return the symbol of q'', for writing second-order constraints."""
        return sp.Symbol(f"dd{self.name}", real=True)


@dataclass(frozen=True)
class Actuator:
    """One input: its name, unit and meaning."""

    name: str
    unit: str
    description: str


@dataclass(frozen=True)
class ServoConstraint:
    """Servo-constraints s(q, q', t) -> 0, stabilised by s' + drift = 0; in all A q'' = b.

    `residual` is s, one entry a constraint; A = ds/dq'. `drift` is written in `residual_symbols`,
    for (2) sigma s + (2 eta/pi) arctan s; it may also contain q, q' and the time, which is how
    second-order constraints are given (`residuals.second_order`). `setpoint` gives q_d by
    coordinate; `errors` are e = q - q_d, and may depend on the time. `references` are what vanishes
    of the constraints on positions, phi(q, t): where a set-point is left out it is sought there.
    """

    residual: sp.Matrix
    residual_symbols: tuple[sp.Symbol, ...]
    residual_units: tuple[str, ...]
    drift: sp.Matrix
    errors: sp.Matrix
    setpoint: tuple[sp.Expr, ...]
    references: tuple[sp.Expr, ...] = ()


@dataclass(frozen=True)
class RobustLaw:
    """The gains of (15)-(23): p2 = -kappa bhat, the layer eps of p3, the leakage law of ahat.

    `limits` bound each torque, `slews`, where there are any, its rate of change: one an actuator.
    """

    kappa: sp.Symbol
    epsilon: sp.Symbol
    adaptation_rate: sp.Symbol
    leakage_rate: sp.Symbol
    initial_bound: sp.Symbol
    sample_time: sp.Symbol
    limits: tuple[sp.Symbol, ...]
    singular_threshold: sp.Symbol
    slews: tuple[sp.Symbol, ...] = ()


@dataclass(frozen=True)
class SwingUp:
    """The gains of the energy swing-up law, in V_L = kE E~^2/2 + kD q_a'^2/2 + kP q_a~^2/2.

    E~ is the energy missing to the setpoint at rest, q_a the one coordinate that the one actuator
    acts on; V_L falls at the rate `damping` q_a'^2.
    """

    position: sp.Symbol
    rate: sp.Symbol
    energy: sp.Symbol
    damping: sp.Symbol


@dataclass(frozen=True)
class StabilityCondition:
    """A named closed-form condition `margin > 0` for stable zero dynamics, as a person reads it."""

    text: str
    margin: sp.Expr


@dataclass(frozen=True)
class ModelSpec:
    """A plant by its energies, with parameters, uncertainty, servo-constraint and control law.

    Energies are written in physical parameters; `lumping` names the combinations the dynamics are
    rewritten in, and `eliminated` the physical symbols that those relations are solved for.
    `uncertain_force` is F(q, q') of (1); it stands on the left-hand side. `swing_up` names the
    gains of the energy swing-up law, where the model has one.
    """

    name: str
    title: str
    source: str
    coordinates: tuple[Coordinate, ...]
    actuators: tuple[Actuator, ...]
    parameters: tuple[Parameter, ...]
    kinetic_energy: sp.Expr
    potential_energy: sp.Expr
    input_matrix: sp.Matrix
    uncertain_force: sp.Matrix
    constraint: ServoConstraint
    law: RobustLaw
    lumping: tuple[tuple[sp.Symbol, sp.Expr], ...] = ()
    eliminated: tuple[sp.Symbol, ...] = ()
    stability: tuple[StabilityCondition, ...] = ()
    swing_up: SwingUp | None = None

    @cached_property
    def own(self) -> OwnNames:
        """Return the names of what is computed, which give way to those declared here."""
        return own_names(self)

    def own_symbol(self, name: str) -> sp.Symbol:
        """Return the real symbol of what is computed under `name`."""
        return _real(self.own(name))

    @property
    def positions(self) -> tuple[sp.Symbol, ...]:
        """Return q, shape (n,)."""
        return tuple(c.position for c in self.coordinates)

    @property
    def varies(self) -> bool:
        """Return whether the constraint depends on the time."""
        given = self.constraint
        return any(TIME in m.free_symbols for m in (given.residual, given.drift, given.errors))

    @property
    def velocities(self) -> tuple[sp.Symbol, ...]:
        """Return q', shape (n,)."""
        return tuple(c.velocity for c in self.coordinates)

    def parameters_in(self, *groups: str) -> tuple[Parameter, ...]:
        """Return the declared parameters of these groups, in the order of declaration."""
        return tuple(p for p in self.parameters if p.group in groups)


def symbol_of(parameter: Parameter) -> sp.Symbol:
    """Return the SymPy symbol of a declared parameter; positive where its bounds say so."""
    positive = parameter.lower > 0.0 or (parameter.lower == 0.0 and parameter.lower_open)
    return sp.Symbol(parameter.name, positive=True) if positive else _real(parameter.name)


def _real(name: str) -> sp.Symbol:
    return sp.Symbol(name, real=True)


def symbols_of(parameters: Iterable[Parameter]) -> SimpleNamespace:
    """Return a namespace with one symbol a parameter, for writing a model down."""
    return SimpleNamespace(**{p.name: symbol_of(p) for p in parameters})


def standard_swing_up(p: SimpleNamespace) -> SwingUp:
    """Return the swing-up law whose gains have the names every model of this package uses."""
    return SwingUp(position=p.kP, rate=p.kD, energy=p.kE, damping=p.kV)


def standard_law(
    p: SimpleNamespace, *limits: sp.Symbol, slews: tuple[sp.Symbol, ...] = ()
) -> RobustLaw:
    """Return the law whose gains have the names every model of this package uses.

    `p` is the namespace of `symbols_of`; `limits` are the largest torques, one an actuator, and
    `slews` their largest rates of change, one an actuator or none at all.
    """
    return RobustLaw(
        kappa=p.kappa,
        epsilon=p.epsilon,
        adaptation_rate=p.k1,
        leakage_rate=p.k2,
        initial_bound=p.bound_initial,
        sample_time=p.sample_time,
        limits=limits,
        singular_threshold=p.singular_threshold,
        slews=slews,
    )
