"""`pfaffian reproduce`: what it writes, that it writes it again, and how verdicts are decided."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from conftest import REPOSITORY
from pfaffian.paper import sections as registry
from pfaffian.paper.results.drawing import thinned
from pfaffian.paper.results.result import FAILS, HOLDS, PARTLY, SectionResult
from pfaffian.paper.simulations.cases import DERIVED, DESIGNED, TERMS, case_of, lasting, softened
from pfaffian.paper.simulations.fly import Task, fly
from pfaffian.paper.simulations.loop import SIGNALS, Loop
from pfaffian.paper.simulations.measures import accumulated, measures
from pfaffian.paper.simulations.runs import (
    PERIODS,
    Check,
    choice_tasks,
    convergence_checks,
    figure_tasks,
    softened_tasks,
    variant_tasks,
)
from pfaffian.paper.verdicts.choices import cut
from pfaffian.paper.verdicts.claims import contradiction
from pfaffian.paper.verdicts.evidence import Evidence, Sampled, frequencies, graded
from pfaffian.paper.verdicts.figures import FIGURES
from pfaffian.paper.verdicts.sampled import figures_of
from pfaffian.paper.verdicts.tables import Comparison, compare, unsettled
from pfaffian.runtime.code.generated_model import host_model, open_generated

FOLDER = open_generated("pendubot")


@pytest.fixture(scope="module")
def designed():
    return fly(
        Task(case_of(FOLDER, "5.1", DESIGNED, TERMS[1]), record=1e-2),
        host_model(FOLDER),
    )


def rows_of(content):
    return list(csv.DictReader(io.StringIO(content.decode())))


def judged(text):
    """Return (claim, verdict) of every row of the tables of claims in `text`."""
    rows = [line.replace("\\|", "!").strip("| ").split("|") for line in text.splitlines()]
    cells = [[c.strip() for c in row] for row in rows if len(row) >= 3]
    return {(row[-3], row[-1]) for row in cells if row[-1].startswith(("holds", "does", "not"))}


def test_every_figure_of_the_simulations_has_its_place():
    places = {n: s.name for s in registry.SECTIONS.values() for n in s.figures}
    assert sorted(places) == list(range(2, 21))
    assert sorted(FIGURES) == list(range(2, 17))
    for number, spec in FIGURES.items():
        assert places[number] == f"section-{spec.section}"


@pytest.mark.parametrize(
    ("asked", "section", "figures", "whole"),
    [
        ("7", "section-5.2", (7,), False),
        ("figure-16", "section-5.3", (16,), False),
        ("5.1", "section-5.1", (2, 3, 4, 5, 6), True),
        ("section-5.3", "section-5.3", (13, 14, 15, 16), True),
        ("6", "section-5.1", (6,), False),
    ],
)
def test_a_figure_or_a_section_is_found_by_its_name(asked, section, figures, whole):
    (choice,) = registry.choices(asked)
    assert (choice.section.name, choice.figures, choice.whole) == (section, figures, whole)


def test_a_single_figure_comes_as_svg_pdf_and_csv_the_same_bytes_again(run, tmp_path, monkeypatch):
    monkeypatch.setenv("PFAFFIAN_CACHE", "off")
    first, again = tmp_path / "first", tmp_path / "again"
    found = run("reproduce", "figure-7", "-o", first, "--json")
    assert found.code == 0
    document = found.document()
    (figure,) = document["figures"]
    assert figure["number"] == 7
    assert run("reproduce", "figure-7", "-o", again, "--json").code == 0
    names = [*figure["files"], "reproduction.html", "reproduction.json"]
    for name in names:
        assert (first / name).read_bytes() == (again / name).read_bytes()
        assert str(tmp_path).encode() not in (first / name).read_bytes()
    assert b"<dc:date>" not in (first / figure["files"][0]).read_bytes()
    data = rows_of((first / figure["files"][2]).read_bytes())
    assert {r["column"] for r in data} == {"printed", "derived", "designed"}
    least = min(float(r["adb_squared"]) for r in data if r["column"] == "derived")
    assert least == pytest.approx(826.3, rel=1e-3)


def test_a_whole_section_is_judged_and_a_second_run_comes_from_the_cache(
    run, tmp_path, monkeypatch
):
    monkeypatch.setenv("PFAFFIAN_CACHE", str(tmp_path / "cache"))
    found = run("reproduce", "section-5.2", "-o", tmp_path / "one", "--json")
    assert found.code == 0
    document = found.document()
    assert document["failures"] == []
    verdicts = {c["says"]: c["verdict"] for c in document["claims"]}
    assert verdicts["The accumulated |β| is smaller than that of LQR."] == HOLDS
    assert [v for s, v in verdicts.items() if s.startswith("ADB is (10)")] == [FAILS]
    for claim in document["claims"]:
        assert claim["evidence"]
        assert claim["measured"]
        assert claim["command"] == "pfaffian reproduce section-5.2"
    page = (tmp_path / "one" / "reproduction.html").read_text(encoding="utf-8")
    assert page.count("data:image/svg+xml;base64,") == len(document["figures"]) == 7
    documented = (REPOSITORY / "docs" / "reproduction.md").read_text(encoding="utf-8")
    written = (tmp_path / "one" / "claims.md").read_text(encoding="utf-8")
    assert len(document["claims"]) == len(judged(written))
    assert judged(written) <= judged(documented)
    for name in ("convergence-5.2", "variants-5.2", "theorem-5.2", "measures-5.2", "choices-5.2"):
        assert f'id="{name}"' in page
    again = run("reproduce", "section-5.2", "-o", tmp_path / "two", "--json")
    assert again.err == ""
    for name in ("reproduction.html", "reproduction.json"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


@pytest.mark.parametrize("asked", ["figure-1", "21", "section-7", "everything"])
def test_what_is_not_in_the_paper_is_refused(run, tmp_path, asked):
    found = run("reproduce", asked, "-o", tmp_path / "x", "--json")
    assert found.code == 2
    assert asked in found.document()["error"]["message"]
    assert not (tmp_path / "x").exists()


def test_an_output_that_is_a_file_is_refused(run, tmp_path):
    (tmp_path / "x").write_text("")
    found = run("reproduce", "figure-7", "-o", tmp_path / "x")
    assert found.code == 2


def test_a_section_made_elsewhere_plugs_in(monkeypatch):
    made = SectionResult(figures=())
    section = replace(registry.SECTIONS["section-6"], maker=lambda: lambda name, request: made)
    monkeypatch.setitem(registry.SECTIONS, "section-6", section)
    assert "section-6" in [c.section.name for c in registry.choices("all")]
    assert section.maker()("section-6", None) is made


# --- how verdicts are decided -------------------------------------------------------------------


def test_a_claim_holds_only_with_both_gains():
    assert graded(True, True) == HOLDS
    assert graded(True, False) == graded(False, True) == PARTLY
    assert graded(False, False) == FAILS


def test_a_run_that_another_solver_does_not_confirm_fails_the_reproduction(designed):
    task = replace(designed.task, relative=1e-10)
    off = replace(designed, state=designed.state.copy())
    off.state[:, 0] += 0.02
    for run, settled in ((designed, True), (off, False)):
        found = compare(Check("x", task, True), run, designed)
        assert isinstance(found, Comparison)
        assert (unsettled([found]) == []) is settled
    ended = replace(designed, ended="speed", end=3.0)
    assert unsettled([compare(Check("x", task, True), ended, designed)])
    assert not unsettled([compare(Check("x", task, False), ended, designed)])


def test_every_run_meets_another_solver_that_decides():
    gain = (-30.0, -29.0, -4.7, -2.8)
    for section in ("5.1", "5.2", "5.3"):
        main = figure_tasks(FOLDER, section, gain)
        variants = variant_tasks(FOLDER, section) | choice_tasks(FOLDER, section)
        variants |= softened_tasks(FOLDER, section)
        checks = convergence_checks(main, variants)
        for name, task in {**main, **variants}.items():
            own = [c for c in checks if c.reference == name and c.decides]
            assert own
            assert all(c.task.case == task.case for c in own)


def test_measures_are_the_papers(designed):
    m = measures(designed)
    e1 = np.abs(designed.state[:, 0] - np.pi / 2)
    assert m["iae_q1"] == pytest.approx(np.trapezoid(e1, designed.time))
    assert m["mae_q1"] == e1.max()
    assert m["mae2_q1"] == e1[designed.time >= 8.0].max()
    total = accumulated(designed.time, e1)
    assert total[0] == 0.0
    assert total[-1] == pytest.approx(m["iae_q1"])
    assert np.isnan(measures(replace(designed, ended="speed"))["mae2_q1"])


def test_frequencies_are_those_of_the_rate(designed):
    state = designed.state.copy()
    time = np.arange(0, 10, 1e-3)
    state = np.zeros((len(time), 6))
    state[:, 3] = np.sin(2 * np.pi * 40 * time)
    slow, fast = frequencies(replace(designed, time=time, state=state))
    assert slow == pytest.approx(40, rel=0.03)
    assert fast == pytest.approx(40, rel=0.03)
    state[:, 3] = 1.0
    assert np.isnan(frequencies(replace(designed, time=time, state=state))[0])


def test_section_53_leaves_a_slow_pole():
    host = host_model(FOLDER)
    for column, pole in ((DERIVED, -0.0394), (DESIGNED, -0.0132)):
        loop = Loop(case_of(FOLDER, "5.3", column, TERMS[2]), host)
        followed = loop.signals(loop.start)[SIGNALS.index("s")]  # the integral at which beta = 0
        goal = np.array([np.pi / 2, 0, 0, 0, followed, 0.0])
        step = 1e-7 * np.eye(6)
        columns = [(np.array(loop(0, goal + h)) - loop(0, goal - h)) / 2e-7 for h in step]
        poles = np.linalg.eigvals(np.array(columns).T)
        assert poles.real.max() == pytest.approx(pole, abs=1e-4)


def test_a_thinned_line_keeps_every_extreme():
    rng = np.random.default_rng(1)
    time, values = np.linspace(0, 1, 50_000), rng.normal(size=50_000)
    values[31_234] = 50.0
    values[7] = -60.0
    x, y = thinned(time, values)
    assert len(x) < 1300
    assert (y.max(), y.min()) == (50.0, -60.0)
    assert (x[0], x[-1]) == (0.0, 1.0)
    assert np.all(np.diff(x) > 0)


# --- what is ours -------------------------------------------------------------------------------


def test_a_run_cut_short_is_the_run_of_that_length(designed):
    short = cut(designed, 5.0)
    flown = fly(replace(designed.task, case=lasting(designed.case, 5.0)), host_model(FOLDER))
    ours, theirs = measures(short), measures(flown)
    for key in ("iae_q1", "mae_q2", "mae2_q1", "beta_end", "peak_torque"):
        assert ours[key] == pytest.approx(theirs[key], rel=1e-4)
    assert short.end == 5.0
    assert not short.ended
    assert cut(replace(designed, ended="speed", end=3.0), 5.0).ended == "speed"
    assert not cut(replace(designed, ended="speed", end=7.0), 5.0).ended


def test_other_choices_are_flown_in_every_section():
    for section in ("5.1", "5.2", "5.3"):
        tasks = choice_tasks(FOLDER, section)
        assert {t.case.duration for t in tasks.values()} >= {20.0}
        estimates = {t.case.controller["bound_initial"] for t in tasks.values()}
        assert estimates == ({0.0} if section == "5.1" else {0.01, 0.1, 1.0})
    assert {t.case.softened for t in softened_tasks(FOLDER, "5.1").values()} == set(PERIODS)
    assert softened_tasks(FOLDER, "5.2") == {}


@pytest.mark.parametrize("column", [DERIVED, DESIGNED])
def test_the_sampled_figures_are_those_of_the_law_with_the_weaker_p2(column):
    """At 1 ms the division of p2 is all but all of the difference, holding and limits are not."""
    host = host_model(FOLDER)
    case = case_of(FOLDER, "5.1", column, TERMS[1])
    name = {DERIVED: "section-5.1-paper", DESIGNED: "section-5.1-designed"}[column]
    found = Sampled(column, 1e-3, **figures_of(name, 1e-3, FOLDER))
    own, weak = (measures(fly(Task(c), host)) for c in (case, softened(case, 1e-3)))
    gap = found.held["iae_q1"] - own["iae_q1"]
    assert gap > 0.15 * own["iae_q1"]
    assert abs(found.held["iae_q1"] - weak["iae_q1"]) < 2e-3 * gap
    assert found.held == pytest.approx(found.unlimited, rel=1e-9)


def test_the_sampled_law_goes_to_the_continuous_one_with_its_period():
    own = measures(fly(Task(case_of(FOLDER, "5.1", DESIGNED, TERMS[1])), host_model(FOLDER)))
    gaps = [
        figures_of("section-5.1-designed", period, FOLDER)["held"]["iae_q1"] - own["iae_q1"]
        for period in (1e-3, 5e-4)
    ]
    assert gaps[0] > 2 * gaps[1] > 0.0


def test_figure_3_is_contradicted_where_p1_alone_has_no_run(designed):
    ended = replace(designed, ended="speed", end=0.667)
    seen = Evidence("5.1", {}, {}, (), (), ())
    runs = {f"5.1-{c}-{t}": ended for c in (DERIVED, DESIGNED) for t in (TERMS[0], TERMS[1])}
    variants = {f"5.1-{c}-p1-at-rest": ended for c in (DERIVED, DESIGNED)}
    compared = [compare(Check("x", ended.task, True), ended, ended)]
    shown, due = contradiction(replace(seen, runs=runs, variants=variants, compared=compared))
    assert (shown.verdict, due.verdict) == (FAILS, PARTLY)
    assert shown.figures == due.figures == ("figure-03",)
    assert shown.measured.startswith("Contradiction: under p₁ alone there is no motion")
    assert "0.667 s" in shown.measured
