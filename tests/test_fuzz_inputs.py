"""Documents and command lines as nobody would write them: each ends in an answer, none in a crash.

What is fuzzed is real, from the command line to the last check of what was given. What would follow
it and takes long (flights, solvers, compilers) is replaced by a check that does not hold.
`make fuzz-inputs` takes 20,000 tries, the default 50.
"""

from __future__ import annotations

import functools
import io
import json
import os
import shutil
import signal
import sys
import tomllib
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import pytest
import typer
from conftest import Outcome, tree
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pfaffian.cli.main import app, main
from pfaffian.derive.spec.library import library_models
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.code.generated_model import open_generated
from pfaffian.runtime.flight.scenario_files import scenario_paths
from pfaffian.runtime.machine.target_files import target_paths
from pfaffian.runtime.twin.files.campaign import campaign_paths
from support_fuzz import QUANTITIES, TEXTS, judge, spoiled, spoiled_text, toml

TRIES = int(os.environ.get("PFAFFIAN_FUZZ_TRIES", "50"))
#: No try may take longer, in seconds: an input that keeps the program busy for ever is a fault too.
_LONGEST = 60


def tries(share: float) -> Any:
    """Return the settings of a test that makes this share of all tries, always the same ones."""
    return settings(
        max_examples=max(5, round(share * TRIES)),
        derandomize=True,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


def _stop(*_: Any, **__: Any) -> Any:
    raise CheckError("what follows is not fuzzed", remedy="nothing to do")


def _remembered(stage: Any) -> Any:
    """Return `stage` so that it runs once a model: no specification is fuzzed."""
    once = functools.cache(stage)
    return lambda folder, *_: once(folder)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return an empty folder that is the current one, where nothing that takes long is done."""
    folder = tmp_path_factory.mktemp("fuzz")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name in (
            "cli.bench.regenerate.bench_regeneration",
            "cli.bench.batch.bench_batch",
            "cli.bench.step.bench_step",
            "cli.flight.campaign.fly_rows",
            "api.main_job.Job.done",
            "cli.paper.reproduce._make",
            "api.flights._fly_twin",
            "paper.audits.audit",
            "derive.certificate.certify.certify",
            "benchmarks.chain_peers.PEERS.items",
            "derive.generation.generate",
            "derive.plan.planner._coarse",
            "derive.plan.planner.check_plan",
            "derive.verify.compare.verify",
            "runtime.flight.flight_program.fly_bare",
            "runtime.flight.flight_program.fly_qemu_user",
            "benchmarks.sensing.measured_estimators",
            "runtime.machine.compile._compile",
        ):
            owner, _, member = f"pfaffian.{name}".rpartition(".")
            if member == "items":
                patch.setattr(owner, {})
            else:
                patch.setattr(f"{owner}.{member}", _stop)
        from pfaffian.derive import pipeline
        from pfaffian.runtime.flight import scenario

        for name in ("lowered_model", "derivation_of"):
            patch.setattr(pipeline, name, _remembered(getattr(pipeline, name)))
        steps = scenario._steps
        patch.setattr(scenario, "_steps", lambda *a: min(5, steps(*a)))
        yield folder


@contextmanager
def alarm() -> Any:
    """Raise where what is done here takes too long."""

    def late(*_: object) -> None:
        raise TimeoutError("it does not end")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(_LONGEST)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def call(*arguments: str) -> Outcome:
    """Run the command line in this process."""
    out, err, before = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["pfaffian", *arguments]
    try:
        with redirect_stdout(out), redirect_stderr(err), alarm(), pytest.raises(SystemExit) as left:
            main()
    finally:
        sys.argv = before
    return Outcome(int(left.value.code or 0), out.getvalue(), err.getvalue())


def check(folder: Path, name: str, content: bytes, *arguments: str, as_json: bool) -> None:
    """Give `content` as the file `name` to a command, and check its answer."""
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(content)
    before = tree(folder)
    outcome = call(*arguments, *(["--json"] if as_json else []))
    judge(outcome, as_json)
    assert tree(folder) == before


def both(text: str) -> st.SearchStrategy[bytes]:
    """Return texts made of the TOML document `text` by spoiling its values, or its letters."""
    values = spoiled(_plain(tomllib.loads(text))).map(lambda d: toml(d).encode("utf-8", "replace"))
    return st.one_of(values, values, spoiled_text(text))


def _plain(document: Any) -> Any:
    return json.loads(json.dumps(document, default=str))


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


MODELS = library_models()
SETS = {n: _text(next(iter(MODELS[n].sets().values()))) for n in ("pendubot", "pvtol", "tora")}


@pytest.mark.parametrize("model", SETS)
@tries(0.07)
@given(data=st.data(), as_json=st.booleans())
def test_parameter_sets(model, data, as_json, place):
    content = data.draw(both(SETS[model]))
    words = ("generate", model, "--params", "mine.toml", "-o", "made")
    check(place, "mine.toml", content, *words, as_json=as_json)


@tries(0.1)
@given(data=st.data(), as_json=st.booleans())
def test_sets_of_a_folder_of_ones_own(data, as_json, place):
    own = place / "own"
    if not own.exists():
        shutil.copytree(MODELS["tora"].path, own, ignore=lambda *_: ["__pycache__"])
    content = data.draw(both(SETS["tora"]))
    words = data.draw(st.sampled_from(["generate own -o made", "design own", "run own -o made"]))
    check(place, "own/benchmark.toml", content, *words.split(), as_json=as_json)


SCENARIOS = {n: _text(scenario_paths()[n]) for n in ("section-5.1-paper", "crane-transport")}


@pytest.mark.parametrize("name", SCENARIOS)
@tries(0.08)
@given(data=st.data(), as_json=st.booleans())
def test_scenarios(name, data, as_json, place):
    content = data.draw(both(SCENARIOS[name]))
    check(place, "flight.toml", content, "simulate", "flight.toml", as_json=as_json)


TWINS = {n: _text(p) for n, p in scenario_paths().items() if p.parent.name == "twin"}


@pytest.mark.parametrize("name", TWINS)
@tries(0.05)
@given(data=st.data(), as_json=st.booleans())
def test_scenarios_on_the_twin(name, data, as_json, place):
    content = data.draw(both(TWINS[name]))
    check(place, "twin.toml", content, "simulate", "twin.toml", as_json=as_json)


CAMPAIGN = """
title = "many"
scenario = "rig-balance-twin"
change = { duration = "0.1 s", twin = { rigs = 2 } }
[[axis]]
name = "encoder"
point = [{ name = "good" }, { name = "bad", change = { twin = { seed = 2 } } }]
"""


@tries(0.1)
@given(data=st.data(), as_json=st.booleans())
def test_campaigns(data, as_json, place):
    content = data.draw(both(CAMPAIGN))
    check(place, "many.toml", content, "campaign", "many.toml", "-o", "made.csv", as_json=as_json)


CONTROL = _text(MODELS["pendubot"].path / "control" / "rig.toml")


@tries(0.1)
@given(data=st.data(), as_json=st.booleans())
def test_control_sets(data, as_json, place):
    own = place / "controlled"
    if not own.exists():
        shutil.copytree(MODELS["pendubot"].path, own, ignore=lambda *_: ["__pycache__"])
    content = data.draw(both(CONTROL))
    words = ("generate", "controlled", "--set", "rig", "-o", "made")
    check(place, "controlled/control/rig.toml", content, *words, as_json=as_json)


TARGETS = {n: _text(p) for n, p in target_paths().items() if n in ("ppc750", "cortex-m7")}


@pytest.mark.parametrize("name", TARGETS)
@tries(0.05)
@given(data=st.data(), as_json=st.booleans())
def test_targets(name, data, as_json, place):
    content = data.draw(both(TARGETS[name]))
    words = ("build", "pendubot", "--target", "board.toml", "-o", "made")
    check(place, "board.toml", content, *words, as_json=as_json)


PLAN = json.loads(_text(MODELS["pendubot"].path / "plans" / "rig.json"))
LONG = ("times", "states", "torques", "accelerations", "rows", "row_rates", "riccati_matrices")


@tries(0.06)
@given(data=st.data(), as_json=st.booleans())
def test_plans(data, as_json, place):
    """All of a plan is spoiled, the long lists by their first entries."""
    short = {k: v[:2] if k in LONG else v for k, v in PLAN.items()}
    made = data.draw(spoiled(short))
    for key in LONG:
        if made.get(key) == short[key]:
            made[key] = PLAN[key]
    text = json.dumps(made)
    content = data.draw(st.one_of(st.just(text.encode("utf-8", "replace")), spoiled_text(text)))
    words = data.draw(
        st.sampled_from(["plan pendubot --set rig --check", "generate pendubot -o made --plan"])
    )
    check(place, "plan.json", content, *words.split(), "plan.json", as_json=as_json)


MANIFEST = json.loads(_text(open_generated("tora").path / "manifest.json"))


@tries(0.06)
@given(data=st.data(), as_json=st.booleans())
def test_manifests(data, as_json, place):
    made = place / "code"
    if not made.exists():
        shutil.copytree(open_generated("tora").path, made, ignore=lambda *_: ["__pycache__"])
    content = data.draw(spoiled(MANIFEST).map(lambda d: json.dumps(d).encode("utf-8", "replace")))
    words = data.draw(
        st.sampled_from(["simulate tora-damping", "verify tora", "build tora --target host"])
    )
    check(
        place, "code/manifest.json", content, *words.split(), "--generated", "code", as_json=as_json
    )


WORDS = [
    *(*MODELS, *scenario_paths(), *campaign_paths(), *target_paths(), "sim", "rig", "all", "host"),
    *(
        "-1",
        "0",
        "1",
        "3",
        "1e9",
        "10**9",
        "nan",
        "0.5",
        "text",
        "latex",
        "single",
        "gcc",
        "unicorn",
    ),
    *(
        "q1=1",
        "q1=1:2,rate=8",
        "q1=1e300",
        "effort=1,speed=2",
        "foo=1",
        "=",
        ",",
        ":",
        "a=b=c",
        "-",
    ),
    *(
        "-6,-6,-6",
        "-6,-4+2j,-4-2j",
        "1,1,1,1",
        "m2=5%",
        "m2=1:2",
        "5 ms",
        "2 N*m",
        "1:3",
        "figure-7",
    ),
    *("made", "made.svg", "made.toml", "made.json", "nowhere/made.csv", ".", "/", "/dev/null", "~"),
    *("[a]", "--", "--json", "--set", "--help", "-o", "--nothing"),
    *(t for t in (*TEXTS, *QUANTITIES[:40]) if "\0" not in t),
]


def _commands() -> dict[str, typer.core.TyperCommand]:
    top = typer.main.get_command(app).commands
    below = {f"bench {n}": c for n, c in top["bench"].commands.items()}
    return {n: c for n, c in top.items() if n != "bench"} | below


COMMANDS = _commands()


@st.composite
def command_lines(draw: Any) -> list[str]:
    """Return a command with options of its own and values of any kind."""
    name = draw(st.sampled_from(sorted(COMMANDS)))
    words, value = name.split(), st.one_of(st.sampled_from(WORDS), st.text("ab1=,:.- ", max_size=8))
    arguments = [p for p in COMMANDS[name].params if p.param_type_name == "argument"]
    options = [p for p in COMMANDS[name].params if p.param_type_name == "option"]
    for _ in arguments:
        words.append(draw(st.one_of(st.sampled_from([*MODELS, *scenario_paths()]), value)))
    for option in draw(st.lists(st.sampled_from(options), max_size=4)):
        words.append(draw(st.sampled_from(option.opts)))
        if not option.is_flag:
            words.append(draw(value))
    if draw(st.booleans()):
        words.append("--json")
    return words if draw(st.integers(0, 9)) else draw(st.permutations(words))


@tries(0.2)
@given(words=command_lines())
def test_command_lines(words, place):
    before = tree(place)
    outcome = call(*words)
    helped = "--help" in words or not outcome.out.startswith("{")
    judge(outcome, "--json" in words and not (outcome.code == 0 and helped))
    if outcome.code:
        assert tree(place) == before
