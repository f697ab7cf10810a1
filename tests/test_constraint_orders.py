"""Constraints of every order on plants of a user's own: derived, generated, built, verified, flown.

The quantities that are checked along a flight come from the plant's accelerations and from the
constraint as it was written down, not from the derivation.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from pfaffian.derive.authoring import ModelBuilder
from pfaffian.derive.ir.lowered import lowered_to_json
from pfaffian.derive.mechanics.constraint import servo_constraint
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
from pfaffian.derive.spec.library import ModelFolder
from pfaffian.derive.spec.model_spec import TIME
from pfaffian.derive.spec.residuals import time_derivative
from pfaffian.derive.verify.compare import verify
from pfaffian.derive.verify.subjects import CompiledUnderTest, PythonUnderTest
from pfaffian.runtime.code.generated_model import (
    fill_records,
    host_model,
    open_generated,
    ppc750_model,
)
from pfaffian.runtime.flight.closed_loop import differing_bits, fly
from pfaffian.runtime.flight.scenario import read_scenario

CART = """import sympy as sp
from pfaffian.derive.authoring import ModelBuilder
from pfaffian.derive.spec import TIME


def model():
    m = ModelBuilder("plant", title="Cart and pole", source="made up for this test")
    x, dx = m.coordinate("x", "m", "position of the cart", bound=10, rate_bound=100)
    th, dth = m.coordinate("th", "rad", "pole from the upright", bound=10, rate_bound=100)
    ddx, ddth = m.acceleration(x), m.acceleration(th)
    cart = m.parameter("cart", "kg", "mass of the cart", upper=100)
    pole = m.parameter("pole", "kg", "mass of the pole", upper=100)
    arm = m.parameter("arm", "m", "hinge to the mass of the pole", upper=10)
    g = m.parameter("g", "m/s^2", "acceleration of gravity", upper=100)
    m.actuator("force", "N", "force on the cart", on={"x": 1})
    kinetic = cart * dx**2 / 2 + pole * (dx**2 + 2 * arm * sp.cos(th) * dx * dth) / 2
    kinetic += pole * arm**2 * dth**2 / 2
    potential = pole * g * arm * sp.cos(th)
    CONSTRAINT
    return m.build(kinetic_energy=kinetic, potential_energy=potential)
"""
SET = """title = "a metre of pole on a kilogram of cart"
source = "made up for this test"

[parameters]
cart = "1 kg"
pole = "0.2 kg"
arm = "0.5 m"
g = "9.81 m/s^2"
EXTRA

[gains]
GAINS
kappa = "10 kg^2/s"
epsilon = "1 m^2/s^3"
k1 = "0.1 kg^2/s^2"
k2 = "2 1/s"
bound_initial = "0.01 N"

[target]
sample_time = "1 ms"
torque_limit = "100 N"
singular_threshold = "0.01 1/kg"
"""
FLIGHT = """title = "a short flight"
model = "plant"
set = "lab"
duration = "SECONDS s"

[initial]
START
"""
#: (2) for the constraints that it stabilises.
STABILISED = 'sigma = "5 1/s"\neta = "0.001 m/s^2"\n'


def written(tmp_path, constraint: str, gains: str, *, parameters: str = "") -> ModelFolder:
    """Write the plant with `constraint` and one set into a folder of its own."""
    folder = tmp_path / "plant"
    folder.mkdir(parents=True)
    (folder / "spec.py").write_text(CART.replace("CONSTRAINT", constraint), encoding="utf-8")
    text = SET.replace("GAINS", gains).replace("EXTRA", parameters)
    (folder / "lab.toml").write_text(text, encoding="utf-8")
    return ModelFolder("plant", folder)


def flown(folder: ModelFolder, run, start: str, seconds: float = 2.0) -> SimpleNamespace:
    """Generate, build, verify on every machine and fly; return what a test may look at."""
    out, scenario = folder.path.parent / "out", folder.path.parent / "flight.toml"
    scenario.write_text(FLIGHT.replace("START", start).replace("SECONDS", str(seconds)))
    done = run("generate", folder.path, "-o", out)
    assert done.code == 0, done.err
    code = open_generated(str(out))
    host, target = host_model(code), ppc750_model(code)
    model, derivation = lowered_model(folder), derivation_of(folder)
    sets = [s.as_dict() for s in library_sets(model, folder)]
    subjects = [PythonUnderTest(code), CompiledUnderTest(host, "c-host")]
    there = CompiledUnderTest(target, "c-ppc750")
    found = verify(derivation, model, sets, subjects, there, samples=200, target_samples=200)
    assert found.passed, found
    flight = read_scenario(str(scenario), generated=out)
    here = fly(flight, host, host, "host")
    brief = replace(flight, steps=200)
    assert differing_bits(fly(brief, host, host, "a"), fly(brief, target, host, "b")) == 0
    assert set(here.status) == {0}
    return SimpleNamespace(derivation=derivation, code=code, host=host, flight=here, values=sets[0])


def motion(made: SimpleNamespace, force: np.ndarray) -> dict[str, np.ndarray]:
    """Return q, q' and q'' along the flight, q'' from the plant's own dynamics under `force`."""
    host, flight = made.host, made.flight
    n = len(flight.time)
    state, applied = host.records("plant_state", n), host.records("plant_input", n)
    rate = host.records("plant_rate", n)
    for name in state.dtype.names:
        state[name] = flight.measured[name]
    applied["force"] = force
    host.acceleration(
        fill_records(host.records("plant_params", n), made.values), state, applied, rate
    )
    names = (*state.dtype.names, *rate.dtype.names)
    return {k: (rate if k in rate.dtype.names else state)[k] for k in names}


def is_followed(derivation) -> bool:
    """Return whether s' + drift = A q'' - b, with s' by the chain rule here."""
    spec, found = derivation.spec, servo_constraint(derivation.spec)
    rate = [
        time_derivative(s, spec.coordinates)
        + sum(s.diff(c.velocity) * c.acceleration for c in spec.coordinates)
        for s in found.residual
    ]
    faster = sp.Matrix([c.acceleration for c in spec.coordinates])
    left = sp.Matrix(rate) + sp.Matrix(found.drift)
    return sp.simplify(left - (found.jacobian * faster - found.acceleration)).is_zero_matrix


GAINS = 'w = m.gain("w", "m", "weight of the pole"); v = m.gain("v", "m/s", "of its angle")\n    '
PHI = "x + w * sp.sin(th)"


def test_a_holonomic_constraint_is_its_residual_written_out(tmp_path):
    declared = GAINS + 'k = m.gain("k", "1/s", "rate")\n    '
    short = f'{declared}m.holonomic("s", "m", {PHI}, k)'
    long = f'{declared}m.first_order("s", "m/s", dx + w * sp.cos(th) * dth + k * ({PHI}))'
    folders = [written(tmp_path / str(n), c, "") for n, c in enumerate((short, long))]
    one, other = (lowered_to_json(lowered_model(f)) for f in folders)
    assert one == other
    assert is_followed(derivation_of(folders[0]))


SECOND = (
    'w = m.gain("w", "m", "weight"); a = m.gain("a", "1/s", "of x\'")\n    '
    'b = m.gain("b", "1/s^2", "of x"); c = m.gain("c", "m/s^2", "of th")\n    '
    'd = m.gain("d", "m/s", "of th\'")\n    '
    'm.second_order("s", "m/s^2", ddx + w * sp.cos(th) * ddth + a * dx + b * x + c * th + d * dth)'
)


def gains_of_second_order() -> str:
    """Return gains that place the four zeros of psi at -3, worked out on the linear plant.

    With arm th'' = g th - x'', x = -arm p^2 + g and th = p^2 up to a factor: psi has the numerator
    p^2 (w p^2 + d p + c) + (p^2 + a p + b)(g - arm p^2).
    """
    p = sp.Symbol("p")
    unknown = sp.symbols("w a b c d")
    w, a, b, c, d = unknown
    arm, g = sp.Rational(1, 2), sp.Rational("9.81")
    psi = p**2 * (w * p**2 + d * p + c) + (p**2 + a * p + b) * (g - arm * p**2)
    fixed = psi.subs(w, -1)
    lead = sp.Poly(fixed, p).LC()
    found = sp.solve(sp.Poly(fixed - lead * (p + 3) ** 4, p).all_coeffs(), [a, b, c, d], dict=True)
    units = {"w": "m", "a": "1/s", "b": "1/s^2", "c": "m/s^2", "d": "m/s"}
    values = {"w": -1.0} | {s.name: float(x) for s, x in found[0].items()}
    return "".join(f'{n} = "{values[n]!r} {u}"\n' for n, u in units.items())


@pytest.mark.target
def test_a_second_order_constraint_is_met_by_the_plant_s_accelerations(tmp_path, run):
    made = flown(written(tmp_path, SECOND, gains_of_second_order()), run, 'th = "0.05 rad"', 4.0)
    assert is_followed(made.derivation)
    size = np.abs(made.values["c"] * made.flight.measured["th"]).max()
    alone, total = (psi_of_second_order(made, made.flight.output[n]) for n in ("p1", "force"))
    assert np.abs(alone).max() < 1e-12 * size  # p1 meets it exactly
    # p2 and p3 add what holding the force for a period leaves, which dies out with the motion.
    assert np.abs(total).max() < 1e-2 * size
    assert np.abs(total[-500:]).max() < 1e-5 * size
    assert np.abs(made.flight.measured["th"][-1]) < 1e-3


def psi_of_second_order(made: SimpleNamespace, force: np.ndarray) -> np.ndarray:
    """Return psi along the flight, with the plant's own accelerations under `force`."""
    at, p = motion(made, force), SimpleNamespace(**made.values)
    psi = at["ddx"] + p.w * np.cos(at["th"]) * at["ddth"] + p.a * at["dx"] + p.b * at["x"]
    return psi + p.c * at["th"] + p.d * at["dth"]


TRACKING = (
    'swing = m.parameter("swing", "m", "amplitude", upper=10)\n    '
    'pace = m.parameter("pace", "rad/s", "frequency", upper=100)\n    '
    'k = m.gain("k", "1/s", "rate of the error")\n    '
    'm.actuator("motor", "N*m", "torque on the pole", on={"th": 1})\n    '
    'm.holonomic("s1", "m", x - swing * sp.sin(pace * TIME), k)\n    '
    'm.holonomic("s2", "m", arm * th - swing * sp.cos(pace * TIME), k)'
)


@pytest.mark.target
def test_a_moving_reference_is_followed_and_the_time_is_an_input(tmp_path, run):
    """Cart and pole, both driven, follow a sine and a cosine for ten seconds."""
    folder = written(
        tmp_path,
        TRACKING,
        f'k = "5 1/s"\n{STABILISED}',
        parameters='swing = "0.3 m"\npace = "3 rad/s"',
    )
    sets = folder.path / "lab.toml"
    text = sets.read_text().replace("torque_limit", "force_limit")
    text = text.replace('"0.01 1/kg"', '"0.01 1/(kg^2*m)"')
    text = text.replace("[target]", '[target]\nmotor_limit = "100 N*m"')
    sets.write_text(text, encoding="utf-8")
    made = flown(folder, run, 'th = "0.6 rad"\nx = "0 m"', 10.0)
    assert is_followed(made.derivation)
    time, at = made.flight.time, made.flight.measured
    late = time > 3.0
    assert np.abs(at["x"] - 0.3 * np.sin(3.0 * time))[late].max() < 1e-4
    assert np.abs(0.5 * at["th"] - 0.3 * np.cos(3.0 * time))[late].max() < 1e-4
    header = (made.code.path / "c" / "plant.h").read_text(encoding="utf-8")
    assert "double time;" in header
    _time_is_judged(made)


def _time_is_judged(made: SimpleNamespace) -> None:
    """A time that is none is a fault of the measurement, in C as in Python."""
    module, names = made.code.python_module(), made.code.manifest.structures["params"].names()
    bad = module.STATUS.index("BAD_INPUT") if hasattr(module, "STATUS") else module.BAD_INPUT
    host = made.host
    params = fill_records(host.records("params"), made.values)
    for time in (np.nan, np.inf, 1e300, -1e300):
        state, status = host.records("state"), np.zeros(1, np.int32)
        host.init(state, params, status)
        measured, output = host.records("input"), host.records("output")
        measured["time"] = time
        host.step(state, params, measured, output, status)
        assert status[0] == bad
        assert output["force"] == output["motor"] == 0.0
        own = module.Params(**{n: made.values[n] for n in names})
        start, _ = module.init(own)
        still = dict.fromkeys(made.code.manifest.structures["input"].names(), 0.0)
        _, _, said = module.step(start, own, module.Input(**still | {"time": time}))
        assert int(said) == bad


ENERGY = (
    'w = m.gain("w", "m", "weight"); k = m.gain("k", "1/s", "of x")\n    '
    'v = m.gain("v", "m/s", "of th"); h = m.gain("h", "s/kg/m", "of the energy")\n    '
    "energy = kinetic + potential - pole * g * arm\n    "
    'm.first_order("s", "m/s", dx + k * x + w * dth + v * th + h * energy)'
)


@pytest.mark.target
def test_a_residual_that_holds_the_energy_is_nonlinear_in_the_velocities(tmp_path, run):
    gains = 'w = "0.590833 m"\nk = "2 1/s"\nv = "2.635 m/s"\nh = "0.05 s/kg/m"\n' + STABILISED
    folder = written(tmp_path, ENERGY, gains)
    coefficients = derivation_of(folder).zero_dynamics.coefficients
    assert len(coefficients) == 4
    made = flown(folder, run, 'th = "0.05 rad"')
    assert is_followed(made.derivation)
    assert made.derivation.constraint.jacobian.has(sp.Symbol("dth", real=True))
    p = SimpleNamespace(**made.values)
    s = made.flight.output["s"]
    slope = np.gradient(s, made.flight.time)
    wanted = -p.sigma * s - 2.0 * p.eta / np.pi * np.arctan(s)
    assert np.abs((slope - wanted)[1:-1]).max() < 2e-2 * np.abs(wanted).max()


def _second(psi: str):
    m = ModelBuilder("plant", title="t", source="s")
    x, dx = m.coordinate("x", "m", "x", bound=1, rate_bound=1)
    y, dy = m.coordinate("y", "m", "y", bound=1, rate_bound=1)
    names = {"x": x, "dx": dx, "y": y, "dy": dy, "sp": sp, "t": TIME}
    names |= {"ddx": m.acceleration(x), "ddy": m.acceleration(y)}
    psi = eval(psi, names)
    coordinates = m._coordinates
    from pfaffian.derive.spec.residuals import second_order

    return psi, *second_order(psi, coordinates), coordinates


@pytest.mark.parametrize(
    "psi",
    [
        "ddx + x * dx",
        "sp.cos(x * y) * ddx + sp.sin(y) * ddy - dx * dy",
        "dy * ddx + dx * ddy + (2 + sp.cos(y)) * ddx + x",
        "sp.exp(t) * ddx + t * dy * ddy - x * sp.sin(t)",
        "ddx / (1 + dx**2) + 3 * x + dx",
        "dx / sp.sqrt(1 + dx**2) * ddx + ddy + x",
        "sp.tanh(dx) * ddx + ddy",
        "(ddx + y) ** 2 - ddx**2 + ddy",
    ],
)
def test_s_rate_and_drift_together_are_psi(psi):
    wanted, s, drift, coordinates = _second(psi)
    rate = time_derivative(s, coordinates)
    rate += sum(s.diff(c.velocity) * c.acceleration for c in coordinates)
    assert sp.simplify(rate + drift - wanted) == 0
    assert sp.simplify(s.subs({c.velocity: 0 for c in coordinates})) == 0


@pytest.mark.parametrize("rest", ["", " + k * swing"])
def test_a_setpoint_at_which_the_constraint_does_not_rest_is_refused(rest, tmp_path, refused):
    constraint = (
        'swing = m.parameter("swing", "m", "offset")\n    k = m.gain("k", "1/s", "of x")\n    '
        'w = m.gain("w", "m", "weight"); v = m.gain("v", "m/s", "of th")\n    '
        f'm.first_order("s", "m/s", dx + k * x + w * dth + v * th{rest})'
    )
    gains = 'w = "0.590833 m"\nk = "2 1/s"\nv = "2.635 m/s"\nxd = "0 m"\n' + STABILISED
    folder = written(tmp_path / "own", constraint, gains, parameters='swing = "1e-6 m"')
    if rest:
        says = ("lab.toml: the servo-constraint does not rest at the setpoint: the residual s is",)
        refused("generate", folder.path, "-o", "out", says=says)
    else:
        assert library_sets(lowered_model(folder), folder)
