"""`pfaffian certify` as a command."""

import json

import pytest


@pytest.mark.parametrize(
    ("chosen", "flown"), [("sim", "section-5.1-paper"), ("sim-designed", "section-5.1-designed")]
)
def test_where_no_scenario_is_named_one_that_flies_the_set_is_taken(chosen, flown, run):
    done = run("certify", "pendubot", "--set", chosen, "--json")
    assert json.loads(done.out)["scenario"] == flown


def test_a_plant_too_large_to_be_bounded_is_refused_by_name(run):
    outcome = run("certify", "chain")
    assert outcome.code == 2
    assert "model chain: no certificate for a plant of 3 coupled coordinates" in outcome.err
