"""What a person writes into a document: units that mean one thing, all mistakes said at once."""

from __future__ import annotations

import pytest
from conftest import REPOSITORY
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import parse_quantity
from pfaffian.runtime.base.toml import read_toml

RIG = REPOSITORY / "derive" / "models" / "pendubot" / "rig.toml"

#: Text, the unit asked for, what it is in that unit, from the definitions of the units.
RIGHT = [
    ("1 1/s", "1/s", 1.0),
    ("2 (1/s)", "1/s", 2.0),
    ("3 1/(kg*m^2)", "1/(kg*m^2)", 3.0),
    ("1 t", "kg", 1000.0),
    ("1 long_ton", "kg", 2240 * 0.45359237),
    ("1 short_ton", "kg", 2000 * 0.45359237),
    ("180 deg", "rad", 3.141592653589793),
    ("90 °", "rad", 1.5707963267948966),
    ("1 N m", "N*m", 1.0),
    ("1 m s^-2", "m/s^2", 1.0),
    ("1 kg m**2", "kg*m^2", 1.0),
    ("7 N*m", "N*m/rad", 7.0),
    ("7 N*m/rad", "N*m", 7.0),
    ("5 rad/s^2", "1/s^2", 5.0),
    ("50 %", "", 0.5),
    ("1e-19 kg*m^2", "kg*m^2", 1e-19),
]
WRONG = [
    *((text, "kg", "unknown unit") for text in ("1+1 kg", "1 1 kg", "2 kg*1", "1 kg-1 g", "2 -kg")),
    ("4 kg//1", "kg", "unknown unit"),
    ("1 kg*deg", "kg", "has degree in it, but kg is needed"),
    ("1 kg*rad", "kg", "has radian in it"),
    ("1 m*deg/rad", "m", "has degree, radian in it"),
    ("1 kg*percent", "kg", "has percent in it"),
    ("9.81 m*deg/s^2", "m/s^2", "has degree in it"),
    ("1 ton", "kg", "'ton' in 'ton' is the name of several units"),
    ("1 kton", "kg", "is the name of several units"),
    ("2 tons*m^2", "kg*m^2", "is the name of several units"),
    ("1 ton_force", "N", "is the name of several units"),
    ("1 cwt", "kg", "is the name of several units"),
]


@pytest.mark.parametrize(("text", "unit", "value"), RIGHT)
def test_a_unit_is_read_as_what_it_is(text, unit, value):
    assert parse_quantity(text, unit, "here") == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(("text", "unit", "says"), WRONG)
def test_a_unit_that_is_none_or_means_several_things_is_refused(text, unit, says):
    with pytest.raises(InputError, match="here: .*" + says.replace("(", "\\(")):
        parse_quantity(text, unit, "here")


def test_an_angle_may_stand_in_a_unit_that_was_computed_without():
    degrees = parse_quantity("180 deg/s^2", "1/s^2", "here", drops_angles=True)
    assert degrees == pytest.approx(3.141592653589793, rel=1e-15)
    with pytest.raises(InputError, match="has degree"):
        parse_quantity("180 deg/s^2", "1/s^2", "here")


def test_a_byte_order_mark_is_passed_over(workspace, run):
    bare, marked = workspace / "bare.toml", workspace / "marked.toml"
    bare.write_bytes(RIG.read_bytes())
    marked.write_bytes(b"\xef\xbb\xbf" + RIG.read_bytes())
    assert read_toml(marked) == read_toml(bare)
    done = run("design", "pendubot", "--params", marked, "--json")
    assert done.code == 0, done.err


def test_all_wrong_units_of_a_set_are_said_at_once(workspace, refused):
    text = RIG.read_text(encoding="utf-8")
    lines = {"theta1": "kg", "theta4": "m", "sigma": "kg", "torque_limit": "kg"}
    for name, unit in lines.items():
        old = next(line for line in text.splitlines() if line.split(" ")[0] == name)
        text = text.replace(f"\n{old}\n", f'\n{name} = "0.01 {unit}"\n')
    (workspace / "mine.toml").write_text(text, encoding="utf-8")
    tables = ("parameters.theta1", "parameters.theta4", "gains.sigma", "target.torque_limit")
    says = tuple(f"mine.toml: {key}: " for key in tables)
    refused("generate", "pendubot", "--params", "mine.toml", "-o", "out", says=says)


@pytest.mark.parametrize("character", ["\\u0000", "\\u001b", "\\u202e", "\\u007f"])
def test_a_control_character_in_a_document_is_refused(character, workspace, refused):
    text = RIG.read_text(encoding="utf-8")
    title = next(line for line in text.splitlines() if line.startswith("title"))
    (workspace / "mine.toml").write_text(text.replace(title, f'title = "a{character}b"'))
    code = f"U+{int(character[2:], 16):04X}"
    says = (f"mine.toml: title: 'a\\{'x' if code < 'U+0100' else 'u'}", code, "leave it out")
    refused("generate", "pendubot", "--params", "mine.toml", "-o", "out", says=says)


@pytest.mark.parametrize("option", [["--set", ""], ["--set", " "], ["--params", ""]])
def test_an_empty_name_is_no_way_to_leave_an_option_out(option, refused):
    for command in ("generate", "design"):
        refused(command, "pendubot", *option, says=(option[0], "leave the option out"))


CAMPAIGN = """\
scenario = "rig-balance-twin"
[[axis]]
name = "{first}"
[[axis.point]]
name = "one"
[[axis.point]]
name = "{point}"
[[axis]]
name = "b"
[[axis.point]]
name = "one"
"""


@pytest.mark.parametrize(
    ("first", "point", "says"),
    [
        ("a", "one", "axis 1: two points are called one"),
        ("b", "two", "two axes are called b"),
        ("", "two", "one of its axes has no name"),
        ("a", " ", "axis 1: one of its points has no name"),
    ],
)
def test_names_of_a_campaign_tell_its_cases_apart(first, point, says, workspace, refused):
    (workspace / "c.toml").write_text(CAMPAIGN.format(first=first, point=point))
    refused("campaign", "c.toml", says=(f"c.toml: {says}",))


@pytest.mark.parametrize("character", ["\\0", "\\x1b", "\\u202e"])
def test_a_control_character_in_a_description_is_refused_with_its_line(
    character, workspace, refused
):
    source = (REPOSITORY / "derive" / "models" / "crane" / "spec.py").read_text(encoding="utf-8")
    line = next(n for n, x in enumerate(source.splitlines(), 1) if "m.parameter(" in x)
    name = source.splitlines()[line - 1].split('"')[1]
    folder = workspace / "mine"
    folder.mkdir()
    old = source.splitlines()[line - 1]
    last = old.split('"')[5]
    assert source.count(f'"{last}"') == 1
    (folder / "spec.py").write_text(source.replace(f'"{last}"', f'"{last}{character}"'))
    says = (f"mine/spec.py:{line}: model crane: a text of {name} holds the control character",)
    refused("derive", "./mine", says=says)
