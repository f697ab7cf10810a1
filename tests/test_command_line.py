"""The command line as a contract: one JSON document, exit codes, help, and what stays silent."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import REPOSITORY
from pfaffian.cli.bench.commands import bench_app
from pfaffian.cli.main import app
from pfaffian.derive.spec.library import find_model, library_models
from pfaffian.derive.verify import compare
from pfaffian.runtime.code.generated_model import open_generated
from pfaffian.runtime.flight.closed_loop import Trajectory
from pfaffian.runtime.flight.scenario_files import scenario_paths

COMMANDS = (
    "models",
    "targets",
    "derive",
    "audit",
    "design",
    "template",
    "plan",
    "campaign",
    "reproduce",
    "certify",
    "generate",
    "verify",
    "build",
    "simulate",
    "pil",
    "run",
    "bench",
)
BENCHMARKS = ("step", "regenerate", "chain", "batch", "sensing")
FLIGHT = ("steps", "mode", "iae_q1", "iae_q2", "mae2_q1", "mae2_q2", "peak_torque")
SHA256 = re.compile(r"[0-9a-f]{64}")


def process(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    """Run the installed `pfaffian` as a process of its own."""
    script = Path(sys.executable).with_name("pfaffian")
    return subprocess.run(
        [str(script), *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        **options,
    )


@pytest.fixture
def short(workspace):
    """Write the paper's scenario, cut to 50 periods."""
    text = scenario_paths()["section-5.1-paper"].read_text()
    assert '"10 s"' in text
    (workspace / "short.toml").write_text(text.replace('"10 s"', '"0.05 s"'))
    return workspace


@pytest.fixture
def copied(workspace):
    source = open_generated("pendubot").path
    return Path(shutil.copytree(source, workspace / "made", ignore=lambda *_: ["__pycache__"]))


# What scripts read -----------------------------------------------------------------------------


def test_models_lists_models_sets_and_scenarios(run):
    document = run("models", "--json").document()
    assert document["models"] == sorted(library_models())
    sets = {(s["model"], s["set"]) for s in document["sets"]}
    assert {("pendubot", "sim"), ("pendubot", "rig")} <= sets
    assert all(s["title"] for s in [*document["sets"], *document["scenarios"]])
    names = {s["scenario"] for s in document["scenarios"]}
    assert names == set(scenario_paths())


def test_derive_gives_sections_identities_and_the_figures_of_a_set(run):
    document = run("derive", "pendubot", "--set", "sim", "--json").document()
    assert {i["proved"] for i in document["identities"]} == {True}
    assert len(document["identities"]) >= 4
    design = document["design"]
    assert design["stable"] is True
    assert design["gains"] == {"lam": 2.25, "lam1": 0.55, "lam2": 0.7}
    slow, fast = design["zero_dynamics_poles"][2], design["zero_dynamics_poles"][0]
    assert slow == pytest.approx([-0.423, 15.98], abs=0.01)  # a complex number is a pair
    assert fast[0] < 0.0
    assert design["singular_distance_rad"] == pytest.approx(0.8218, abs=1e-4)
    assert run("derive", "pendubot", "--json").document()["design"] is None


def test_generate_tells_what_it_did(run, workspace):
    document = run("generate", "pendubot", "--set", "rig", "-o", "made", "--json").document()
    written = [p for p in (workspace / "made").rglob("*") if p.is_file()]
    assert document["files"] == len(document["changed"]) == len(written)
    assert (document["model"], document["folder"], document["sets"]) == (
        "pendubot",
        "made",
        ["rig"],
    )
    assert SHA256.fullmatch(document["model_sha256"])
    assert {"lower", "parameters", "emit", "write"} <= set(document["seconds"])
    document = run("generate", "pendubot", "--set", "rig", "--check", "-o", "made", "--json")
    assert document.document() == {"drift": False, "diff": ""}


@pytest.mark.target
def test_verify_has_the_keys_of_the_contract(run):
    outcome = run("verify", "pendubot", "--samples", 200, "--target-samples", 50, "--json")
    document = outcome.document()
    assert outcome.code == 0
    assert (document["samples"], document["target_samples"]) == (200, 50)
    assert document["target_mismatches"] == 0
    assert 0.0 < document["worst_scaled_ulp"] <= 4.0
    assert document["passed"] is True
    assert "verifying on 200 samples" in outcome.err


def test_build_has_the_keys_of_the_contract_and_leaves_an_image(run, workspace):
    document = run("build", "pendubot", "--target", "host", "-o", "made", "--json").document()
    assert document["text_bytes"] > 1000
    assert document["stack_bytes"] is document["instructions_per_step"] is None
    assert document["image"] == "made/pendubot-host.so"
    assert (workspace / document["image"]).read_bytes().startswith(b"\x7fELF")


@pytest.mark.target
def test_build_for_the_target_counts_stack_and_instructions(run, workspace):
    document = run("build", "pendubot", "-o", "made", "--json").document()
    assert 1000 < document["text_bytes"] < 40_000
    assert 0 < document["stack_bytes"] < 4096
    assert 100 < document["instructions_per_step"] < 5000
    image = (workspace / document["image"]).read_bytes()
    assert image[:6] == b"\x7fELF\x01\x02"  # 32 bits, big-endian
    assert str(sys.prefix) not in json.dumps(document)


@pytest.mark.target
def test_simulate_and_pil_have_the_keys_of_the_contract_and_the_same_trajectory(run, short):
    here = run("simulate", "short.toml", "--json")
    there = run("pil", "short.toml", "--json")
    for outcome, mode in ((here, "host"), (there, "pil-unicorn")):
        document = outcome.document()
        assert outcome.code == 0
        assert set(FLIGHT) <= set(document)
        assert (document["steps"], document["mode"]) == (50, mode)
        assert all(math.isfinite(document[k]) for k in FLIGHT if k != "mode")
        assert SHA256.fullmatch(document["trajectory_sha256"])
        assert "flying short" in outcome.err
    assert here.document()["trajectory_sha256"] == there.document()["trajectory_sha256"]
    assert there.document()["host_trajectory_sha256"] == here.document()["trajectory_sha256"]
    assert there.document()["differing_bits"] == 0
    assert [p.name for p in short.iterdir()] == ["short.toml"]


@pytest.mark.target
def test_the_main_job_leaves_its_code_and_one_page_and_tells_it_in_one_document(run, workspace):
    outcome = run("run", "--samples", 50, "-o", "made", "--json")
    document = outcome.document()
    assert outcome.code == 0, outcome.err
    assert document["verification"]["passed"] is True
    assert document["build"]["target"] == "ppc750"
    assert len(document["flights"]) >= 2
    for flight in document["flights"]:
        assert set(FLIGHT) <= set(flight)
        assert (flight["mode"], flight["differing_bits"]) == ("pil-unicorn", 0)
    assert sorted(p.name for p in workspace.iterdir()) == ["generated", "made"]
    assert [p.name for p in (workspace / "made").iterdir()] == ["pendubot.html"]
    assert document["report"] == "made/pendubot.html"
    assert run("generate", "pendubot", "--check").code == 0  # into generated/MODEL by default


@pytest.mark.target
def test_the_main_job_flies_a_law_and_a_complete_controller_and_tells_it(run, workspace):
    """As the job of the library, on a copy of its folder with shorter flights."""
    folder = workspace / "pendubot"
    shutil.copytree(find_model("pendubot").path, folder, ignore=lambda *_: ["__pycache__"])
    (folder / "scenarios").mkdir()
    for name, was, seconds in (
        ("section-5.1-designed", "10 s", "1 s"),
        ("rig-swing-up", "35 s", "2 s"),
    ):
        text = scenario_paths()[name].read_text(encoding="utf-8")
        assert text.count(f'duration = "{was}"') == 1
        (folder / "scenarios" / f"{name}.toml").write_text(
            text.replace(f'duration = "{was}"', f'duration = "{seconds}"'), encoding="utf-8"
        )
    outcome = run("run", "./pendubot", "--samples", 50, "-o", "made", "--json")
    assert outcome.code == 0, outcome.err
    document = outcome.document()
    assert document["verification"]["passed"] is True
    assert document["build"]["target"] == "ppc750"
    assert [f["scenario"] for f in document["flights"]] == ["section-5.1-designed", "rig-swing-up"]
    for flight in document["flights"]:
        assert set(FLIGHT) <= set(flight)
        assert (flight["mode"], flight["differing_bits"]) == ("pil-unicorn", 0)
    assert document["flights"][1]["captured"] is True
    assert (workspace / document["report"]).read_text(encoding="utf-8").count("<svg") > 10
    assert run("generate", "./pendubot", "--check").code == 0


@pytest.mark.target
def test_a_target_that_differs_in_a_bit_is_one_document_and_exit_1(run, short, monkeypatch):
    monkeypatch.setattr("pfaffian.runtime.flight.closed_loop.differing_bits", lambda *_: 1)
    outcome = run("pil", "short.toml", "--json")
    document = outcome.document()
    assert outcome.code == document["error"]["exit_code"] == 1
    assert document["differing_bits"] == 1
    assert set(FLIGHT) <= set(document)
    assert run("pil", "short.toml").out.count("differing_bits") == 1


@pytest.mark.target
def test_a_verification_that_fails_is_one_document_and_exit_1(run, monkeypatch):
    monkeypatch.setattr(compare, "LIMIT_ULP", 0.0)
    outcome = run("verify", "pendubot", "--samples", 20, "--target-samples", 0, "--json")
    document = outcome.document()
    assert outcome.code == document["error"]["exit_code"] == 1
    assert document["passed"] is False
    assert document["worst_scaled_ulp"] > 0.0
    assert "not fit for use" in document["error"]["remedy"]
    assert "worst scaled error" in outcome.err


def test_a_trajectory_is_hashed_over_every_output(run, short, monkeypatch):
    kept: list[Trajectory] = []
    monkeypatch.setattr(Trajectory, "sha256", lambda self: kept.append(self) or "0" * 64)
    run("simulate", "short.toml", "--json")
    [trajectory] = {id(t): t for t in kept}.values()
    monkeypatch.undo()
    digest = trajectory.sha256()
    for records in (trajectory.measured, trajectory.output, trajectory.state):
        for name in records.dtype.names:
            was = records[name][7].copy()
            records[name][7] += 1
            assert trajectory.sha256() != digest, name
            records[name][7] = was
    assert trajectory.sha256() == digest
    raw = hashlib.sha256()
    for records in (trajectory.measured, trajectory.output, trajectory.state):
        for name in records.dtype.names:
            raw.update(records[name].tobytes())
    raw.update(trajectory.status.astype("<i4").tobytes())
    assert raw.hexdigest() == digest


# Code and source belong together ---------------------------------------------------------------


def test_verify_refuses_code_generated_from_another_version_of_the_model(run, copied):
    manifest = copied / "manifest.json"
    document = json.loads(manifest.read_text())
    document["model_sha256"] = document["model_sha256"][::-1]
    manifest.write_text(json.dumps(document))
    outcome = run("verify", "pendubot", "--samples", 5, "--generated", "made", "--json")
    assert outcome.code == 1
    assert set(outcome.document()) == {"error"}
    error = outcome.document()["error"]
    assert "made: generated from another pendubot than the one derived now" in error["message"]
    assert error["remedy"] == "regenerate it: pfaffian generate pendubot -o made"
    assert run("generate", "pendubot", "-o", "made").code == 0
    outcome = run(
        "verify", "pendubot", "--samples", 5, "--target-samples", 0, "--generated", "made"
    )
    assert outcome.code == 0, outcome.err


def test_code_the_compiler_refuses_is_exit_1_with_its_words(run, copied):
    with (copied / "c" / "pendubot.c").open("a") as file:
        file.write("this is not C\n")
    outcome = run("build", "pendubot", "--target", "host", "--generated", "made", "--json")
    assert outcome.code == outcome.document()["error"]["exit_code"] == 1
    assert "did not build the host image" in outcome.document()["error"]["message"]
    assert "pendubot.c" in outcome.document()["error"]["remedy"]


# People ----------------------------------------------------------------------------------------


def test_help_of_every_command(run):
    page = run("--help")
    assert page.code == 0
    for command in COMMANDS:
        assert re.search(rf"^\W*{command}\s+[A-Z]", page.out, re.MULTILINE), command
        one = run(command, "--help")
        assert one.code == 0
        assert one.err == ""
        assert re.search(rf"Usage: .* {command} ", one.out), command
    names = {c.name or c.callback.__name__ for c in app.registered_commands}
    assert names | {"bench"} == set(COMMANDS)  # no command is missing from this test
    for command in set(COMMANDS) - {"bench"}:
        assert "--json" in run(command, "--help").out
    assert {c.name for c in bench_app.registered_commands} == set(BENCHMARKS)
    for benchmark in BENCHMARKS:
        assert "--json" in run("bench", benchmark, "--help").out


def test_the_version_is_that_of_the_package(run):
    outcome = run("--version")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out == f"pfaffian {importlib.metadata.version('pfaffian')}\n"


def test_the_help_shows_every_word_of_every_option_square_brackets_too(run):
    import typer

    def commands(group, words):
        for name, command in group.commands.items():
            if hasattr(command, "commands"):
                yield from commands(command, (*words, name))
            else:
                yield (*words, name), command

    bracketed = 0
    for words, command in commands(typer.main.get_command(app), ()):
        page = " ".join(run(*words, "--help").out.split())
        for option in command.params:
            text = " ".join((option.help or "").split())
            assert text in page, (words, option.name)
            bracketed += "[" in text
    assert bracketed >= 4


def test_derive_gives_the_distance_in_the_unit_of_its_coordinate(run, monkeypatch):
    from dataclasses import replace

    from pfaffian.derive import design

    real = design.assess
    assert "distance to ADB = 0 [rad]" in run("derive", "pendubot", "--set", "sim").out
    other = {"singular_unit": "m", "singular_coordinate": "x"}
    monkeypatch.setattr(design, "assess", lambda *a: replace(real(*a), **other))
    assert "distance to ADB = 0 [m]" in run("derive", "pendubot", "--set", "sim").out
    none = {"singular_unit": "", "singular_coordinate": "", "singular_distance_rad": math.inf}
    monkeypatch.setattr(design, "assess", lambda *a: replace(real(*a), **none))
    assert re.search(r"distance to ADB = 0 +│ inf", run("derive", "pendubot", "--set", "sim").out)


def test_square_brackets_of_the_users_own_are_shown(run, workspace):
    (workspace / "[mine]").mkdir()
    assert "[mine]: holds no spec.py" in run("derive", "[mine]").err
    (workspace / "[a]").mkdir()
    shutil.copy(library_models()["tora"].spec_file, workspace / "[a]" / "spec.py")
    assert "deriving [a]" in run("derive", "[a]").err


def test_nothing_asked_shows_the_help_and_is_bad_input(run):
    outcome = run()
    assert outcome.code == 2
    assert "Usage: " in outcome.out + outcome.err
    assert all(command in outcome.out + outcome.err for command in COMMANDS)


@pytest.mark.parametrize(("form", "words"), [("text", "M"), ("markdown", "# "), ("latex", "\\")])
def test_derive_prints_each_form_and_its_progress_elsewhere(form, words, run):
    outcome = run("derive", "pendubot", "--format", form)
    assert outcome.code == 0
    assert words in outcome.out
    assert "deriving" not in outcome.out
    assert outcome.err == "deriving pendubot\n"
    if form == "markdown":
        assert outcome.out == (REPOSITORY / "generated/pendubot/derivation.md").read_text()


def test_the_console_script_is_installed_and_works_as_a_process(workspace):
    done = process("models", "--json", cwd=workspace)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["models"] == sorted(library_models())
    assert "Usage: pfaffian generate " in process("generate", "--help", cwd=workspace).stdout
    assert list(workspace.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ("generate pendubot --check -o nowhere --json", 1),
        ("derive triple_pendulum --json", 2),
        ("build pendubot --target host --toolchain gcc --json", 3),
    ],
)
def test_exit_codes_of_the_process(arguments, code, workspace):
    environment = {"PATH": "/nowhere", "HOME": str(workspace), "PFAFFIAN_CACHE": "off"}
    if code == 1:
        del environment["PFAFFIAN_CACHE"]
        environment |= {"HOME": str(Path.home())}
    done = process(*arguments.split(), cwd=workspace, env=environment)
    assert done.returncode == code, done.stderr
    assert json.loads(done.stdout)["error"]["exit_code"] == code
    assert done.stderr.startswith("error: ") or "\nerror: " in done.stderr
    assert "Traceback" not in done.stderr


def test_a_reader_that_goes_away_is_no_traceback(workspace):
    script = Path(sys.executable).with_name("pfaffian")
    writer = subprocess.Popen([str(script), "derive", "pendubot"], stdout=-1, stderr=-1, text=True)
    writer.stdout.close()
    said = writer.stderr.read()
    writer.stderr.close()
    assert writer.wait(timeout=60) == 141  # as of any program that SIGPIPE ends
    assert "Traceback" not in said
    assert "BrokenPipe" not in said
