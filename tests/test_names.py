"""Names: a person's stay what they are and ours give way, or the name is refused at its line.

`PFAFFIAN_NAMES=all` puts every name of the list into every role, alone and with several.
"""

from __future__ import annotations

import itertools
import os
import re

import numpy as np
import pytest
from conftest import REPOSITORY
from pfaffian.derive.authoring import ModelBuilder
from pfaffian.derive.emit.files.controller import control_structures
from pfaffian.derive.emit.statements import with_local_names
from pfaffian.derive.ir.own_names import OwnNames
from pfaffian.derive.ir.program import Instruction, Op, Program
from pfaffian.derive.spec.reserved_names import CONTROLLER, objection, reserved_words
from pfaffian.derive.verify.subjects import CompiledUnderTest
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.generated_model import host_model, open_generated
from support_names import (
    NAMES,
    OURS,
    Named,
    generated,
    may_be_a_coordinate,
    usable,
    verified,
)

EVERY = os.environ.get("PFAFFIAN_NAMES") == "all"
#: Actuators that the case of two masses must fly under, all the same.
TORQUES = ("p1", "p2", "p3", "s", "beta", "adb", "engaged", "bound_estimate", "saturated")


def test_the_list_has_every_kind_of_name():
    assert len(NAMES) >= 300
    assert {"p1", "linux", "NULL", "lambda", "len", "omega", "E", "xor"} <= set(NAMES)


@pytest.mark.parametrize("name", [n for n in NAMES if objection(n)])
def test_a_reserved_name_is_refused_where_it_is_declared(name):
    def refuses(declare):
        with pytest.raises(InputError, match=f"model t: {re.escape(name)} (is|begins)"):
            declare()

    m = ModelBuilder("t", title="t", source="t")
    refuses(lambda: m.coordinate(name, "m", "a coordinate", bound=1, rate_bound=1))
    refuses(lambda: m.parameter(name, "kg", "a parameter"))
    refuses(lambda: m.uncertain(name, "N", "an uncertainty"))
    refuses(lambda: m.gain(name, "1/s", "a gain"))
    refuses(lambda: m.actuator(name, "N", "an actuator", on={}))


def test_few_names_are_reserved_and_none_of_ours_but_members_of_the_controller():
    assert [n for n in OURS.split() if objection(n)] == []
    members = {n for n in NAMES if objection(n, member=True) and not objection(n)}
    assert members == {
        *("law", "mode", "fault", "phase", "output", "params", "status", "sum", "energy")
    }


def test_the_documents_list_what_is_reserved():
    page = (REPOSITORY / "docs" / "own-plant.md").read_text(encoding="utf-8")
    lists = re.findall(r"^```\n(.*?)^```$", page.split("## Names")[1], re.DOTALL | re.MULTILINE)
    assert lists[0].split() == list(reserved_words())
    assert lists[1].split() == CONTROLLER.split()
    for name in lists[0].split():
        assert objection(name)


def test_a_coordinate_whose_rate_is_called_as_its_setpoint_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"dd is the name of the rate .* and of the setpoint"):
        generated(Named(coordinates=("d", "right")), tmp_path / "out")


@pytest.mark.parametrize("name", ["o", "voi"])
def test_what_follows_from_a_coordinate_is_refused_too(name):
    m = ModelBuilder("t", title="t", source="t")
    with pytest.raises(InputError, match=f"(do|void), which follows from {name}, is a keyword"):
        m.coordinate(name, "m", "a coordinate", bound=1, rate_bound=1)


def two_masses(folder, actuator):
    named = Named(actuators=(actuator,), parameters=["weight"])
    generated(named, folder)
    code = open_generated(str(folder))
    rng = np.random.default_rng(7)
    inputs = {"left": 2.0, "right": 1.0, "dleft": 1.0, "dright": 1.0}
    values = {n: rng.normal(0.0, size, 500) for n, size in inputs.items()}
    values |= {n: np.full(500, v) for n, v in code.parameters("lab").items()}
    values["torque_limit"] = np.full(500, 5.0)
    return code, CompiledUnderTest(host_model(code), "c-host").evaluate("step", values)


@pytest.fixture(scope="module")
def plainly(tmp_path_factory):
    return two_masses(tmp_path_factory.mktemp("plain") / "out", "u")


@pytest.mark.parametrize("actuator", TORQUES if EVERY else ("p1", "s", "saturated"))
def test_the_torque_is_the_same_under_every_name_and_never_beyond_its_limit(
    actuator, plainly, tmp_path
):
    code, found = two_masses(tmp_path / "out", actuator)
    _, wanted = plainly
    own = code.manifest.own
    assert own(actuator) == f"{actuator}_law" == code.manifest.own_names[actuator]
    assert np.array_equal(found[actuator], wanted["u"])
    assert np.abs(found[actuator]).max() == 5.0
    for signal in ("p1", "p2", "p3", "s", "beta", "adb", "bound_estimate", "saturated"):
        assert np.array_equal(found[own(signal)], wanted[signal]), signal
    assert np.abs(found[own("p1")]).max() > 5.0, "the law asks for more than the limit"


def test_odd_names_together_are_verified_with_one_actuator(tmp_path):
    parameters = [n for n in usable(NAMES) if n not in {"sin", "s", "p1", "sd"}]
    code = verified(
        Named(coordinates=("sin", "s"), actuators=("p1",), parameters=parameters[::4]),
        tmp_path / "out",
        20,
    )
    assert code.manifest.own_names["p1"] == "p1_law"
    assert "p1" in code.manifest.structures["plant_input"].names()


def test_odd_names_together_are_verified_with_several_actuators(tmp_path):
    code = verified(
        Named(
            coordinates=("adb", "engaged", "e1"),
            actuators=("s1", "beta", "length"),
            constraints=("s3", "b", "s2"),
            gains=("s", "offset", "leakage_decay"),
            parameters=("p1_s1", "p1", "det_m", "rate", "state", "input", "np", "OK", "cos"),
        ),
        tmp_path / "out",
        20,
        extras=True,
    )
    assert code.manifest.own_names["p1_s1"] == "p1_s1_law"
    assert code.manifest.of_actuator("p1", "s1") in code.manifest.structures["output"].names()


def test_plain_names_leave_ours_as_they_are(plainly):
    code, _ = plainly
    assert code.manifest.own_names == {}
    assert "own_names" not in code.manifest.to_json()


def test_no_name_is_handed_out_twice():
    declared = frozenset({"p1", "p1_law", "p1_length", "bhat_length", "drift_previous"})
    own = OwnNames(declared, ("length", "drift"))
    made = [*itertools.chain(*(own.of_actuators(b) for b in ("p1", "p2", "bhat", "torque")))]
    made += [own(n) for n in ("p1", "bhat_length", "drift_previous", "s")]
    made += [own.previous(a) for a in ("length", "drift")]
    assert len(set(made)) == len(made)
    assert not set(made) & declared
    assert own("p1") == "p1_law_law"
    assert own("s") == "s"


def test_a_coordinate_called_as_the_rate_of_another_has_a_row_of_its_own(tmp_path):
    own = OwnNames(frozenset({"x", "x_rate", "x_ref"}), ("push", "pull"))
    made = own.reference(["x", "x_rate"])
    assert len(set(made)) == len(made) == 2 * (3 + 2 * 2 * 2)
    assert made[0] == "x_ref_law"
    verified(Named(coordinates=("x", "x_rate"), parameters=("x_ref",)), tmp_path / "out", 20)


def test_members_of_the_controller_that_would_be_one_are_refused(tmp_path):
    named = Named(coordinates=("x", "x_goal"))
    model, _ = generated(named, tmp_path / "out")
    with pytest.raises(InputError, match="two members x_goal"):
        control_structures(model)


def test_locals_of_a_function_get_names_of_their_own():
    tape = (
        Instruction(Op.INPUT, name="state"),
        Instruction(Op.INPUT, name="state_value"),
        Instruction(Op.ADD, (0, 1), name="sum"),
        Instruction(Op.ADD, (2, 1), name="sum"),
    )
    program = Program("f", "f", (), tape, (), ())
    names = [i.name for i in with_local_names(program, frozenset({"state"})).instructions]
    assert names == ["state_value_value", "state_value", "sum", "sum_value"]


def some(cases):
    """Return all the cases where every name is asked for (an hour), else the first."""
    return cases if EVERY else cases[:1]


def chunks(names, size):
    return [names[k : k + size] for k in range(0, len(names), size)]


@pytest.mark.parametrize("names", some(chunks(usable(NAMES), 40)), ids=lambda n: n[0])
@pytest.mark.parametrize("role", ["gains", "parameters"] if EVERY else ["gains"])
def test_names_as_parameter_and_gain(role, names, tmp_path):
    two = {"actuators": ("push", "pull"), "constraints": ("wanted", "too")}
    verified(Named(**{role: names}, **(two if role == "gains" else {})), tmp_path / "out", 20)


def several():
    """Return plants of three coordinates, actuators and constraints, each name in each role."""
    names = [n for n in usable(NAMES, member=True) if n not in {"x1", "t1"}]
    names = [n for n in names if may_be_a_coordinate(n)]
    names = [n for n in names if f"d{n}" not in names and f"dd{n}" not in names]
    count = len(names)
    for k in range(0, count, 3):
        roles = [[names[(k + shift + i) % count] for i in range(3)] for shift in (0, 31, 67)]
        yield Named(coordinates=roles[0], actuators=roles[1], constraints=roles[2])


@pytest.mark.parametrize("named", some(list(several())), ids=lambda n: n.coordinates[0])
def test_names_with_several(named, tmp_path):
    verified(named, tmp_path / "out", 20)


@pytest.mark.parametrize("name", usable(NAMES, member=True) if EVERY else ["s"])
def test_a_name_alone(name, tmp_path):
    other = "u" if name != "u" else "v"
    for named in (
        *([Named(coordinates=(name, "right"))] if may_be_a_coordinate(name) else []),
        Named(actuators=(name,)),
        Named(constraints=(name,), actuators=(other,)),
    ):
        verified(named, tmp_path / "-".join([*named.coordinates, *named.actuators]), 20)
