"""Parameter sets at their edges: bounds, forms, digests, numbers that are none."""

import math
from dataclasses import replace

import pytest
from pfaffian.derive.ir.parameter import Parameter
from pfaffian.derive.pipeline import lowered_model
from pfaffian.derive.sets.parameter_set import ParameterSet
from pfaffian.derive.sets.raw_set import read_set
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import parse_quantity

SOURCE = find_model("pendubot")


def test_bounds_are_closed_or_open_as_declared():
    closed = Parameter("m", "kg", "mass", "physical", 1.0, 2.0)
    for value in (1.0, 1.5, 2.0):
        assert closed.check(value, "here") == value
    opened = replace(closed, lower_open=True)
    assert opened.check(math.nextafter(1.0, 2.0), "here") > 1.0
    for parameter, value in (
        (opened, 1.0),
        (closed, math.nextafter(1.0, 0.0)),
        (closed, math.nextafter(2.0, 3.0)),
        (closed, math.nan),
        (closed, math.inf),
    ):
        with pytest.raises(InputError, match="here: m = "):
            parameter.check(value, "here")


@pytest.mark.parametrize("raw", ["1e999 kg", "-1e999 kg"])
def test_a_number_that_is_not_finite_is_refused(raw):
    with pytest.raises(InputError, match="is not finite"):
        parse_quantity(raw, "kg", "here")
    with pytest.raises(InputError, match="is not finite"):
        parse_quantity(math.inf, "", "here")


def test_the_digest_of_a_set_knows_every_bit():
    one = ParameterSet("a", "", "", (("m", 0.1), ("g", 9.81)))
    digests = {
        one.digest(),
        replace(one, values=(("m", math.nextafter(0.1, 1.0)), ("g", 9.81))).digest(),
        replace(one, values=(("m", 9.81), ("g", 0.1))).digest(),
        replace(one, values=(("m", -0.1), ("g", 9.81))).digest(),
    }
    assert len(digests) == 4
    assert replace(one, title="other").digest() == one.digest()


def test_a_set_in_the_other_form_drops_what_its_base_says_of_the_plant(tmp_path):
    """sim is physical, lengths and masses; five thetas in its place leave none of those."""
    lumped = "\n".join(f'theta{k} = "{0.01 * k} {u}"' for k, u in
                       enumerate(("kg*m^2",) * 3 + ("kg*m",) * 2, 1))  # fmt: skip
    path = tmp_path / "mine.toml"
    path.write_text(f'extends = "sim"\n[parameters]\n{lumped}\n', encoding="utf-8")
    found = read_set(path, lowered_model(SOURCE).parameters, SOURCE.sets())
    assert {"theta1", "theta5", "g", "lam"} <= set(found.values)
    assert not {"m1", "m2", "l1", "lc1", "lc2", "I1", "I2"} & set(found.values)
