"""The planted faults stay plantable, and some of them are caught again: `make mutants` in short.

The whole list takes tens of minutes; here every edit must still find its text, every test named
must be there, and a few drawn of the quick faults are judged as `make mutants` judges all.
"""

from __future__ import annotations

import os
import random
import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent / "mutants"))
import catalogue
import run as runner
from catalogue import AREAS, Fault, plant, problem, read_faults

FAULTS = read_faults()
#: How many quick faults are judged, and which: the same ones everywhere.
COUNT, SEED = int(os.environ.get("PFAFFIAN_MUTANTS", "4")), 13


@pytest.mark.parametrize("area", AREAS)
def test_every_fault_finds_its_text_and_its_tests(area):
    assert [p for f in FAULTS if f.area == area and (p := problem(f))] == []


def test_the_list_has_150_faults_in_every_area_and_few_are_explained():
    assert len(FAULTS) >= 150
    assert {f.area for f in FAULTS} == set(AREAS)
    assert sum(bool(f.equivalent) for f in FAULTS) <= len(FAULTS) // 20


def test_python_faults_leave_a_module_that_compiles():
    for file, old, new in (e for f in FAULTS for e in f.edits):
        if file.endswith(".py"):
            text = (catalogue.ROOT / file).read_text(encoding="utf-8")
            compile(text.replace(old, new), file, "exec")


def drawn():
    quick = [f for f in FAULTS if f.quick]
    return random.Random(SEED).sample(quick, min(COUNT, len(quick)))


def test_some_faults_are_caught(monkeypatch, tmp_path):
    monkeypatch.setattr(runner, "WORK", tmp_path)
    monkeypatch.setattr(runner, "baseline", lambda *_: {})  # this run has those tests anyway
    found = runner.judge_all(drawn(), 1)
    assert [(v.what, v.outcome, v.note) for v in found if v.outcome != runner.KILLED] == []


SOUND = "def double(x):\n    return 2 * x\n"
TEST = "import double\n\n\ndef test_two():\n    assert double.double(1) == 2\n"


@pytest.fixture
def little(tmp_path, monkeypatch):
    """A tree of one module and one test, in place of ours."""
    (tmp_path / "tree" / "tests").mkdir(parents=True)
    (tmp_path / "tree" / "tests" / "double.py").write_text(SOUND)
    (tmp_path / "tree" / "tests" / "test_it.py").write_text(TEST)
    monkeypatch.setattr(runner, "ROOT", tmp_path / "tree")
    monkeypatch.setattr(runner, "WORK", tmp_path / "work")
    monkeypatch.setattr(runner, "problem", lambda f: problem(f, tmp_path / "tree"))
    return tmp_path


def fault(find, replace, test="test_it.py::test_two", equivalent=""):
    return Fault("verify", replace, "tests/double.py", find, replace, (test,), (), equivalent)


def test_a_run_tells_killed_survived_and_invalid_apart_and_knows_them_again(little, capsys):
    faults = [
        fault("2 * x", "3 * x"),
        fault("2 * x", "x + x"),
        fault("2 * x", "x * 2", equivalent="the product commutes"),
        fault("4 * x", "5 * x"),
        fault("2 * x", "7 * x", "test_it.py::test_three"),
        fault("2 * x", "8 * x", equivalent="it is not"),
    ]
    first = runner.judge_all(faults, 2)
    outcomes = ["killed", "survived", "survived", "invalid", "invalid", "killed"]
    assert [v.outcome for v in first] == outcomes
    failures = [v.failure() for v in first]
    assert [bool(f) for f in failures] == [False, True, False, True, True, True]
    assert "stands 0 times" in failures[3]
    assert "no test test_it.py::test_three" in failures[4]
    assert runner.by_area(first)[-1] == ("together", 6, 2, 1, 3)
    assert (little / "tree" / "tests" / "double.py").read_text() == SOUND
    capsys.readouterr()
    assert runner.judge_all(faults, 2) == first
    assert "killed" not in capsys.readouterr().err  # read, not judged again
    (little / "tree" / "tests" / "double.py").write_text(SOUND + "\n")
    runner.judge_all(faults[:1], 1)
    assert "killed" in capsys.readouterr().err  # another tree


def test_a_test_that_fails_without_the_fault_judges_nothing(little):
    (little / "tree" / "tests" / "test_it.py").write_text(TEST.replace("== 2", "== 5"))
    (verdict,) = runner.judge_all([fault("2 * x", "3 * x")], 1)
    assert verdict.outcome == "invalid"
    assert "without the fault" in verdict.failure()


def test_a_fault_without_an_end_is_caught_by_its_time(little, monkeypatch):
    monkeypatch.setattr(runner, "TIME_LIMIT", 3.0)
    endless = fault("    return 2 * x", "    while True:\n        pass")
    monkeypatch.setattr(runner, "baseline", lambda *_: {})
    (verdict,) = runner.judge_all([endless], 1)
    assert verdict.outcome == "killed"
    assert "no end" in verdict.note


def test_planting_takes_one_place_each_and_is_taken_out_again(tmp_path):
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_it.py").write_text(TEST)
    path, other = tmp_path / "tests" / "double.py", tmp_path / "other.py"
    path.write_text(SOUND)
    other.write_text("A = 1\n")
    both = replace(fault("2 * x", "3 * x"), also=(("other.py", "= 1", "= 2"),))
    before = path.stat().st_mtime_ns
    restore = plant(both, tmp_path, 10**9)
    assert path.read_text() == SOUND.replace("2 * x", "3 * x")
    assert other.read_text() == "A = 2\n"
    assert path.stat().st_mtime == 10**9
    for one in restore:
        one()
    assert (path.read_text(), other.read_text()) == (SOUND, "A = 1\n")
    assert path.stat().st_mtime_ns == before
    path.write_text(SOUND + "# 2 * x\n")
    with pytest.raises(ValueError, match="2 times"):
        plant(both, tmp_path, 10**9)
