"""The constraint from a Riccati equation: its algebra, its Lyapunov function, theory's figures."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import sympy as sp
from pfaffian.derive.design import assess
from pfaffian.derive.design.assess import with_values
from pfaffian.derive.design.place.linear_plant import state_space
from pfaffian.derive.design.place.riccati import read_weights, riccati_row
from pfaffian.derive.pipeline import lowered_model, parameter_set
from pfaffian.derive.sets.gains import zero_polynomial
from pfaffian.derive.spec.library import find_model
from scipy.linalg import expm

SOURCE = find_model("pendubot")
BALANCED, UNIT = "10,10,.1,.1", "1,1,1,1"
#: Section 3.7 of the theory: gains as printed there, and the digits they are printed with.
MEASURED = {
    ("sim", BALANCED): (2.084, 6.621, 11.601),
    ("sim", UNIT): (1.692, 6.410, 10.599),
    ("rig", BALANCED): (1.599, 5.687, 7.876),
    ("rig", UNIT): (1.397, 5.612, 7.653),
}


@pytest.fixture(scope="module")
def model():
    return lowered_model(SOURCE)


def plant(model, name):
    return parameter_set(model, SOURCE, SOURCE.set_path(name))


def row_of(model, name, weights):
    diagonal, effort = read_weights(model, weights, "--riccati")
    return riccati_row(model, plant(model, name).as_dict(), diagonal, effort, "--riccati")


@pytest.mark.parametrize("order", [2, 4])
def test_p_is_a_lyapunov_function_where_the_row_is_zero_for_any_plant(order):
    """With Q from the Riccati equation itself, A, B, x, u and the symmetric P all free."""
    a = sp.Matrix(order, order, lambda i, j: sp.Symbol(f"a{i}{j}"))
    b = sp.Matrix(order, 1, lambda i, _: sp.Symbol(f"b{i}"))
    p = sp.Matrix(order, order, lambda i, j: sp.Symbol(f"p{min(i, j)}{max(i, j)}"))
    x = sp.Matrix(order, 1, lambda i, _: sp.Symbol(f"x{i}"))
    u, effort = sp.symbols("u R")
    q = -(a.T * p + p * a - p * b * b.T * p / effort)
    s = (b.T * p * x)[0]
    rate = (2 * x.T * p * (a * x + b * u))[0]
    decay = (x.T * q * x)[0]
    # Off the constraint the rate is -x'Qx + s (s/R + 2 u): the input enters through s alone.
    assert sp.expand(rate + decay - s * (s / effort + 2 * u)) == 0
    if order == 2:
        on_constraint = {x[0]: sp.solve(s, x[0])[0]}
        assert sp.simplify((rate + decay).subs(on_constraint)) == 0


def test_the_input_gain_of_the_row_is_positive(model):
    """B' P B > 0 is ADB in the row's own scale: P is positive definite."""
    for name, weights in MEASURED:
        row = row_of(model, name, weights)
        _, b = state_space(model, plant(model, name).as_dict())
        p = np.array(row.matrix)
        assert np.all(np.linalg.eigvalsh(p) > 0.0)
        assert np.array_equal(p, p.T)
        assert (b.T @ p @ b).item() > 0.0


@pytest.mark.parametrize(("name", "weights"), MEASURED)
def test_gains_are_those_of_the_theory(model, name, weights):
    gains = row_of(model, name, weights).gains
    assert [round(gains[n], 3) for n in ("lam", "lam1", "lam2")] == list(MEASURED[name, weights])


def test_zeros_and_singular_set_are_those_of_the_theory(model):
    balanced = assess(model, with_values(plant(model, "sim"), row_of(model, "sim", BALANCED).gains))
    assert [float(f"{p.real:.3g}") for p in balanced.zero_dynamics_poles] == [-15.9, -5.39, -4.08]
    assert round(math.degrees(balanced.singular_distance_rad), 1) == 53.8
    unit = assess(model, with_values(plant(model, "sim"), row_of(model, "sim", UNIT).gains))
    assert round(math.degrees(unit.singular_distance_rad), 1) == 67.9
    assert balanced.stable
    assert unit.stable


@pytest.mark.parametrize(("name", "weights"), MEASURED)
def test_the_riccati_equation_holds_and_the_row_is_the_residual(model, name, weights):
    row = row_of(model, name, weights)
    a, b = state_space(model, plant(model, name).as_dict())
    p = np.array(row.matrix)
    residue = a.T @ p + p @ a - p @ b @ b.T @ p / row.effort + np.diag(row.weights)
    assert np.max(np.abs(residue)) < 1e-8 * np.max(np.abs(a.T @ p))
    g = row.gains
    wanted = np.array([g["lam"] * g["lam1"], g["lam2"], g["lam"], 1.0])
    assert np.array(row.row) / row.row[3] == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("friction", [0.0, 0.02])
@pytest.mark.parametrize(("name", "weights"), MEASURED)
def test_the_function_decreases_along_the_linear_zero_dynamics(model, name, weights, friction):
    """Zero dynamics by projection, whose eigenvalues must be the roots of the zero polynomial."""
    values = plant(model, name).as_dict() | {"joint2_viscous": friction}
    row = riccati_row(model, values, *read_weights(model, weights, "--riccati"), "--riccati")
    a, b = state_space(model, values)
    r, p = np.array([row.row]), np.array(row.matrix)
    sliding = a - b @ (r @ a) / (r @ b).item()
    poles = sorted(np.roots(zero_polynomial(model, values | row.gains)), key=lambda z: z.real)
    found = sorted(np.linalg.eigvals(sliding), key=lambda z: z.real)
    assert min(abs(z) for z in found) < 1e-6  # s itself stays where it is
    assert found[:3] == pytest.approx(poles, rel=1e-5)
    rng = np.random.default_rng(7)
    for start in rng.normal(size=(20, 4)):
        x = start - r[0] * (r[0] @ start) / (r[0] @ r[0])
        v = [float(y @ p @ y) for y in (expm(sliding * t) @ x for t in np.linspace(0.0, 3.0, 61))]
        assert all(later < earlier for earlier, later in pairwise(v))
        assert 2.0 * x @ p @ sliding @ x == pytest.approx(
            -float(x @ np.diag(row.weights) @ x), rel=1e-6
        )


def test_effort_scales_with_the_weights(model):
    """Only Q/R matters for the gains."""
    one = row_of(model, "sim", "10,10,.1,.1").gains
    other = row_of(model, "sim", "20,20,.2,.2,2").gains
    assert other == pytest.approx(one, rel=1e-9)
