"""Hurwitz conditions in closed form and Routh's array in numbers, against the roots themselves."""

from __future__ import annotations

import itertools
import random
import re

import numpy as np
import pytest
import sympy as sp
from pfaffian.derive.mechanics.hurwitz import (
    CLOSED_DEGREE,
    LONGEST,
    closed_conditions,
    coefficient_symbols,
    hurwitz_conditions,
)
from pfaffian.derive.mechanics.zero_dynamics import ZeroDynamics
from pfaffian.derive.models.pendubot.spec import PARAMETERS
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
from pfaffian.derive.sets.gains import is_hurwitz, zero_polynomial
from pfaffian.derive.sets.parameter_set import violated_bounds
from pfaffian.derive.sets.routh import hurwitz_margins, routh_column, violated_rows
from pfaffian.derive.spec.library import find_model, library_models
from pfaffian.derive.spec.model_spec import symbols_of
from test_own_plant import FILES

P = symbols_of(PARAMETERS)


def rightmost(polynomial) -> float:
    """Return the largest real part of the roots, over their size; 0 is the imaginary axis."""
    roots = np.roots(polynomial)
    return float(max(roots.real) / max(abs(roots)))


def random_polynomial(numbers: random.Random, degree: int) -> list[float]:
    """Return one with real roots and pairs well off the imaginary axis, to either side of it."""
    polynomial = np.array([numbers.choice((1.0, -1.0)) * numbers.uniform(0.5, 3.0)])
    side = -1.0 if numbers.random() < 0.5 else None
    while len(polynomial) <= degree:
        real = (side or numbers.choice((1.0, -1.0))) * numbers.uniform(0.1, 2.0)
        if degree + 1 - len(polynomial) > 1 and numbers.random() < 0.6:
            imaginary = numbers.uniform(0.0, 4.0)
            polynomial = np.polymul(polynomial, [1.0, -2.0 * real, real**2 + imaginary**2])
        else:
            polynomial = np.polymul(polynomial, [1.0, -real])
    return [float(c) for c in polynomial]


@pytest.mark.parametrize("degree", range(1, 7))
def test_rouths_column_counts_the_roots_on_the_right(degree):
    numbers = random.Random(degree)
    stable = 0
    for _ in range(1000):
        polynomial = random_polynomial(numbers, degree)
        column = routh_column(polynomial)
        right = int(sum(np.roots(polynomial).real > 0.0))
        changes = sum((a > 0.0) != (b > 0.0) for a, b in itertools.pairwise(column))
        assert (len(column), column[0]) == (degree + 1, 1.0)
        assert changes == right, polynomial
        assert is_hurwitz(tuple(polynomial)) == (right == 0)
        stable += right == 0
    assert 300 < stable < 900


@pytest.mark.parametrize(
    ("polynomial", "column"),
    [
        ((1.0, 0.0, 1.0), (1.0, 0.0)),  # roots on the axis
        ((1.0, 2.0, 1.0, 2.0), (1.0, 2.0, 0.0)),  # (p + 2)(p^2 + 1): a row of zeros
        ((1.0, 1.0, 2.0, 2.0, 3.0), (1.0, 1.0, 0.0)),  # a zero in the column alone
        ((1.0, 3.0, 2.0, 0.0), (1.0, 3.0, 2.0, 0.0)),  # a root at 0
        ((-2.0, -6.0, -4.0), (1.0, 3.0, 2.0)),  # negative throughout: stable
        ((-1.0, 3.0, 2.0), (1.0, -3.0, -2.0)),
        ((4.0,), (1.0,)),
    ],
)
def test_rouths_column_ends_at_its_first_zero_and_is_scaled_by_the_leading_coefficient(
    polynomial, column
):
    assert routh_column(polynomial) == column
    stable = len(column) == len(polynomial) and all(c > 0.0 for c in column)
    assert is_hurwitz(polynomial) == stable
    assert stable == bool(np.all(np.roots(polynomial).real < -1e-12))
    assert bool(violated_rows(polynomial)) != stable


@pytest.mark.parametrize("polynomial", [(0.0, 1.0, 1.0), (1.0, float("nan")), (float("inf"), 1.0)])
def test_a_polynomial_without_its_leading_coefficient_or_with_no_number_is_not_hurwitz(polynomial):
    assert np.isnan(routh_column(polynomial)).tolist() == [True]
    assert not is_hurwitz(polynomial)
    assert violated_rows(polynomial)


@pytest.mark.parametrize("degree", range(1, CLOSED_DEGREE + 1))
def test_closed_conditions_of_free_coefficients_agree_with_the_roots(degree):
    names = coefficient_symbols(degree)
    conditions = closed_conditions(names)
    assert len(conditions) == degree + (degree > 2)
    margins = sp.lambdify(names, [c.margin for c in conditions])
    in_names = sp.lambdify(names, [c.in_names for c in conditions])
    numbers = random.Random(100 + degree)
    for _ in range(3000):
        polynomial = random_polynomial(numbers, degree)
        stable = rightmost(polynomial) < 0.0
        assert all(m > 0.0 for m in margins(*polynomial)) == stable, polynomial
        assert all(m > 0.0 for m in in_names(*polynomial)) == stable, polynomial


def test_what_always_holds_is_dropped_and_what_never_holds_is_said():
    m, d, k = sp.symbols("m d k", positive=True)
    x, y = sp.symbols("x y", real=True)
    assert closed_conditions([m, d, k]) == ()
    assert [c.text for c in closed_conditions([m, d * x, k * x])] == ["x > 0"]
    assert [c.text for c in closed_conditions([-m, d * x - y, -k])] == ["y > d*x"]
    assert [c.text for c in closed_conditions([m, -d * x, k])] == ["x < 0"]
    assert [c.text for c in closed_conditions([0.5 * m, 0.5 * d * x, k])] == ["x > 0"]
    assert [c.text for c in closed_conditions([m, 0, k])] == ["a1/a2 > 0, which never holds"]
    assert [c.text for c in closed_conditions([m, d, -k])] == ["a0/a2 > 0, which never holds"]
    undamped = closed_conditions([m, d, k, k * d / m])
    assert [c.text for c in undamped] == ["a1*a2 > a0*a3, which never holds"]


def test_a_square_is_kept_where_it_may_be_zero():
    x = sp.Symbol("x", real=True)
    (condition,) = closed_conditions([1, x**2])
    assert condition.margin == x**2  # p + x^2 is not Hurwitz for x = 0


def test_large_determinants_stay_in_named_coefficients():
    rows = [sum(sp.symbols(f"{letter}0:8", real=True)) for letter in "stuvw"]
    last = closed_conditions(rows)[-1]
    assert last.named
    assert last.text == "(-a0*a3**2 - a1**2*a4 + a1*a2*a3)/a4 > 0"


def test_there_is_no_closed_form_above_degree_four():
    coefficients = tuple(coefficient_symbols(5))
    zeros = ZeroDynamics(coefficients, (), (), (), coefficients, ())
    found = hurwitz_conditions(derivation_of(find_model("pendubot")).spec, zeros)
    assert (found.closed, found.frictionless, found.damped) == (False, (), ())


@pytest.mark.parametrize("name", library_models())
def test_closed_conditions_of_every_model_agree_with_its_roots(name):
    """Gains and friction drawn around those of the model's sets, without and with friction."""
    folder = find_model(name)
    model = lowered_model(folder)
    gains = [p.name for p in model.parameters if p.group == "synthesised"]
    rubbing = [p.name for p in model.parameters if p.group == "uncertainty"]
    positive = {p.name for p in model.parameters if p.lower == 0.0}
    numbers = random.Random(name)
    sets = library_sets(model, folder)[:2]  # read once: a set's mass matrix is judged on a grid
    for friction in (False, True):
        verdicts = []
        for k in range(400):
            near = k % 2
            values = numbers.choice(sets).as_dict()
            for gain in gains:
                turn = -1.0 if gain not in positive and not near and numbers.random() < 0.1 else 1.0
                values[gain] *= turn * numbers.lognormvariate(0.0, 0.03 if near else 0.4)
            values |= dict.fromkeys(rubbing, 0.0)
            if friction:
                values |= {
                    n: numbers.uniform(-1.0, 3.0) * (1e-6 if near else 1e-3) for n in rubbing
                }
            polynomial = zero_polynomial(model, values)
            if abs(rightmost(polynomial)) < 1e-6:
                continue
            margins = hurwitz_margins(model, values)
            stable = rightmost(polynomial) < 0.0
            assert all(m.margin > 0.0 for m in margins) == stable == is_hurwitz(polynomial), values
            assert bool(violated_bounds(model, values)) or stable
            verdicts.append(stable)
        assert 20 < sum(verdicts) < len(verdicts) - 20


@pytest.mark.parametrize("name", library_models())
def test_every_model_shows_its_conditions_in_a_readable_length(name):
    folder = find_model(name)
    found = derivation_of(folder).hurwitz
    assert found.frictionless
    assert found.damped
    for condition in (*found.frictionless, *found.damped):
        assert condition.named or len(str(condition.margin)) <= LONGEST
        assert not condition.never
    documents = dict(lowered_model(folder).documents)
    assert "## Hurwitz conditions\n" in documents["derivation.md"]
    assert "\\subsection*{Hurwitz conditions}\n" in documents["derivation.tex"]
    assert all(f'"caption": "without friction, {c.says}"' in documents["derivation.json"]
               for c in found.frictionless)  # fmt: skip


def upright_margins() -> list[sp.Expr]:
    conditions = derivation_of(find_model("pendubot")).hurwitz.frictionless
    return [c.margin.subs({P.q1d: sp.pi / 2, P.q2d: 0}) for c in conditions]


def test_the_pendubots_derived_conditions_are_those_of_the_theory():
    """Both directions exactly: lam2 > 0 and 1 < lam lam1/lam2 < lam < 1 + theta3/theta2.

    lam, lam1, lam2 and the inertias are positive by declaration. One side: the theory's set is all
    of lam1 = u, lam2 = u + v, lam lam1 = lam2 + w, theta3 = (lam - 1) theta2 + z with u, v, w, z
    positive, and there every derived margin is positive. The other: where lam <= 1, or where
    lam > 1 and theta3 < (lam - 1) theta2, one derived margin is not positive; and elsewhere two of
    them have the signs of the two bounds that are left.
    """
    t, u, v, w, z = sp.symbols("t u v w z", positive=True)
    margins = upright_margins()
    within = [(P.theta3, (P.lam - 1) * P.theta2 + z), (P.lam, (P.lam2 + w) / P.lam1),
              (P.lam2, P.lam1 + v), (P.lam1, u)]  # fmt: skip
    assert all(sp.factor(m.subs(within)).is_positive for m in margins)

    _, ratio, slow, last = margins
    assert sp.factor(ratio.subs(P.lam, 1 / (1 + t))).is_negative
    assert ratio.subs(P.lam, 1) == 0
    assert sp.factor(ratio.subs(P.theta2, (P.theta3 + z) / t).subs(P.lam, 1 + t)).is_negative
    assert sp.expand(slow.subs(P.lam, 1 + t) * t - ((1 + t) * P.lam1 - P.lam2)) == 0
    assert sp.expand(last - (P.lam2 - P.lam1)) == 0
    worded = [c.margin for c in derivation_of(find_model("pendubot")).spec.stability]
    assert worded[0] == P.lam2
    assert sp.expand(worded[1] * P.lam2 - (P.lam * P.lam1 - P.lam2)) == 0
    assert sp.expand(worded[2] * P.lam2 / P.lam - (P.lam2 - P.lam1)) == 0
    assert sp.expand(worded[3] * P.theta2 - (P.theta2 + P.theta3 - P.lam * P.theta2)) == 0


def test_the_pendubots_derived_worded_and_numerical_verdicts_agree_on_random_gains():
    derivation = derivation_of(find_model("pendubot"))
    still = {s: 0 for c in derivation.zero_dynamics.coefficients for s in c.free_symbols
             if s.name.startswith("joint")}  # fmt: skip
    at = {P.q1d: sp.pi / 2, P.q2d: 0} | still
    names = [P.lam, P.lam1, P.lam2, P.theta2, P.theta3, P.theta5, P.g]
    polynomial = sp.lambdify(names, [c.subs(at) for c in derivation.zero_dynamics.coefficients])
    derived = sp.lambdify(names, upright_margins())
    worded = sp.lambdify(names, [c.margin for c in derivation.spec.stability])
    numbers = random.Random(11)
    stable = 0
    for _ in range(20000):
        point = [numbers.uniform(1e-3, 3.0) for _ in names]
        have = [float(c) for c in polynomial(*point)]
        verdict = all(float(m) > 0.0 for m in derived(*point))
        assert verdict == all(m > 0.0 for m in worded(*point)), point
        if abs(rightmost(have)) > 1e-6:
            assert verdict == (rightmost(have) < 0.0), point
        stable += verdict
    assert stable > 500


@pytest.fixture
def ballbeam(workspace):
    """Write the plant of docs/own-plant.md; return a function that changes its set."""
    (workspace / "ballbeam").mkdir()
    for name in ("ballbeam/spec.py", "ballbeam/bench.toml"):
        (workspace / name).write_text(FILES[name], encoding="utf-8")

    def gains(weight: str, rate_r: str, rate_theta: str) -> None:
        text = (
            f'weight_r = "{weight} 1/m"\nrate_r = "{rate_r} 1/s"\nrate_theta = "{rate_theta} 1/s"'
        )
        path = workspace / "ballbeam" / "bench.toml"
        old = path.read_text(encoding="utf-8")
        path.write_text(re.sub(r"zero_dynamics_poles = .*", text, old), encoding="utf-8")

    return gains


def test_a_users_unstable_set_is_told_the_derived_condition_and_by_how_much(ballbeam, refused):
    ballbeam("-1.713", "6", "0.75")
    message = refused("generate", "./ballbeam", "-o", "out", says=("ballbeam/bench.toml: ",))
    assert message.endswith(" 1/s; violated: rate_theta > rate_r (off by 5.25)")


def test_a_setpoint_gain_of_the_wrong_sign_is_told_too(ballbeam, refused, run):
    ballbeam("1.713", "0.6667", "6")
    message = refused("generate", "./ballbeam", "-o", "out", says=("ballbeam/bench.toml: ",))
    assert message.endswith("violated: weight_r*cos(thetad) < 0 (off by 1.713)")
    document = run("design", "./ballbeam", "--json").document()
    assert document["violated"] == ["weight_r*cos(thetad) < 0 (off by 1.713)"]
    assert document["routh_column"] == pytest.approx([1.0, 6.0, -10.671, -8.0031], rel=1e-3)


def test_instability_by_friction_alone_is_told_with_friction(run):
    """The worded conditions of the pendubot are of the plant without friction, and hold here."""
    shown = run("design", "pendubot", "--set", "sim", "--friction", "joint2_viscous=0.01", "--json")
    first, *_ = shown.document()["violated"]
    assert first.startswith("(damping_q2*lam + lam*lam1*theta2 - lam2*theta2 - lam2*theta3*cos(q2d")
    assert "lam lam1/lam2" not in first


THREE_CARTS = """
from pfaffian.derive.authoring import ModelBuilder


def model():
    m = ModelBuilder("carts", title="Three carts in a row", source="made up here")
    (x, dx), (y, dy), (z, dz) = (
        m.coordinate(n, "m", f"position {n}", bound=10, rate_bound=100) for n in "xyz"
    )
    mass = m.parameter("mass", "kg", "mass of each")
    spring = m.parameter("spring", "N/m", "each spring")
    m.actuator("u", "N", "force", on={"x": 1})
    return m.build(
        kinetic_energy=mass * (dx**2 + dy**2 + dz**2) / 2,
        potential_energy=spring * ((x - y) ** 2 + (y - z) ** 2) / 2,
    )
"""


def test_above_degree_four_the_row_of_rouths_array_is_told(workspace, refused, run):
    folder = workspace / "carts"
    folder.mkdir()
    (folder / "spec.py").write_text(THREE_CARTS, encoding="utf-8")
    (folder / "own.toml").write_text(
        'title = "t"\nsource = "s"\n[parameters]\nmass = "1 kg"\nspring = "1 N/m"\n[gains]\n'
        'weight_x = 1\nweight_y = 0\nrate_x = "1 1/s"\nrate_y = "1 1/s"\nrate_z = "-3 1/s"\n'
        'sigma = "5 1/s"\neta = "0.001 m/s^2"\nkappa = "1 kg^2/s"\nepsilon = "1 m^2/s^3"\n'
        'k1 = "1e-5 kg^2/s^2"\nk2 = "2 1/s"\nbound_initial = "0.01 N"\n[target]\n'
        'sample_time = "2 ms"\ntorque_limit = "1 N"\nsingular_threshold = "1e-3 1/kg"\n',
        encoding="utf-8",
    )
    text = run("derive", "./carts").out
    assert "a5*p^5 + a4*p^4" in text
    assert "no closed form is given for degree 5" in text
    refused("generate", "./carts", "-o", "out", says=("violated: row ", "of Routh's column > 0"))


def test_derive_and_design_report_the_margins_of_a_set(run):
    document = run("derive", "cart_pole", "--set", "barto", "--json").document()
    conditions = {m["condition"]: m["margin"] for m in document["design"]["hurwitz"]}
    assert conditions["rate_x > 0"] == pytest.approx(1.0)
    assert min(conditions.values()) > 0.0
    column = run("design", "cart_pole", "--set", "barto", "--json").document()["routh_column"]
    assert column == document["design"]["routh_column"]
    assert column == pytest.approx([1.0, 9.0, 24.0, 27.0])  # (p + 3)^3
    for command in ("derive", "design"):
        shown = run(command, "cart_pole", "--set", "barto").out
        assert "Routh's column, 1/s^k" in shown
        assert "1, 9, 24, 27" in shown
    assert "(rate_theta - rate_x)/weight_x > 0" in run("derive", "cart_pole").out
