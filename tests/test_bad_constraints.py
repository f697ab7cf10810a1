"""Servo-constraints that are wrong, in a user's file: the message names its line, and what is."""

from __future__ import annotations

import pytest

PLANT = """import sympy as sp
from pfaffian.derive.authoring import ModelBuilder
from pfaffian.derive.spec import TIME


def model():
    m = ModelBuilder("masses", title="Three masses", source="made up for this test")
    x, dx = m.coordinate("x", "m", "first mass", bound=10, rate_bound=10)
    y, dy = m.coordinate("y", "m", "second mass", bound=10, rate_bound=10)
    z, dz = m.coordinate("z", "m", "third mass", bound=10, rate_bound=10)
    ddx, ddy, ddz = (m.acceleration(q) for q in (x, y, z))
    mass = m.parameter("mass", "kg", "each mass")
    spring = m.parameter("spring", "N/m", "between second and third")
    r = m.gain("rate_of_error", "1/s", "rate of the errors")
    m.actuator("force1", "N", "on the first", on={"x": 1})
    m.actuator("force2", "N", "on the second", on={"y": 1, "x": -1})
    FIRST
    SECOND
    return m.build(
        kinetic_energy=mass * (dx**2 + dy**2 + dz**2) / 2,
        potential_energy=spring * (y - z) ** 2 / 2,
    )
"""
FIRST = 'm.first_order("s1", "m/s", dx + r * x)'
SECOND = 'm.first_order("s2", "m/s", dy + r * y)'
#: The second constraint, or what stands in its place, and parts of the message.
WRONG = {
    "the same once more": (
        'm.first_order("s2", "m/s", dx + r * x)',
        "model masses: the servo-constraint s2 is redundant: it follows from s1",
        "leave it out",
    ),
    "twice the same": (
        'm.first_order("s2", "m/s", 2 * dx + 2 * r * x)',
        "model masses: the servo-constraint s2 is redundant: it follows from s1",
        "leave it out",
    ),
    "the same by a factor that moves": (
        'm.first_order("s2", "m/s", sp.cos(y / x) * (dx + r * x))',
        "model masses: the servo-constraint s2 is redundant: it follows from s1",
        "leave it out",
    ),
    "the same as one of second order": (
        'm.second_order("s2", "m/s^2", ddx + r * dx)',
        "model masses: the servo-constraint s2 is inconsistent with s1",
        "leave it out",
    ),
    "another rate of the same": (
        'm.first_order("s2", "m/s", dx + 2 * r * x)',
        "model masses: the servo-constraint s2 is inconsistent with s1: it wants other "
        "accelerations of the same combination of coordinates",
        "leave it out",
    ),
    "a mass that no actuator moves": (
        'm.first_order("s2", "m/s", dz + r * z)',
        "model masses: ADB is identically zero, the actuators do not move s: no actuator moves s2",
        "differentiate it once more",
    ),
    "masses that move together": (
        'm.first_order("s2", "m/s", dx + dz + r * (x + z))',
        "model masses: ADB is singular everywhere: the actuators move s1, s2 only together",
        "choose servo-constraints that the actuators move apart",
    ),
    "one too many": (
        'm.first_order("s3", "m/s", dz + r * z)',
        "model masses: 3 servo-constraints (s1, s2, s3) for 2 actuators",
        "give one constraint for each actuator",
    ),
    "no velocity": (
        'm.first_order("s2", "m", y)',
        "model masses: the servo-constraint s2 does not depend on the velocities",
        "a constraint on positions is holonomic",
    ),
    "the time alone": (
        'm.holonomic("s2", "", sp.sin(r * TIME), r)',
        "model masses: the servo-constraint s2 does not depend on the velocities",
        "write it in the coordinates and their velocities",
    ),
    "an acceleration in a constraint of first order": (
        'm.first_order("s2", "m/s", dy + ddy / r)',
        "model masses: the servo-constraint s2 contains the acceleration ddy",
        "give it as a second-order constraint",
    ),
    "a velocity in a holonomic one": (
        'm.holonomic("s2", "m", y + dy / r, r)',
        "a holonomic constraint depends on the velocity dy",
        "give it as a first-order constraint",
    ),
    "an acceleration in a holonomic one": (
        'm.holonomic("s2", "m", y + ddy / r**2, r)',
        "a holonomic constraint depends on the acceleration ddy",
        "give it as a second-order constraint",
    ),
    "a squared acceleration": (
        'm.second_order("s2", "m^2/s^4", ddy**2 + r**4 * y**2)',
        "a second-order constraint is not affine in the acceleration of y",
        "write it as A(q, q', t) q'' - b(q, q', t)",
    ),
    "a product of accelerations": (
        'm.second_order("s2", "m^2/s^4", ddy * ddx + r**4 * y**2)',
        "a second-order constraint is not affine in the acceleration of",
        "write it as A(q, q', t) q'' - b(q, q', t)",
    ),
    "coefficients that are no gradient": (
        'm.second_order("s2", "m^2/s^3", dx * ddy + r**3 * y**2)',
        "the coefficients of the accelerations of y and x are no gradient in the velocities",
        "multiply the constraint by an integrating factor",
    ),
    "coefficients that grow beyond bounds at rest": (
        'm.second_order("s2", "1/s", ddy / dy + r)',
        "cannot be integrated over the velocities in closed form, from rest",
        "give the first-order constraint s(q, q', t) itself",
    ),
    "coefficients without an integral": (
        'm.second_order("s2", "m/s^2", ddy * sp.exp((dy / r / x) ** 2) + r * dy)',
        "cannot be integrated over the velocities in closed form, from rest",
        "give the first-order constraint s(q, q', t) itself",
    ),
    "a symbol without a declaration": (
        'm.first_order("s2", "m/s", dy + sp.Symbol("haste") * y)',
        "model masses: the servo-constraint s2 contains haste, which is declared nowhere",
        "declare it as a parameter or gain with its unit",
    ),
    "a symbol of one's own for a gain": (
        'm.first_order("s2", "m/s", dy + sp.Symbol("rate_of_error") * y)',
        "model masses: the servo-constraint s2 contains a second symbol rate_of_error",
        "use the symbols that the declarations return",
    ),
    "a length beside a velocity": (
        'm.first_order("s2", "m/s", dy + y)',
        "model masses: the servo-constraint s2: y has dimension [length], but dy has",
        "mend the units",
    ),
    "a unit that is not its own": (
        'm.first_order("s2", "rad/s", dy + r * y)',
        "model masses: the servo-constraint s2 has dimension [length] / [time], but rad/s is",
        "mend the unit",
    ),
    "an own drift in another unit": (
        'm.second_order("s2", "m/s^2", ddy + r * y)',
        "model masses: the servo-constraint s2 has dimension [length] / [time], but (m/s)/s is",
        "mend the unit",
    ),
    "no unit": (
        'm.first_order("s2", "m per", dy)',
        "model masses: the servo-constraint s2 has the unit 'm per'",
        "give a unit such as",
    ),
    "two of one name": (
        'm.first_order("s1", "m/s", dy + r * y)',
        "model masses: two servo-constraints are called s1",
        "rename one of them",
    ),
    "the name of a coordinate": (
        'm.first_order("y", "m/s", dy + r * y)',
        "model masses: y is the name of the coordinate y and of a servo-constraint",
        "rename one of them",
    ),
    "a list": (
        'm.first_order("s2", "m/s", [dy, r * y])',
        "model masses: the servo-constraint s2 is [dy, rate_of_error*y], no SymPy expression",
        "give each constraint by a call of its own",
    ),
    "a division by zero": (
        'm.first_order("s2", "m/s", dy / sp.S.Zero)',
        "model masses: the servo-constraint s2 is not finite",
        "look for a division by zero",
    ),
    "friction that is no power": (
        'm.friction(dy**2, mass)',
        "model masses: friction along dy**2, which is not linear in the velocities",
        "put the law into the force",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_constraint_is_refused_at_its_line(what, workspace, refused):
    wrong, *says = WRONG[what]
    second = f"{SECOND}\n    {wrong}" if '"s3"' in wrong else wrong
    text = PLANT.replace("FIRST", FIRST).replace("SECOND", second)
    (workspace / "masses").mkdir()
    (workspace / "masses" / "spec.py").write_text(text, encoding="utf-8")
    line = text[: text.index(wrong)].count("\n") + 1
    refused("derive", "masses", says=(f"masses/spec.py:{line}: ", *says))


def test_friction_that_knows_the_time_is_refused(workspace, refused):
    """The plant is simulated without a clock: only the controller is told the time."""
    wrong = f"{SECOND}\n    m.friction(dy, mass * r**2 * sp.sin(r * TIME) * y)"
    text = PLANT.replace("FIRST", FIRST).replace("SECOND", wrong)
    (workspace / "masses").mkdir()
    (workspace / "masses" / "spec.py").write_text(text, encoding="utf-8")
    says = ("model masses: friction contains the time", "only servo-constraints and errors may")
    refused("derive", "masses", says=says)


def test_as_it_stands_the_plant_is_taken(workspace, run):
    text = PLANT.replace("FIRST", FIRST).replace("SECOND", SECOND)
    (workspace / "masses").mkdir()
    (workspace / "masses" / "spec.py").write_text(text, encoding="utf-8")
    done = run("derive", "masses")
    assert done.code == 0, done.err
    assert "NOT proved" not in done.out
