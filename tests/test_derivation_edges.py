"""Parts of the derivation that the Pendubot alone does not use, against values worked by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.mechanics.constraint import servo_constraint
from pfaffian.derive.mechanics.mass_solver import define_factors, define_solution
from pfaffian.derive.models.pendubot.spec import model
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
from pfaffian.derive.sets.routh import is_stable_column, routh_column
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.spec.model_spec import TIME
from pfaffian.derive.symbolic.block import BlockBuilder


def test_a_time_in_the_constraint_is_in_its_right_hand_side():
    """s - sin t wants A q'' to be larger by cos t: b = -(ds/dq) q' - ds/dt - drift."""
    spec = model()
    given = spec.constraint
    still, moving = servo_constraint(spec), None
    residual = sp.Matrix(given.residual) - sp.Matrix([sp.sin(TIME)])
    constraint = replace(given, residual=sp.ImmutableMatrix(residual))
    moving = servo_constraint(replace(spec, constraint=constraint))
    drift = moving.drift[0] - still.drift[0]
    gap = moving.acceleration[0] - still.acceleration[0]
    assert sp.simplify(gap + drift - sp.cos(TIME)) == 0
    assert moving.jacobian == still.jacobian


def test_a_residual_whose_row_depends_on_q_has_its_rate_in_b():
    """Of s = q1 dq1 + dq2 the row of A is (q1, 1), and b holds -dq1^2."""
    spec = model()
    q1, dq1, dq2 = sp.symbols("q1 dq1 dq2", real=True)
    residual = sp.ImmutableMatrix([q1 * dq1 + dq2])
    found = servo_constraint(replace(spec, constraint=replace(spec.constraint, residual=residual)))
    assert found.jacobian == sp.ImmutableMatrix([[q1, 1]])
    assert sp.expand(found.acceleration[0] + found.drift[0] + dq1**2) == 0


@pytest.mark.parametrize("n", [2, 3, 5])
def test_the_factors_solve_with_the_mass_matrix(n):
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    mass = root @ root.T + n * np.eye(n)
    right = rng.normal(size=n)
    builder = BlockBuilder("solve", "")
    entries = {}

    def named(i, j):
        name = f"m{min(i, j) + 1}{max(i, j) + 1}"
        entries[name] = mass[i, j]
        return sp.Symbol(name, real=True)

    symbols = sp.Matrix(n, n, named)
    sides = sp.symbols(f"r:{n}", real=True)
    for symbol in (*dict.fromkeys(symbols), *sides):
        builder.take(symbol, "", "", "input")
    found = define_solution(builder, define_factors(builder, symbols), sides, "x")
    for k, x in enumerate(found):
        builder.give(f"out{k}", x, "", "")
    block = builder.build()
    known = {sp.Symbol(k, real=True): v for k, v in entries.items()}
    known |= dict(zip(sides, right, strict=True))
    values = {}
    for d in block.definitions:
        values[d.symbol] = float(d.expression.subs({**known, **values}))
    solved = [values[s] for s in block.results]
    assert solved == pytest.approx(np.linalg.solve(mass, right).tolist(), rel=1e-12)


def test_the_acceleration_solves_the_equation_of_motion_anywhere():
    """M q'' + C q' + G + F = B tau by hand, with q'' from the lowered program."""
    folder = find_model("pendubot")
    lowered = lowered_model(folder)
    values = library_sets(lowered, folder)[0].as_dict()
    program = lowered.program("acceleration")
    rng = np.random.default_rng(8)
    dynamics = derivation_of(folder).dynamics
    rates = sp.Matrix(sp.symbols("dq1 dq2", real=True))
    bias = dynamics.coriolis_matrix * rates + dynamics.gravity
    for _ in range(5):
        at = dict(zip(("q1", "q2", "dq1", "dq2", "tau"), rng.uniform(-3, 3, 5), strict=True))
        zero = dict.fromkeys((s.name for s in program.inputs), 0.0)
        given = {n: {**zero, **values, **at}[n] for n in zero}
        found = list(evaluate(program, given).values())
        point = {sp.Symbol(n, real=True): v for n, v in {**values, **at}.items()}
        point |= {s: v for s in (dynamics.mass_matrix.free_symbols | bias.free_symbols)
                  for n, v in {**values, **at}.items() if s.name == n}  # fmt: skip
        mass = np.array(dynamics.mass_matrix.subs(point), float)
        left = mass @ found + np.array(bias.subs(point), float).ravel()
        assert left == pytest.approx([at["tau"], 0.0], abs=1e-9)


def test_a_pole_on_the_axis_is_not_stable():
    assert not is_stable_column(routh_column([1.0, 0.0, 1.0]))  # +-i
    assert not is_stable_column(routh_column([1.0, 1.0, 0.0]))  # 0
    assert not is_stable_column(routh_column([1.0, 2.0, 1.0, 2.0]))  # -2, +-i
    assert is_stable_column(routh_column([1.0, 3.0, 3.0, 1.0]))
    assert not is_stable_column((math.nan,))
