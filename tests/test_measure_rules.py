"""The numbers of a run by hand: trapezoids over uneven times, the last two seconds, the largest."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from pfaffian.paper.simulations.cases import DURATION, FRICTION, START
from pfaffian.paper.simulations.measures import accumulated, measures
from pfaffian.runtime.flight.metrics import tracking_metrics

TIME = np.array([0.0, 1.0, 3.0, 3.5])
Q1, Q2 = np.array([2.0, -1.0, 0.5, -0.25]), np.array([0.0, 4.0, -1.0, 3.0])


def area(values):
    """Return the area below straight lines between (0, a), (1, b), (3, c), (3.5, d)."""
    a, b, c, d = values
    return 0.5 * (a + b) + (b + c) + 0.25 * (c + d)


@dataclass
class Made:
    """What `measures` reads of a run."""

    signals: dict[str, np.ndarray]
    time: np.ndarray = field(default_factory=lambda: TIME)
    ended: str = ""
    case: object = field(default_factory=lambda: SimpleNamespace(duration=3.5))

    def errors(self):
        return np.stack([Q1, Q2], 1)


RUN = Made(
    {
        "beta": np.array([1.0, -3.0, 2.0, 0.5]),
        "tau": np.array([1.0, 2.0, -4.0, 0.0]),
        "adb": np.array([3.0, -2.0, 5.0, 4.0]),
    }
)


def test_integrals_of_a_run_are_trapezoids():
    found = measures(RUN)
    assert found["iae_q1"] == pytest.approx(area([2.0, 1.0, 0.5, 0.25]))
    assert found["iae_q2"] == pytest.approx(area([0.0, 4.0, 1.0, 3.0]))
    assert found["beta_sum"] == pytest.approx(area([1.0, 3.0, 2.0, 0.5]))
    assert found["effort"] == pytest.approx(area([1.0, 4.0, 16.0, 0.0]))


def test_largest_values_and_those_of_the_last_two_seconds():
    found = measures(RUN)
    assert (found["mae_q1"], found["mae_q2"]) == (2.0, 4.0)
    assert (found["mae2_q1"], found["mae2_q2"]) == (0.5, 3.0)
    assert (found["beta_max"], found["beta_end"]) == (3.0, 2.0)
    assert (found["peak_torque"], found["gain_square"]) == (4.0, 4.0)
    early = measures(Made(RUN.signals, ended="speed"))
    assert np.isnan([early["mae2_q1"], early["mae2_q2"], early["beta_end"]]).all()
    assert early["mae_q1"] == 2.0


def test_what_accumulates_is_the_trapezoid_up_to_each_time():
    found = accumulated(TIME, np.array([2.0, 1.0, 0.5, 0.25]))
    assert found == pytest.approx([0.0, 1.5, 3.0, 3.1875])


def test_tracking_figures_of_a_flight_are_the_same_rules():
    flight = SimpleNamespace(
        time=TIME,
        errors=lambda: {"q1": Q1, "q2": Q2},
        output={"tau": np.array([1.0, -2.5, 2.0, 0.0])},
        scenario=SimpleNamespace(
            folder=SimpleNamespace(manifest=SimpleNamespace(actuators=["tau"]))
        ),
    )
    found = tracking_metrics(flight)
    assert found["iae_q1"] == pytest.approx(area([2.0, 1.0, 0.5, 0.25]))
    assert (found["mae_q2"], found["mae2_q1"], found["peak_torque"]) == (4.0, 0.5, 2.5)


def test_the_papers_friction_and_start_are_those_printed():
    printed = {"1": 4.18, "2": 1.59, "3": 3.15, "4": 0.09, "5": 3.52, "6": 0.021}
    assert {f"friction{k}": v for k, v in printed.items()} == FRICTION
    assert (START, DURATION) == ((1.0, 0.5, 1.0, 0.0), 10.0)
