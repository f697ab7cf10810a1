"""Models of the user's own that are wrong: the message names the file and line, or what is wrong.

Each model is the Pendubot's specification with one passage replaced.
"""

from __future__ import annotations

import pytest
from pfaffian.derive.spec.library import find_model

SPEC = find_model("pendubot").spec_file


@pytest.fixture
def own(workspace):
    """Return a function that writes `own/spec.py`: the Pendubot's with one passage replaced.

    It returns the number of the line of that passage.
    """
    folder = workspace / "own"
    folder.mkdir()

    def write(right: str, wrong: str) -> int:
        text = SPEC.read_text(encoding="utf-8")
        assert text.count(right) == 1
        (folder / "spec.py").write_text(text.replace(right, wrong), encoding="utf-8")
        return text[: text.index(right)].count("\n") + 1

    return write


BROKEN = {
    "a mass in metres": (
        '_physical("m1", "kg",',
        '_physical("m1", "m",',
        "model pendubot: kinetic energy: ",
        "mend the units of the symbols in the two terms",
    ),
    "an energy that is a momentum": (
        "kinetic_energy=kinetic,",
        "kinetic_energy=kinetic * p.m1,",
        "kinetic energy has dimension",
        "but J is needed",
    ),
    "a lumped parameter in another unit": (
        '_lumped("theta4", "kg*m",',
        '_lumped("theta4", "kg*m^2",',
        "theta4 has dimension",
        "but kg*m^2 is needed",
    ),
    "an angle with a length": (
        "sp.sin(q1 + q2)",
        "sp.sin(q1 + p.l1)",
        "model pendubot: kinetic energy",
        "mend",
    ),
    "a symbol without a unit": (
        "potential_energy=potential,",
        "potential_energy=potential + sp.Symbol('wind'),",
        "the potential energy contains wind, which is declared nowhere",
        "declare it as a parameter or coordinate",
    ),
    "a kinetic energy at rest": (
        "kinetic_energy=kinetic,",
        "kinetic_energy=kinetic + p.theta4 * p.g,",
        "the kinetic energy is not a quadratic form of the velocities",
        "m v^2/2",
    ),
    "a lumping that does not span": (
        "            (p.theta5, p.m2 * p.lc2),\n        ),\n"
        "        eliminated=(p.I1, p.I2, p.lc1, p.lc2,",
        "        ),\n        eliminated=(p.I1, p.I2, p.lc1,",
        "still depends on lc2, m2 after lumping",
        "add a lumped parameter",
    ),
    "an actuator without a constraint": (
        'actuators=(Actuator("tau", "N*m", "motor torque on link 1"),),',
        'actuators=(Actuator("tau", "N*m", ""), Actuator("tau2", "N*m", "")),',
        "own/spec.py:{line}: model pendubot: 1 servo-constraints (s) for 2 actuators",
        "give one constraint for each actuator",
    ),
    "a force on three joints": (
        "Matrix([_uncertain_force(p, 1, dq1),",
        "Matrix([0, _uncertain_force(p, 1, dq1),",
        "own/spec.py: uncertain_force has shape (3, 1), but (2, 1) is needed",
        "mend it",
    ),
    "a symbol too many": (
        "residual_symbols=(s,),",
        "residual_symbols=(s, s),",
        "own/spec.py:{residual}: model pendubot: 2 servo-constraints (s, s) for 1 actuators",
        "give one constraint for each actuator",
    ),
    "a constraint that contains an acceleration": (
        "(dq2 + p.lam2 * e2)",
        "(dq2 + coordinates[0].acceleration + p.lam2 * e2)",
        "own/spec.py:{line}: model pendubot: the servo-constraint s contains the acceleration ddq1",
        "give it as a second-order constraint",
    ),
    "a constraint on positions alone": (
        "p.lam * (dq1 + p.lam1 * e1) + (dq2 + p.lam2 * e2)",
        "p.lam * p.lam1 * e1 + p.lam2 * e2",
        "own/spec.py:{line}: model pendubot: the servo-constraint s does not depend on the "
        "velocities: its row of A is zero",
        "a constraint on positions is holonomic: give it as such",
    ),
    "a constraint out of reach": (
        "Matrix([1, 0])",
        "Matrix([0, 0])",
        "model pendubot: ADB is identically zero, the actuators do not move s",
        "choose a servo-constraint that the actuators reach",
    ),
    "a misspelt name": (
        "(p.theta5, p.m2 * p.lc2)",
        "(p.theta55, p.m2 * p.lc2)",
        "own/spec.py:{line}: AttributeError: ",
        "must define model() -> ModelSpec",
    ),
    "a division by zero": (
        "p = symbols_of(PARAMETERS)",
        "p = 1 / 0",
        "own/spec.py:{line}: ZeroDivisionError: division by zero",
        "must define model() -> ModelSpec",
    ),
    "a syntax error": (
        "def model() ->",
        "def model( ->",
        "own/spec.py:{line}: SyntaxError: ",
        "must define model() -> ModelSpec",
    ),
    "a module that is not installed": (
        "import sympy as sp",
        "import sympyy as sp",
        "own/spec.py:{line}: ModuleNotFoundError: No module named 'sympyy'",
        "must define model() -> ModelSpec",
    ),
    "no model()": (
        "def model() ->",
        "def modell() ->",
        "own/spec.py: ",
        "must define model() -> ModelSpec",
    ),
    "a model() that forgets to return": (
        "    return ModelSpec(\n",
        "    ModelSpec(\n",
        "own/spec.py: model() returned None",
        "must define model() -> ModelSpec",
    ),
    "a model that leaves": (
        "p = symbols_of(PARAMETERS)",
        "raise SystemExit(0)",
        "own/spec.py:{line}: SystemExit",
        "must define model() -> ModelSpec",
    ),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_model_is_refused_where_it_is_broken(what, own, refused):
    right, wrong, *says = BROKEN[what]
    line, lines = own(right, wrong), SPEC.read_text(encoding="utf-8").splitlines()
    residual = next(k for k, text in enumerate(lines, 1) if "residual=" in text)
    refused("derive", "own", says=tuple(s.format(line=line, residual=residual) for s in says))


def test_a_mended_model_works_at_once_and_leaves_no_bytecode(own, run, workspace):
    own('title="Pendubot"', 'title="Pendubot of mine"')
    assert run("derive", "own").out.startswith("Pendubot of mine\n")
    own('title="Pendubot"', 'title="Pendubot or mine"')  # same length, within the same second
    assert run("derive", "own").out.startswith("Pendubot or mine\n")
    assert [p.name for p in workspace.rglob("*")] == ["own", "spec.py"]


def test_a_model_folder_without_a_spec_or_without_sets_is_refused(workspace, own, refused):
    own('title="Pendubot"', 'title="Pendubot"')
    says = ("model own has no parameter set", "--params")
    refused("generate", "own", "-o", "made", says=says)
    refused("generate", "own", "--set", "sim", "-o", "made", says=says)
    (workspace / "empty").mkdir()
    refused("generate", "empty", says=("empty: holds no spec.py", "name the model's own folder"))
