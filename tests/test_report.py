"""The report: complete in itself, the same bytes each time, and every number it owes in it."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pfaffian.runtime.code.generated_model import GeneratedFolder
from pfaffian.runtime.contract.dtypes import layout_of
from pfaffian.runtime.flight.closed_loop import Trajectory
from pfaffian.runtime.flight.metrics import tracking_metrics
from pfaffian.runtime.flight.scenario import Scenario, read_scenario
from pfaffian.runtime.report.figures import number_text, symbol_text, two_link_lengths, unit_text
from pfaffian.runtime.report.mathml import mathml
from pfaffian.runtime.report.page import ReportData, WholeFlight, flight_labels, render_report

_VOID = {"meta", "input", "br", "hr", "img", "link"}
_SCENARIOS = ("section-5.1-paper", "section-5.1-designed")


def _flight(scenario: Scenario, rate: float) -> Trajectory:
    """A made-up flight that settles with `rate`: the report takes whatever was recorded."""
    n = 4000
    scenario = dataclasses.replace(scenario, steps=n)
    time = np.arange(n) * scenario.sample_time
    structures = scenario.folder.manifest.structures
    signals = {
        role: np.zeros(n, layout_of(structures[role])) for role in ("input", "output", "state")
    }
    decay = np.exp(-rate * time)
    for shift, (name, goal) in enumerate(scenario.setpoint.items()):
        signals["input"][name] = goal + 0.5 * decay * np.cos(9.0 * time + shift)
    signals["output"]["tau"] = 2.0 + decay
    signals["output"]["beta"] = 0.1 * decay
    signals["output"]["adb"] = -60.0 - 5.0 * decay
    return Trajectory(
        scenario,
        "host",
        time,
        signals["input"],
        signals["output"],
        signals["state"],
        np.zeros(n, np.int32),
        np.zeros(n),
    )


def _data(flights: tuple[Trajectory, ...]) -> ReportData:
    functions = [
        {
            "function": function,
            "language": language,
            "worst_scaled_ulp": worst,
            "output": "tau",
            "samples": 100_000,
            "at": {"q1": 0.1},
        }
        for function, language, worst in (
            ("step", "python", 1.25),
            ("step", "c-host", 2.0625),
            ("energy", "c-ppc750", 0.5),
        )
    ]
    return ReportData(
        folder=flights[0].scenario.folder,
        flights=flights,
        verification={
            "samples": 100_000,
            "worst_scaled_ulp": 2.0625,
            "target_samples": 20_000,
            "target_mismatches": 0,
            "functions": functions,
            "more": [1],
        },
        build={
            "target": "ppc750",
            "text_bytes": 4321,
            "stack_bytes": 304,
            "instructions_per_step": 1070,
            "compiler": "some cc",
            "more": {},
        },
        agreement={f.scenario.name: 0 for f in flights},
    )


@pytest.fixture(scope="module")
def flights() -> tuple[Trajectory, ...]:
    pairs = zip(_SCENARIOS, (2.0, 4.0), strict=True)
    return tuple(_flight(read_scenario(name), rate) for name, rate in pairs)


@pytest.fixture(scope="module")
def page(flights: tuple[Trajectory, ...]) -> str:
    return render_report(_data(flights))


@pytest.fixture
def _no_histories(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the slow figures where a test is about the words."""
    monkeypatch.setattr("pfaffian.runtime.report.page.history_figures", lambda flights, labels: ())


class _Structure(HTMLParser):
    """Collects tags and attributes, and whether every tag that opens also closes in order."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.stack: list[str] = []
        self.faults: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in _VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        if not self.stack or self.stack.pop() != tag:
            self.faults.append(f"{tag} at {self.getpos()}")


def _text(page: str) -> str:
    """The page's words without its mark-up, in single spaces."""
    body = re.sub(r"<(script|style|svg|math).*?</\1>", "", page, flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]*>", "", body).replace("&nbsp;", " ").split())


def _embedded(page: str) -> Any:
    found = re.search(r'<script type="application/json" id="flight-data">(.*?)</script>', page)
    assert found
    return json.loads(found[1])


def test_nothing_is_loaded(page: str) -> None:
    for tag, name, value in _Structure(page).attributes:
        assert name not in ("src", "srcset", "action", "data", "poster"), (tag, name)
        if name.endswith("href"):
            assert value.startswith("#"), (tag, value)
    assert re.findall(r"url\((?!#)", page) == []
    assert "@import" not in page
    assert set(re.findall(r"https?://[^\"' ]+", page)) <= {
        "http://www.w3.org/2000/svg",
        "http://www.w3.org/1999/xlink",
    }


def test_links_lead_somewhere(page: str) -> None:
    attributes = _Structure(page).attributes
    ids = [value for _, name, value in attributes if name == "id"]
    assert len(ids) == len(set(ids))
    used = {value[1:] for _, name, value in attributes if name.endswith("href")}
    used |= set(re.findall(r"url\(#([^)]*)\)", page))
    assert used <= set(ids)


def test_tags_balance(page: str) -> None:
    structure = _Structure(page)
    assert structure.faults == []
    assert structure.stack == []


def test_same_bytes_twice(page: str, flights: tuple[Trajectory, ...]) -> None:
    assert render_report(_data(flights)) == page


def test_names_no_machine(page: str, flights: tuple[Trajectory, ...]) -> None:
    assert str(flights[0].scenario.folder.path) not in page
    assert sys.prefix not in page


def test_size(page: str) -> None:
    assert len(page.encode()) < 3_000_000


def test_shows_the_figures(page: str, flights: tuple[Trajectory, ...]) -> None:
    text, manifest = _text(page), flights[0].scenario.folder.manifest
    for words in (
        "4 321 bytes",
        "304 bytes",
        "1 070",
        "2.06 scaled ulp",
        "20 000, with 0 mismatches",
        "output tau of step in c-host",
        "4 000 OK",
        str(manifest.operations["step"]),
        manifest.model_sha256,
        manifest.parameters_sha256,
        "8 of 8 identities proved",
    ):
        assert words in text, words
    for flight in flights:
        assert flight.sha256() in text
        for name, value in tracking_metrics(flight).items():
            if not name.startswith("mae_"):
                assert _text(number_text(value, 4, True)) in text, name


def test_the_complete_controller_is_shown(flights: tuple[Trajectory, ...]) -> None:
    found = {
        "scenario": "rig-swing-up",
        "steps": 35_000,
        "captured": True,
        "time_to_capture": 1.711,
        "differing_bits": 0,
        "trajectory_sha256": "ab" * 32,
    }
    film = b'<svg xmlns="http://www.w3.org/2000/svg" class="film"><animate dur="5s"/></svg>'
    shown = render_report(dataclasses.replace(_data(flights), whole=WholeFlight(film, found)))
    structure = _Structure(shown)
    assert structure.faults == []
    assert film.decode() in shown
    assert "Held to the end from 1.711 s on. Host and target computed identical bits." in _text(
        shown
    )
    bad = {**found, "captured": False, "differing_bits": 3}
    text = _text(render_report(dataclasses.replace(_data(flights), whole=WholeFlight(film, bad))))
    assert "It was not caught. 3 bits differ between host and target." in text


def test_figures_have_every_flight_and_axes(page: str, flights: tuple[Trajectory, ...]) -> None:
    figures = re.findall(r'<figure id="figure-([\w-]+)">(.*?)</figure>', page, flags=re.DOTALL)
    assert [name for name, _ in figures] == [
        "history-q1",
        "history-q2",
        "error-q1",
        "error-q2",
        "history-tau",
        "transient-tau",
        "history-beta",
        "history-bound_estimate",
        "history-adb",
        "distance-adb",
        "verification",
    ]
    for name, figure in figures[:-1]:
        assert "time [s]" in figure, name
        for label in flight_labels(flights):
            assert label in figure, name
    drawn = dict(figures)
    assert "setpoint 1.571" in drawn["history-q1"]
    assert "limit 10" in drawn["history-tau"]
    assert "threshold 0.5" in drawn["distance-adb"]
    assert "limit 4" in drawn["verification"]


def test_all_equations_and_identities(page: str, flights: tuple[Trajectory, ...]) -> None:
    path = flights[0].scenario.folder.path / "derivation.json"
    derivation = json.loads(path.read_text(encoding="utf-8"))
    assert page.count("<math ") == sum(len(s["equations"]) for s in derivation["sections"])
    section = page[page.index('<section id="equations">') :]
    assert section.count('class="mark pass"') == len(derivation["identities"])
    assert 'class="mark fail"' not in page


@pytest.mark.usefixtures("_no_histories")
def test_unproved_identity_is_said(flights: tuple[Trajectory, ...], tmp_path: Path) -> None:
    folder = tmp_path / "model"
    shutil.copytree(flights[0].scenario.folder.path, folder)
    document = json.loads((folder / "derivation.json").read_text(encoding="utf-8"))
    document["identities"][2]["proved"] = False
    (folder / "derivation.json").write_text(json.dumps(document), encoding="utf-8")
    data = dataclasses.replace(
        _data(flights[:1]), folder=GeneratedFolder(folder, flights[0].scenario.folder.manifest)
    )
    text = _text(render_report(data))
    assert "Only 7 of 8 identities" in text
    assert text.count(": not proved") == 1


def test_animation_data(page: str, flights: tuple[Trajectory, ...]) -> None:
    for row, flight in zip(_embedded(page)["flights"], flights, strict=True):
        stride = round(row["frame"] / flight.scenario.sample_time)
        assert 50.0 < 1.0 / row["frame"] < 70.0
        for values, name in zip(row["angles"], ("q1", "q2"), strict=True):
            np.testing.assert_allclose(values, flight.measured[name][::stride], rtol=0, atol=6e-5)
        np.testing.assert_allclose(row["torque"], flight.output["tau"][::stride], rtol=0, atol=6e-4)
        np.testing.assert_allclose(row["links"], (0.15, 0.16), rtol=1e-3)


@pytest.mark.usefixtures("_no_histories")
def test_faults_are_said(flights: tuple[Trajectory, ...]) -> None:
    data = _data(flights)
    wrong = {**data.verification, "worst_scaled_ulp": 7.5, "target_mismatches": 3}
    unsettled = dataclasses.replace(flights[0], status=np.full(4000, 2, np.int32))
    page = render_report(
        dataclasses.replace(
            data, flights=(unsettled, flights[1]), verification=wrong, agreement={_SCENARIOS[0]: 12}
        )
    )
    text = _text(page)
    for words in (
        "not verified",
        "7.50",
        "12 bits differ",
        "not compared",
        "does not settle",
        "4 000 NEAR_SINGULAR",
    ):
        assert words in text, words


@pytest.mark.usefixtures("_no_histories")
def test_one_flight_without_functions_or_measured_target(flights: tuple[Trajectory, ...]) -> None:
    data = _data(flights[:1])
    bare = {k: v for k, v in data.verification.items() if k != "functions"}
    build = {**data.build, "stack_bytes": None, "instructions_per_step": None}
    page = render_report(dataclasses.replace(data, verification=bare, build=build))
    assert 'id="view"' not in page
    assert 'id="figure-verification"' not in page
    assert _Structure(page).faults == []


@pytest.mark.usefixtures("_no_histories")
def test_other_models_have_no_animation(flights: tuple[Trajectory, ...]) -> None:
    scenario = flights[0].scenario
    plant = {k: v for k, v in scenario.plant.items() if not k.startswith("theta")}
    other = dataclasses.replace(flights[0], scenario=dataclasses.replace(scenario, plant=plant))
    assert two_link_lengths(other) is None
    page = render_report(_data((other,)))
    assert "flight-data" not in page.replace('getElementById("flight-data")', "")
    assert 'href="#animation"' not in page


@pytest.mark.usefixtures("_no_histories")
def test_foreign_words_stay_words(flights: tuple[Trajectory, ...]) -> None:
    scenario = dataclasses.replace(flights[0].scenario, title="</script><b>& ü")
    page = render_report(_data((dataclasses.replace(flights[0], scenario=scenario),)))
    assert "<b>&" not in page
    assert _embedded(page)["flights"][0]["label"] == "</script><b>& ü"
    assert _Structure(page).faults == []


@pytest.mark.parametrize(
    ("latex", "shown"),
    [
        (
            r"\mathrm{bound\_estimate\_rate} = - bound_{estimate} \kappa_2",
            "boundestimate\u00a0rate=−boundestimate⋅κ2",
        ),
        (r"\mathrm{bhat\_next} = \hat{b}_{inside} layer", "bˆnext=bˆinside⋅layer"),
        (r"\mathrm{cos\_q1\_plus\_q2} = \cos{\left(q_{1 plus q2} \right)}", "cosq1+q2=cos(q1+2)"),
        (r"\mathrm{m11} = 2 cos_{q2} \theta_3 + l_{c1}", "m11=2cosq2θ3+lc1"),
        (r"\operatorname{atan}{\left(s \right)}", "arctan(s)"),
        (
            r"\begin{cases} drift & \text{for}\: engaged > 0 \\rate & \text{otherwise} \end{cases}",
            "{driftifengaged>0rateotherwise",
        ),
        (r"T = \tfrac12 \dot q^T M \dot q", "T=12q˙TMq˙"),
    ],
)
def test_equations_read_as_written(latex: str, shown: str) -> None:
    assert re.sub("<[^>]*>", "", mathml(latex)).replace("&gt;", ">") == shown


def test_words_are_one_identifier_each() -> None:
    found = mathml(r"\mathrm{near\_singular} = effort regressor")
    assert re.findall(r"<mi[^>]*>(\w+)</mi>", found) == ["near", "singular", "effort", "regressor"]


def test_numbers_units_and_symbols() -> None:
    assert unit_text("1/(kg*m^2)") == "1/(kg\u00a0m²)"
    assert [symbol_text(n) for n in ("q1", "tau", "adb", "k12")] == ["q₁", "τ", "ADB", "k₁₂"]
    assert number_text(0.25) == "0.25"
    assert number_text(0.25, 4, True) == "0.2500"
    assert number_text(-3) == "−3"
    assert "10<sup>−8</sup>" in number_text(-9.6e-8)
    assert number_text(None) == "–"


def test_labels_tell_flights_apart(flights: tuple[Trajectory, ...]) -> None:
    assert flight_labels(flights) == ["the paper's gains", "gains for zero-dynamics poles at -6"]
    twice = (flights[0], dataclasses.replace(flights[0], mode="pil"))
    assert len(set(flight_labels(twice))) == 2
    assert len(set(flight_labels((flights[0], flights[0])))) == 2


def test_imports_nothing_of_compile_time() -> None:
    script = (
        "import sys, pfaffian.runtime.report.page; "
        "sys.exit(any(m.split('.')[0] in ('sympy', 'casadi') or m.startswith('pfaffian.derive') "
        "for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0
