"""The twin's own laws against the formulas of docs/twin.md: dry friction, and what is spread."""

import numpy as np
import pytest
from pfaffian.runtime.twin.draws import whole
from pfaffian.runtime.twin.rig import Rigs
from pfaffian.runtime.twin.settings import Drive, DryFriction
from support_twin import model, twin

COULOMB, STICTION, STRIBECK, LAYER = 0.02, 0.07, 0.4, 0.3


def braking(rate):
    """Return the friction force on q1 at `rate`, from the change of both rates in one substep."""
    rates = []
    for frictions in ((), (DryFriction("q1", COULOMB, STICTION, STRIBECK, LAYER),)):
        still = {"q1": -1.0, "q2": 0.4, "dq1": rate, "dq2": 0.0}
        scenario = twin(0.01, initial=still, substeps=1000, frictions=frictions)
        rigs, one = Rigs(scenario, model()), np.ones(1, np.uint32)
        rigs.advance(one * np.uint32(0), one, np.zeros((1, 1)))
        rates.append(rigs.truth[0, 2:].copy())
    plant = scenario.base.plant
    a, b, c = plant["theta1"], plant["theta2"], plant["theta3"] * np.cos(0.4)
    mass = np.array([[a + b + 2 * c, b + c], [b + c, b]])
    return mass @ (rates[1] - rates[0]) / scenario.substep


@pytest.mark.parametrize("rate", [-3.0, -0.5, -0.1, 0.05, 0.2, 0.4, 1.0, 6.0])
def test_dry_friction_is_the_stribeck_curve_with_a_layer_and_brakes(rate):
    size = COULOMB + (STICTION - COULOMB) / (1.0 + (rate / STRIBECK) ** 2)
    wanted = -size * np.clip(rate / LAYER, -1.0, 1.0)
    assert braking(rate) == pytest.approx([wanted, 0.0], rel=2e-3, abs=2e-3 * abs(wanted))


def test_a_delay_is_spread_evenly_to_both_sides_of_its_mean():
    scenario = twin(
        0.01, substeps=40, rigs=2000, drives={"tau": Drive(delay=4e-3, delay_spread=3e-3)}
    )
    delays = Rigs(scenario, model()).delays[:, 0]
    step = scenario.substep
    assert delays.min() == pytest.approx(1e-3, abs=2.0 * step)
    assert delays.max() == pytest.approx(7e-3, abs=2.0 * step)
    assert delays.mean() == pytest.approx(4e-3, abs=4.0 * 3e-3 / np.sqrt(3 * 2000))
    assert delays.std() == pytest.approx(3e-3 / np.sqrt(3.0), rel=0.05)


def test_a_delay_is_never_negative_where_its_spread_is_larger():
    scenario = twin(0.01, rigs=200, drives={"tau": Drive(delay=5e-4, delay_spread=1e-3)})
    delays = Rigs(scenario, model()).delays[:, 0]
    assert delays.min() == 0.0
    assert 0.0 < (delays == 0.0).mean() < 0.6
    assert delays.max() > 1e-3


def test_plants_and_starts_are_spread_evenly_to_both_sides():
    count, share, width = 2000, 0.2, 0.05
    scenario = twin(0.01, rigs=count, spread={"theta1": share}, initial_spread={"q1": width})
    rigs = Rigs(scenario, model())
    ratio = rigs.params["theta1"] / scenario.base.plant["theta1"] - 1.0
    start = rigs.state["q1"] - scenario.base.initial["q1"]
    for values, reach in ((ratio, share), (start, width)):
        assert np.abs(values).max() <= reach
        assert values.min() < -0.98 * reach
        assert values.max() > 0.98 * reach
        assert abs(values.mean()) < 4.0 * reach / np.sqrt(3 * count)
    assert (rigs.params["theta2"] == scenario.base.plant["theta2"]).all()
    assert abs(np.corrcoef(ratio, start)[0, 1]) < 0.1


def test_whole_numbers_are_drawn_evenly_to_both_sides_of_zero():
    for largest in (0, 1, 4):
        found = whole(np.array([0.0, 0.5, np.nextafter(1.0, 0.0)]), largest)
        assert found.tolist() == [-largest, 0, largest]
    drawn = whole(np.random.default_rng(4).random(90_000), 4)
    assert np.unique(drawn).tolist() == list(range(-4, 5))
    assert np.abs(np.bincount(drawn + 4) - 10_000).max() < 500
