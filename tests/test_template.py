"""`pfaffian template`: a set to fill in with all its keys, or the same set filled in again."""

from __future__ import annotations

import json
import tomllib

import pytest
from pfaffian.derive.ir.names import POLES_KEY
from pfaffian.derive.pipeline import lowered_model, parameter_set
from pfaffian.derive.sets.raw_set import TABLES, read_set
from pfaffian.derive.sets.template import template_of
from pfaffian.derive.spec.library import ModelFolder, library_models
from test_own_plant import FILES

LIBRARY = library_models()
SETS = [(name, key) for name, folder in LIBRARY.items() for key in folder.sets()]


@pytest.fixture
def own_plants(workspace):
    """Write the plants of docs/own-plant.md into an empty folder and go there."""
    for name, text in FILES.items():
        path = workspace / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return workspace


def _refilled(folder, name, at):
    """Return the set of that name, and the one that its template makes when it is read again."""
    model = lowered_model(folder)
    raw = read_set(folder.set_path(name), model.parameters, folder.sets())
    at.write_text(template_of(model, tuple(folder.sets()), raw).text(), encoding="utf-8")
    return parameter_set(model, folder, folder.set_path(name)), parameter_set(model, folder, at)


@pytest.mark.parametrize(("model", "name"), SETS)
def test_the_template_filled_from_a_set_is_that_set_to_the_bit(model, name, workspace):
    there, again = _refilled(LIBRARY[model], name, workspace / "again.toml")
    assert again.digest() == there.digest()
    assert (again.title, again.source) == (there.title, there.source)


@pytest.mark.parametrize("name", ["ballbeam/bench", "twocarts/lab"])
def test_so_is_that_of_a_plant_from_outside(name, own_plants):
    plant, key = name.split("/")
    folder = ModelFolder(plant, own_plants / plant)
    there, again = _refilled(folder, key, own_plants / "again.toml")
    assert again.digest() == there.digest()


def test_a_rounded_setpoint_stays_as_it_was_written(workspace):
    """In other digits an equilibrium could no longer have been rounded to it."""
    (workspace / "rounded.toml").write_text('extends = "sim"\n[gains]\nq1d = "1.571 rad"\n')
    folder, again = LIBRARY["pendubot"], workspace / "again.toml"
    model = lowered_model(folder)
    raw = read_set(workspace / "rounded.toml", model.parameters, folder.sets())
    again.write_text(template_of(model, (), raw).text(), encoding="utf-8")
    assert 'q1d = "1.571 rad"' in again.read_text(encoding="utf-8")
    there = parameter_set(model, folder, folder.set_path("sim"))
    assert parameter_set(model, folder, again).digest() == there.digest()


@pytest.mark.parametrize("model", LIBRARY)
def test_an_empty_template_is_refused_with_one_message_that_names_every_key(
    model, run, refused, workspace
):
    made = run("template", model, "-o", "mine.toml", "--json").document()
    wanted = made["required"]
    declared = lowered_model(LIBRARY[model]).parameters
    needed = {f"{TABLES[p.group]}.{p.name}" for p in declared if p.group in ("plant", "target")}
    optional = {f"{TABLES[p.group]}.{p.name}" for p in declared if p.group in TABLES and p.default}
    assert needed - optional <= set(wanted)
    said = refused("generate", model, "--params", "mine.toml", "-o", "out", says=("mine.toml",))
    assert said.count("still to fill in") == 1
    for key in wanted:
        assert key in said
    assert not (workspace / "out").exists()


@pytest.mark.parametrize("model", LIBRARY)
def test_every_key_of_the_file_stands_there_once_with_its_unit_and_meaning(model, run):
    text = run("template", model).out
    declared = [p for p in lowered_model(LIBRARY[model]).parameters if p.group in TABLES]
    lines = text.splitlines()
    for p in declared:
        found = [n for n in lines if n.removeprefix("# ").startswith(f"{p.name} = ")]
        assert len(found) == 1
        assert f"{p.description} [{p.unit or 'a plain number'}]" in found[0]
    uncommented = "\n".join(n.removeprefix("# ") if " = " in n else n for n in lines)
    document = tomllib.loads(uncommented)
    assert set(document) - {"title", "source", "extends"} == {TABLES[p.group] for p in declared}


def test_the_lumped_parameters_stand_in_for_the_physical_ones_and_the_other_way_round(run):
    by_set = {name: run("template", "pendubot", "--set", name).out for name in ("rig", "sim")}
    lumped, physical = (tomllib.loads(by_set[name])["parameters"] for name in ("rig", "sim"))
    assert set(lumped) == {"theta1", "theta2", "theta3", "theta4", "theta5", "g"}
    assert set(physical) == {"m1", "m2", "l1", "lc1", "lc2", "I1", "I2", "g"}
    gains = {name: tomllib.loads(text)["gains"] for name, text in by_set.items()}
    assert (POLES_KEY in gains["rig"], POLES_KEY in gains["sim"]) == (True, False)
    assert ("lam" in gains["rig"], "lam" in gains["sim"]) == (False, True)


def test_generate_takes_the_filled_template_and_makes_the_same_set_of_it(run, own_plants):
    for model, name in (("pendubot", "sim-designed"), ("./ballbeam", "bench")):
        filled = run("template", model, "--set", name)
        (own_plants / f"{name}.toml").write_text(filled.out, encoding="utf-8")
        for option in (("--set", name), ("--params", f"{name}.toml")):
            assert run("generate", model, *option, "-o", option[0].strip("-")).code == 0
        manifests = [
            json.loads((own_plants / kind / "manifest.json").read_text())
            for kind in ("set", "params")
        ]
        assert manifests[0]["parameter_sets"] == manifests[1]["parameter_sets"]
        assert manifests[0]["parameter_sets"]


def test_a_template_overwrites_nothing_unasked_and_says_one_document(run, refused, workspace):
    (workspace / "mine.toml").write_text("mine", encoding="utf-8")
    says = ("-o mine.toml: exists already",)
    refused("template", "pendubot", "-o", "mine.toml", says=says)
    refused("template", "pendubot", "-o", "mine", says=("is no .toml file",))
    refused("template", "pendubot", "--set", "rigg", says=("no parameter set rigg",))
    done = run("template", "pendubot", "--set", "rig", "-o", "mine.toml", "--force", "--json")
    document = done.document()
    assert document["template"] == (workspace / "mine.toml").read_text(encoding="utf-8")
    assert document["required"] == []
    assert {"table", "key", "unit", "description", "state", "value"} <= set(document["keys"][0])


def test_who_has_no_set_is_told_where_one_comes_from(refused, own_plants):
    (own_plants / "slide" / "lab.toml").unlink()
    says = ("model slide has no parameter set", "pfaffian template prints one to fill in")
    refused("generate", "./slide", "-o", "out", says=says)
    refused("design", "./slide", says=says)
