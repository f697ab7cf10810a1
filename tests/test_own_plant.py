"""docs/own-plant.md, word for word: its files, its commands, its figures and its bad input."""

from __future__ import annotations

import re
import shlex

import pytest
from conftest import REPOSITORY

DOC = (REPOSITORY / "docs" / "own-plant.md").read_text(encoding="utf-8")
FILES = dict(
    re.findall(r"`([\w/]+\.(?:py|toml))`\n\n```(?:python|toml)\n(.*?)```", DOC, flags=re.DOTALL)
)
#: The files of the complete controller, which are written when there is a plan for them.
CONTROL = dict(re.findall(r"`([\w/]+\.toml)`, [^`]*:\n\n```toml\n(.*?)```", DOC, flags=re.DOTALL))
COMMANDS, FURTHER, WHOLE, OTHERS, SLIDE = (
    block.splitlines() for block in re.findall(r"```sh\n(.*?)```", DOC, flags=re.DOTALL)
)
#: What the document prints after each command that it names in brackets.
PRINTED = {
    " ".join(command.split()): text
    for command, text in re.findall(
        r"\(`(pfaffian[^`]+)`\):\n\n```\n(.*?)```", DOC, flags=re.DOTALL
    )
}
#: File, the lines that are changed, and the message, by what is wrong.
BAD = {
    what: (file, change.splitlines(), message)
    for what, file, change, message in re.findall(
        r"\n\n([A-Z][\w ]+), in `([\w.]+)`:\n\n```diff\n(.*?)```\n\n```console\n(.*?)```",
        DOC,
        flags=re.DOTALL,
    )
}


@pytest.fixture
def plant(workspace):
    """Write the document's files into an empty folder and go there."""
    for name, text in FILES.items():
        path = workspace / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return workspace


def _command(line: str) -> list[str]:
    first, *arguments = shlex.split(line)
    assert first == "pfaffian"
    return arguments


def _flat(text: str) -> str:
    return " ".join(text.split())


def test_the_document_has_what_the_test_looks_for():
    ballbeam, carts = (f"{folder}/spec.py" for folder in ("ballbeam", "twocarts"))
    carts_set, slide, slide_set = "twocarts/lab.toml", "slide/spec.py", "slide/lab.toml"
    ball_set = "ballbeam/bench.toml"
    assert set(FILES) == {ballbeam, ball_set, "mine.toml", carts, carts_set, slide, slide_set}
    assert set(CONTROL) == {"ballbeam/control/bench.toml", "complete.toml"}
    assert [c.split()[1] for c in FURTHER] == ["template", "generate", "build", "pil", "plan"]
    assert [c.split()[1] for c in WHOLE] == ["generate", "build", "simulate", "pil"]
    assert [c.split()[1] for c in SLIDE] == ["derive", "generate"]
    assert [c.split()[1] for c in OTHERS] == ["generate", "verify"]
    assert [c.split()[1] for c in COMMANDS] == ["derive", "generate", "verify", "simulate"]
    assert len(FILES["ballbeam/spec.py"].splitlines()) <= 32
    assert len(PRINTED) == 5
    assert len(BAD) == 6


@pytest.mark.target
def test_the_commands_of_the_document_work_and_print_what_it_says(plant, run):
    assert _all_work(COMMANDS, run) == 3
    verified = run(*_command(COMMANDS[2]), "--json").document()
    assert verified["passed"]
    assert verified["samples"] == 300
    flown = run(*_command(COMMANDS[3]), "--json").document()
    assert set(flown["status"]) == {"OK"}
    assert flown["mae2_r"] < 1e-3
    assert flown["mae2_theta"] < 1e-4


def _all_work(commands, run):
    """Run the commands and look for what the document says they print; return how many say."""
    shown = 0
    for line in commands:
        done = run(*_command(line))
        assert done.code == 0, done.err
        said = _flat(re.sub(r"[^\x00-\x7f]", " ", done.out))
        for text in PRINTED.get(line, "").splitlines():
            assert _flat(text) in said
        shown += line in PRINTED
    return shown


@pytest.mark.target
def test_from_there_to_a_complete_controller_that_catches_the_ball_on_host_and_target(plant, run):
    assert run(*_command(COMMANDS[1])).code == 0
    assert _all_work(FURTHER, run) == 1
    assert run("template", "./ballbeam", "--json").document()["required"]
    for name, text in CONTROL.items():
        path = plant / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    assert _all_work(WHOLE, run) == 1
    flown = run(*_command(WHOLE[-1]), "--json").document()
    assert flown["differing_bits"] == 0
    assert flown["time_to_capture"] == pytest.approx(3.4, abs=0.4)
    assert flown["mae2_r"] < 0.01
    assert flown["saturated_share"] == 0


def test_a_slide_of_twenty_tons_with_friction_of_its_own_is_generated(plant, run, refused):
    assert _all_work(SLIDE, run) == 0
    spec = plant / "slide" / "spec.py"
    text = spec.read_text(encoding="utf-8").replace(
        '"made up here")', '"made up here", domain=LABORATORY)'
    )
    needed = "from pfaffian.derive.spec.standard_parameters import LABORATORY\n"
    spec.write_text(needed + text, encoding="utf-8")
    says = ("slide/lab.toml: parameters.mass: mass = 20000 kg is out of bounds",)
    refused("generate", "./slide", "-o", "bounded", says=says)


@pytest.mark.target
def test_the_carts_with_constraints_of_other_orders_are_generated_and_verified(plant, run):
    for line in OTHERS:
        done = run(*_command(line))
        assert done.code == 0, done.err
    assert run(*_command(OTHERS[1]), "--json").document()["passed"]
    assert "double time;" in (plant / "carts" / "c" / "twocarts.h").read_text(encoding="utf-8")


def test_carts_that_cannot_rest_at_their_setpoint_are_refused(plant, refused):
    path = plant / "twocarts" / "lab.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('yd = "50 cm"', 'yd = "40 cm"'), encoding="utf-8")
    says = (
        "twocarts/lab.toml: the servo-constraint does not rest at the setpoint: the right-hand",
        "side of s2's A q'' = b is 1.6 m/s^2 there",
        "mend the setpoint, or the constraint",
    )
    refused("generate", "./twocarts", "-o", "carts", says=says)


@pytest.mark.parametrize("what", BAD)
def test_bad_input_is_refused_as_the_document_says(what, plant, refused):
    file, change, message = BAD[what]
    old, new = (
        "\n".join(line[1:] for line in change if line.startswith(sign)) for sign in ("-", "+")
    )
    path = plant / "ballbeam" / file
    text = path.read_text(encoding="utf-8")
    assert text.count(f"{old}\n") == 1
    path.write_text(text.replace(old, new), encoding="utf-8")
    first, *remedy = message.strip().split("\n  ")
    first = _flat(first).removeprefix("error: ")
    said = refused("generate", "./ballbeam", "-o", "out", says=(f"ballbeam/{file}",))
    assert said.endswith(first)
    assert not (plant / "out").exists()
    assert remedy


#: Further slips in the user's file: what is replaced, by what, and parts of the message. `{line}`
#: is the line of what is replaced.
SLIPS = {
    "an energy that is no expression": (
        "potential_energy=ball * g * centre[1]",
        "potential_energy=[ball]",
        "ballbeam/spec.py:{line}: model ballbeam: the potential energy is [ball_mass], no SymPy",
    ),
    "a velocity in the potential energy": (
        "potential_energy=ball * g * centre[1]",
        "potential_energy=ball * dr**2",
        "ballbeam/spec.py:{line}: model ballbeam: the potential energy depends on the velocity dr",
    ),
    "a division by zero": (
        "potential_energy=ball * g * centre[1]",
        "potential_energy=ball * g * centre[1] / sp.S.Zero",
        "ballbeam/spec.py:{line}: model ballbeam: the potential energy is not finite",
    ),
    "a function without code": (
        "potential_energy=ball * g * centre[1]",
        "potential_energy=ball * g * r * sp.asinh(sp.sin(theta))",
        "ballbeam/spec.py:{line}: model ballbeam: the potential energy contains asinh(sin(theta))",
    ),
    "a name of the law": (
        '"ball_radius", "m"',
        '"kappa", "m"',
        "ballbeam/spec.py:{line}: model ballbeam: kappa is the name of the parameter "
        "kappa (radius of the ball) and of the law's own kappa",
    ),
    "a name of the generated code": (
        '"ball_radius", "m"',
        '"double", "m"',
        "ballbeam/spec.py:{line}: model ballbeam: double is a keyword of C or C++",
    ),
    "a unit that is none": (
        '"ball_radius", "m"',
        '"ball_radius", "metre per"',
        "ballbeam/spec.py:{line}: model ballbeam: ball_radius has the unit 'metre per'",
    ),
    "a coordinate without a domain": (
        '"position of the ball", bound=10',
        '"position of the ball", bound=0',
        "ballbeam/spec.py:{line}: model ballbeam: coordinate r has no domain",
    ),
    "an actuator on something else": (
        'on={"theta": 1}',
        'on={"thet": 1}',
        "ballbeam/spec.py:{line}: model ballbeam: actuator tau acts on thet",
    ),
}


@pytest.mark.parametrize("what", SLIPS)
def test_other_slips_name_the_line_too(what, plant, refused):
    right, wrong, says = SLIPS[what]
    text = FILES["ballbeam/spec.py"]
    assert text.count(right) == 1
    line = text[: text.index(right)].count("\n") + 1
    (plant / "ballbeam" / "spec.py").write_text(text.replace(right, wrong), encoding="utf-8")
    if wrong.startswith(('"kappa', '"double')):
        sets = plant / "ballbeam" / "bench.toml"
        name = wrong.split('"')[1]
        sets.write_text(sets.read_text().replace("ball_radius", name), encoding="utf-8")
    refused("generate", "./ballbeam", "-o", "out", says=(says.format(line=line),))


def test_velocities_that_only_appear_together_leave_the_mass_matrix_singular(plant, refused):
    text = FILES["ballbeam/spec.py"]
    start, end = text.index("kinetic_energy="), text.index("potential_energy=")
    together = "kinetic_energy=ball * (dr + radius * dtheta) ** 2 / 2,\n        "
    (plant / "ballbeam" / "spec.py").write_text(text[:start] + together + text[end:])
    line = text[:start].count("\n") + 1
    says = (f"ballbeam/spec.py:{line}: model ballbeam: M is singular",)
    refused("derive", "./ballbeam", says=says)
