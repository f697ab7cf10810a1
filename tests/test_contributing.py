"""CONTRIBUTING.md, recipe by recipe, in a scratch copy of the tree."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import REPOSITORY

PAGE = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
OWN_PLANT = (REPOSITORY / "docs" / "own-plant.md").read_text(encoding="utf-8")
PARTS = ("api", "benchmarks", "cli", "derive", "generated", "paper", "runtime", "templates", ".dev")


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    """Return a copy of what is shipped, and a function that runs its command line."""
    root = tmp_path_factory.mktemp("scratch")
    for part in PARTS:
        shutil.copytree(
            REPOSITORY / part, root / part, symlinks=True, ignore=lambda *_: ["__pycache__"]
        )
    (root / "work").mkdir()
    environment = {**os.environ, "PYTHONPATH": str(root / ".dev"), "COLUMNS": "200"}

    def call(*arguments: str, code: int = 0) -> str:
        run = "import sys; from pfaffian.cli.main import main; sys.exit(main())"
        done = subprocess.run(
            [sys.executable, "-c", run, *arguments],
            cwd=root / "work",
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == code, done.stderr
        return done.stdout

    return root, call


def recipe(title: str) -> str:
    """Return the text of one recipe; every one has five steps."""
    text = PAGE.split(f"## {title}\n")[1].split("\n## ")[0]
    assert re.findall(r"^(\d)\. ", text, re.MULTILINE) == list("12345")
    return text


def named_file(page: str, name: str) -> str:
    """Return the file `name` that `page` shows."""
    return re.search(rf"`{re.escape(name)}`:?\n\n```\w+\n(.*?)```", page, re.DOTALL).group(1)


def test_a_model_is_a_folder_with_a_specification_and_a_set(scratch):
    root, call = scratch
    assert "derive/models/NAME/spec.py" in recipe("Add a model")
    folder = root / "derive" / "models" / "slide"
    folder.mkdir()
    (folder / "spec.py").write_text(named_file(OWN_PLANT, "slide/spec.py"), encoding="utf-8")
    template = call("template", str(folder))
    assert {"mass", "spring", "sigma", "torque_limit"} <= set(re.findall(r"\w+", template))
    (folder / "lab.toml").write_text(named_file(OWN_PLANT, "slide/lab.toml"), encoding="utf-8")
    assert "slide" in json.loads(call("models", "--json"))["models"]
    call("generate", "slide", "-o", str(root / "generated" / "slide"))
    call("generate", "slide", "-o", str(root / "generated" / "slide"), "--check")
    (root / "runtime" / "scenarios" / "slide-out.toml").write_text(
        'title = "out"\nmodel = "slide"\nset = "lab"\nduration = "0.1 s"\n[initial]\nx = "40 cm"\n'
    )
    flown = json.loads(call("simulate", "slide-out", "--json"))
    assert flown["scenario"] == "slide-out"


def test_a_pass_is_a_file_and_a_row(scratch):
    root, call = scratch
    text = recipe("Add a pass of the optimiser")
    name = "derive/optimise/keep_all.py"
    (root / name).write_text(named_file(text, name), encoding="utf-8")
    [row] = re.findall(r'`(\("\w+", keep_all\))`', text)
    passes = root / "derive" / "optimise" / "passes.py"
    source = passes.read_text(encoding="utf-8")
    last = '    ("multiply-add", fuse_multiply_adds),\n'
    assert source.count(last) == 1
    source = source.replace(last, f"{last}    {row},\n")
    source = source.replace(
        "from pfaffian.derive.optimise.schedule",
        "from pfaffian.derive.optimise.keep_all import keep_all\n"
        "from pfaffian.derive.optimise.schedule",
    )
    passes.write_text(source, encoding="utf-8")
    made = json.loads(call("generate", "tora", "-o", "tora", "--json"))
    steps = [p for p in made["passes"] if p["program"] == "step" and p["name"] == "nothing"]
    assert steps
    assert steps[0]["before"] == steps[0]["after"]


def test_a_target_is_a_file(scratch):
    root, call = scratch
    assert "runtime/targets/" in recipe("Add a target")
    folder = root / "runtime" / "targets"
    shutil.copy(folder / "7447a.toml", folder / "mine.toml")
    assert "mine" in [t["name"] for t in json.loads(call("targets", "--json"))["targets"]]


def test_a_command_is_a_function_with_its_help(scratch):
    root, call = scratch
    recipe("Add a command")
    (root / "cli" / "model" / "hello.py").write_text(
        '"""`pfaffian hello`."""\n\nfrom pfaffian.cli import output\n\n\n'
        "def greet(as_json: bool) -> None:\n"
        '    """Say hello."""\n'
        '    output.deliver({"said": "hello"}, as_json, lambda: output.say("hello"))\n',
        encoding="utf-8",
    )
    main = root / "cli" / "main.py"
    source = main.read_text(encoding="utf-8")
    mark = "@app.command()\ndef models("
    assert source.count(mark) == 1
    added = (
        '@app.command()\ndef hello(json: Json = False) -> None:\n    """Say hello."""\n'
        "    from pfaffian.cli.model.hello import greet\n\n    greet(json)\n\n\n"
    )
    main.write_text(source.replace(mark, added + mark), encoding="utf-8")
    assert call("hello") == "hello\n"
    assert json.loads(call("hello", "--json")) == {"said": "hello"}
    assert "Say hello." in call("--help")


def test_what_the_page_names_is_there():
    paths = re.findall(r"`((?:derive|runtime|tests|docs|cli|api|generated)/[\w./-]*)`", PAGE)
    real = [p for p in paths if "NAME" not in p and "keep_all" not in p]
    assert len(real) > 8
    for path in real:
        assert (REPOSITORY / path).exists(), path
    targets = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    for goal in re.findall(r"`?make (\w+)`?", PAGE):
        assert re.search(rf"^{goal}:", targets, re.MULTILINE), goal


def test_the_hooks_run_what_make_lint_runs():
    hooks = (REPOSITORY / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    for tool in ("ruff check", "ruff format", "mypy", "lint-imports"):
        assert tool in hooks
    assert Path(REPOSITORY / ".pre-commit-config.yaml").is_file()
