"""The house: the README draws the imports, and no room or function outgrows its limit."""

from __future__ import annotations

import ast
import re
import subprocess
import sys

import pytest
from conftest import REPOSITORY

PACKAGES = ("api", "benchmarks", "cli", "derive", "paper", "runtime")
#: Modules a folder may hold, and lines a function may have.
MOST_MODULES, MOST_LINES = 12, 60


def sources(package):
    return [p for p in (REPOSITORY / package).rglob("*.py") if "__pycache__" not in p.parts]


def test_the_chart_of_the_readme_is_that_of_the_imports():
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    [shown] = re.findall(r"^```mermaid\n(.*?)^```$", readme, re.DOTALL | re.MULTILINE)
    command = [sys.executable, str(REPOSITORY / "docs" / "rooms.py")]
    made = subprocess.run(command, capture_output=True, text=True, check=True)
    assert shown == made.stdout


@pytest.mark.parametrize("package", PACKAGES)
def test_no_folder_holds_more_than_a_dozen_modules(package):
    folders = {p.parent for p in sources(package)}
    counts = {f: len([p for p in f.glob("*.py") if p.name != "__init__.py"]) for f in folders}
    assert {f: n for f, n in counts.items() if n > MOST_MODULES} == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_no_function_is_longer_than_a_screen(package):
    long = {
        f"{path.name}:{node.name}": node.end_lineno - node.lineno + 1
        for path in sources(package)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and node.end_lineno - node.lineno + 1 > MOST_LINES
    }
    assert long == {}


def test_nothing_of_the_toolchain_imports_the_paper_or_the_benchmarks():
    for package in ("api", "derive", "generated", "runtime", "templates"):
        for path in sources(package):
            text = path.read_text(encoding="utf-8")
            assert not re.search(r"pfaffian[./](paper|benchmarks)\b", text), path
