"""Section 6 on the twin: its figures, tables and animation come from the flights."""

from __future__ import annotations

import csv
import io
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pfaffian.paper.page import render_page
from pfaffian.paper.results.drawing import Image
from pfaffian.paper.results.result import Drawn, SectionResult
from pfaffian.paper.rig import failures as rig_failures
from pfaffian.paper.rig import figures as rig_figures
from pfaffian.paper.rig import section_6 as experiment
from pfaffian.paper.rig import tables as rig_tables
from pfaffian.paper.rig.flights import (
    LAWS,
    RIGS,
    WINDOW,
    case_of,
    errors_of,
    fly_recorded,
    measured,
    swing_of,
)
from pfaffian.paper.simulations.baseline import lqr_gain
from pfaffian.runtime.code.generated_model import host_model, open_generated
from pfaffian.runtime.report.animation import animated_flight, shown_csv
from pfaffian.runtime.twin.files.campaign import read_campaign
from pfaffian.runtime.twin.files.read import read_twin
from pfaffian.runtime.twin.recording import entered_at

FOLDER = open_generated("pendubot")


@pytest.fixture(scope="module")
def flights():
    campaign, found = read_campaign(LAWS), {}
    for law in (experiment.PROPOSED, experiment.LQR):
        scenario = campaign.scenario(case_of(campaign, law=law, case="none"))
        found[law] = fly_recorded(scenario)
    return found


def test_measures_are_those_of_the_recorded_flight(flights):
    for flight in flights.values():
        found, first = measured(flight), entered_at(flight)
        error, step = np.abs(errors_of(flight)), flight.scenario.base.sample_time
        part = error[first : first + round(WINDOW / step) + 1]
        iae = step * (part.sum(axis=0) - 0.5 * (part[0] + part[-1]))
        assert found.iae == pytest.approx(tuple(iae), rel=1e-9)
        assert found.mae2 == pytest.approx(tuple(flight.statistics.mae2[0]), rel=1e-12)
        assert found.entered == flight.statistics.balance_time[0]


def test_bars_hold_the_measures(flights):
    found = {law: measured(f) for law, f in flights.items()}
    drawn = rig_figures.measure_bars(19, found)
    rows = list(csv.DictReader(io.StringIO(drawn.csv.decode())))
    assert len(rows) == 4
    for row in rows:
        k = ("q₁", "q₂").index(row["group"])
        assert float(row["value"]) == pytest.approx(found[row["entry"]].iae[k], rel=1e-8)


def test_both_laws_take_over_from_the_same_swing_up(flights):
    one, other = flights.values()
    first = entered_at(one)
    assert first == entered_at(other) > 0
    assert np.array_equal(one.signals["tau"][:first], other.signals["tau"][:first])


def test_figures_and_animation_are_the_same_bytes_again(flights):
    again = fly_recorded(flights[experiment.PROPOSED].scenario)
    assert again.sha256() == flights[experiment.PROPOSED].sha256()
    assert animated_flight(again) == animated_flight(flights[experiment.PROPOSED])
    twice = {**flights, experiment.PROPOSED: again}
    assert rig_figures.outputs(twice) == rig_figures.outputs(flights)


def test_the_animation_is_that_of_the_flight(flights):
    flight = flights[experiment.PROPOSED]
    root = ElementTree.fromstring(animated_flight(flight))
    turning = [e for e in root.iter() if e.get("type") == "rotate"]
    assert len(turning) == 2
    values = turning[0].get("values", "").split(";")
    assert len(values) == len(turning[0].get("keyTimes", "").split(";"))
    assert float(values[0].split()[0]) == 90.0
    assert float(values[-1].split()[0]) == pytest.approx(-90.0, abs=2.0)


def test_the_planned_swing_up_is_measured_against_its_plan(flights):
    found = swing_of(flights[experiment.PROPOSED])
    assert all(0 < rms < most < np.pi for rms, most in zip(found.rms, found.following, strict=True))
    assert 0 < found.work <= found.energy


def test_the_regulator_flown_is_the_riccati_solution_for_unit_weights():
    given = FOLDER.manifest.control_sets["rig"]
    flown = [given[f"feedback_tau_{n}"] for n in ("q1", "q2", "dq1", "dq2")]
    assert np.abs(flown) == pytest.approx(np.abs(lqr_gain(host_model(FOLDER), "rig")), rel=1e-5)


def test_a_regression_finds_the_parameter_that_decides():
    rng = np.random.Generator(np.random.PCG64(1))
    drawn = {n: rng.uniform(-1, 1, 400) for n in ("one", "two", "three")}
    rows = rig_failures.distinguishing(drawn, drawn["two"] > 0.8)
    assert rows[0][0] == "two"
    assert rows[0][1] > 5 * abs(rows[1][1])
    assert rows[0][2] > 0.8
    assert rig_failures.distinguishing(drawn, np.zeros(400, bool)) == []


def test_a_rig_that_leaves_fault_by_itself_is_told():
    scenario = replace(read_twin("rig-swing-up"), rigs=1)
    scenario = replace(scenario, base=replace(scenario.base, steps=2500))
    found = fly_recorded(scenario).statistics
    assert len(rig_tables.left_fault(found)) == 0
    assert len(rig_tables.left_fault(replace(found, first_fault=np.array([3])))) == 1


def test_a_rig_that_failed_is_caught_with_the_inertias_the_controller_was_told():
    """Rig 104 of the campaign: theta3/theta2 18 % high. It leaves the plan, and hangs over."""
    campaign = read_campaign(RIGS)
    rig = campaign.scenario(case_of(campaign, swing_up="plan")).alone(104)
    found = rig_failures.reflown(rig)
    assert 0.5 < found.left < 1.5
    assert 1.0 < found.identified < 1.5
    flight = fly_recorded(rig)
    assert not flight.statistics.captured[0]
    last = errors_of(flight)[-2000:]
    assert np.abs(last[:, 0]).max() < 0.1
    assert np.abs(np.abs(last[:, 1]) - np.pi).max() < 0.1


def test_the_page_offers_what_a_moving_figure_has(flights):
    flight = flights[experiment.PROPOSED]
    film, data = animated_flight(flight), shown_csv(flight)
    moving = Drawn("flight", 0, "6", "The flight", "", Image(film, None), data)
    assert moving.kinds == ("svg", "csv")
    page = render_page({"section-6": SectionResult((moving,))}, FOLDER.manifest, "x")
    assert "figures/flight.csv" in page
    assert "figures/flight.pdf" not in page
    rows = list(csv.DictReader(io.StringIO(data.decode())))
    assert [float(r["q1"]) for r in rows] == list(flight.signals["q1"][: len(rows), 0])
    assert float(rows[-1]["t"]) == 4.0


def test_the_flight_in_the_documents_is_the_one_flown_now(flights):
    kept = Path(__file__).parent.parent / "docs" / "swing-up-flight.svg"
    assert kept.read_bytes() == animated_flight(flights[experiment.PROPOSED])
