"""The functions the assumptions speak of: ADB of (10), Fhat of (11), Pi of (47)."""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.block import Block, BlockBuilder
from pfaffian.derive.derivation import Derivation
from pfaffian.derive.lowering import lower
from pfaffian.derive.program import Program
from pfaffian.derive.spec import ModelSpec, symbol_of
from pfaffian.runtime.errors import InputError

_GROUPS = ("lumped", "plant", "synthesised", "gain", "uncertainty")


def require_one_actuator(spec: ModelSpec) -> None:
    """Raise `InputError` for a plant with more than one actuator."""
    if len(spec.actuators) != 1:
        raise InputError(
            f"model {spec.name}: the certificate is stated for one actuator, "
            f"this plant has {len(spec.actuators)}",
            remedy="give a plant with one actuator and one servo-constraint",
        )


def assumption_program(derivation: Derivation) -> Program:
    """Return the program of `assumption_block`, for points and for intervals."""
    return lower(assumption_block(derivation))


def following_program(derivation: Derivation) -> Program:
    """Return `along` = (ds/dq) q' and the entries `a_NAME` of A: beta' = A q'' + along + drift."""
    spec, constraint = derivation.spec, derivation.constraint
    builder = BlockBuilder("following", f"{spec.title}: rate of beta")
    for c in spec.coordinates:
        builder.take(c.position, c.unit, c.description, "input")
    for c in spec.coordinates:
        builder.take(c.velocity, f"{c.unit}/s", f"rate of {c.name}", "input")
    for p in spec.parameters_in(*_GROUPS):
        builder.take(symbol_of(p), p.unit, p.description, "parameter")
    slope = constraint.residual.jacobian(sp.Matrix(spec.positions))
    builder.give("along", (slope * sp.Matrix(spec.velocities))[0], "", "(ds/dq) q'")
    for c, entry in zip(spec.coordinates, constraint.jacobian[0, :], strict=True):
        builder.give(f"a_{c.name}", entry, "", f"entry of A for {c.name}")
    return lower(builder.build())


def assumption_block(derivation: Derivation) -> Block:
    """Return ADB, Fhat with its derivatives, and what bounds it, as one block.

    Inputs: q, q' and the parameters of controller and uncertainty. Outputs: `adb` [1/(kg m^2)],
    `fhat` [N m], `regressor`, `restraint` = kappa |ADB| (|Fhat| over it is the |beta| at which p2
    balances Fhat), and the derivatives of `fhat` as `fhat_by_NAME`. Raises `InputError` for a
    plant with more than one actuator.
    """
    spec = derivation.spec
    require_one_actuator(spec)
    builder = BlockBuilder("assumptions", f"{spec.title}: assumptions 1 and 2")
    for c in spec.coordinates:
        builder.take(c.position, c.unit, c.description, "input")
    for c in spec.coordinates:
        builder.take(c.velocity, f"{c.unit}/s", f"rate of {c.name}", "input")
    for p in spec.parameters_in(*_GROUPS):
        builder.take(symbol_of(p), p.unit, p.description, "parameter")
    adb = _define_gain(builder, derivation)
    fhat = builder.define("fhat", _matched(derivation), "(11)", "N*m")
    continuous = derivation.block("continuous")
    law = continuous.expanded(sp.Symbol("regressor", real=True))
    regressor = builder.define("regressor", law, "Pi, (47)")
    restraint = builder.define("restraint", spec.law.kappa * sp.Abs(adb), "kappa |ADB|")
    for symbol in (adb, fhat, regressor, restraint):
        builder.give(symbol.name, symbol, "", "of the assumptions")
    for x in (*spec.positions, *spec.velocities):
        slope = sp.diff(_matched(derivation), x)
        builder.give(f"fhat_by_{x.name}", slope, "", f"derivative of Fhat by {x.name}")
    return builder.build()


def _row(derivation: Derivation) -> sp.Matrix:
    """Return A adj(M) of shape (1, n), that is A D det M."""
    row = derivation.constraint.jacobian * derivation.dynamics.mass_matrix.adjugate()
    return row.applyfunc(sp.expand)


def _define_gain(builder: BlockBuilder, derivation: Derivation) -> sp.Symbol:
    above = sp.factor((_row(derivation) * derivation.dynamics.input_matrix)[0])
    det = builder.define("det_m", sp.expand(derivation.dynamics.mass_matrix.det()), "det M")
    return builder.define("adb", above / det, "(10)", "1/(kg*m^2)")


def _matched(derivation: Derivation) -> sp.Expr:
    """Return Fhat = B^+ F + (ADB)^-1 AD (F - B B^+ F).

    It equals (11), but keeps what acts on the motor out of the quotient, where an interval would
    count the same angle twice.
    """
    b, force = derivation.dynamics.input_matrix, derivation.dynamics.uncertain_force
    direct = ((b.T * b).inv() * b.T * force)[0]
    rest = force - b * direct
    row = _row(derivation)
    above, below = sp.factor((row * rest)[0]), sp.factor((row * b)[0])
    return direct + above / below
