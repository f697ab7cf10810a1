"""Functions in energies, constraints and friction: right values, right units, refusals at the line.

Lowered expressions are held against mpmath at 60 digits, closed linkages and springs of finite
length against mechanics that shares nothing with the derivation.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mpmath
import mujoco
import numpy as np
import pytest
import sympy as sp
from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.emit.precision import DOUBLE, SINGLE
from pfaffian.derive.generation import generate
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.evaluate_arrays import evaluate_at
from pfaffian.derive.ir.intervals import enclose
from pfaffian.derive.ir.program import Program, Signal
from pfaffian.derive.lower.to_program import lower
from pfaffian.derive.pipeline import (
    derivation_of,
    jacobian_programs,
    library_sets,
    lowered_model,
    single_elementary,
)
from pfaffian.derive.sets.swing_up_limit import enclosed
from pfaffian.derive.symbolic.block import Block, Definition
from pfaffian.derive.symbolic.supported import first_unsupported
from pfaffian.derive.symbolic.units import dimension_of
from pfaffian.derive.verify.compare import verify
from pfaffian.derive.verify.sampling import draw
from pfaffian.derive.verify.subjects import CompiledUnderTest, PythonUnderTest
from pfaffian.derive.writer import write_generation
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.generated_model import (
    fill_records,
    generated_models,
    host_model,
    open_generated,
)
from support_elementary import BASE_FLAGS, WARNINGS, run
from support_plants import spec_text, written_plant

X, Y = sp.symbols("x y", real=True)
HALF = sp.Rational(1, 2)
#: The batch form says x == x where it asks for a NaN.
STRICT = tuple(w for w in WARNINGS if w != "-Wfloat-equal")
EITHER, POSITIVE, UNIT = (-3.0, 3.0), (0.01, 9.0), (-0.999, 0.999)

#: What may be written, and between what ends its arguments lie.
EXPRESSIONS = {
    "x^(1/2)": (sp.sqrt(X), POSITIVE),
    "x^(3/2)": (X ** (3 * HALF), POSITIVE),
    "x^(5/2)": (X ** (5 * HALF), POSITIVE),
    "x^(-1/2)": (X**-HALF, POSITIVE),
    "x^(-3/2)": (X ** (-3 * HALF), POSITIVE),
    "x^(3/4)": (X ** sp.Rational(3, 4), POSITIVE),
    "x^(-7/8)": (X ** sp.Rational(-7, 8), POSITIVE),
    "a number's cube root": (X * sp.cbrt(2), EITHER),
    "the length of a spring": (sp.sqrt(X**2 + Y**2), EITHER),
    "tan": (sp.tan(X), EITHER),
    "cot": (sp.cot(X), POSITIVE),
    "sec": (sp.sec(X), EITHER),
    "csc": (sp.csc(X), POSITIVE),
    "asin": (sp.asin(X), UNIT),
    "acos": (sp.acos(X), UNIT),
    "acot": (sp.acot(X), POSITIVE),
    "atan2": (sp.atan2(Y, X), EITHER),
    "sinh": (sp.sinh(X), EITHER),
    "cosh": (sp.cosh(X), EITHER),
    "coth": (sp.coth(X), POSITIVE),
    "sech": (sp.sech(X), EITHER),
    "csch": (sp.csch(X), POSITIVE),
    "log": (sp.log(X), POSITIVE),
    "log to base 10": (sp.log(X, 10), POSITIVE),
    "Abs": (sp.Abs(X) * X, EITHER),
    "Max": (sp.Max(0, X - Y) ** 2, EITHER),
    "Min": (sp.Min(X, Y, 1), EITHER),
    "the slope of Max": (sp.Max(0, X - Y).diff(X), EITHER),
    "Heaviside": (sp.Heaviside(X) * X, EITHER),
    "Piecewise": (sp.Piecewise((X**2, X > Y), (Y, sp.Eq(X, Y)), (-X, True)), EITHER),
    "not": (sp.Piecewise((X, sp.Not(sp.Or(X > 1, Y < 0))), (Y, sp.Ne(X, 2)), (0, True)), EITHER),
    "sinc": (sp.sinc(X), POSITIVE),
}


def program_of(expression: sp.Expr) -> Program:
    inputs = tuple(Signal(s.name, "", "", "input") for s in (X, Y))
    value = sp.Symbol("value", real=True)
    return lower(
        Block(
            "f",
            "f",
            inputs,
            (X, Y),
            (Definition(value, expression, "value", ""),),
            (Signal("value", "", "", "output"),),
            (value,),
        )
    )


def points(ends: tuple[float, float], count: int = 60) -> np.ndarray[Any, Any]:
    return np.random.default_rng(4).uniform(*ends, (count, 2))


@pytest.mark.parametrize("what", EXPRESSIONS)
def test_what_is_lowered_has_the_right_value(what: str) -> None:
    """Within a few units in the last place of mpmath's value at 60 digits, by plain floats."""
    expression, ends = EXPRESSIONS[what]
    assert first_unsupported(expression) is None
    program = program_of(expression)
    exact = sp.lambdify((X, Y), expression, "mpmath")
    for x, y in points(ends).tolist():
        with mpmath.workdps(60):
            wanted = exact(mpmath.mpf(x), mpmath.mpf(y))
            reach = sum(abs(mpmath.diff(exact, (x, y), n)) for n in ((1, 0), (0, 1))) * 1e-16
            error = abs(evaluate(program, {"x": x, "y": y})["value"] - wanted)
        assert error <= 8 * 2.0**-53 * abs(wanted) + 4 * reach, (x, y)


@pytest.mark.parametrize("what", EXPRESSIONS)
def test_enclosures_hold_what_is_lowered(what: str) -> None:
    """Certificate and swing-up bound every function over boxes: no point lies outside."""
    expression, ends = EXPRESSIONS[what]
    program = program_of(expression)
    rng = np.random.default_rng(6)
    for low in rng.uniform(ends[0], ends[1] * 0.8, (10, 2)):
        high = np.minimum(low + 0.3, ends[1])
        box = {n: (np.asarray(a), np.asarray(b)) for n, a, b in zip("xy", low, high, strict=True)}
        bottom, top = enclose(program, box)["value"]
        plain = enclosed(program, {n: (float(a), float(b)) for n, (a, b) in box.items()})
        inside = rng.uniform(low, high, (30, 2)).T
        values = evaluate_at(program, {"x": inside[0], "y": inside[1]})["value"]
        assert np.all((bottom <= values) & (values <= top))
        assert np.all((plain[0] <= values) & (values <= plain[1]))


def test_what_leaves_its_domain_is_no_number() -> None:
    for expression in (sp.sqrt(X), X ** (3 * HALF), sp.log(X), sp.asin(X - 1), sp.acos(X - 1)):
        assert math.isnan(evaluate(program_of(expression), {"x": -2.0, "y": 0.0})["value"])
    assert evaluate(program_of(sp.log(X)), {"x": 0.0, "y": 0.0})["value"] == -math.inf
    assert evaluate(program_of(sp.cosh(X)), {"x": -800.0, "y": 0.0})["value"] == math.inf


UNITS = {"l": "m", "a": "m^2", "m": "kg", "k": "N/m", "phi": "rad"}
L, AREA, MASS, K, PHI = sp.symbols("l a m k phi", real=True)
DIMENSIONS = {
    "a root": (sp.sqrt(AREA), "m"),
    "a length to 3/2": (AREA ** (3 * HALF), "m^3"),
    "the length of a spring": (K * (sp.sqrt(L**2 + AREA) - L) ** 2, "J"),
    "Max with zero": (K * sp.Max(0, L) ** 2, "J"),
    "Min": (sp.Min(L, sp.sqrt(AREA)), "m"),
    "Abs": (sp.Abs(L) * L, "m^2"),
    "log of a ratio": (K * AREA * sp.log(L / sp.sqrt(AREA)), "J"),
    "atan2 of lengths": (sp.atan2(L, sp.sqrt(AREA)), "rad"),
    "sign of a length": (sp.sign(L) * MASS, "kg"),
    "Heaviside of a length": (sp.Heaviside(L) * MASS, "kg"),
    "Piecewise": (sp.Piecewise((0, sp.sqrt(AREA) < L), (K * L**2, L > 0), (K * AREA, True)), "J"),
}
UNLIKE = {
    "log of a length": (sp.log(L), "argument of log in log(l) is not dimensionless"),
    "asin of a length": (sp.asin(L), "argument of asin in asin(l) is not dimensionless"),
    "Max of unlike": (sp.Max(L, AREA), "has dimension"),
    "atan2 of unlike": (sp.atan2(L, AREA), "in atan2(l, a), a has dimension [length] ** 2"),
    "branches of unlike": (sp.Piecewise((L, L > 0), (AREA, True)), "has dimension"),
    "a condition of unlike": (sp.Piecewise((L, L > AREA), (2 * L, True)), "has dimension"),
    "an exponent with a unit": (sp.Pow(2, L), "is not dimensionless"),
}


@pytest.mark.parametrize("what", DIMENSIONS)
def test_units_follow_roots_and_choices(what: str) -> None:
    from pfaffian.runtime.base.quantity import unit_registry

    expression, unit = DIMENSIONS[what]
    wanted = unit_registry().parse_units(unit).dimensionality
    assert dimension_of(expression, UNITS, "here") == wanted


@pytest.mark.parametrize("what", UNLIKE)
def test_unlike_units_are_refused(what: str) -> None:
    expression, says = UNLIKE[what]
    with pytest.raises(InputError) as caught:
        dimension_of(expression, UNITS, "here")
    assert "here" in str(caught.value)
    assert says in str(caught.value)


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return a function that generates and loads a plant of `support_plants`, each once."""
    known: dict[str, Any] = {}

    def of(name: str) -> Any:
        if name not in known:
            folder = tmp_path_factory.mktemp(name)
            source = written_plant(folder / name, name)
            model = lowered_model(source)
            written_code(Emission(model, library_sets(model, source)), folder / "out")
            known[name] = SimpleNamespace(
                source=source,
                model=model,
                folder=folder / "out",
                code=host_model(open_generated(str(folder / "out"))),
            )
        return known[name]

    return of


def written_code(emission: Emission, folder: Path) -> None:
    write_generation(generate(emission), folder)


def accelerations(
    code: Any, values: dict[str, float], params: Any, names: list[str]
) -> list[float]:
    state, applied, rate = (code.records(r) for r in ("plant_state", "plant_input", "plant_rate"))
    for name, value in values.items():
        (state if name in state.dtype.names else applied)[name] = value
    code.acceleration(params, state, applied, rate)
    return [float(rate[n][0]) for n in names]


SPRING_CART = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <site name="post" pos="0 0 0.3"/>
    <body>
      <joint name="x" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <site name="hook" pos="0 0 0"/>
      <body>
        <joint name="th" type="hinge" axis="0 1 0"/>
        <inertial pos="0 0 0.5" mass="0.2" diaginertia="1e-10 1e-10 1e-10"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <spatial stiffness="50" springlength="0.35"><site site="post"/><site site="hook"/></spatial>
  </tendon>
  <actuator><motor joint="x"/></actuator>
</mujoco>
"""


def test_a_spring_of_finite_length_moves_as_in_mujoco(generated: Any) -> None:
    code = generated("oblique").code
    model = mujoco.MjModel.from_xml_string(SPRING_CART)
    data = mujoco.MjData(model)
    params = fill_records(code.records("plant_params"), code.folder.parameters("lab"))
    params["drag"] = 1.7
    rng = np.random.default_rng(12)
    for _ in range(200):
        data.qpos[:], data.qvel[:] = rng.uniform(-2, 2, 2), rng.normal(0, 3, 2)
        data.ctrl[0] = rng.normal(0, 10)
        data.qfrc_applied[0] = -1.7 * data.qvel[0] * abs(data.qvel[0])
        mujoco.mj_forward(model, data)
        values = dict(zip(("x", "th", "dx", "dth"), [*data.qpos, *data.qvel], strict=True))
        values["force"] = data.ctrl[0]
        ours = accelerations(code, values, params, ["ddx", "ddth"])
        np.testing.assert_allclose(ours, data.qacc, rtol=1e-7, atol=1e-7)


def linkage_acceleration(p: dict[str, float], th: float, rate: float, tau: float) -> float:
    """Return th'' of a slider-crank from its three bodies, held together by multipliers.

    Coordinates th, x, y, psi (the rod's centre and angle) and the piston's place; the rod's ends
    are on the pin and on the piston: J q'' = -J' q', M q'' + J^T f = Q.
    """
    r, half = p["r"], p["l"] / 2
    psi = math.asin(-r * math.sin(th) / p["l"])
    s, c, across, along = math.sin(th), math.cos(th), half * math.sin(psi), half * math.cos(psi)
    jacobian = np.array(
        [
            [r * s, 1, 0, across, 0],
            [-r * c, 0, 1, -along, 0],
            [0, 1, 0, -across, -1],
            [0, 0, 1, along, 0],
        ]
    )
    others = np.linalg.solve(jacobian[:, 1:], -jacobian[:, 0] * rate)
    w = others[2]
    bent = np.array(
        [
            r * c * rate**2 + along * w**2,
            r * s * rate**2 + across * w**2,
            -along * w**2,
            -across * w**2,
        ]
    )
    mass = np.diag([p["crank"], p["rod"], p["rod"], p["inertia"], p["piston"]])
    force = np.array([tau, 0, -p["rod"] * p["g"], 0, 0])
    whole = np.block([[mass, jacobian.T], [jacobian, np.zeros((4, 4))]])
    return float(np.linalg.solve(whole, np.concatenate([force, -bent]))[0])


def test_a_loop_closed_by_hand_moves_as_its_bodies_held_by_multipliers(generated: Any) -> None:
    code = generated("slider").code
    known = dict(code.folder.parameters("lab"))
    params = fill_records(code.records("plant_params"), known)
    rng = np.random.default_rng(13)
    for _ in range(200):
        th, rate, tau = rng.uniform(-7, 7), rng.normal(0, 20), rng.normal(0, 5)
        ours = accelerations(code, {"th": th, "dth": rate, "tau": tau}, params, ["ddth"])
        wanted = linkage_acceleration(known, th, rate, tau)
        np.testing.assert_allclose(ours, [wanted], rtol=1e-10, atol=1e-9)


def test_a_slider_crank_is_flown_at_the_speed_wanted(generated: Any) -> None:
    """From rest, a quarter turn behind: within a milliradian after a second and a half."""
    code = generated("slider").code
    params = fill_records(code.records("params"), code.folder.parameters("lab"))
    plant_params = fill_records(code.records("plant_params"), code.folder.parameters("lab"))
    state, measured, output = (code.records(r) for r in ("state", "input", "output"))
    moving, applied = code.records("plant_state"), code.records("plant_input")
    status, step = np.zeros(1, np.int32), np.array([1e-4])
    moving["th"] = -math.pi / 2
    code.init(state, params, status)
    for k in range(1501):
        measured["th"], measured["dth"], measured["time"] = moving["th"], moving["dth"], k * 1e-3
        code.step(state, params, measured, output, status)
        assert status[0] in (0, 1)
        applied["tau"] = output["tau"]
        code.plant_step(moving, plant_params, applied, step, 10)
    assert abs(moving["th"][0] - 20.0 * 1.501) < 1e-3
    assert abs(moving["dth"][0] - 20.0) < 1e-2


def test_where_the_loop_does_not_close_the_step_says_numeric_and_commands_nothing(
    generated: Any,
) -> None:
    """r > l is within the declared bounds: the root is of a negative number at a quarter turn."""
    code = generated("slider").code
    known = dict(code.folder.parameters("lab")) | {"r": 0.3}
    params = fill_records(code.records("params"), known)
    state, measured, output = (code.records(r) for r in ("state", "input", "output"))
    status = np.zeros(1, np.int32)
    code.init(state, params, status)
    before = state.copy()
    for th, wanted in ((math.pi / 2, "NUMERIC"), (0.1, "OK")):
        measured["th"] = th
        code.step(state, params, measured, output, status)
        found = code.folder.manifest.status[status[0]]
        assert (found == "NUMERIC") == (wanted == "NUMERIC")
        assert all(np.isfinite(output[n][0]) for n in output.dtype.names)
        if wanted == "NUMERIC":
            assert output["tau"][0] == 0.0
            assert state.tolist() == before.tolist()


def test_verification_judges_where_the_formulas_are_real(generated: Any) -> None:
    plant = generated("slider")
    derivation = derivation_of(plant.source)
    block = derivation.block("energy")
    sets = [dict(s.values) for s in library_sets(plant.model, plant.source)]
    rng = np.random.default_rng(1)
    drawn = draw(plant.model, block.inputs, sets, 400, rng, block=block).values
    root = drawn["l"] ** 2 - drawn["r"] ** 2 * np.sin(drawn["th"]) ** 2
    assert np.all(root > 0.0)
    assert np.any(drawn["r"] > drawn["l"])  # the bounds allow it: judged where it is real
    found = verify(
        derivation, plant.model, sets, [CompiledUnderTest(plant.code, "c-host")], None, 150, 0
    )
    assert found.passed, found


def test_every_kind_of_function_is_emitted_in_every_form(generated: Any, tmp_path: Path) -> None:
    """Compiled without a warning: double, single, batch and derivatives; verified in double."""
    plant = generated("everykind")
    sets = library_sets(plant.model, plant.source)
    jacobians = jacobian_programs(plant.source)
    written_code(Emission(plant.model, sets, jacobians=jacobians, batch=True), tmp_path / "double")
    single = Emission(plant.model, sets, precision=SINGLE, single=single_elementary())
    written_code(single, tmp_path / "single")
    used = set()
    for form, header in (("double", DOUBLE), ("single", SINGLE)):
        folder = tmp_path / form / "c"
        assert (folder / header.further_header).is_file()
        for source in sorted(folder.glob("everykind*.c")):
            run(("gcc", *BASE_FLAGS, *STRICT, "-O1", "-c", source.name, "-o", "x.o"), folder)
            used |= set(re.findall(r"pf_(?:log|asin|acos|sinh|cosh)f?\b", source.read_text()))
    assert used == {
        f"pf_{n}{f}" for n in ("log", "asin", "acos", "sinh", "cosh") for f in ("", "f")
    }
    derivation = derivation_of(plant.source)
    values = [dict(s.values) for s in sets]
    subjects = [PythonUnderTest(plant.code.folder), CompiledUnderTest(plant.code, "c-host")]
    found = verify(derivation, plant.model, values, subjects, None, 40, 0)
    assert found.passed, found


def test_the_models_of_the_library_get_no_function_they_do_not_call() -> None:
    for name, folder in sorted(generated_models().items()):
        further = [p.name for p in (folder / "c").iterdir() if "further" in p.name]
        assert not further, name


REFUSED = {
    "an energy": (
        "k * (sp.sqrt(x**2 + height**2) - free) ** 2 / 2",
        "k * height**2 * sp.asinh(x / height)",
        "potential_energy=",
        "the potential energy contains asinh(x/height), which has no lowering",
        "log(x + sqrt(x**2 + 1))",
    ),
    "a cube root": (
        "k * (sp.sqrt(x**2 + height**2) - free) ** 2 / 2",
        "k * height**2 * sp.cbrt(1 + x**2 / height**2)",
        "potential_energy=",
        "contains (1 + x**2/height**2)**(1/3)",
        "powers with exponents of whole numbers, halves",
    ),
    "a choice without an end": (
        "k * (sp.sqrt(x**2 + height**2) - free) ** 2 / 2",
        "k * sp.Piecewise((x**2, x > 0))",
        "potential_energy=",
        "contains Piecewise((x**2, x > 0)), which has no lowering",
        "(value, True)",
    ),
    "friction": (
        "drag * dx * sp.Abs(dx)",
        "drag * dx**2 * sp.erf(dx)",
        "m.friction(",
        "the friction along dx contains erf(dx), which has no lowering",
        "write it in sums, products",
    ),
    "a constraint": (
        "    return m.build(",
        '    m.first_order("s", "1/s", dth + sp.gamma(th))\n    return m.build(',
        "m.first_order(",
        "the servo-constraint s contains gamma(th), which has no lowering",
        "write it in sums, products",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_has_no_lowering_is_refused_at_its_line(
    what: str, workspace: Path, refused: Any
) -> None:
    right, wrong, where, says, remedy = REFUSED[what]
    written_plant(workspace / "oblique", "oblique")
    text = spec_text("oblique")
    assert text.count(right) == 1
    text = text.replace(right, wrong)
    (workspace / "oblique" / "spec.py").write_text(text, encoding="utf-8")
    line = text[: text.index(where)].count("\n") + 1
    refused("derive", "./oblique", says=(f"oblique/spec.py:{line}: ", says, remedy))
