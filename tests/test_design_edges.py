"""Figures of a design against closed forms, one at a time."""

import math

import numpy as np
import pytest
from pfaffian.derive.design.assess import Design, assess, singular_distance
from pfaffian.derive.design.place import poles as placement
from pfaffian.derive.design.worst_case import read_box
from pfaffian.derive.pipeline import lowered_model, parameter_set
from pfaffian.derive.sets.gains import polynomial_of, roots_of
from pfaffian.derive.sets.raw_set import parse_poles
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.base.errors import InputError

SOURCE = find_model("pendubot")


@pytest.fixture(scope="module")
def model():
    return lowered_model(SOURCE)


@pytest.fixture(scope="module")
def sim(model):
    return parameter_set(model, SOURCE, SOURCE.set_path("sim"))


@pytest.mark.parametrize("roots", [(-1.0,), (-2.0, -3.0), (-6.0, -4 + 2j, -4 - 2j), (-1.0,) * 4])
def test_the_polynomial_of_poles_has_them_as_roots(roots):
    found = polynomial_of(tuple(map(complex, roots)))
    assert found == pytest.approx(np.poly(roots).real.tolist())
    assert found[0] == 1.0
    wanted = sorted(map(complex, roots), key=lambda r: (r.real, r.imag))
    assert roots_of(found) == pytest.approx(wanted, abs=1e-3)


def test_poles_that_are_unstable_or_unpaired_are_refused():
    assert parse_poles([-1, "-4+2j", "-4-2j"], "here") == (-1, -4 + 2j, -4 - 2j)
    for bad in ([-1, 0.5], [0], ["-4+2j"], ["-4+2j", "-4-3j"], ["-4+2j", "-4+2j"], [math.nan]):
        with pytest.raises(InputError, match="here"):
            parse_poles(bad, "here")


def test_a_mismatch_is_relative_to_poles_all_at_the_largest_radius(monkeypatch):
    """(p + 2)(p + 10) has the coefficients 12, 20; 13 and 30 are off by 1/10 and 10/10^2."""
    monkeypatch.setattr(placement, "zero_polynomial", lambda *_: (2.0, 26.0, 60.0))
    assert placement._mismatch(None, {}, (-2 + 0j, -10 + 0j)) == pytest.approx([0.1, 0.1])


def test_the_decay_rate_is_that_of_the_slowest_pole():
    figures = dict.fromkeys(Design.__dataclass_fields__, None)
    figures["zero_dynamics_poles"] = (-7 + 0j, -2 + 3j, -2 - 3j)
    assert Design(**figures).decay_rate == 2.0


def test_the_contraction_is_kappa_times_the_square_of_adb(model, sim):
    """ADB at the setpoint, where cos q2 = 1, by hand."""
    k = sim.as_dict()
    t1, t2, t3 = (k[f"theta{i}"] for i in (1, 2, 3))
    gain = ((k["lam"] - 1.0) * t2 - t3) / (t1 * t2 - t3**2)
    found = assess(model, sim, nearest=False)
    assert found.input_gain == pytest.approx(gain)
    assert found.contraction == pytest.approx(k["kappa"] * gain**2)
    assert found.sampled_contraction == pytest.approx(k["sample_time"] * k["kappa"] * gain**2)


def test_the_singular_distance_is_that_of_the_nearer_side(model, sim):
    """cos q2 = (lam - 1) theta2/theta3 is met at +-0.82; from q2d = -0.3 the lower is nearer."""
    k = sim.as_dict()
    edge = math.acos((k["lam"] - 1.0) * k["theta2"] / k["theta3"])
    for offset in (0.0, 0.3, -0.3):
        distance, name = singular_distance(model, {**k, "q2d": offset})
        assert name == "q2"
        assert distance == pytest.approx(edge - abs(offset), abs=1e-9)


def test_a_percentage_is_of_the_set_s_value(model, sim):
    (interval,) = read_box(model, sim.as_dict(), "theta2=5%", "--box")
    nominal = sim.as_dict()["theta2"]
    assert (interval.lower, interval.upper) == pytest.approx((0.95 * nominal, 1.05 * nominal))
