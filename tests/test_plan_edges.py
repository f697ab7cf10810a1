"""Plans: the curve between nodes, integrals and verdicts of the check, rates of the rows."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pfaffian.derive.plan import check
from pfaffian.derive.plan.check import DEFECT_TOLERANCE, PlanCheck
from pfaffian.derive.plan.document import read_plan
from pfaffian.derive.plan.reference import Curve, torque_at
from pfaffian.derive.sets import plan_table
from pfaffian.derive.sets.plan_table import hermite
from pfaffian.derive.spec.library import LIBRARY
from pfaffian.runtime.base.errors import InputError


def cubic(t):
    return 1.0 - 2.0 * t + 0.5 * t**2 + 3.0 * t**3


def slope(t):
    return -2.0 + t + 9.0 * t**2


def test_a_curve_has_its_values_and_slopes_at_the_nodes():
    """And between them, for a cubic: the curve is that cubic."""
    times = np.array([0.0, 0.5, 2.0, 2.25])
    curve = Curve(times, cubic(times), slope(times))
    for t in (0.0, 0.1, 0.5, 0.77, 1.9, 2.0, 2.2, 2.25):
        assert curve(t) == pytest.approx(cubic(t), rel=1e-12)
        assert curve.slope(t) == pytest.approx(slope(t), rel=1e-12)
    assert curve(-1.0) == cubic(0.0)
    assert curve(9.0) == pytest.approx(cubic(2.25))
    assert curve.slope(-1.0) == curve.slope(9.0) == 0.0


def test_the_table_s_cubic_is_the_curve_s():
    h, t = 0.5, 0.75
    a, b, c, d = cubic(t), cubic(t + h), h * slope(t), h * slope(t + h)
    for u in (0.0, 0.2, 0.5, 0.9, 1.0):
        assert hermite(a, b, c, d, u) == pytest.approx(cubic(t + u * h), rel=1e-12)


def test_the_torque_is_linear_between_the_nodes_and_held_outside():
    times, torques = np.array([0.0, 1.0, 3.0]), np.array([[0.0, 4.0], [2.0, 0.0], [-2.0, 1.0]])
    found = [torque_at(times, torques, t).tolist() for t in (-1.0, 0.5, 2.0, 9.0)]
    assert found == [[0.0, 4.0], [1.0, 2.0], [0.0, 0.5], [-2.0, 1.0]]


def test_the_integral_of_a_check_is_exact_for_cubics():
    points = np.linspace(0.0, 2.0, check._PARTS + 1)
    whole = 2.0 - 4.0 + 0.5 * 8.0 / 3.0 + 3.0 * 4.0
    assert check._simpson(cubic(points), 2.0) == pytest.approx(whole, rel=1e-13)


@pytest.fixture(scope="module")
def rig():
    return read_plan(LIBRARY / "pendubot/plans/rig.json")


GOOD = PlanCheck(0.0, 0.1, 0.0, 1.0, 1.0, 1.0, (1.0,), (3.0, 3.0), ())


def said(changes, nodes=None, end_time=1.0):
    """Return what is said of a plan of one second that keeps all but `changes`."""
    problem = SimpleNamespace(
        start=(0.0,) * 4,
        goal=(1.0, 0.0, 0.0, 0.0),
        end_time=(0.5, 1.0),
        actuators=(("tau", "N*m"),),
        torque_limits=(1.0,),
        coordinates=(("q1", "rad"), ("q2", "rad")),
        speed_limits=(3.0, math.inf),
    )
    states = np.array([problem.start, problem.goal] if nodes is None else nodes)
    plan = SimpleNamespace(states=states, end_time=end_time)
    return " | ".join(check._violations(problem, plan, replace(GOOD, **changes)))


def test_a_plan_that_breaks_a_demand_is_said():
    assert said({}) == ""
    assert said({"peak_speed": (3.0, 1e9)}) == ""
    assert "misses the node at 0.1 s" in said({"defect": 1.01 * DEFECT_TOLERANCE})
    assert "misses the node" in said({"defect": math.nan})
    assert "tau reaches 1.001 N*m" in said({"peak_torque": (1.001,)})
    assert "dq1 reaches 3.01 rad/s" in said({"peak_speed": (3.01, 3.0)})
    assert "it takes 1.01 s" in said({}, end_time=1.01)
    assert "it ends 0.01 away" in said({}, nodes=[[0.0] * 4, [0.99, 0.0, 0.0, 0.0]])
    assert "it starts 0.01 away" in said({}, nodes=[[0.0, 0.0, 0.01, 0.0], [1.0, 0.0, 0.0, 0.0]])


def test_the_energy_used_is_the_integral_of_the_power_s_size(monkeypatch):
    """One interval of a second in which the power goes from -1 W to 1 W: 1/2 J, and no work."""
    parts = check._PARTS
    states = np.zeros((parts + 1, 2))
    powers = np.linspace(-1.0, 1.0, parts + 1)[:, None]
    monkeypatch.setattr(check, "_interval", lambda *_: (states[-1], states, powers))
    monkeypatch.setattr(check, "_drift", lambda *_: 0.0)
    monkeypatch.setattr(check, "_energy", lambda *_: 0.0)
    monkeypatch.setattr(check, "_violations", lambda *_: ())
    plan = SimpleNamespace(
        times=np.array([0.0, 1.0]), states=np.zeros((2, 2)), torques=np.zeros((2, 1))
    )
    found = check.check_plan(None, SimpleNamespace(order=1), plan)
    assert found.energy_used == pytest.approx(0.5, rel=1e-12)
    assert found.work == pytest.approx(0.0, abs=1e-12)


def test_the_row_rates_of_a_fresh_plan_are_differences_of_its_rows(rig):
    """The path is integrated again here, so that what computes the rates is what is judged."""
    from pfaffian.derive.pipeline import derivation_of
    from pfaffian.derive.plan.plant import casadi_rates
    from pfaffian.derive.plan.riccati import riccati_path
    from pfaffian.derive.spec.library import find_model

    derivation = derivation_of(find_model("pendubot"))
    rates = casadi_rates(derivation, dict(rig.problem.parameters))
    path = riccati_path(rig.problem, rates, rig.trajectory, rig.row.weights, rig.row.effort)
    times = rig.trajectory.times
    h = times[1] - times[0]
    r = path.rows
    middle = (r[:-4] - 8.0 * r[1:-3] + 8.0 * r[3:-1] - r[4:]) / (12.0 * h)
    off = np.abs(middle - path.rates[2:-2]).max()
    assert off < 0.02 * np.abs(path.rates).max()


def test_a_table_needs_nodes_that_are_evenly_spaced_from_zero():
    path = Path("mine.json")
    assert plan_table._period({"times": [0.0, 0.25, 0.5, 0.75]}, path, "") == 0.25
    for times in ([0.0, 0.25, 0.51, 0.75], [0.1, 0.25, 0.5], [0.0, 0.0], [0.0, 0.7, 0.75]):
        with pytest.raises(InputError, match=r"mine\.json: its (times|nodes)"):
            plan_table._period({"times": times}, path, "plan again")
