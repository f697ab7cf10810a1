"""Terms that blocks of any stage define in the same way: measurement, angles, dynamics."""

from __future__ import annotations

from collections.abc import Iterable

import sympy as sp
from pfaffian.derive.mechanics.dynamics import SMALL, Dynamics
from pfaffian.derive.mechanics.mass_solver import MassSolver, determinant
from pfaffian.derive.spec.model_spec import TIME, ModelSpec, symbol_of
from pfaffian.derive.symbolic.block import BlockBuilder
from pfaffian.derive.symbolic.forms import grouped
from pfaffian.derive.symbolic.units import force_unit, unit_product


def numbered(base: str, count: int) -> tuple[str, ...]:
    """Return `base` alone for one, `base1`, `base2`, ... for more."""
    return (base,) if count == 1 else tuple(f"{base}{k + 1}" for k in range(count))


def real(name: str) -> sp.Symbol:
    """Return a real symbol."""
    return sp.Symbol(name, real=True)


def take_measurement(builder: BlockBuilder, spec: ModelSpec) -> None:
    """Declare q and q' as inputs, and the time, which only a time-varying constraint reads."""
    for c in spec.coordinates:
        builder.take(c.position, c.unit, c.description, "input")
    for c in spec.coordinates:
        builder.take(c.velocity, f"{c.unit}/s", f"rate of {c.name}", "input")
    builder.take(TIME, "s", "time of the constraint", "input")


def take_parameters(builder: BlockBuilder, spec: ModelSpec, *groups: str) -> None:
    """Declare the parameters of `groups` as inputs."""
    for p in spec.parameters_in(*groups):
        builder.take(symbol_of(p), p.unit, p.description, "parameter")


def define_trigonometry(
    builder: BlockBuilder, expressions: Iterable[sp.Basic]
) -> dict[sp.Basic, sp.Symbol]:
    """Define every sine and cosine in `expressions`, and their arguments where those are sums.

    Returns the mapping to substitute. Named values are rounded once and used often.
    """
    found = sorted(
        set().union(*(e.atoms(sp.sin, sp.cos) for e in expressions)), key=sp.default_sort_key
    )
    known: dict[sp.Basic, sp.Symbol] = {}
    for function in found:
        argument = function.args[0]
        if argument not in known and not argument.is_Symbol:
            known[argument] = builder.define(_angle_name(builder, argument), argument, "angle")
        angle = known.get(argument, argument)
        known[function] = builder.define(
            f"{function.func.__name__}_{angle.name}", function.func(angle), ""
        )
    return known


def _angle_name(builder: BlockBuilder, angle: sp.Expr) -> str:
    """Return `q1_plus_q2`, `q1_minus_q2`, or where that says too little `angle1`, `angle2`, ..."""
    terms = angle.as_coefficients_dict()
    if all(t.is_Symbol and abs(c) == 1 for t, c in terms.items()):
        plus = sorted(t.name for t, c in terms.items() if c == 1)
        minus = sorted(t.name for t, c in terms.items() if c == -1)
        return "_minus_".join(["_plus_".join(plus), *minus]).lstrip("_")
    return builder.unused("angle", angle)


def define_terms(builder: BlockBuilder, total: sp.Add) -> sp.Expr:
    """Define the terms of a sum that are products, and first the sums these contain."""

    def named(value: sp.Expr) -> sp.Expr:
        if not value.args or value.is_number:
            return value
        value = value.func(*(named(a) for a in value.args))
        return _term(builder, value) if value.is_Add else value

    terms = (term.func(*(named(a) for a in term.args)) for term in total.args if term.args)
    plain = (term for term in total.args if not term.args)
    return sp.Add(*plain, *(_term(builder, t) if t.is_Mul else t for t in terms))


def _term(builder: BlockBuilder, value: sp.Expr) -> sp.Expr:
    """Define `value` up to its sign, so that a term and its negative are one name."""
    if value.could_extract_minus_sign():
        return -_term(builder, -value)
    return builder.define(builder.unused("part", value), value, "")


def define_dynamics(
    builder: BlockBuilder, spec: ModelSpec, dynamics: Dynamics
) -> tuple[sp.Matrix, MassSolver, sp.Matrix]:
    """Define M and the bias h = C q' + G; return (M, what solves with M, h) in those names."""
    n = len(spec.coordinates)
    units = [c.unit for c in spec.coordinates]
    raw = dynamics.coriolis_force + dynamics.gravity
    entries = dynamics.mass_matrix.applyfunc(lambda entry: grouped(entry, spec.positions))
    det = grouped(determinant(dynamics, spec.positions), spec.positions) if n <= SMALL else sp.S.One
    named = define_trigonometry(builder, [*entries, *raw, det])
    mass = sp.zeros(n, n)
    for i in range(n):
        for j in range(i, n):
            if dynamics.mass_matrix[i, j] == 0 and n > SMALL:
                continue  # a zero stays one, and the factorisation makes use of it
            mass[i, j] = mass[j, i] = builder.define(
                f"m{i + 1}{j + 1}",
                entries[i, j].xreplace(named),
                "mass matrix, (1)",
                unit_product(("J*s^2", 1), (units[i], -1), (units[j], -1)),
            )
    names = [
        builder.define(
            f"bias{i + 1}", raw[i].xreplace(named), "row of C q' + G, (1)", force_unit(units[i])
        )
        for i in range(n)
    ]
    return mass, MassSolver(builder, mass, det.xreplace(named)), sp.Matrix(names)
