"""Zero dynamics: what moves while s = 0, linearised at the setpoint; and gains from its poles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.ir.own_names import OwnNames
from pfaffian.derive.mechanics.constraint import Constraint
from pfaffian.derive.mechanics.cyclic import CyclicDirection, cyclic_directions, trailing_zeros
from pfaffian.derive.mechanics.dynamics import SMALL, Dynamics
from pfaffian.derive.mechanics.linearisation import linearise
from pfaffian.derive.spec.model_spec import TIME, ModelSpec, symbol_of
from pfaffian.runtime.base.errors import InputError
from sympy.polys.matrices import DomainMatrix

POLE = sp.Symbol("p")
#: With fewer entries than this that are no plain symbol, coefficients are written out in any case.
_FEW_ENTRIES = 8


@dataclass(frozen=True)
class ZeroDynamics:
    """Coefficients of the characteristic polynomial (highest first) and the gains it determines.

    `wanted` are the symbols c_(k-1) ... c_0 of a monic polynomial, `gains` the synthesised gains
    in terms of them. `in_slopes` are the coefficients with the entries of dF/dq' that friction
    makes up named by the symbols of `slopes`, which has what these stand for. For larger plants
    both are written in entries of the linearisation, which `entries` gives; else it is empty.
    `at_origin` counts the zeros at the origin that the directions in `cyclic` account for without
    friction: `wanted` is of the polynomial without them.
    """

    coefficients: tuple[sp.Expr, ...]
    entries: tuple[tuple[sp.Symbol, sp.Expr], ...]
    wanted: tuple[sp.Symbol, ...]
    gains: tuple[tuple[sp.Symbol, sp.Expr], ...]
    in_slopes: tuple[sp.Expr, ...]
    slopes: tuple[tuple[sp.Symbol, sp.Expr], ...]
    cyclic: tuple[CyclicDirection, ...] = ()
    at_origin: int = 0


def without_friction(spec: ModelSpec, coefficients: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
    """Return the coefficients with all uncertainty at zero, highest power first."""
    zero = {symbol_of(p): 0 for p in spec.parameters_in("uncertainty")}
    return tuple(c.subs(zero) for c in coefficients)


def zero_dynamics(spec: ModelSpec, dynamics: Dynamics, constraint: Constraint) -> ZeroDynamics:
    """Linearise the zero dynamics of s at the setpoint and solve for the gains.

    The zeros of the output s are the roots p of det [[M p^2 + D p + K, -B], [S1 p + S0, 0]], with
    K = dG/dq, D = dF/dq' and S1, S0 = ds/dq', ds/dq at the setpoint at rest. A constraint whose
    drift depends on the motion itself (one of second order) enters by the row of s' + drift
    instead: nothing takes its s to zero. Time-varying entries are frozen at time 0.
    """
    linear = linearise(spec, dynamics, constraint)
    free, scale = _free_rows(linear.input)
    damping, slopes = _named_slopes(spec, free * linear.damping)
    named = _Entries(spec.own)
    row = named("rate_row", linear.rate_row) * POLE + named("position_row", linear.position_row)
    row = _with_own_motion(spec, row, named)
    plant = sum(
        (
            named(base, part) * POLE**power
            for base, part, power in (
                ("mass", free * linear.mass, 2),
                ("damping", damping, 1),
                ("stiffness", free * linear.stiffness, 0),
            )
        ),
        sp.zeros(free.rows, free.cols),
    )
    pencil = plant.col_join(row)
    eliminated = not free.is_square
    if not eliminated:  # the torques are unknowns too
        m = len(spec.actuators)
        pencil = pencil.row_join((-named("input", linear.input)).col_join(sp.zeros(m, m)))
    matrix = DomainMatrix.from_Matrix(pencil)
    determinant = matrix.domain.to_sympy(matrix.det()) / scale
    in_slopes = sp.Poly(determinant, POLE).all_coeffs()
    if not eliminated and (len(row.row(0)) <= SMALL or len(named.values) < _FEW_ENTRIES):
        in_slopes = [sp.expand(c.subs(named.values)) for c in in_slopes]
        named.values.clear()
    coefficients = [
        c.xreplace(dict(slopes)) if named.values else sp.factor(c.xreplace(dict(slopes)))
        for c in in_slopes
    ]
    while coefficients and coefficients[0] == 0:  # slopes that are related may cancel
        in_slopes, coefficients = in_slopes[1:], coefficients[1:]
    if not coefficients:
        raise _unreached(spec)
    entries = tuple(named.values.items())
    cyclic = cyclic_directions(spec, dynamics, constraint)
    still = without_friction(spec, [c.xreplace(dict(entries)) for c in coefficients])
    still = tuple(sp.factor(c) for c in still) if cyclic else still
    at_origin = min(trailing_zeros(still), sum(d.zeros for d in cyclic))
    order = len(coefficients) - 1 - at_origin
    wanted = tuple(spec.own_symbol(f"c{k}") for k in reversed(range(order)))
    gains = () if named.values else _synthesise(spec, tuple(coefficients[: order + 1]), wanted)
    return ZeroDynamics(
        tuple(coefficients), entries, wanted, gains, tuple(in_slopes), slopes, cyclic, at_origin
    )


def _unreached(spec: ModelSpec) -> InputError:
    names = ", ".join(s.name for s in spec.constraint.residual_symbols)
    return InputError(
        f"model {spec.name}: ADB and its slopes are zero at the setpoint, at rest: the actuators "
        f"do not move {names} there",
        remedy="choose a servo-constraint that the actuators reach at the setpoint; one that is "
        "quadratic in the velocities, such as an energy, needs a linear part",
        about="residual",
    )


def _free_rows(inputs: sp.Matrix) -> tuple[sp.Matrix, sp.Rational]:
    """Return N (n - m, n) with N B = 0 and what the determinant is to be scaled by.

    With them the torques are eliminated before the determinant is expanded: with T = (N, L) and
    L B = 1, det T times the pencil's determinant is that of the rows N (M p^2 + D p + K) over those
    of s. A large plant has thousands of terms less. It takes a matrix B of numbers; for others, and
    for small plants, N is the identity and nothing is eliminated.
    """
    n = inputs.rows
    if n <= SMALL or not all(x.is_Rational for x in inputs):
        return sp.eye(n), sp.S.One
    free = sp.Matrix.vstack(*(v.T for v in inputs.T.nullspace()), sp.zeros(0, n))
    held = (inputs.T * inputs).inv() * inputs.T
    return free, free.col_join(held).det()


class _Entries:
    """Names the entries of matrices that are no single number or symbol.

    In named entries the determinant is one of polynomials, which takes milliseconds.
    """

    def __init__(self, own: OwnNames) -> None:
        self._own = own
        self.values: dict[sp.Symbol, sp.Expr] = {}

    def __call__(self, base: str, matrix: sp.Matrix) -> sp.Matrix:
        return sp.Matrix(
            *matrix.shape,
            lambda i, j: self._named(f"{base}_{i + 1}_{j + 1}", matrix[i, j]),
        )

    def _named(self, name: str, value: sp.Expr) -> sp.Expr:
        if value.is_Number or value.is_Symbol:
            return value
        symbol = sp.Symbol(self._own(name), real=True)
        known = next((s for s, v in self.values.items() if v == value), None)
        if known is None:
            self.values[symbol] = value
        return known or symbol


def _with_own_motion(spec: ModelSpec, row: sp.Matrix, named: _Entries) -> sp.Matrix:
    """Replace the rows of constraints whose drift depends on q or q' by those of s' + drift."""
    given = spec.constraint
    q, dq = list(spec.positions), list(spec.velocities)
    at_rest: dict[sp.Basic, sp.Basic] = dict(zip(q, given.setpoint, strict=True))
    at_rest |= dict.fromkeys([*dq, TIME, *given.residual_symbols], sp.S.Zero)
    row = sp.Matrix(row)
    for r, drift in enumerate(given.drift):
        if not drift.has(*q, *dq):
            continue
        position, rate, own = (
            sp.Matrix([[drift.diff(x) for x in xs]]).subs(at_rest)
            for xs in (q, dq, given.residual_symbols)
        )
        direct = named(f"drift_rate_{r + 1}", rate) * POLE
        direct += named(f"drift_position_{r + 1}", position)
        through = named(f"drift_residual_{r + 1}", own) * row
        row[r, :] = row[r, :] * POLE + direct + through
    return row


def _named_slopes(
    spec: ModelSpec, damping: sp.Matrix
) -> tuple[sp.Matrix, tuple[tuple[sp.Symbol, sp.Expr], ...]]:
    """Name the entries of dF/dq' that friction makes up, as their sums of products hide the rest.

    The slope of the force on q under its own rate is `damping_q`, under that of r `damping_q_r`;
    that of a combination of rows which no actuator reaches is `damping_free1_r`.
    """
    own = [c.name for c in spec.coordinates]
    rows = own if damping.is_square else [f"free{k + 1}" for k in range(damping.rows)]
    rubbing = {symbol_of(p) for p in spec.parameters_in("uncertainty")}
    slopes: dict[sp.Symbol, sp.Expr] = {}
    shown = damping.as_mutable()
    for i, row in enumerate(rows):
        for j, column in enumerate(own):
            entry = sp.expand(damping[i, j]) if rows is not own else damping[i, j]
            if entry.is_Symbol or not entry.free_symbols & rubbing:
                shown[i, j] = entry
                continue
            name = f"damping_{row}" + ("" if row == column else f"_{column}")
            while name in spec.own.declared:
                name += "_"
            shown[i, j] = sp.Symbol(name, real=True)
            slopes[shown[i, j]] = entry
    return shown, tuple(slopes.items())


def _synthesise(
    spec: ModelSpec, coefficients: tuple[sp.Expr, ...], wanted: tuple[sp.Symbol, ...]
) -> tuple[tuple[sp.Symbol, sp.Expr], ...]:
    """Solve for the gains that give the wanted polynomial on the frictionless plant."""
    gains = [symbol_of(p) for p in spec.parameters_in("synthesised")]
    if len(spec.actuators) > 1:
        return ()  # one polynomial does not determine the gains of several constraints
    still = {symbol_of(p): 0 for p in spec.parameters_in("uncertainty")}
    lead = coefficients[0].subs(still)
    equations = [c.subs(still) - lead * w for c, w in zip(coefficients[1:], wanted, strict=True)]
    if not gains:
        return ()
    found = _solve_abstractly(equations, gains) or _only(equations, gains)
    return tuple((gain, sp.factor(found[gain])) for gain in gains if found)


def _solve_abstractly(
    equations: Sequence[sp.Expr], gains: Sequence[sp.Symbol]
) -> dict[sp.Symbol, sp.Expr]:
    """Solve with each coefficient of a monomial in the gains held by one symbol; {} on failure.

    The solver is several times faster where it need not carry the plant's inertias along. A
    relation among the coefficients, which this hides, can only cost the solution: then its
    denominator vanishes, or it is not the only one.
    """
    held: dict[sp.Expr, sp.Dummy] = {}
    bare = []
    for equation in equations:
        if not equation.is_polynomial(*gains):
            return {}
        terms = sp.Poly(equation, *gains).terms()
        powers = [sp.prod(g**k for g, k in zip(gains, ks, strict=True)) for ks, _ in terms]
        symbols = [held.setdefault(sp.expand(c), sp.Dummy()) for _, c in terms]
        bare.append(sum(s * p for s, p in zip(symbols, powers, strict=True)))
    values = {symbol: coefficient for coefficient, symbol in held.items()}
    found = _only(bare, gains)
    parts = {g: [sp.factor(x.subs(values)) for x in sp.fraction(e)] for g, e in found.items()}
    if any(denominator == 0 for _, denominator in parts.values()):
        return {}
    return {g: numerator / denominator for g, (numerator, denominator) in parts.items()}


def _only(equations: Sequence[sp.Expr], gains: Sequence[sp.Symbol]) -> dict[sp.Symbol, sp.Expr]:
    """Return the solution if there is exactly one and it determines every gain, else {}."""
    solutions = sp.solve(equations, gains, dict=True)
    return solutions[0] if len(solutions) == 1 and set(solutions[0]) == set(gains) else {}
