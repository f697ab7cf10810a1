"""Complete controllers that cannot be: refused with file, key and remedy; nothing is written."""

import shutil

import pytest
from pfaffian.derive.pipeline import library_controls, library_sets, lowered_model, plan_tables
from pfaffian.derive.sets.controller_set import read_control
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.base.errors import InputError

SOURCE = find_model("pendubot")
GOOD = (SOURCE.path / "control" / "rig.toml").read_text(encoding="utf-8")
#: The passage replaced, by what, and what message and remedy must say.
REFUSED = {
    "a misspelt table": ("[feedback]", "[fedback]", "unknown key fedback", "feedback?"),
    "a misspelt member": ("watchdog_time", "watchdog", "unknown key watchdog", "_time?"),
    "an unknown swing-up": ('"plan"\nb', '"jump"\nb', "swing_up = 'jump'", "energy"),
    "a swing-up that is a list": ('"plan"\nb', "[]\nb", "swing_up = []", "energy"),
    "an unknown balance law": ('"robust"', '"magic"', "balance = 'magic'", "robust"),
    "half a count": ("overruns = 3", "overruns = 3.5", "overruns is no whole number", "give"),
    "yes for a count": ("overruns = 3", "overruns = true", "overruns is no whole number", "give"),
    "another unit": ('"0.1 s"', '"0.1 m"', "supervisor.watchdog_time", "s"),
    "a gain too few": (", -4.80355931]", "]", "feedback.tau is no row of 4", "order: q"),
    "words for gains": ("-4.80355931]", '"much"]', "feedback.tau", "number"),
    "a row too few": ("    [4.396, 3.602, 0.8009, 0.479],\n", "", "form.weights has not 4", "q1"),
    "an unsymmetric form": ("[33.95, 29.21", "[33.9, 29.21", "form.weights is not symm", "w_ji"),
    "release before capture": ("form = 12", "form = 0.5", "capture.form = 0.7 is above", "later"),
    "a table that is none": ('"plan"\nb', '"plan"\nrest = 3\nb', "rest", "[rest]"),
}  # fmt: skip


@pytest.fixture(scope="module")
def model():
    return lowered_model(SOURCE)


@pytest.fixture(scope="module")
def law(model):
    return next(s for s in library_sets(model, SOURCE) if s.name == "rig").as_dict()


@pytest.mark.parametrize("what", REFUSED)
def test_a_bad_controller_is_refused_with_file_and_key(what, model, law, tmp_path):
    right, wrong, message, remedy = REFUSED[what]
    assert GOOD.count(right) == 1, GOOD.count(right)
    path = tmp_path / "rig.toml"
    path.write_text(GOOD.replace(right, wrong), encoding="utf-8")
    with pytest.raises(InputError) as error:
        read_control(path, model, law, ("rig",))
    assert str(path) in error.value.message
    assert message in error.value.message
    assert remedy in error.value.remedy


def test_a_plan_that_is_not_there_is_refused(model, law, tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(GOOD, encoding="utf-8")
    with pytest.raises(InputError, match="there is no plan for parameter set rig") as error:
        read_control(path, model, law, ())
    assert "pfaffian plan pendubot --set rig" in error.value.remedy


def test_the_good_one_is_read_as_the_library_does(model, law):
    sets = library_sets(model, SOURCE)
    known = library_controls(model, SOURCE, sets, plan_tables(model, SOURCE, sets, None))
    path = SOURCE.path / "control" / "rig.toml"
    assert read_control(path, model, law, ("rig",)) == known[0]


def test_generate_of_a_model_with_a_bad_controller_writes_nothing(refused, workspace):
    shutil.copytree(SOURCE.path, workspace / "pendubot", ignore=lambda *_: ["__pycache__"])
    path = workspace / "pendubot" / "control" / "rig.toml"
    path.write_text(GOOD.replace("overruns = 3", "overrun = 3"), encoding="utf-8")
    says = ("rig.toml", "supervisor: unknown key overrun", "overruns?")
    refused("generate", "./pendubot", "-o", "out", says=says)
