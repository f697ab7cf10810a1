"""Names and symbols that cannot be: what `pfaffian derive` says, and where; setpoints by name."""

from __future__ import annotations

import pytest
import sympy as sp
from pfaffian.derive.authoring import ModelBuilder
from pfaffian.derive.spec.library import ModelFolder
from pfaffian.runtime.base.errors import InputError

SPEC = """import sympy as sp
from sympy.physics.mechanics import dynamicsymbols
from pfaffian.derive.authoring import ModelBuilder
from pfaffian.derive.spec import TIME


def model():
    m = ModelBuilder("pair", title="two masses", source="made up here")
    x, dx = m.coordinate("x", "m", "first", bound=10, rate_bound=100)
    y, dy = m.coordinate("y", "m", "second", bound=10, rate_bound=100)
    mass = m.parameter("mass", "kg", "of each")
    k = m.parameter("k", "N/m", "spring")
    push = m.actuator("push", "N", "force", on={"x": 1})
    return m.build(
        kinetic_energy=mass * (dx**2 + dy**2) / 2,
        potential_energy=k * (x**2 + (y - x) ** 2) / 2,
    )
"""
#: What is replaced, by what, at which line the message is, and what it says.
CASES = {
    "a parameter called time": ('m.parameter("mass"', 'm.parameter("time"', 11, "time is the time"),
    "the time in an energy": (
        "k * (x**2",
        "k * ((x - sp.sin(TIME)) ** 2",
        16,
        "the potential energy contains the time: energies may not vary with it",
    ),
    "a function left of dynamicsymbols": (
        "k * (x**2",
        "k * (dynamicsymbols('x')**2",
        16,
        "the potential energy contains x(t), a function of SymPy's such as dynamicsymbols makes",
    ),
    "a symbol of one's own for a coordinate": (
        "mass * (dx**2",
        "mass * (sp.Symbol('dx')**2",
        15,
        "the kinetic energy contains a second symbol dx, made apart from the one that is declared",
    ),
    "a symbol that nothing declares": (
        "k * (x**2",
        "sp.Symbol('r') * (x**2",
        16,
        "the potential energy contains r, which is declared nowhere",
    ),
    "an acceleration in an energy": (
        "mass * (dx**2",
        "mass * (m.acceleration(x)**2",
        15,
        "the kinetic energy contains the acceleration ddx",
    ),
    "a coordinate called as the rate of another": (
        'm.coordinate("y"',
        'm.coordinate("dx"',
        9,
        "dx is the name of the coordinate dx and of the rate of the coordinate x",
    ),
    "a parameter called as an acceleration": (
        'm.parameter("k"',
        'm.parameter("ddx"',
        12,
        "ddx is the name of the acceleration of the coordinate x and of the parameter ddx (spring)",
    ),
    "a parameter called as a setpoint": (
        'm.parameter("k"',
        'm.parameter("yd"',
        12,
        "yd is the name of the parameter yd (spring) and of the setpoint of y",
    ),
    "a gain of every law": (
        'm.parameter("k"',
        'm.parameter("sigma"',
        12,
        "sigma is the name of the parameter sigma (spring) and of the law's own sigma (decay rate",
    ),
    "two of one name": (
        'm.parameter("k"',
        'm.parameter("mass"',
        11,
        "mass is the name of the parameter mass (of each) and of the parameter mass (spring)",
    ),
    "an actuator called as a coordinate": (
        'm.actuator("push"',
        'm.actuator("x"',
        9,
        "x is the name of the coordinate x and of the actuator x",
    ),
    "a macro by keyword": (
        'm.parameter("k", "N/m"',
        'm.parameter(unit="N/m", name="linux"',
        12,
        "linux is a macro that compilers define for some target",
    ),
    "a member of the controller": (
        'm.actuator("push"',
        'm.actuator("mode"',
        13,
        "mode is a name of the complete controller",
    ),
    "a model called as a header": (
        'ModelBuilder("pair"',
        'ModelBuilder("math"',
        None,
        "math is a header of C, which the model's own would hide",
    ),
}


@pytest.mark.parametrize("what", CASES)
def test_derive_refuses_it_at_its_line(what, workspace, refused):
    right, wrong, line, says = CASES[what]
    assert SPEC.count(right) == 1
    text = SPEC.replace(right, wrong)
    if "name=" in wrong:
        text = text.replace('name="linux", "spring"', 'name="linux", description="spring"')
    (workspace / "pair").mkdir()
    (workspace / "pair" / "spec.py").write_text(text, encoding="utf-8")
    where = "pair/spec.py" + (f":{line}: model" if line else "")
    refused("derive", "./pair", says=(where, says))


@pytest.mark.parametrize("name", ["s", "b", "p1"])
def test_a_coordinate_called_as_a_signal_of_the_law_is_one_like_any_other(name, workspace):
    (workspace / "spec.py").write_text(SPEC.replace('"y"', f'"{name}"'), encoding="utf-8")
    spec = ModelFolder("pair", workspace).load()
    assert [c.name for c in spec.coordinates] == ["x", name]
    wanted = "s_law" if name == "s" else "s"
    assert [s.name for s in spec.constraint.residual_symbols] == [wanted]


def builder():
    m = ModelBuilder("held", title="t", source="t")
    z, dz = m.coordinate("z", "m", "height", bound=10, rate_bound=100)
    mass, rate = m.parameter("mass", "kg", "mass"), m.gain("pace", "1/s", "of the error")
    m.actuator("lift", "N", "force", on={"z": 1})
    return m, z, dz, mass, rate


def test_the_setpoint_is_had_by_a_call_and_by_hand_alike():
    specs = []
    for by_hand in (False, True):
        m, z, dz, mass, rate = builder()
        goal = sp.Symbol("zd", real=True) if by_hand else m.setpoint(z)
        m.first_order("height", "m/s", dz + rate * (z - goal))
        specs.append(m.build(kinetic_energy=mass * dz**2 / 2, potential_energy=0 * z))
    assert specs[0] == specs[1]
    assert sp.Symbol("zd", real=True) in specs[0].constraint.residual.free_symbols


def test_the_setpoint_of_what_is_no_coordinate_is_refused():
    m, *_ = builder()
    with pytest.raises(InputError, match="y is not a coordinate"):
        m.setpoint(sp.Symbol("y", real=True))
