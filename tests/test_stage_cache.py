"""The cache saves time and nothing else: damaged, full or off, the results are the same."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from conftest import tree
from pfaffian.derive.pipeline import derivation_key, derivation_of, lowered_model
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.base.cache import cache_folder, cached, digest


class Counted:
    """A computation that counts how often it ran."""

    def __init__(self, result: bytes = b"the result") -> None:
        self.result, self.runs = result, 0

    def __call__(self) -> bytes:
        self.runs += 1
        return self.result


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("PFAFFIAN_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_a_result_is_computed_once_for_each_stage_and_key(folder):
    compute, other = Counted(), Counted(b"another")
    for _ in range(3):
        assert cached("stage", "key", compute) == b"the result"
        assert cached("stage", "another-key", other) == b"another"
        assert cached("another-stage", "key", other) == b"another"
    assert (compute.runs, other.runs) == (1, 2)
    assert [p for p, c in tree(folder).items() if c != "a folder"] == [
        "another-stage/key",
        "stage/another-key",
        "stage/key",
    ]


@pytest.mark.parametrize(
    "damage",
    [
        lambda p: p.write_bytes(b""),
        lambda p: p.write_bytes(p.read_bytes()[:-1]),
        lambda p: p.write_bytes(p.read_bytes() + b"\0"),
        lambda p: p.write_bytes(b"T" + p.read_bytes()[1:]),
        lambda p: p.write_bytes(bytes(64)),
    ],
    ids=["empty", "cut off", "longer", "one byte", "zeros"],
)
def test_a_damaged_entry_is_computed_again_and_mended(damage, folder):
    compute = Counted()
    cached("stage", "key", compute)
    damage(folder / "stage" / "key")
    for _ in range(2):
        assert cached("stage", "key", compute) == b"the result"
    assert compute.runs == 2


def test_turned_off_it_computes_each_time_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("PFAFFIAN_CACHE", "off")
    monkeypatch.chdir(tmp_path)
    compute = Counted()
    for _ in range(2):
        assert cached("stage", "key", compute) == b"the result"
    assert compute.runs == 2
    assert cache_folder() is None
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("place", ["/proc/pfaffian", "a file", "a file/deeper"])
def test_a_folder_that_cannot_be_written_is_passed_over(place, tmp_path, monkeypatch):
    (tmp_path / "a file").write_text("mine")
    monkeypatch.setenv("PFAFFIAN_CACHE", str(tmp_path / place))
    before = tree(tmp_path)
    compute = Counted()
    assert cached("stage", "key", compute) == b"the result"
    assert compute.runs == 1
    assert tree(tmp_path) == before


def test_a_full_disk_leaves_no_half_an_entry(folder, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    assert cached("stage", "key", Counted()) == b"the result"
    assert [p for p, c in tree(folder).items() if c != "a folder"] == []


def test_a_failed_computation_is_not_remembered(folder):
    def fail() -> bytes:
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        cached("stage", "key", fail)
    assert cached("stage", "key", Counted()) == b"the result"


def test_parts_of_a_digest_cannot_run_together():
    assert digest(b"ab", b"c") != digest(b"a", b"bc") != digest(b"abc")


def test_the_key_of_a_derivation_follows_the_text_of_the_model(workspace):
    shutil.copytree(find_model("pendubot").path, workspace / "own")
    spec = workspace / "own" / "spec.py"
    keys = {derivation_key(find_model("own"))}
    (workspace / "own" / "mine.toml").write_text('extends = "sim"')
    keys.add(derivation_key(find_model("own")))
    assert len(keys) == 1  # a parameter set is no part of it
    spec.write_text(spec.read_text().replace("9.8", "9.81") + "\n")
    keys.add(derivation_key(find_model("own")))
    assert len(keys) == 2


@pytest.fixture
def warm(folder):
    """Return a cache of its own that holds both stages of the Pendubot."""
    source = find_model("pendubot")
    with pytest.MonkeyPatch.context() as everyday:
        everyday.delenv("PFAFFIAN_CACHE")
        lowered, derivation = lowered_model(source), derivation_of(source)
        shared = cache_folder()
    for stage in ("lowered", "derivation"):
        shutil.copytree(shared / stage, folder / stage)
    assert (lowered, derivation.spec.name) == (lowered_model(source), "pendubot")
    return folder


def test_a_damaged_stage_is_derived_again_into_the_same_files(warm, run, workspace):
    assert run("generate", "pendubot", "-o", "made").code == 0
    whole = tree(warm)
    for path in warm.rglob("*"):
        if path.is_file():
            raw = bytearray(path.read_bytes())
            raw[len(raw) // 2] ^= 1
            path.write_bytes(bytes(raw))
    document = run("generate", "pendubot", "-o", "made", "--json").document()
    assert "derive" in document["seconds"]  # it was derived again
    assert document["changed"] == []  # into the same files
    mended = [p for p, c in tree(warm).items() if c == whole[p] and c != "a folder"]
    assert any(p.startswith("lowered/") for p in mended)
    document = run("generate", "pendubot", "-o", "made", "--json").document()
    assert "derive" not in document["seconds"]


def test_a_compiler_runs_without_a_cache(monkeypatch, run, workspace):
    monkeypatch.setenv("PFAFFIAN_CACHE", "/proc/pfaffian")
    without = run("build", "pendubot", "--target", "host", "--json").document()
    monkeypatch.delenv("PFAFFIAN_CACHE")
    assert run("build", "pendubot", "--target", "host", "--json").document() == without
