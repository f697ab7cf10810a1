"""Control units on the twin: a sound one holds the rig, a broken one drops it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.generated_model import fill_records
from pfaffian.runtime.code.sensing import Encoder
from pfaffian.runtime.twin import StateFeedbackUnit, balance_unit, fly_twin
from pfaffian.runtime.twin.settings import Channel, Drive
from pfaffian.runtime.twin.units.balance import BalanceUnit, ExactSenses
from scipy.linalg import solve_continuous_are
from support_twin import model, twin

ENCODERS = {n: Channel(Encoder(5000.0, counter_bits=16)) for n in ("q1", "q2")}


def balance(scenario):
    return balance_unit(scenario, model())


class Reversed(BalanceUnit):
    """The balance law with the motor's wires exchanged."""

    def step(self, reading):
        command = super().step(reading)
        return replace(command, torque=-command.torque)


def test_the_twin_is_honest_the_law_holds_it_and_a_broken_one_drops_it():
    late = {"drives": {"tau": Drive(delay=0.04)}}
    scenario = twin(3.0, channels=ENCODERS)
    held = fly_twin(scenario, balance(scenario), model=model())
    assert held.statistics.captured.all()
    for broken, unit in (
        (twin(3.0), Reversed(model(), dict(scenario.base.controller), ExactSenses())),
        (twin(3.0, channels=ENCODERS, **late), balance(scenario)),
    ):
        fallen = fly_twin(broken, unit, model=model()).statistics
        assert not fallen.captured.any()
        assert fallen.mae[0].max() > 1.0


def riccati_gain(scenario):
    """Return the LQR gain of the plant linearised at the setpoint."""
    params = fill_records(model().records("plant_params"), dict(scenario.base.plant))

    def accelerations(x, torque):
        state = fill_records(
            model().records("plant_state"), dict(zip(("q1", "q2", "dq1", "dq2"), x, strict=True))
        )
        applied, rate = model().records("plant_input"), model().records("plant_rate")
        applied["tau"] = torque
        model().acceleration(params, state, applied, rate)
        return np.array([rate["ddq1"][0], rate["ddq2"][0]])

    goal, small = np.array([math.pi / 2, 0.0, 0.0, 0.0]), 1e-5
    a, b = np.zeros((4, 4)), np.zeros((4, 1))
    a[:2, 2:] = np.eye(2)
    for k, step in enumerate(small * np.eye(4)):
        a[2:, k] = (accelerations(goal + step, 0.0) - accelerations(goal - step, 0.0)) / 2 / small
    b[2:, 0] = (accelerations(goal, small) - accelerations(goal, -small)) / 2 / small
    cost = solve_continuous_are(a, b, np.diag([10.0, 10.0, 1.0, 1.0]), np.eye(1))
    return b.T @ cost


@pytest.mark.parametrize("turns", [0, 1])
def test_state_feedback_balances_and_goes_no_full_turn_for_it(turns):
    scenario = twin(
        5.0, initial={"q1": 1.52 + 2 * math.pi * turns, "q2": 0.03}, substeps=4, channels={}
    )
    unit = StateFeedbackUnit(
        model().folder.manifest,
        riccati_gain(scenario),
        dict(scenario.base.setpoint),
        np.array([2.0]),
        ExactSenses(),
    )
    found = fly_twin(scenario, unit, model=model()).statistics
    assert found.captured.all()
    assert found.mae2[0].max() < 0.01
    assert found.mae[0].max() < 0.2


def test_state_feedback_of_another_shape_is_refused():
    manifest = model().folder.manifest
    with pytest.raises(InputError, match=r"gain \(1, 3\)"):
        StateFeedbackUnit(manifest, np.ones((1, 3)), {}, np.ones(1), ExactSenses())
