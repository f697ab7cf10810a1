"""Campaigns: what is refused, how changes merge, the same bytes whoever shares the work."""

import pytest
from pfaffian.runtime.twin.files.campaign import campaign_paths, read_campaign

SMALL = """
title = "three rigs, two laws"
scenario = "rig-swing-up"

[change]
duration = "0.4 s"
[change.twin]
rigs = 3
seed = 5
[change.twin.spread.plant]
theta1 = 0.1

[[axis]]
name = "law"
[[axis.point]]
name = "robust"
[[axis.point]]
name = "nominal"
change = { twin = { control = { balance = "nominal" } } }

[[axis]]
name = "limit"
[[axis.point]]
name = "2 N m"
[[axis.point]]
name = "0.2 N m"
change = { controller = { torque_limit = "0.2 N*m" } }
"""
REFUSED = {
    "no scenario": ('scenario = "rig-swing-up"', "", "missing scenario", "add scenario"),
    "an unknown scenario": ("rig-swing-up", "rig-swing-down", "rig-swing-down", "rig-swing-up"),
    "a misspelt key": ("title =", "titel =", "unknown key titel", "title?"),
    "an axis without points": (
        '[[axis]]\nname = "law"\n[[axis.point]]\nname = "robust"\n[[axis.point]]\n'
        'name = "nominal"\nchange = { twin = { control = { balance = "nominal" } } }\n',
        '[[axis]]\nname = "law"\n',
        "axis 1: missing point",
        "add point",
    ),
    "a change that is none": ("change = { controller =", "chance = { controller =", "chance", "ch"),
    "a change of nothing known": (
        "torque_limit",
        "torque_limits",
        "torque_limits",
        "torque_limit?",
    ),
    "a word for a number": ('"0.2 N*m"', '"much"', "torque_limit", "N"),
    "an unknown parameter": ("theta1 = 0.1", "theta9 = 0.1", "theta9", "theta"),
}


@pytest.fixture
def campaign(workspace):
    def write(text):
        (workspace / "small.toml").write_text(text, encoding="utf-8")
        return "small.toml"

    return write


@pytest.mark.parametrize("what", REFUSED)
def test_a_bad_campaign_is_refused_before_anything_flies(what, campaign, refused):
    right, wrong, message, remedy = REFUSED[what]
    assert SMALL.count(right) == 1
    campaign(SMALL.replace(right, wrong))
    refused("campaign", "small.toml", says=(message, remedy))


def test_an_unknown_campaign_is_refused(refused):
    refused("campaign", "section-6-rig", says=("unknown campaign section-6-rig", "section-6-rigs?"))


def test_cases_are_all_combinations_and_later_axes_change_on_top(campaign):
    cases = read_campaign(campaign(SMALL)).cases
    assert [c.name for c in cases] == [
        "robust, 2 N m", "robust, 0.2 N m", "nominal, 2 N m", "nominal, 0.2 N m",
    ]  # fmt: skip
    last = cases[-1].document
    assert last["twin"]["control"]["balance"] == "nominal"
    assert last["controller"]["torque_limit"] == "0.2 N*m"
    assert last["twin"]["rigs"] == 3
    assert "balance" not in cases[0].document["twin"].get("control", {})
    assert last["initial"] == cases[0].document["initial"]


def test_one_process_or_two_give_the_same_bytes(campaign, run, workspace):
    name = campaign(SMALL)
    found = [run("campaign", name, "--jobs", n, "-o", f"{n}.csv", "--json") for n in (1, 2)]
    assert [f.code for f in found] == [0, 0]
    assert found[0].out == found[1].out
    one, two = ((workspace / f"{n}.csv").read_bytes() for n in (1, 2))
    assert one == two
    rows = found[0].document()["rows"]
    assert len(rows) == 4
    assert len({r["sha256"] for r in rows}) >= 2
    assert all(r["rigs"] == 3 and r["violations"] == 0 for r in rows)


@pytest.mark.parametrize("name", sorted(campaign_paths()))
def test_every_case_of_the_packaged_campaigns_is_a_scenario(name):
    campaign = read_campaign(name)
    assert campaign.cases
    for case in campaign.cases:
        assert campaign.scenario(case).rigs >= 1
