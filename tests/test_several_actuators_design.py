"""`pfaffian design` with two actuators: poles, Riccati rows, and the nearest singular point."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import sympy as sp
from pfaffian.derive.derivation.derive import derive
from pfaffian.derive.design.nearest import REACH, nearest_zero
from pfaffian.derive.design.place.linear_plant import residual_rows, state_space
from pfaffian.derive.design.place.poles import gains_for_poles, placement_for_poles
from pfaffian.derive.design.place.regular_form import placed_rows, spread_poles
from pfaffian.derive.design.place.riccati import read_weights, riccati_row
from pfaffian.derive.design.place.row_space import row_gap
from pfaffian.derive.ir.parameter import Parameter
from pfaffian.derive.lower.model import lower_model
from pfaffian.derive.lower.to_program import lower
from pfaffian.derive.pipeline import derivation_of, lowered_model, parameter_set
from pfaffian.derive.sets.gains import polynomial_of, zero_polynomial
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.spec.model_spec import Matrix
from pfaffian.derive.symbolic.block import BlockBuilder
from pfaffian.runtime.base.errors import InputError
from scipy.linalg import expm

SOURCE = find_model("pvtol")
GAINS = ("weight_x", "rate_x", "rate_theta", "rate_y")
POLES = {
    "apart": (-1, -2, -3, -4),
    "a pair": (-2 + 1j, -2 - 1j, -3, -4),
    "a pair and a double": (-2 + 1j, -2 - 1j, -2, -2),
    "two doubles": (-1.5, -1.5, -4, -4),
    "all alike": (-2, -2, -2, -2),
    "slow": (-0.5, -0.5, -0.5, -0.5),
    "fast": (-20, -20, -20, -20),
}
WEIGHTS = ("1,1,1,1,1,1", "10,10,10,.1,.1,.1", "1,2,3,4,5,6,.3")


@pytest.fixture(scope="module")
def model():
    return lowered_model(SOURCE)


@pytest.fixture(scope="module")
def values(model):
    return parameter_set(model, SOURCE, SOURCE.set_path("hauser")).as_dict()


@pytest.fixture(scope="module")
def free():
    """The same plant under two constraints that can meet every row space: eight gains."""
    spec = derivation_of(SOURCE).spec
    names = [f"{letter}{k}" for letter in "ab" for k in range(1, 5)]
    a1, a2, a3, a4, b1, b2, b3, b4 = (sp.Symbol(n, real=True) for n in names)
    x, y, theta = spec.positions
    dx, dy, dtheta = spec.velocities
    residual = Matrix(
        [
            dy + a1 * dx + a2 * x + a3 * y + a4 * theta,
            dtheta + b1 * dx + b2 * x + b3 * y + b4 * theta,
        ]
    )
    kept = tuple(p for p in spec.parameters if p.group != "synthesised")
    own = tuple(Parameter(n, "", "", "synthesised", -1e6, 1e6) for n in names)
    constraint = replace(spec.constraint, residual=residual)
    return lower_model(derive(replace(spec, parameters=kept + own, constraint=constraint)), ())


def without_gains(model, values):
    chosen = {p.name: math.nan for p in model.parameters if p.group == "synthesised"}
    return {n: v for n, v in values.items() if n not in GAINS} | chosen


def sliding_poles(model, values):
    """The zero dynamics by projection onto s = 0, whose m other eigenvalues are zero."""
    a, b = state_space(model, values)
    rows = residual_rows(model, values)
    null = np.linalg.svd(rows)[2][len(rows) :].T
    return np.linalg.eigvals(null.T @ (a - b @ np.linalg.solve(rows @ b, rows @ a)) @ null)


# Poles


@pytest.mark.parametrize("poles", POLES.values(), ids=POLES)
@pytest.mark.parametrize("start", ["own gains", "no gains"])
def test_the_zero_dynamics_have_the_wanted_polynomial(model, values, poles, start):
    poles = tuple(map(complex, poles))
    given = values if start == "own gains" else without_gains(model, values)
    gains = gains_for_poles(model, given, poles, "--poles")
    have = np.array(zero_polynomial(model, values | gains))
    radius = max(map(abs, poles)) ** np.arange(5)
    off = (have / have[0] - polynomial_of(poles)) / radius
    assert np.abs(off).max() < 1e-10
    found = np.poly(sliding_poles(model, values | gains))
    assert np.abs((found - polynomial_of(poles)) / radius).max() < 1e-9


@pytest.mark.parametrize("p", [0.5, 2.0, 6.0, 20.0])
def test_gains_of_a_fourfold_pole_are_those_worked_out_by_hand(model, values, p):
    """The coefficients alone leave them open to a part in a thousand: (1e-12)^(1/4)."""
    m, j, eps, g = (values[n] for n in ("mass", "inertia", "coupling", "g"))
    weight = -3.0 * p**2 * m / (g * m + 3.0 * eps * j * p**2)
    lead = m + eps * j * weight
    rate_theta = (3.0 * p * lead - eps * j * weight * p / 3.0) / m
    wanted = dict(zip(GAINS, (weight, p / 3.0, rate_theta, p), strict=True))
    found = gains_for_poles(model, without_gains(model, values), (complex(-p),) * 4, "--poles")
    assert found == pytest.approx(wanted, rel=2e-6)


def test_with_drag_the_poles_are_those_of_the_plant_with_it(run, model, values):
    drag = {"x_drag": 0.3, "y_drag": 0.2, "theta_damping": 0.1}
    text = ",".join(f"{n}={v}" for n, v in drag.items())
    found = run("design", "pvtol", "--poles=-1,-2,-3,-4", "--friction", text, "--json").document()
    have = np.array(zero_polynomial(model, values | drag | found["gains"]))
    assert have / have[0] == pytest.approx(polynomial_of((-1, -2, -3, -4)), rel=1e-9)
    assert found["placement"]["by"] in ("row space", "coefficients")
    assert found["stable"] is True


def test_constraints_that_do_not_couple_cannot_hold_two_double_pairs(refused):
    """One constraint has a single pole, which is real; the other three."""
    refused(
        *("design", "pvtol", "--poles=-2+1j,-2-1j,-2+1j,-2-1j"),
        says=("--poles: no gains weight_x, rate_x", "is off by 0.0", "at least one real pole"),
    )


@pytest.mark.parametrize("poles", [*POLES.values(), (-2 + 1j, -2 - 1j, -2 + 1j, -2 - 1j)])
def test_a_residual_with_enough_gains_meets_the_rows_of_the_regular_form(free, values, poles):
    poles = tuple(map(complex, poles))
    given = without_gains(free, values)
    found = placement_for_poles(free, given, poles, "--poles")
    assert found.row_gap < 1e-9
    assert (found.by == "row space") == (found.spread == 0.0)
    radius = max(map(abs, poles)) ** np.arange(5)
    have = np.array(zero_polynomial(free, given | found.gains))
    assert np.abs((have / have[0] - polynomial_of(poles)) / radius).max() < 1e-10
    if found.spread == 0.0:
        placed = placed_rows(*state_space(free, given), poles)
        assert row_gap(residual_rows(free, given | found.gains), placed.rows) < 1e-9


@pytest.mark.parametrize(("n", "m"), [(2, 2), (3, 2), (4, 3)])
def test_placed_rows_leave_the_wanted_poles_on_s_zero(n, m):
    rng = np.random.default_rng(n + 10 * m)
    a = np.vstack([np.eye(n, 2 * n, n), rng.normal(size=(n, 2 * n))])
    b = np.vstack([np.zeros((n, m)), rng.normal(size=(n, m))])
    poles = tuple(-1.0 - 0.5 * k + 0.0j for k in range(2 * n - m))
    s = placed_rows(a, b, poles).rows
    null = np.linalg.svd(s)[2][m:].T
    found = np.linalg.eigvals(null.T @ (a - b @ np.linalg.solve(s @ b, s @ a)) @ null)
    assert sorted(found.real) == pytest.approx(sorted(p.real for p in poles), rel=1e-6)
    assert np.abs(found.imag).max() < 1e-6


def test_poles_are_spread_no_more_than_needed():
    assert spread_poles((-2, -2, -1), 2, 0.02) == (-2, -2, -1)
    assert spread_poles((-2, -2, -2, -2), 2, 0.02) == pytest.approx((-1.98, -1.98, -2.02, -2.02))
    pairs = spread_poles((-2 + 1j, -2 - 1j) * 2, 1, 0.02)
    assert len(set(pairs)) == 4
    assert {p.conjugate() for p in pairs} == set(pairs)


def test_a_left_factor_leaves_the_row_space(model, values):
    rng = np.random.default_rng(3)
    rows = residual_rows(model, values)
    assert row_gap(rng.normal(size=(2, 2)) @ rows, rows) < 1e-12
    assert row_gap(np.vstack([rows[0], rows[0]]), rows) == 1.0
    turned = rows.copy()
    turned[0] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]
    assert 0.1 < row_gap(turned, rows) <= 1.0


# Riccati rows


@pytest.mark.parametrize("drag", [0.0, 0.3])
@pytest.mark.parametrize("weights", WEIGHTS)
def test_the_rows_are_the_residuals_and_p_falls_along_the_zero_dynamics(
    model, values, weights, drag
):
    given = values | {"x_drag": drag, "theta_damping": drag}
    found = riccati_row(model, given, *read_weights(model, weights, "--riccati"), "--riccati")
    a, b = state_space(model, given)
    p, q = np.array(found.matrix), np.diag(found.weights)
    residue = a.T @ p + p @ a - p @ b @ b.T @ p / found.effort + q
    assert np.abs(residue).max() < 1e-8 * np.abs(p).max()
    own = residual_rows(model, given | found.gains)
    assert np.array(found.rows) == pytest.approx(b.T @ p)
    assert row_gap(own, b.T @ p) < 1e-8
    null = np.linalg.svd(own)[2][2:].T
    sliding = a - b @ np.linalg.solve(own @ b, own @ a)
    rng = np.random.default_rng(5)
    worst = -math.inf
    for x in rng.normal(size=(40, 4)) @ null.T:
        v = [float(y @ p @ y) for y in (expm(sliding * t) @ x for t in np.linspace(0.0, 4.0, 41))]
        assert all(later < earlier for earlier, later in pairwise(v))
        rate = 2.0 * x @ p @ sliding @ x
        assert rate == pytest.approx(-float(x @ q @ x), rel=1e-6)
        worst = max(worst, rate / (x @ p @ x))
    assert worst <= found.lyapunov_rate < 0.0
    largest = -1.0 / np.max(
        np.linalg.eigvals(np.linalg.solve(null.T @ q @ null, null.T @ p @ null))
    )
    assert found.lyapunov_rate == pytest.approx(largest.real, rel=1e-6)
    poles = np.roots(zero_polynomial(model, given | found.gains))
    assert max(pole.real for pole in poles) <= found.lyapunov_rate / 2.0


def test_the_command_gives_both_rows_and_the_rate(run, workspace):
    arguments = ("design", "pvtol", "--riccati", WEIGHTS[0])
    found = run(*arguments, "-o", "mine.toml", "--json").document()
    lyapunov = found["lyapunov"]
    assert np.array(lyapunov["row"]).shape == (2, 6)
    assert lyapunov["row_gap"] < 1e-9
    assert lyapunov["lyapunov_rate"] < 0.0
    assert found["method"] == "riccati"
    again = run("design", "pvtol", "--params", "mine.toml", "--json").document()
    assert again["gains"] == found["gains"]
    plain = run(*arguments)
    assert plain.out.count("row B^T P") == 2
    assert "largest V'/V on s = 0" in plain.out


def test_a_residual_that_cannot_meet_the_rows_is_refused_with_the_gap(model, values):
    fewer = tuple(
        replace(p, group="gain") if p.name == "rate_theta" else p for p in model.parameters
    )
    with pytest.raises(InputError, match=r"2 rows B\^T P .* is 0\.\d+ away") as refusal:
        riccati_row(replace(model, parameters=fewer), values, (1.0,) * 6, 1.0, "--riccati")
    assert "--poles" in refusal.value.remedy


def test_both_families_of_the_trade_off_are_complete(run):
    curve = run("design", "pvtol", "--curve", "--json").document()["curve"]
    assert [p["family"] for p in curve] == ["poles"] * 25 + ["riccati"] * 25
    for point in curve[:25]:
        assert point["gains"]["rate_y"] == pytest.approx(-point["knob"], rel=1e-5)


# The nearest singular point


def program(expression, names):
    builder = BlockBuilder("input_gain", "a test")
    for name in names:
        builder.take(sp.Symbol(name, real=True), "", "", "input")
    builder.give("adb", expression, "", "")
    return lower(builder.build())


X, Y, Z = sp.symbols("x y z", real=True)
SURFACES = {
    "a plane": (1 - X - Y, "xy", math.sqrt(0.5)),
    "a plane in space": (1 - X - Y - 2 * Z, "xyz", math.sqrt(1.0 / 6.0)),
    "a small circle between the rays": (
        (X - sp.Rational(7, 10)) ** 2 + (Y - sp.Rational(4, 10)) ** 2 - sp.Rational(1, 100),
        "xy",
        math.hypot(0.7, 0.4) - 0.1,
    ),
    "an ellipse": (X**2 / 4 + Y**2 - 1, "xy", 1.0),
    "one angle": (sp.cos(X) - sp.Rational(1, 2), "x", math.pi / 3.0),
}


@pytest.mark.parametrize(("expression", "names", "wanted"), SURFACES.values(), ids=SURFACES)
def test_the_nearest_zero_of_known_surfaces(expression, names, wanted):
    surface = program(expression, names)
    offset, least = nearest_zero(surface, {}, dict.fromkeys(names, 0.0))
    found = math.hypot(*offset.values())
    assert found == pytest.approx(wanted, rel=1e-6)
    assert 0.98 * wanted < least <= found
    there = sp.lambdify([sp.Symbol(n, real=True) for n in names], expression)
    assert there(*offset.values()) == pytest.approx(0.0, abs=1e-9)
    rng = np.random.default_rng(4)
    inside = rng.normal(size=(20_000, len(names)))
    inside *= (least * rng.random(20_000) / np.linalg.norm(inside, axis=1))[:, None]
    signs = np.sign(there(*inside.T))
    assert (signs == np.sign(there(*[0.0] * len(names)))).all()


def test_where_there_is_no_zero_none_is_found_and_the_ball_is_proved_free():
    offset, least = nearest_zero(program(3 + sp.cos(X) * sp.cos(Y), "xy"), {}, {"x": 0.0, "y": 0.0})
    assert offset == {}
    assert least == pytest.approx(REACH, rel=1e-3)


def test_a_zero_that_only_touches_is_not_claimed_to_be_absent():
    """No sign changes there, so no zero is found; the proof must stop in front of it."""
    touching = (X - 1) ** 2 + Y**2
    offset, least = nearest_zero(program(touching, "xy"), {}, {"x": 0.0, "y": 0.0})
    assert offset == {}
    assert least <= 1.0


def test_the_singular_set_of_two_actuators_is_where_the_determinant_vanishes(run, values):
    """det ADB = (cos theta + eps w J/m)/(m J), since sin^2 + cos^2 = 1."""
    found = run("design", "pvtol", "--json").document()
    m, j, eps, w = (values[n] for n in ("mass", "inertia", "coupling", "weight_x"))
    wanted = math.acos(-eps * w * j / m)
    assert found["singular_distance_rad"] == pytest.approx(wanted, abs=1e-10)
    nearest = found["nearest_singular_point"]
    assert nearest["distance"] == pytest.approx(wanted, abs=1e-10)
    assert nearest["least"] == pytest.approx(wanted, rel=1e-5)
    assert nearest["least"] <= wanted
    assert list(nearest["offset"]) == ["theta"]
    assert nearest["unit"] == "rad"
    assert found["input_gain"] == pytest.approx((1.0 + eps * w * j / m) / (m * j), rel=1e-12)


@pytest.mark.parametrize("name", ["pendubot", "furuta", "acrobot", "tora", "two_wheeled"])
def test_with_one_coordinate_it_is_the_offset_of_the_scan(run, name):
    found = run("design", name, "--json").document()
    nearest = found["nearest_singular_point"]
    if found["singular_distance_rad"] == "inf":
        assert nearest["offset"] == {}
    else:
        assert nearest["distance"] == pytest.approx(found["singular_distance_rad"], abs=1e-9)
        assert nearest["least"] <= nearest["distance"]
