"""Gains from wanted poles through the row of s: exact fractions against NumPy, SciPy and paper."""

from __future__ import annotations

import itertools

import mpmath
import numpy as np
import pytest
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.pipeline import library_sets, lowered_model
from pfaffian.derive.sets.gains import polynomial_of, synthesise_gains, zero_polynomial
from pfaffian.derive.sets.gains_from_poles import row_for_polynomial
from pfaffian.derive.spec.library import ModelFolder, find_model
from scipy.signal import ss2tf

LINKS = """import sympy as sp
from pfaffian.derive.authoring import ModelBuilder


def model():
    m = ModelBuilder("links", title="Three links, one motor", source="made up for this test")
    moving = [m.coordinate(f"q{k}", "rad", "from the upright", bound=100, rate_bound=100)
              for k in (1, 2, 3)]
    q, dq = zip(*moving)
    mass, length, g = (m.parameter("mass", "kg", "of each link, at its end", upper=100),
                       m.parameter("length", "m", "of each link", upper=10),
                       m.parameter("g", "m/s^2", "acceleration of gravity", upper=100))
    m.actuator("tau", "N*m", "torque at the base", on={"q1": 1})
    kinetic = potential = 0
    for k in range(3):
        across = length * sum(sp.cos(q[j]) * dq[j] for j in range(k + 1))
        down = length * sum(sp.sin(q[j]) * dq[j] for j in range(k + 1))
        kinetic += mass * (across**2 + down**2) / 2
        potential += mass * g * length * sum(sp.cos(q[j]) for j in range(k + 1))
    return m.build(kinetic_energy=kinetic, potential_energy=potential)
"""
SET = """title = "three links of half a metre"
source = "made up for this test"

[parameters]
mass = "0.4 kg"
length = "0.5 m"
g = "9.81 m/s^2"

[gains]
zero_dynamics_poles = [-4, -5, -6, -7, -8]
sigma = "5 1/s"
eta = "0.001 1/s^2"
kappa = "0.05 kg^2*m^4/s"
epsilon = "1 1/s^3"
k1 = "1e-3 kg^2*m^4/s^2"
k2 = "2 1/s"
bound_initial = "0.01 N*m"

[target]
sample_time = "1 ms"
torque_limit = "50 N*m"
singular_threshold = "1e-3 1/(kg*m^2)"
"""


def _linear(order: int, rng: np.random.Generator) -> tuple[dict[str, float], tuple]:
    """Return a random plant by the names of the block, and its M, D, K, B."""
    half = rng.normal(size=(order, order))
    mass = half @ half.T + order * np.eye(order)
    damping, stiffness = rng.normal(size=(2, order, order))
    force = rng.normal(size=(order, 1))
    named = {
        f"{name}_{i + 1}_{j + 1}": float(matrix[i, j])
        for name, matrix in (
            ("mass", mass),
            ("damping", damping),
            ("stiffness", stiffness),
            ("input", force),
        )
        for i, j in itertools.product(range(matrix.shape[0]), range(matrix.shape[1]))
    }
    return named, (mass, damping, stiffness, force)


def _state_space(mass, damping, stiffness, force) -> tuple[np.ndarray, np.ndarray]:
    n = len(mass)
    a = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(mass, m) for m in (stiffness, damping)]]
    )
    return a, np.concatenate([np.zeros((n, 1)), np.linalg.solve(mass, force)])


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("seed", range(5))
def test_the_row_gives_a_random_plant_the_wanted_numerator(order, seed):
    rng = np.random.default_rng([order, seed])
    named, matrices = _linear(order, rng)
    poles = -rng.uniform(0.5, 3.0, 2 * order - 1)
    wanted = np.poly(poles)
    row = row_for_polynomial(named, order, [float(c) for c in wanted])
    assert row is not None
    # At 50 digits, to a unit in the last place of each entry: large rows cancel in doubles.
    with mpmath.workdps(50):
        mass, damping, stiffness, force = (mpmath.matrix(m.tolist()) for m in matrices)
        for point in (mpmath.mpf(2), mpmath.mpf("-0.3"), mpmath.mpc(1, 2)):
            pencil = mass * point**2 + damping * point + stiffness
            scale = mpmath.det(pencil) / mpmath.det(mass)
            moved = mpmath.lu_solve(pencil, force) * scale
            columns = [*moved, *(point * x for x in moved)]
            found = mpmath.fdot(zip(row, columns, strict=True))
            size = mpmath.fsum(abs(r * x) for r, x in zip(row, columns, strict=True))
            assert abs(found - mpmath.polyval([float(c) for c in wanted], point)) < 2e-16 * size


@pytest.mark.parametrize("order", [1, 2, 3])
def test_scipy_finds_the_wanted_numerator(order):
    named, matrices = _linear(order, np.random.default_rng(order))
    wanted = np.poly(-np.arange(1.0, 2 * order))
    row = row_for_polynomial(named, order, [float(c) for c in wanted])
    a, b = _state_space(*matrices)
    numerator, _ = ss2tf(a, b, np.array([row]), np.zeros((1, 1)))
    np.testing.assert_allclose(numerator[0], [0.0, *wanted], rtol=1e-7, atol=1e-7)


def test_the_row_is_ackermann_s():
    """r b = 1, and A - b r A has the wanted poles and one at zero."""
    rng = np.random.default_rng(5)
    named, matrices = _linear(3, rng)
    poles = np.array([-1.0, -1.5, -2.0, -2.5, -3.0])
    row = np.array(row_for_polynomial(named, 3, [float(c) for c in np.poly(poles)]))
    a, b = _state_space(*matrices)
    assert (row @ b).item() == pytest.approx(1.0, rel=1e-12)
    found = np.linalg.eigvals(a - b @ (row @ a)[None, :])
    np.testing.assert_allclose(np.sort(found.real), [*sorted(poles), 0.0], atol=1e-7)
    np.testing.assert_allclose(found.imag, 0.0, atol=1e-7)


def test_a_plant_that_is_not_controllable_has_no_row():
    named, _ = _linear(2, np.random.default_rng(1))
    apart = {f"{m}_{i}_{j}": float(i == j) for m in ("mass", "damping", "stiffness")
             for i in (1, 2) for j in (1, 2)}  # fmt: skip
    assert row_for_polynomial(named | apart | {"input_2_1": 0.0}, 2, [1.0, 3.0, 3.0, 1.0]) is None


def test_the_pendubot_s_closed_form_is_the_row():
    folder = find_model("pendubot")
    model = lowered_model(folder)
    values = library_sets(model, folder)[0].as_dict()
    poles = (complex(-5.0), complex(-6.0, 1.0), complex(-6.0, -1.0))
    closed = synthesise_gains(model, values, poles, "here")
    wanted = polynomial_of(poles)
    row = row_for_polynomial(evaluate(model.program("linearisation"), values), 2, wanted)
    names = [f"row_{kind}_{i}" for kind in ("position", "rate") for i in (1, 2)]
    known = values | dict(zip(names, row, strict=True))
    assert evaluate(model.program("row_gains"), known) == pytest.approx(closed, rel=1e-10)


def test_three_links_of_a_user_s_own_have_the_poles_of_their_set(workspace, run):
    folder = workspace / "links"
    folder.mkdir()
    (folder / "spec.py").write_text(LINKS, encoding="utf-8")
    (folder / "lab.toml").write_text(SET, encoding="utf-8")
    done = run("generate", "./links", "-o", "out")
    assert done.code == 0, done.err
    found = ModelFolder("links", folder)
    model = lowered_model(found)
    (only,) = library_sets(model, found)
    polynomial = np.array(zero_polynomial(model, only.as_dict()))
    wanted = np.poly([-4.0, -5.0, -6.0, -7.0, -8.0])
    np.testing.assert_allclose(polynomial / polynomial[0], wanted, rtol=1e-9)
    assert (workspace / "out" / "c" / "links.c").is_file()
