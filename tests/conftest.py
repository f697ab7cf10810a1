"""Fixtures shared by the tests of the command line: run it in this process, watch the disk."""

from __future__ import annotations

import json
import os
import sys
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
#: Whether the tests of thorough.toml run too, and others take all their samples: `make thorough`.
THOROUGH = os.environ.get("PFAFFIAN_THOROUGH") == "1"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip what only `make thorough` runs, and say what of it stays.

    Raises `UsageError` for a row that names no test, where whole files are collected.
    """
    listed = tomllib.loads((Path(__file__).parent / "thorough.toml").read_text(encoding="utf-8"))
    unmatched = {item.path.stem for item in items} & set(listed)
    left = {(stem, name) for stem in unmatched for name in listed[stem]}
    for item in items:
        rows = listed.get(item.path.stem, {})
        bare = item.name.partition("[")[0]
        left -= {(item.path.stem, item.name), (item.path.stem, bare)}
        short = rows.get(item.name) or rows.get(bare)
        if short and not THOROUGH:
            item.add_marker(pytest.mark.skip(reason=f"make thorough; here: {short}"))
    if left and not any("::" in argument for argument in config.args):
        raise pytest.UsageError(f"thorough.toml names tests that are not there: {sorted(left)}")


@dataclass(frozen=True)
class Outcome:
    """What one call of the command line gave back."""

    code: int
    out: str
    err: str

    def document(self) -> Any:
        """Return standard output, which must be one JSON document and nothing else."""
        return json.loads(self.out)


def tree(folder: Path) -> dict[str, bytes | str]:
    """Return what is at every path below `folder`: a file's bytes, where a link leads, a folder."""

    def content(path: Path) -> bytes | str:
        if path.is_symlink():
            return f"-> {path.readlink()}"
        return "a folder" if path.is_dir() else path.read_bytes()

    return {str(p.relative_to(folder)): content(p) for p in sorted(folder.rglob("*"))}


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    """Return a function that runs `pfaffian ARGUMENTS` in this process."""
    from pfaffian.cli.main import main

    monkeypatch.setenv("COLUMNS", "200")

    def call(*arguments: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["pfaffian", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            main()
        said = capsys.readouterr()
        return Outcome(int(left.value.code or 0), said.out, said.err)

    return call


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty folder that is the current one."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def refused(run: Callable[..., Outcome], workspace: Path) -> Any:
    """Return a function that checks that a call is refused and leaves the workspace alone.

    `says` are parts of the message: what, where and what to do. The error must come without a
    traceback, and with --json as one document on standard output and nothing else there.
    """

    def check(*arguments: object, says: tuple[str, ...], code: int = 2) -> str:
        before = tree(workspace)
        plain = run(*arguments)
        script = run(*arguments, "--json")
        assert tree(workspace) == before, "a refused call wrote something"
        assert plain.code == script.code == code, plain.err
        assert plain.out == ""
        assert "error: " in plain.err
        assert "Traceback" not in plain.err
        error = script.document()["error"]
        assert set(script.document()) == {"error"}
        assert error["exit_code"] == code
        assert error["message"]
        assert error["remedy"], "the message does not say what to do"
        for text in (plain.err, f"{error['message']}\n{error['remedy']}"):
            for part in says:
                assert part in text
        return str(error["message"])

    return check


@pytest.fixture
def params(workspace: Path) -> Callable[[str], Path]:
    """Return a function that writes the parameter set `mine.toml` into the workspace."""

    def write(text: str) -> Path:
        path = workspace / "mine.toml"
        path.write_text(text, encoding="utf-8")
        return Path(path.name)

    return write


@pytest.fixture
def written(workspace: Path) -> Callable[[str], str]:
    """Return a function that writes a scenario, `flight.toml`, and returns its path."""

    def write(text: str) -> str:
        path = workspace / "flight.toml"
        path.write_text(text, encoding="utf-8")
        return str(path)

    return write
