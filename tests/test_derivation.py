"""The Pendubot's derivation against the formulas published in the paper and in the theory."""

import random

import pytest
import sympy as sp
from pfaffian.derive.derivation.derive import derive
from pfaffian.derive.models.pendubot.spec import PARAMETERS, model
from pfaffian.derive.sets.gains import is_hurwitz
from pfaffian.derive.spec.model_spec import symbols_of
from pfaffian.derive.symbolic.normal_form import is_zero, zero_matrix, zero_residual

P = symbols_of(PARAMETERS)
Q1, Q2, DQ1, DQ2 = sp.symbols("q1 q2 dq1 dq2", real=True)


@pytest.fixture(scope="module")
def derivation():
    return derive(model())


def test_mass_coriolis_and_gravity_are_those_printed_in_equation_1(derivation):
    t1, t2, t3, t4, t5, g = P.theta1, P.theta2, P.theta3, P.theta4, P.theta5, P.g
    mass = sp.Matrix(
        [
            [t1 + t2 + 2 * t3 * sp.cos(Q2), t2 + t3 * sp.cos(Q2)],
            [t2 + t3 * sp.cos(Q2), t2],
        ]
    )
    coriolis = sp.Matrix([[-t3 * DQ2, -t3 * (DQ2 + DQ1)], [t3 * DQ1, 0]]) * sp.sin(Q2)
    gravity = sp.Matrix([t4 * g * sp.cos(Q1) + t5 * g * sp.cos(Q1 + Q2), t5 * g * sp.cos(Q1 + Q2)])
    assert zero_matrix(derivation.dynamics.mass_matrix - mass)
    assert zero_matrix(derivation.dynamics.coriolis_matrix - coriolis)
    assert zero_matrix(derivation.dynamics.gravity - gravity)


def test_dynamics_agree_with_sympys_own_lagranges_method(derivation):
    """An independent derivation: other code, from the energies in physical parameters."""
    from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols

    spec = model()
    q1, q2 = dynamicsymbols("q1 q2")
    t = dynamicsymbols._t
    moving = {Q1: q1, Q2: q2, DQ1: q1.diff(t), DQ2: q2.diff(t)}
    energy = (spec.kinetic_energy - spec.potential_energy).subs(moving)
    method = LagrangesMethod(energy, [q1, q2])
    method.form_lagranges_equations()
    back = [(q1.diff(t), DQ1), (q2.diff(t), DQ2), (q1, Q1), (q2, Q2)]
    lumped = dict(spec.lumping)
    dynamics = derivation.dynamics
    bias = dynamics.coriolis_matrix * sp.Matrix([DQ1, DQ2]) + dynamics.gravity
    assert zero_matrix(method.mass_matrix.subs(back) - dynamics.mass_matrix.subs(lumped))
    assert zero_matrix(-method.forcing.subs(back) - bias.subs(lumped))


def test_input_gain_has_the_term_that_equation_10_drops(derivation):
    det = P.theta1 * P.theta2 - P.theta3**2 * sp.cos(Q2) ** 2
    wanted = ((P.lam - 1) * P.theta2 - P.theta3 * sp.cos(Q2)) / det
    printed = P.lam * P.theta2 / det
    assert is_zero(derivation.input_gain - wanted)
    assert not is_zero(derivation.input_gain - printed)


def test_constraint_matrices_are_those_of_equation_7(derivation):
    s = P.lam * (DQ1 + P.lam1 * (Q1 - P.q1d)) + DQ2 + P.lam2 * (Q2 - P.q2d)
    b = (
        -P.lam * P.lam1 * DQ1
        - P.lam2 * DQ2
        - P.sigma * s
        - 2 * P.eta / sp.pi * sp.atan(sp.expand(s))
    )
    assert derivation.constraint.jacobian == sp.Matrix([[P.lam, 1]])
    difference = derivation.constraint.acceleration[0] - b
    assert sp.expand(difference.subs(sp.atan(s), 0)).replace(sp.atan, lambda _: sp.S.Zero) == 0
    (arctan,) = derivation.constraint.acceleration[0].atoms(sp.atan)
    assert sp.expand(arctan.args[0] - s) == 0


def test_mismatched_part_is_that_of_the_theory(derivation):
    f2 = derivation.decomposition.force[1]
    c2 = sp.cos(Q2)
    first = (
        f2
        * (P.lam * (P.theta2 + P.theta3 * c2) - P.theta1 - P.theta2 - 2 * P.theta3 * c2)
        / ((P.lam - 1) * P.theta2 - P.theta3 * c2)
    )
    assert is_zero(derivation.decomposition.mismatched[0] - first)
    assert derivation.decomposition.mismatched[1] == f2


def test_every_identity_is_proved_and_a_false_one_is_not(derivation):
    assert len(derivation.identities) == 8
    assert all(identity.proved for identity in derivation.identities)
    assert not is_zero(sp.sin(Q1) ** 2 + sp.cos(Q1) ** 2 - 1 - P.g * sp.sin(Q2))
    assert zero_residual(sp.sin(Q1 + Q2) ** 2 + sp.cos(Q1 + Q2) ** 2 - 1) == 0


def upright(expression):
    friction = {
        s: 0 for s in expression.free_symbols if "friction" in s.name or s.name.endswith("load")
    }
    return expression.subs({P.q1d: sp.pi / 2, P.q2d: 0} | friction)


def test_zero_dynamics_polynomial_is_that_of_the_theory(derivation):
    d2 = P.joint2_viscous
    t2, t3, t5 = P.theta2, P.theta3, P.theta5
    wanted = (
        P.lam * t2 - t2 - t3,
        P.lam * d2 + P.lam * P.lam1 * t2 - P.lam2 * (t2 + t3),
        P.lam * P.lam1 * d2 + P.g * t5 * (1 - P.lam),
        P.g * t5 * (P.lam2 - P.lam * P.lam1),
    )
    for coefficient, expected in zip(derivation.zero_dynamics.coefficients, wanted, strict=True):
        assert sp.expand(upright(coefficient) - expected) == 0


def test_gain_synthesis_is_the_closed_form_of_the_theory(derivation):
    c2, c1, c0 = derivation.zero_dynamics.wanted
    t2, t3, weight = P.theta2, P.theta3, P.g * P.theta5
    wanted = {
        P.lam: (weight + c1 * (t2 + t3)) / (weight + c1 * t2),
        P.lam1: (c0 * (t2 + t3) + c2 * weight) / (weight + c1 * (t2 + t3)),
        P.lam2: (c0 * t2 + c2 * weight) / (weight + c1 * t2),
    }
    for gain, expression in derivation.zero_dynamics.gains:
        assert is_zero(upright(expression) - wanted[gain])


def test_named_stability_conditions_are_equivalent_to_hurwitz(derivation):
    """10,000 random gain sets: the closed form of the theory and Routh's array agree on each."""
    numbers = random.Random(7)
    gains = [P.lam, P.lam1, P.lam2, P.theta2, P.theta3, P.theta5, P.g]
    polynomial = sp.lambdify(gains, [upright(c) for c in derivation.zero_dynamics.coefficients])
    margins = sp.lambdify(gains, [c.margin for c in derivation.spec.stability])
    still = sp.Symbol("joint2_viscous", real=True)
    polynomial = sp.lambdify(
        gains, [upright(c).subs(still, 0) for c in derivation.zero_dynamics.coefficients]
    )
    stable = 0
    for _ in range(10_000):
        t2, t3 = numbers.uniform(0.001, 0.01), numbers.uniform(0.001, 0.01)
        lam = numbers.uniform(0.5, 1.0 + 1.2 * t3 / t2)
        lam2 = numbers.uniform(0.1, 10.0)
        lam1 = lam2 * numbers.uniform(0.1, 1.6)
        point = (lam, lam1, lam2, t2, t3, numbers.uniform(0.01, 0.1), 9.8)
        closed_form = all(m > 0 for m in margins(*point))
        assert closed_form == is_hurwitz(tuple(map(float, polynomial(*point)))), point
        stable += closed_form
    assert 500 < stable < 9_500  # both answers occur


def test_energies_with_a_wrong_unit_are_refused():
    """The paper prints g in kg/m^2: with that unit V is no energy."""
    from dataclasses import replace

    from pfaffian.derive.spec.check_dimensions import check_dimensions
    from pfaffian.runtime.base.errors import InputError

    spec = model()
    check_dimensions(spec)
    printed = tuple(replace(p, unit="kg/m^2") if p.name == "g" else p for p in spec.parameters)
    with pytest.raises(InputError, match="potential energy"):
        check_dimensions(replace(spec, parameters=printed))
    inertia = tuple(replace(p, unit="kg*m^2") if p.name == "theta4" else p for p in spec.parameters)
    with pytest.raises(InputError, match="theta4"):
        check_dimensions(replace(spec, parameters=inertia))
