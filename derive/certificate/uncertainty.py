"""The functions the assumptions speak of: ADB of (10), Fhat of (11), Pi of (47)."""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.derivation.decomposition import writes_rows_out
from pfaffian.derive.derivation.derive import Derivation
from pfaffian.derive.ir.program import Program
from pfaffian.derive.lower.to_program import lower
from pfaffian.derive.mechanics.block_terms import numbered
from pfaffian.derive.spec.model_spec import symbol_of
from pfaffian.derive.symbolic.block import Block, BlockBuilder
from pfaffian.derive.symbolic.normal_form import trigonometric_sum
from pfaffian.runtime.base.errors import InputError

_GROUPS = ("lumped", "plant", "synthesised", "gain", "uncertainty")
#: The output with det ADB, which only several actuators have beside `adb`.
DETERMINANT = "adb_det"
#: How often the bound of the least eigenvalue is improved, for three actuators and more.
_IMPROVEMENTS = 4


def assumption_program(derivation: Derivation) -> Program:
    """Return the program of `assumption_block`, for points and for intervals."""
    return lower(assumption_block(derivation))


def following_program(derivation: Derivation) -> Program:
    """Return `along` = (ds/dq) q' and the entries `a_NAME` of A: beta' = A q'' + along + drift.

    With several constraints they are numbered by row: `along1`, `a2_NAME`.
    """
    spec, constraint = derivation.spec, derivation.constraint
    builder = BlockBuilder("following", f"{spec.title}: rate of beta", spec.own)
    for c in spec.coordinates:
        builder.take(c.position, c.unit, c.description, "input")
    for c in spec.coordinates:
        builder.take(c.velocity, f"{c.unit}/s", f"rate of {c.name}", "input")
    for p in spec.parameters_in(*_GROUPS):
        builder.take(symbol_of(p), p.unit, p.description, "parameter")
    slope = constraint.residual.jacobian(sp.Matrix(spec.positions))
    along = slope * sp.Matrix(spec.velocities)
    for r, mark in enumerate(numbered("", len(along))):
        builder.give(f"along{mark}", along[r], "", "(ds/dq) q'")
        for c, entry in zip(spec.coordinates, constraint.jacobian[r, :], strict=True):
            builder.give(f"a{mark}_{c.name}", entry, "", f"entry of A for {c.name}")
    return lower(builder.build())


def assumption_block(derivation: Derivation) -> Block:
    """Return ADB, Fhat with its derivatives, and what bounds it, as one block.

    Inputs: q, q' and the parameters of controller and uncertainty. Outputs: `adb` [1/(kg m^2)],
    `fhat` [N m], `regressor`, `restraint` = kappa |ADB| (|Fhat| over it is the |beta| at which p2
    balances Fhat), and the derivatives of `fhat` as `fhat_by_NAME`. With several actuators `adb` is
    the least singular value of ADB, or a lower bound of it, `fhat` is |Fhat|, and `adb_det` the
    determinant.
    """
    spec = derivation.spec
    if not writes_rows_out(derivation.dynamics):
        raise InputError(
            f"model {spec.name}: no certificate for a plant of {len(spec.coordinates)} coupled "
            "coordinates: ADB and Fhat, written out, are too large to be bounded",
            remedy="certify a plant of two coordinates, or one with a diagonal mass matrix",
        )
    several = len(spec.actuators) > 1
    builder = BlockBuilder("assumptions", f"{spec.title}: assumptions 1 and 2", spec.own)
    for c in spec.coordinates:
        builder.take(c.position, c.unit, c.description, "input")
    for c in spec.coordinates:
        builder.take(c.velocity, f"{c.unit}/s", f"rate of {c.name}", "input")
    for p in spec.parameters_in(*_GROUPS):
        builder.take(symbol_of(p), p.unit, p.description, "parameter")
    if several:
        adb, matched = _define_least_gain(builder, derivation), _matched_vector(derivation)
        parts = [builder.define(f"fhat{i + 1}", f, "(11)") for i, f in enumerate(matched)]
        fhat = builder.define("fhat", sp.sqrt(sum(f**2 for f in parts)), "|Fhat|")
    else:
        adb, matched = _define_gain(builder, derivation), sp.Matrix([_matched(derivation)])
        fhat = builder.define("fhat", matched[0], "(11)", "N*m")
    continuous = derivation.block("continuous")
    law = continuous.expanded(spec.own_symbol("regressor"))
    regressor = builder.define("regressor", law, "Pi, (47)")
    restraint = builder.define("restraint", spec.law.kappa * sp.Abs(adb), "kappa |ADB|")
    named = {"adb": adb, "fhat": fhat, "regressor": regressor, "restraint": restraint}
    for name, symbol in named.items():
        builder.give(name, symbol, "", "of the assumptions")
    if several:
        builder.give(DETERMINANT, spec.own_symbol(DETERMINANT), "", "det ADB")
    for x in (*spec.positions, *spec.velocities):
        slope = sp.diff(matched, x)
        slope = (
            sum(f * d for f, d in zip(parts, slope, strict=True)) / fhat if several else slope[0]
        )
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


def _define_least_gain(builder: BlockBuilder, derivation: Derivation) -> sp.Symbol:
    """Define the least singular value of ADB (m, m), m > 1, from N = ADB (ADB)^T.

    The m - 1 other eigenvalues of N have the product det^2/lmin and the sum tr - lmin, so
    lmin >= det^2 ((m - 1)/(tr - l))^(m - 1) for any l <= lmin, from l = 0 on; for m = 2 the limit
    is exact and closed, and is taken at once.
    """
    gain = (_row(derivation) * derivation.dynamics.input_matrix).applyfunc(
        lambda e: sp.factor(trigonometric_sum(e))
    )
    m = gain.rows
    below = builder.define("det_m", sp.expand(derivation.dynamics.mass_matrix.det()), "det M")
    entries = sp.Matrix(
        m, m, lambda r, c: builder.define(f"adb{r + 1}{c + 1}", gain[r, c] / below, "(10)")
    )
    det = builder.define(DETERMINANT, derivation.input_gain, "det ADB, (10)")
    trace = builder.define("trace", sum(e**2 for e in entries), "trace of ADB (ADB)^T")
    if m == 2:
        n = entries * entries.T
        spread = builder.define("spread", sp.sqrt((n[0, 0] - n[1, 1]) ** 2 + 4 * n[0, 1] ** 2), "")
        least = 2 * det**2 / (trace + spread)
    else:
        least = sp.S.Zero
        for k in range(_IMPROVEMENTS):
            found = det**2 * ((m - 1) / (trace - least)) ** (m - 1)
            least = builder.define(f"least{k + 1}", found, "below the least eigenvalue")
    return builder.define("adb", sp.sqrt(least), "least singular value of ADB")


def _matched_vector(derivation: Derivation) -> sp.Matrix:
    """Return Fhat (m, 1) as `_matched` does for one actuator."""
    b, force = derivation.dynamics.input_matrix, derivation.dynamics.uncertain_force
    square = (b.T * b).applyfunc(trigonometric_sum)
    direct = square.inv() * b.T * force
    rest = (force - b * direct).applyfunc(trigonometric_sum)
    row = _row(derivation)
    gain = (row * b).applyfunc(trigonometric_sum)
    above = (gain.adjugate() * row * rest).applyfunc(lambda e: sp.factor(trigonometric_sum(e)))
    below = sp.factor(trigonometric_sum(gain.det()))
    return direct + above / below
