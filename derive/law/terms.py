"""What both control laws compute in the same way: dynamics, s, drift, ADB, the demand and Pi.

Everything is a vector over the m servo-constraints and actuators. With one of each the names carry
no number: `s`, `beta`, `adb`; with more they do: `s1`, `beta2`, `adb12`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.mechanics.block_terms import define_dynamics, define_terms, define_trigonometry
from pfaffian.derive.mechanics.constraint import Constraint
from pfaffian.derive.mechanics.dynamics import Dynamics
from pfaffian.derive.mechanics.mass_solver import MassSolver
from pfaffian.derive.spec.model_spec import ModelSpec
from pfaffian.derive.spec.residuals import time_derivative
from pfaffian.derive.symbolic.block import BlockBuilder
from pfaffian.derive.symbolic.units import force_unit, unit_product


@dataclass(frozen=True)
class Shared:
    """Symbols of what both laws use: s, drift, demand (m,), ADB (m, m), its determinant, Pi."""

    s: tuple[sp.Symbol, ...]
    drift: tuple[sp.Symbol, ...]
    demand: tuple[sp.Symbol, ...]
    adb: sp.Matrix
    adb_det: sp.Symbol
    regressor: sp.Symbol


class LawUnits:
    """Units of the law's signals, from those of the residuals and the actuators.

    The quantities that run over all constraints (bhat, ahat, mu) take the unit of the first.
    """

    def __init__(self, spec: ModelSpec) -> None:
        """Work the units out for `spec`."""
        self.forces = tuple(a.unit for a in spec.actuators)
        self.residuals = spec.constraint.residual_units
        self.force, self.residual = self.forces[0], self.residuals[0]
        self.drifts = tuple(unit_product((u, 1), ("s", -1)) for u in self.residuals)
        self.adb = self.gain(0, 0)
        self.scaled = unit_product((self.adb, 1), (self.residual, 1))
        self.adb_det = unit_product(*((self.gain(i, i), 1) for i in range(len(self.forces))))

    def gain(self, row: int, column: int) -> str:
        """Return the unit of an entry of ADB."""
        return unit_product((self.residuals[row], 1), ("s", -1), (self.forces[column], -1))


def define_shared(
    builder: BlockBuilder,
    spec: ModelSpec,
    dynamics: Dynamics,
    constraint: Constraint,
    least_square: sp.Expr = sp.S.Zero,
    error_rates: Sequence[sp.Expr] = (),
) -> Shared:
    """Define s, drift, ADB, the demand b + AD(C q' + G) and the regressor Pi of (47).

    `least_square` is added to |e|^2 and |e'|^2 in Pi; `error_rates` (n,) are e' where it does not
    follow from e(q, t).
    """
    units = LawUnits(spec)
    errors = [
        builder.define(f"e{i + 1}", e, "error, (4)", spec.coordinates[i].unit)
        for i, e in enumerate(spec.constraint.errors)
    ]
    free_motion = constraint.free_motion
    named = define_trigonometry(
        builder, [*constraint.residual, *constraint.drift, *constraint.jacobian, *free_motion]
    )
    named |= dict(zip(spec.constraint.errors, errors, strict=True))
    s, drift = _define_residuals(builder, spec, constraint, named)
    _, solver, bias = define_dynamics(builder, spec, dynamics)
    jacobian = _define_jacobian(builder, spec, constraint.jacobian.xreplace(named))
    ad = _define_constraint_rows(builder, spec, solver, jacobian)
    adb, adb_det = _define_input_gain(builder, dynamics, ad, units)
    demand = []
    for r, (b, d) in enumerate(
        zip(spec.own.numbered("b"), spec.own.numbered("demand"), strict=True)
    ):
        right = builder.define(
            b,
            -free_motion[r].xreplace(named) - drift[r],
            "right-hand side of A q'' = b, (7)",
            units.drifts[r],
        )
        demand.append(
            builder.define(d, right + (ad[r, :] * bias)[0], "b + A D (C q' + G)", units.drifts[r])
        )
    rates = error_rates or [
        time_derivative(e, spec.coordinates).xreplace(named) for e in spec.constraint.errors
    ]
    regressor = _define_regressor(builder, spec, errors, rates, least_square)
    return Shared(s, drift, tuple(demand), adb, adb_det, regressor)


def _define_jacobian(builder: BlockBuilder, spec: ModelSpec, jacobian: sp.Matrix) -> sp.Matrix:
    """Define the entries of A (m, n) that are sums.

    Each is used in every entry of A D: rounded once, it is the same in all of them. Of several
    constraints the terms of these sums are named too: det ADB may not depend at all on what they
    share, as on the direction of the axes, but their rounding is each one's own.
    """
    units, m = LawUnits(spec), jacobian.rows

    def entry(r: int, i: int) -> sp.Expr:
        value = jacobian[r, i]
        if not value.is_Add:
            return value
        if m > 1:
            value = define_terms(builder, value)
        rate = f"{spec.coordinates[i].unit}/s"
        return builder.define(
            f"jacobian{i + 1}" if m == 1 else f"jacobian{r + 1}{i + 1}",
            value,
            "entry of A, (7)",
            unit_product((units.residuals[r], 1), (rate, -1)),
        )

    return sp.Matrix(*jacobian.shape, entry)


def _define_constraint_rows(
    builder: BlockBuilder, spec: ModelSpec, solver: MassSolver, jacobian: sp.Matrix
) -> sp.Matrix:
    """Define the entries of A D (m, n), D = M^-1."""
    units, m = LawUnits(spec), jacobian.rows
    forces = [force_unit(c.unit) for c in spec.coordinates]
    return sp.Matrix(
        [
            solver.define_row(
                jacobian[r, :],
                "ad" if m == 1 else f"ad{r + 1}",
                "entry of A D, D = M^-1",
                [unit_product((units.residuals[r], 1), ("s", -1), (f, -1)) for f in forces],
                of_several=m > 1,
            )
            for r in range(m)
        ]
    )


def _define_residuals(
    builder: BlockBuilder,
    spec: ModelSpec,
    constraint: Constraint,
    named: dict[sp.Basic, sp.Symbol],
) -> tuple[tuple[sp.Symbol, ...], tuple[sp.Symbol, ...]]:
    """Define s and drift(s) = sigma s + (2 eta/pi) arctan s, both (m,)."""
    units = LawUnits(spec)
    s = tuple(
        builder.define(name, row.xreplace(named), "(3)", unit)
        for name, row, unit in zip(
            spec.own.numbered("s"), constraint.residual, units.residuals, strict=True
        )
    )
    given = dict(zip(spec.constraint.residual_symbols, s, strict=True))
    drift = tuple(
        builder.define(
            name, row.xreplace(given).xreplace(named), "sigma s + (2 eta/pi) arctan s, (2)", unit
        )
        for name, row, unit in zip(
            spec.own.numbered("drift"), spec.constraint.drift, units.drifts, strict=True
        )
    )
    return s, drift


def _define_input_gain(
    builder: BlockBuilder, dynamics: Dynamics, ad: sp.Matrix, units: LawUnits
) -> tuple[sp.Matrix, sp.Symbol]:
    """Define ADB and its determinant; with one actuator they are the same value."""
    product = ad * dynamics.input_matrix
    m = product.rows
    if m == 1:
        adb = builder.define("adb", product[0], "(10)", units.adb)
        return sp.Matrix([[adb]]), adb
    named = define_trigonometry(builder, list(dynamics.input_matrix))
    gain = sp.Matrix(
        m,
        m,
        lambda r, c: builder.define(
            f"adb{r + 1}{c + 1}", product[r, c].xreplace(named), "(10)", units.gain(r, c)
        ),
    )
    return gain, builder.define("adb", gain.det(), "determinant of ADB, (10)", units.adb_det)


def _define_regressor(
    builder: BlockBuilder,
    spec: ModelSpec,
    errors: list[sp.Symbol],
    rates: Sequence[sp.Expr],
    least_square: sp.Expr,
) -> sp.Symbol:
    """Define Pi = (|e'| + 1)^2 + (|e| + 1)^2.

    It adds unlike units where the coordinates have different ones, as (47) does in any case.
    """
    kinds = {c.unit for c in spec.coordinates}
    motion = kinds.pop() if len(kinds) == 1 else ""
    speed = builder.define(
        "speed",
        sp.sqrt(sp.Add(*(v**2 for v in rates), least_square)),
        "|e'|",
        motion and f"{motion}/s",
    )
    distance = builder.define(
        "distance", sp.sqrt(sp.Add(*(e**2 for e in errors), least_square)), "|e|", motion
    )
    return builder.define("regressor", (speed + 1) ** 2 + (distance + 1) ** 2, "Pi, (47)")


def give_parts(
    builder: BlockBuilder,
    spec: ModelSpec,
    shared: Shared,
    beta: tuple[sp.Symbol, ...],
    parts: tuple[tuple[sp.Symbol, ...], ...],
) -> None:
    """Let p1, p2, p3, s, beta and ADB leave, for logs and plots."""
    units = LawUnits(spec)
    texts = ("nominal part, (17)", "initial deviation part, (18)", "robust part, (19)")
    for part, text in zip(parts, texts, strict=True):
        for symbol, unit in zip(part, units.forces, strict=True):
            builder.give(symbol.name, symbol, unit, text)
    for symbol, unit in zip(shared.s, units.residuals, strict=True):
        builder.give(symbol.name, symbol, unit, "residual s, (3)")
    for symbol, unit in zip(beta, units.residuals, strict=True):
        builder.give(symbol.name, symbol, unit, "constraint-following error, (21)")
    single = len(units.forces) == 1
    what = "input gain of the constraint, (10)" if single else "determinant of ADB, (10)"
    builder.give(shared.adb_det.name, shared.adb_det, units.adb if single else units.adb_det, what)


def norm(vector: tuple[sp.Symbol, ...]) -> sp.Expr:
    """Return |vector|; the absolute value where it has one entry."""
    return sp.Abs(vector[0]) if len(vector) == 1 else sp.sqrt(sum(v**2 for v in vector))
