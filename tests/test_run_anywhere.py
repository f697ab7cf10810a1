"""`run` and `certify` take every model of the library, and a plant of one's own."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path

import pytest
from conftest import tree
from pfaffian.derive.spec.library import library_models
from pfaffian.runtime.flight.scenario_files import report_scenarios, scenario_paths

pytestmark = pytest.mark.target
ALL = os.environ.get("PFAFFIAN_RUN_ALL") == "1"


@pytest.fixture
def own(workspace):
    """Return a folder of one's own with the RTAC under another name, and a short scenario."""
    folder = workspace / "rotor"
    shutil.copytree(library_models()["tora"].path, folder, ignore=lambda *_: ["__pycache__"])
    text = scenario_paths()["tora-damping"].read_text()
    text = text.replace('model = "tora"', 'model = "rotor"')
    (folder / "short.toml").write_text(_shortened(text))
    return Path("rotor")


def _shortened(text: str) -> str:
    [line] = [line for line in text.splitlines() if line.startswith("duration")]
    return text.replace(line, 'duration = "0.1 s"')


def test_every_model_of_the_library_has_flights_for_its_report():
    for name, folder in library_models().items():
        assert report_scenarios(name, folder.scenarios()), name
    assert report_scenarios("pendubot", {}) == ["section-5.1-designed", "section-5.1-paper"]


@pytest.mark.skipif(not ALL, reason="minutes: make run-all; a plant of one's own is run below")
@pytest.mark.parametrize("model", sorted(library_models()))
def test_the_main_job_does_any_model_of_the_library(model, run, workspace):
    document = run("run", model, "--samples", 5, "-o", "made", "--json").document()
    assert "error" not in document
    assert (document["model"], document["report"]) == (model, f"made/{model}.html")
    assert (workspace / document["report"]).read_text().count("<svg") > 0
    assert run("generate", model, "--check").code == 0


def test_the_main_job_and_the_certificate_take_a_plant_of_ones_own(own, run, workspace):
    before = tree(workspace)
    document = run("run", own, "--samples", 5, "-o", "made", "--json").document()
    assert document["flights"][0]["scenario"] == "short"
    assert document["generated"] == "generated/rotor"
    assert (workspace / "made" / "rotor.html").is_file()
    assert run("generate", own, "--check").code == 0
    given = run(
        *("run", own, "--samples", 5, "-o", "again", "--generated", "generated/rotor", "--json")
    )
    assert given.document()["flights"] == document["flights"]
    assert given.document()["verification"] == document["verification"]
    for way in ((), ("--generated", "generated/rotor", "--scenario", "rotor/short.toml")):
        certified = run("certify", own, *way, "--json")
        assert certified.document()["scenario"] == "short", certified.err
    kept = {p: c for p, c in tree(workspace).items() if p.startswith("rotor")}
    assert kept == before  # nothing is written into the folder of the plant


def test_a_scenario_beside_the_sets_is_no_set(own, run):
    assert library_models()["tora"].sets().keys() == {"benchmark"}
    outcome = run("design", own, "--set", "short")
    assert outcome.code == 2
    assert "has no parameter set short" in outcome.err


def test_what_the_job_misses_is_said_before_the_work(own, refused, workspace, monkeypatch):
    from pfaffian.cli import output

    def begun(text: str) -> None:
        pytest.fail(f"the work began: {text}")

    monkeypatch.setattr(output, "note", begun)
    (workspace / own / "short.toml").unlink()
    says = ("there is no scenario of model rotor", "scenarios/NAME.toml")
    refused("run", own, says=says)
    says = ("no compiler found for target ppc750", "install one: ")
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr("importlib.util.find_spec", lambda *_: None)
    refused("run", "pendubot", code=3, says=("no ", "install"))


def test_an_emulator_that_is_not_installed_is_said_before_the_work(refused, monkeypatch):
    monkeypatch.setitem(sys.modules, "unicorn", None)
    refused("run", "pendubot", code=3, says=("unicorn is missing", "pip install"))


@pytest.mark.parametrize("initial", ["q1=1e300", "q1=nan", "dq1=-1e9", "q1=1001"])
def test_a_start_that_is_nowhere_is_refused(initial, refused):
    says = ("--initial: ", "is no number within 1000", "write q1=1")
    refused("certify", "pendubot", "--initial", initial, says=says)


@pytest.mark.parametrize("call", ["verify pendubot --samples", "run pendubot --samples"])
@pytest.mark.parametrize("samples", ["1e99", "99999999999999999999", "10000001", "0"])
def test_more_samples_than_could_ever_end_are_refused(call, samples, refused):
    refused(*call.split(), samples, says=("--samples", "--help"))


def test_the_printed_rates_of_every_model_have_no_empty_index():
    """A rate without an index was printed as `\\dot{x}_`, which takes what follows for one."""
    from pfaffian.runtime.code.generated_model import generated_models
    from pfaffian.runtime.report.mathml import mathml

    for name, folder in generated_models().items():
        document = json.loads((folder / "derivation.json").read_text())
        for section in document["sections"]:
            for equation in section["equations"]:
                assert "}_ " not in equation["latex"], (name, equation)
                mathml(equation["latex"])
