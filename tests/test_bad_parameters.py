"""Parameter sets that cannot be: refused with what, where and what to do; no file appears."""

from __future__ import annotations

import pytest
from pfaffian.derive.spec.library import find_model

SIM = 'extends = "sim"\n'
RIG = 'extends = "rig"\n'
#: The paper's gains, written down for the rig.
PAPER_GAINS = '[gains]\nlam = 2.25\nlam1 = "0.55 1/s"\nlam2 = "0.7 1/s"\n'
POLES = f"{RIG}[gains]\nzero_dynamics_poles = "

#: What is wrong: the document, and what the message must say.
REFUSED = {
    "a syntax error": ("[gains\nlam = 1", "is not valid TOML", "line 1", "mend the line"),
    "a key twice": ('title = "a"\ntitle = "b"\n', "is not valid TOML", "line 2", "mend the line"),
    "an endless integer": (f"lam = {'9' * 5000}", "is not valid TOML", "mend the line"),
    "nesting without end": (f"lam = {'[' * 5000}{']' * 5000}", "nested too deeply", "one level"),
    "nothing at all": ("", "missing theta1, theta2, theta3", "add theta1", 'extends = "..."'),
    "one missing parameter": (
        '[parameters]\nm1 = "1 kg"\nm2 = "1 kg"\nl1 = "1 m"\nlc1 = "1 m"\nlc2 = "1 m"\n'
        'I1 = "1 kg*m^2"\ng = "9.8 m/s^2"\n',
        "missing I2",
        "add I2 (moment of inertia of link 2 about its centre of mass) in kg*m^2",
    ),
    "missing gains": (
        '[parameters]\ntheta1 = "1 kg*m^2"\ntheta2 = "1 kg*m^2"\ntheta3 = "0.1 kg*m^2"\n'
        'theta4 = "1 kg*m"\ntheta5 = "1 kg*m"\ng = "9.8 m/s^2"\n',
        "missing sigma, eta",
        "add sigma (decay rate of the servo-constraint, (2)) in 1/s",
    ),
    "a parameter too many": (
        f'{SIM}[parameters]\ntheta6 = "1 kg"\n',
        "unknown key parameters.theta6",
        "did you mean theta",
        "known: m1, m2",
    ),
    "a misspelt gain": (
        f'{SIM}[gains]\nkapa = "1 1/s"\n',
        "unknown key gains.kapa",
        "did you mean kappa?",
    ),
    "a gain among the parameters": (
        f'{SIM}[parameters]\nlam1 = "1 1/s"\n',
        "unknown key parameters.lam1",
        "known: m1",
    ),
    "a table too many": (
        f"{SIM}[parametrs]\nm1 = 1\n",
        "unknown key parametrs",
        "did you mean parameters?",
    ),
    "a number for a table": (f"{SIM}gains = 3\n", "gains must be a table", "write [gains]"),
    "a number for the title": (f"{SIM}title = 3\n", "title must be a string", 'write title = "'),
    "a list of bases": ('extends = ["sim"]', "extends must be a string", 'write extends = "'),
    "a bare number": (
        f"{SIM}[parameters]\nm1 = 0.09\n",
        "parameters.m1: 0.09 has no unit",
        "converts to kg, for instance",
    ),
    "a unit where there is none": (
        f'{SIM}[gains]\nlam = "2.25 kg"\n',
        "gains.lam: kg has dimension [mass]",
        "give a plain number, for instance 2.5",
    ),
    "the paper's unit of g": (
        f'{SIM}[parameters]\ng = "9.8 kg/m^2"\n',
        "parameters.g: kg/m^2 has dimension [mass] / [length] ** 2",
        "but m/s^2 ([length] / [time] ** 2) is needed",
        'for instance "1.0 m/s^2"',
    ),
    "the paper's unit of theta4": (
        f'{RIG}[parameters]\ntheta4 = "0.0679 kg*m^2"\n',
        "parameters.theta4: kg*m^2 has dimension [mass] * [length] ** 2",
        "but kg*m ([mass] * [length]) is needed",
        'for instance "1.0 kg*m"',
    ),
    "the paper's unit of theta5": (
        f'{RIG}[parameters]\ntheta5 = "0.0332 kg*m^2"\n',
        "parameters.theta5: kg*m^2 has dimension",
        "but kg*m (",
        'for instance "1.0 kg*m"',
    ),
    "a unit nobody knows": (
        f'{SIM}[parameters]\nm1 = "0.09 klg"\n',
        "parameters.m1: unknown unit 'klg'",
        "converts to kg",
    ),
    "a unit that would compute for ever": (
        f'{SIM}[parameters]\nm1 = "1 kg**9**9**9**9"\n',
        "parameters.m1: unknown unit",
        "converts to kg",
    ),
    "decibels of mass": (
        f'{SIM}[parameters]\nm1 = "1 dB*kg"\n',
        "parameters.m1: 'dB*kg' does not convert to kg",
        "converts to kg",
    ),
    "text for a number": (
        f'{SIM}[parameters]\nm1 = "heavy"\n',
        "parameters.m1: 'heavy' is not a number with a unit",
        "converts to kg",
    ),
    "a truth value": (f"{SIM}[gains]\nlam = true\n", "gains.lam: True is not a quantity", "give a"),
    "not a number": (f"{SIM}[gains]\nlam = nan\n", "gains.lam: nan is not finite", "give a finite"),
    "infinity": (f'{SIM}[parameters]\nm1 = "1e999 kg"\n', "m1: inf is not finite", "give a finite"),
    "an integer of endless digits": (
        f"{SIM}[parameters]\nm1 = 0x{'f' * 5000}\n",
        "parameters.m1: a number of thousands of digits has no unit",
        "converts to kg",
    ),
    "a tower of tables": (
        f"{SIM}[parameters]\nm1{'.a' * 900} = 1\n",
        "parameters.m1: {'a': {'a': ",
        "is not a quantity",
        "converts to kg",
    ),
    "an integer beyond floats": (
        f"{SIM}[gains]\nlam = {10**400}\n",
        "gains.lam: inf is not finite",
        "give a finite number",
    ),
    "a mass of zero": (
        f'{SIM}[parameters]\nm1 = "0 kg"\n',
        "parameters.m1: m1 = 0 kg is out of bounds (mass of link 1)",
        "greater than 0 and at most 1000 kg",
    ),
    "a negative mass": (
        f'{SIM}[parameters]\nm2 = "-1 g"\n',
        "parameters.m2: m2 = -0.001 kg is out of bounds (mass of link 2)",
        "greater than 0",
    ),
    "masses whose lumped parameters the code would refuse": (
        f'{SIM}[parameters]\nm1 = "1000 kg"\nlc1 = "50 m"\n',
        "theta1 = 2.5e+06 kg*m^2 is out of bounds",
        "at most 10000 kg*m^2",
    ),
    "inertias of no mechanism": (
        f'{RIG}[parameters]\ntheta3 = "0.0073 kg*m^2"\n',
        "the mass matrix is not positive definite at q2 = 0 rad: minor2 = -1.45e-06",
        "theta1 = 0.0096, theta2 = 0.0054, theta3 = 0.0073",
        "check the inertias",
    ),
    "a setpoint that falls over": (
        f'{SIM}[gains]\nq1d = "1 rad"\n',
        "the setpoint is not an equilibrium: gravity leaves 0.309 N*m on q2",
        "choose a setpoint where the unactuated joints are in balance",
    ),
    "a setpoint inside the singular set": (
        f'{SIM}[target]\nsingular_threshold = "100 1/(kg*m^2)"\n',
        "the setpoint lies in the singular set: |ADB| = 69.95 there",
        "below target.singular_threshold = 100",
        "lower the threshold",
    ),
    "two poles of three": (f"{POLES}[-5, -5]", "2 poles for zero dynamics of order 3", "give 3"),
    "an unstable pole": (
        f"{POLES}[-5, -5, 0.5]",
        "gains.zero_dynamics_poles: 0.5",
        "negative real",
    ),
    "half a pair of poles": (
        f'{POLES}[-5, "-5+2j", "-5-1j"]',
        "zero_dynamics_poles: complex poles must come in conjugate pairs",
        "add the conjugate",
    ),
    "a word for a pole": (f'{POLES}["fast", -5, -5]', "'fast' is not a finite pole", "[-6, "),
    "a pole at infinity": (f"{POLES}[-inf, -5, -5]", "-inf is not a finite pole", "[-6, "),
    "no list of poles": (f"{POLES}-5", "zero_dynamics_poles: must be a list of poles", "[-6, "),
    "poles and gains": (
        f"{POLES}[-5, -5, -5]\nlam = 1.5\n",
        "gains.zero_dynamics_poles and lam are both given",
        "not both",
    ),
    "two forms of the plant": (
        f'{SIM}[parameters]\ntheta2 = "0.01 kg*m^2"\nm1 = "1 kg"\n',
        "m1 (physical) and theta2 (lumped) are both given",
        "all physical or all lumped",
    ),
    "half of the other form": (
        f'{RIG}[parameters]\nm1 = "1 kg"\n',
        "missing m2, l1, lc1, lc2, I1, I2",
        "add m2 (mass of link 2) in kg",
    ),
    "an unknown base": ('extends = "sym"', "extends names no parameter set: sym", "mean sim?"),
    "gains with unstable zero dynamics": (
        f"{RIG}{PAPER_GAINS}",
        "the zero dynamics are unstable with lam = 2.25, lam1 = 0.55, lam2 = 0.7: poles",
        "14.04+0j 1/s; violated: 1 + theta3/theta2 > lam (off by 0.3981)",
        'for poles at -6 take lam = 1.5468, lam1 = "5.70422 1/s", lam2 = "7.72968 1/s"',
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_parameter_set_is_refused_with_what_where_and_what_to_do(what, params, refused):
    text, *says = REFUSED[what]
    file = params(text)
    refused("generate", "pendubot", "--params", file, "-o", "made", says=("mine.toml: ", *says))


def test_every_violated_bound_of_unstable_zero_dynamics_is_named(params, refused):
    file = params(f'{SIM}[gains]\nlam = 2.0\nlam1 = "0.2 1/s"\nlam2 = "0.7 1/s"\n')
    message = refused(
        "generate", "pendubot", "--params", file, says=("lam lam1/lam2 > 1", "for poles at -6")
    )
    assert "theta3/theta2" not in message  # this bound holds for sim, and must not be blamed


def test_the_proposed_gains_work_as_they_are_printed(params, refused, run):
    file = params(f"{RIG}{PAPER_GAINS}")
    refused("generate", "pendubot", "--params", file, says=("unstable",))
    remedy = run("generate", "pendubot", "--params", file, "--json").document()["error"]["remedy"]
    proposal = remedy.removeprefix("for poles at -6 take ").split(", or give ")[0]
    file = params(f"{RIG}[gains]\n" + proposal.replace(", ", "\n"))
    done = run("generate", "pendubot", "--params", file, "-o", "made")
    assert done.code == 0, done.err


def test_a_circle_of_bases_is_refused_and_shown(workspace, refused):
    source = find_model("pendubot")
    folder = workspace / "own"
    folder.mkdir()
    (folder / "spec.py").write_bytes(source.spec_file.read_bytes())
    (folder / "egg.toml").write_text('extends = "hen"\n')
    (folder / "hen.toml").write_text('extends = "egg"\n')
    message = refused(
        "generate", "own", "--set", "egg", says=("extends itself", "break the circle")
    )
    assert message.endswith(f"{folder}/egg.toml -> {folder}/hen.toml -> {folder}/egg.toml)")


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda p: p.write_bytes(b"title = '\xff\xfe\x00'"), ("is not UTF-8", "save it as UTF-8")),
        (lambda p: p.mkdir(), ("cannot be read (Is a directory)", "check the path")),
        (lambda p: None, ("cannot be read (No such file", "check the path")),
        (lambda p: p.symlink_to(p), ("cannot be read (Too many levels", "check the path")),
    ],
    ids=["binary", "a folder", "no such file", "a link to itself"],
)
def test_a_parameter_file_that_cannot_be_read_is_named(make, says, workspace, refused):
    make(workspace / "odd.toml")
    arguments = ("generate", "pendubot", "--params", "odd.toml", "-o", "made")
    refused(*arguments, says=("odd.toml: ", *says))
