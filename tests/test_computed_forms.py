"""The form that sums are computed in: no digits lost where the plant's own formulas lose none."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp
from pfaffian.derive.authoring import ModelBuilder
from pfaffian.derive.derivation.derive import derive
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.lower.model import lower_model
from pfaffian.derive.mechanics.lagrange import mass_matrix
from pfaffian.derive.pipeline import derivation_of, lowered_model
from pfaffian.derive.spec.exact_numbers import exact_number
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.symbolic.forms import grouped
from pfaffian.derive.verify.compare import verify
from pfaffian.runtime.base.errors import InputError

x, y, dx, dy, q = MOVING = sp.symbols("x y dx dy q", real=True)
k, m, j, a = sp.symbols("k m j a", positive=True)
sin, cos = sp.sin, sp.cos


class ProgramSubject:
    """The lowered program itself, evaluated operation by operation in double."""

    name = "c-program"

    def __init__(self, model):
        self.model = model

    def evaluate(self, function, values):
        program = self.model.program(function)
        rows = zip(*(v.tolist() for v in values.values()), strict=True)
        with np.errstate(all="ignore"):
            found = [evaluate(program, dict(zip(values, row, strict=True))) for row in rows]
        return {s.name: np.array([f[s.name] for f in found]) for s in program.outputs}


def verified(spec, samples, *functions):
    derivation = derive(spec)
    model = lower_model(derivation, ())
    subject = ProgramSubject(model)
    return verify(derivation, model, [], [subject], None, samples, 0, functions=functions)


@pytest.mark.parametrize(
    ("written", "wanted"),
    [
        (k * x**2 / 2 - k * x * y + k * y**2 / 2, k * (x - y) ** 2 / 2),
        (k * (x**2 - 2 * x * y + y**2) / 2, k * (x - y) ** 2 / 2),
        (k * (x - y) ** 2 / 2 + m * x, k * (x - y) ** 2 / 2 + m * x),
        (m * (dx**2 * sin(q) ** 2 + dx**2 * cos(q) ** 2), m * dx**2),
        (k / 2 - k * cos(2 * q) / 2, k * sin(q) ** 2),
        (k / 2 + k * cos(2 * q) / 2, k * cos(q) ** 2),
        (k - k * cos(q) ** 2, k * sin(q) ** 2),
        (m * dx**2 + j * dx**2, (m + j) * dx**2),
        ((k * x + a * cos(q)) * dx + a * cos(q) * dy, k * x * dx + a * cos(q) * (dx + dy)),
        (m + k * cos(q), m + k * cos(q)),
        (k - k * cos(q), k - k * cos(q)),
    ],
)  # fmt: skip
def test_terms_of_one_parameter_become_a_product(written, wanted):
    found = grouped(written, MOVING)
    assert found == wanted
    assert sp.expand(sp.expand_trig(found - written).subs(cos(q) ** 2, 1 - sin(q) ** 2)) == 0


def test_a_difference_of_parameters_is_not_gathered():
    b = sp.Symbol("b", real=True)  # of either sign: a + b could cancel
    assert grouped(a * x**2 + b * x**2, MOVING) == a * x**2 + b * x**2


def test_every_sum_that_is_regrouped_is_the_same_sum():
    rng = np.random.default_rng(1)
    factors = [x, y, dx, sin(q), cos(q), sin(2 * q), cos(2 * q), k, m, a, x - y, k * x + a]
    for _ in range(60):
        total = sp.Add(*(
            sp.Integer(rng.integers(-3, 4)) * sp.Mul(*rng.choice(factors, rng.integers(1, 4)))
            for _ in range(4)
        ))  # fmt: skip
        symbols = sorted(total.free_symbols, key=str)
        point = {s: sp.Rational(sp.prime(i + 5), sp.prime(i + 9)) for i, s in enumerate(symbols)}
        difference = (grouped(total, MOVING) - total).subs(point)
        assert abs(difference.evalf(30)) < 1e-25, total


def elastic(written=lambda k, th, q: k * (th - q) ** 2 / 2):
    builder = ModelBuilder("flex", title="elastic joint", source="made up")
    angle, rate = builder.coordinate("q", "rad", "link", bound=1000, rate_bound=1000)
    motor, speed = builder.coordinate("th", "rad", "motor", bound=1000, rate_bound=1000)
    inertia = builder.parameter("inertia", "kg*m^2", "link")
    rotor = builder.parameter("rotor", "kg*m^2", "motor")
    weight = builder.parameter("weight", "N*m", "of the link")
    stiffness = builder.parameter("stiffness", "N*m/rad", "spring")
    builder.actuator("tau", "N*m", "motor", on={"th": 1})
    return builder.build(
        kinetic_energy=inertia * rate**2 / 2 + rotor * speed**2 / 2,
        potential_energy=-weight * cos(angle) + written(stiffness, motor, angle),
    )


@pytest.mark.parametrize("form", ["as a square", "multiplied out"])
def test_the_energy_of_a_spring_is_accurate_by_its_inputs_alone(form):
    spec = elastic()
    if form == "multiplied out":
        spec = elastic(lambda k, th, q: k * th**2 / 2 - k * th * q + k * q**2 / 2)
    found = verified(spec, 1500, "energy")
    assert found.passed
    assert found.functions[0].worst_input_scaled_ulp < 2.0


def test_a_kinetic_energy_of_differences_is_accurate_by_its_inputs_alone():
    """The mass matrix of m (dx - dy)^2 is not named: its entries would excuse what cancels."""
    builder = ModelBuilder("belt", title="belt", source="made up")
    first, dfirst = builder.coordinate("first", "m", "cart", bound=10, rate_bound=1000)
    other, dother = builder.coordinate("other", "m", "cart", bound=10, rate_bound=1000)
    light, heavy = (builder.parameter(n, "kg", n) for n in ("light", "heavy"))
    builder.actuator("u", "N", "force", on={"first": 1})
    spec = builder.build(
        kinetic_energy=light * dfirst**2 / 2 + heavy * (dfirst - dother) ** 2 / 2,
        potential_energy=sp.Integer(0) * other + 0 * first,
    )
    found = verified(spec, 800, "energy")
    assert found.functions[0].worst_input_scaled_ulp < 2.0


@pytest.mark.parametrize("model", ["furuta", "acrobot", "two_wheeled"])
def test_no_digits_are_lost_near_the_upright_position(model):
    """1 - cos(2 alpha) for small alpha in M or det M gave 12,783 units in the last place."""
    source = find_model(model)
    lowered = lowered_model(source)
    subject = ProgramSubject(lowered)
    functions = ("acceleration", "energy")
    found = verify(derivation_of(source), lowered, [], [subject], None, 800, 0, functions=functions)
    assert found.worst_scaled_ulp < 2.0


def drawing_arm():
    """Two links, the hand on a line of any slope: ADB does not depend on the slope."""
    builder = ModelBuilder("arm", title="drawing arm", source="made up")
    q1, dq1 = builder.coordinate("q1", "rad", "shoulder", bound=100, rate_bound=100)
    q2, dq2 = builder.coordinate("q2", "rad", "elbow", bound=100, rate_bound=100)
    m2, l1, l2, j1, j2 = (
        builder.parameter(n, u, n)
        for n, u in (("m2", "kg"), ("l1", "m"), ("l2", "m"), ("j1", "kg*m^2"), ("j2", "kg*m^2"))
    )
    slope = builder.parameter("slope", "rad", "of the line")
    builder.actuator("tau1", "N*m", "shoulder", on={"q1": 1})
    builder.actuator("tau2", "N*m", "elbow", on={"q2": 1})
    angles, rates = sp.Matrix([q1, q2]), sp.Matrix([dq1, dq2])
    hand = sp.Matrix([l1 * cos(q1) + l2 * cos(q1 + q2), l1 * sin(q1) + l2 * sin(q1 + q2)])
    speed, rate = hand.jacobian(angles) * rates, builder.gain("approach", "1/s", "to the line")
    builder.holonomic("along", "m", cos(slope) * hand[0] + sin(slope) * hand[1] - l1, rate)
    builder.holonomic("across", "m", -sin(slope) * hand[0] + cos(slope) * hand[1] - l2, rate)
    return builder.build(
        kinetic_energy=(m2 * speed.dot(speed) + j1 * dq1**2 + j2 * (dq1 + dq2) ** 2) / 2,
        potential_energy=sp.Integer(0),
    )


def test_the_input_gain_of_an_arm_in_task_space_is_accurate():
    """Sums inside A that no name held gave 7e6 units in the last place at ADB."""
    found = verified(drawing_arm(), 1200, "continuous", "energy")
    assert found.passed
    assert found.worst_scaled_ulp < 2.5


@pytest.mark.parametrize(
    ("value", "wanted"),
    [
        (0.5, "1/2"), (1.0, "1"), (2.0, "2"), (9.81, "981/100"), (-0.1, "-1/10"), (1e-3, "1/1000"),
        (2.0**-30, "1/1073741824"), (1e300, str(10**300)),
        (1 / 3, None), (2 / 3, None), (3.141592653589793, None), (0.1 + 0.2, None),
    ],
)  # fmt: skip
def test_a_float_is_the_number_that_was_written_or_none(value, wanted):
    found = exact_number(value)
    assert (None if found is None else str(found)) == wanted


SPEC = """
import sympy as sp
from pfaffian.derive.authoring import ModelBuilder
def model():
    m = ModelBuilder("cpl", title="carts", source="textbook")
    x, dx = m.coordinate("x", "m", "driven", bound=10, rate_bound=10)
    y, dy = m.coordinate("y", "m", "free", bound=10, rate_bound=10)
    m1, m2 = m.parameter("m1", "kg", "driven"), m.parameter("m2", "kg", "free")
    c = m.parameter("c", "N/m", "spring")
    m.actuator("u", "N", "force", on={"x": ONE})
    return m.build(
        kinetic_energy=KINETIC,
        potential_energy=POTENTIAL,
    )
"""


def carts(folder, kinetic, potential, one="1"):
    folder.mkdir(exist_ok=True)
    text = SPEC.replace("KINETIC", kinetic).replace("POTENTIAL", potential).replace("ONE", one)
    (folder / "spec.py").write_text(text)
    return find_model(str(folder))


def test_energies_with_decimal_points_are_the_same_energies(tmp_path):
    plain = carts(tmp_path / "a", "(m1*dx**2 + m2*dy**2)/2", "c*(x - y)**2/2").load()
    floats = carts(
        tmp_path / "b", "0.5*m1*dx**2.0 + 1.0*m2*dy**2/2", "0.5*c*(x - y)**2.0", "1.0"
    ).load()
    for field in ("potential_energy", "input_matrix", "uncertain_force", "constraint"):
        assert getattr(plain, field) == getattr(floats, field)
    assert sp.expand(plain.kinetic_energy - floats.kinetic_energy) == 0
    assert not floats.kinetic_energy.atoms(sp.Float)


@pytest.mark.parametrize(
    ("potential", "said", "remedy"),
    [
        ("0.3333333333333333*c*(x - y)**2", "0.3333333333333333", "sp.Rational(1, 3)"),
        ("3.141592653589793*c*(x - y)**2", "3.141592653589793", "write sp.pi "),
        ("c*(x - y)**2/1.2345678901234567", "0.81", "at most 15 digits"),
    ],
)
def test_a_float_that_is_no_exact_number_is_refused_at_its_line(tmp_path, potential, said, remedy):
    folder = carts(tmp_path / "c", "(m1*dx**2 + m2*dy**2)/2", potential)
    with pytest.raises(InputError) as refused, folder.blamed():
        folder.load()
    assert f"{folder.spec_file}:13: model cpl: the potential energy holds {said}" in str(
        refused.value.message
    )
    assert remedy in refused.value.remedy


def slider_crank():
    """A crank of radius a on a rod of length m, its slider of mass k: a root in the energy."""
    build = ModelBuilder("slider", title="t", source="s")
    th, dth = build.coordinate("th", "rad", "crank", bound=10, rate_bound=100)
    inertia = build.parameter("inertia", "kg*m^2", "crank", upper=10.0)
    mass = build.parameter("mass", "kg", "slider", upper=10.0)
    radius = build.parameter("radius", "m", "crank", upper=0.5)
    rod = build.parameter("rod", "m", "rod", upper=1.0)
    build.actuator("tau", "N*m", "crank", on={"th": 1})
    place = radius * cos(th) + sp.sqrt(rod**2 - radius**2 * sin(th) ** 2)
    return build.build(
        kinetic_energy=(inertia * dth**2 + mass * (place.diff(th) * dth) ** 2) / 2,
        potential_energy=sp.S.Zero,
    )


def test_a_root_in_an_energy_stays_as_it_was_written_and_keeps_its_digits():
    """Multiplied out and over one denominator it takes ten times as much and loses digits."""
    spec = slider_crank()
    found = verified(spec, 400, "acceleration")
    assert found.worst_scaled_ulp < 2.0
    dynamics = derive(spec).dynamics
    assert dynamics.coriolis_force[0].count_ops() < 80
    th, dth = spec.positions[0], spec.velocities[0]
    wanted = spec.kinetic_energy.diff(dth).diff(dth).diff(th) * dth**2 / 2
    at = {s: sp.Rational(3 + n, 10) for n, s in enumerate(sorted(wanted.free_symbols, key=str))}
    assert abs((dynamics.coriolis_force[0] - wanted).subs(at).evalf(40)) < 1e-35


def test_a_root_of_the_rates_is_no_kinetic_energy():
    spec = slider_crank()
    energy = spec.kinetic_energy + sp.sqrt(spec.velocities[0] ** 2 + 1) * sp.Symbol("inertia")
    with pytest.raises(InputError, match="not a quadratic form of the velocities"):
        mass_matrix(energy, spec.velocities, "model slider")
