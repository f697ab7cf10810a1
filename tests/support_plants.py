"""Plants of a user's own whose energies hold more than polynomials, sines and cosines."""

from __future__ import annotations

from pathlib import Path

from pfaffian.derive.spec.library import ModelFolder

_HEAD = """import sympy as sp
from pfaffian.derive.authoring import ModelBuilder
from pfaffian.derive.spec import TIME


def model():
    m = ModelBuilder("NAME", title="TITLE", source="made up for a test")
"""
OBLIQUE_SPRING = """    x, dx = m.coordinate("x", "m", "cart", bound=100, rate_bound=100)
    th, dth = m.coordinate("th", "rad", "pole from the upright", bound=100, rate_bound=100)
    cart, bob = m.parameter("cart", "kg", "cart"), m.parameter("bob", "kg", "bob")
    rod = m.parameter("rod", "m", "rod", upper=10.0)
    k, g = m.parameter("k", "N/m", "spring"), m.parameter("g", "m/s^2", "gravity")
    height = m.parameter("height", "m", "of the post, over x = 0", upper=10.0)
    free = m.parameter("free", "m", "length of the spring without force", upper=10.0)
    m.actuator("force", "N", "on the cart", on={"x": 1})
    bob_at = sp.Matrix([x + rod * sp.sin(th), rod * sp.cos(th)])
    v = bob_at.jacobian(sp.Matrix([x, th])) * sp.Matrix([dx, dth])
    drag = m.uncertain("drag", "kg/m", "quadratic drag of the cart")
    m.friction(dx, drag * dx * sp.Abs(dx))
    return m.build(
        kinetic_energy=(cart * dx**2 + bob * v.dot(v)) / 2,
        potential_energy=bob * g * bob_at[1] + k * (sp.sqrt(x**2 + height**2) - free) ** 2 / 2,
    )
"""
SLIDER_CRANK = """    th, dth = m.coordinate("th", "rad", "crank", bound=1000, rate_bound=1000)
    crank = m.parameter("crank", "kg*m^2", "inertia of the crank", upper=10.0)
    rod = m.parameter("rod", "kg", "rod, its centre in the middle", upper=10.0)
    inertia = m.parameter("inertia", "kg*m^2", "of the rod", upper=10.0)
    piston = m.parameter("piston", "kg", "piston", upper=10.0)
    r = m.parameter("r", "m", "radius of the crank", upper=0.5)
    l = m.parameter("l", "m", "length of the rod", upper=1.0)
    g = m.parameter("g", "m/s^2", "gravity", upper=100.0)
    pace = m.parameter("pace", "rad/s", "speed wanted", upper=100.0)
    m.actuator("tau", "N*m", "on the crank", on={"th": 1})
    root = sp.sqrt(l**2 - r**2 * sp.sin(th) ** 2)
    pin = sp.Matrix([r * sp.cos(th), r * sp.sin(th)])
    end = sp.Matrix([r * sp.cos(th) + root, 0])
    centre, angle = (pin + end) / 2, sp.asin(-r * sp.sin(th) / l)
    v, w, slide = centre.diff(th) * dth, angle.diff(th) * dth, end.diff(th) * dth
    m.holonomic("phase", "rad", th - pace * TIME, m.gain("approach", "1/s", "of the phase"))
    whirl = crank * dth**2 + inertia * w**2
    return m.build(
        kinetic_energy=(whirl + rod * v.dot(v) + piston * slide.dot(slide)) / 2,
        potential_energy=rod * g * centre[1],
    )
"""
EVERY_KIND = """    x, dx = m.coordinate("x", "m", "slide", bound=100, rate_bound=100)
    a, da = m.coordinate("a", "rad", "vane", bound=100, rate_bound=100)
    mass = m.parameter("mass", "kg", "slide", upper=100.0)
    inertia = m.parameter("inertia", "kg*m^2", "vane", upper=100.0)
    k, r = m.parameter("k", "N/m", "stop"), m.parameter("r", "m", "length", upper=10.0)
    e = m.parameter("e", "J", "size of the energies", upper=100.0)
    m.actuator("push", "N", "on the slide", on={"x": 1})
    m.actuator("tau", "N*m", "on the vane", on={"a": 1})
    rate_x, rate_a = m.gain("rate_x", "1/s", "of x"), m.gain("rate_a", "1/s", "of a")
    m.holonomic("sx", "m", x - r * sp.sinh(sp.sin(a)), rate_x)
    m.holonomic("sa", "rad", a - sp.atan2(x, r) / 2, rate_a)
    wear = m.uncertain("wear", "kg/s", "wear")
    m.friction(dx, wear * dx * sp.Piecewise((2, x > r), (1, True)))
    m.friction(da, wear * r**2 * da * sp.sqrt(1 + sp.tan(a) ** 2))
    z, half = x / r, sp.Rational(1, 2)
    return m.build(
        kinetic_energy=mass * dx**2 / 2 * (1 + (1 + z**2) ** (3 * half)) + inertia * da**2 / 2,
        potential_energy=k * sp.Max(0, x - r) ** 2 / 2
        + e * sp.log(1 + z**2)
        + e * sp.asin(sp.sin(a) / 2) * sp.acos(sp.cos(a) / 3)
        + e * sp.cosh(sp.sin(a)) * (2 + z**2) ** (-3 * half / 2),
    )
"""
_SETS = {
    "oblique": """cart = "1 kg"
bob = "0.2 kg"
rod = "0.5 m"
k = "50 N/m"
height = "0.3 m"
free = "0.35 m"
g = "9.81 m/s^2"

[gains]
zero_dynamics_poles = [-4, -4, -4]
sigma = "5 1/s"
eta = "0.001 1/s^2"
kappa = "20 kg^2*m^2/s"
epsilon = "1 1/s^3"
k1 = "0.1 kg^2*m^2/s^2"
k2 = "2 1/s"
bound_initial = "0.1 N"

[target]
sample_time = "1 ms"
torque_limit = "100 N"
singular_threshold = "0.01 1/(kg*m)"
""",
    "slider": """crank = "0.01 kg*m^2"
rod = "0.3 kg"
inertia = "0.002 kg*m^2"
piston = "0.5 kg"
r = "5 cm"
l = "20 cm"
g = "9.81 m/s^2"
pace = "20 rad/s"

[gains]
approach = "10 1/s"
sigma = "10 1/s"
eta = "0.001 1/s^2"
kappa = "0.001 kg^2*m^4/s"
epsilon = "1 1/s^3"
k1 = "0.001 kg^2*m^4/s^2"
k2 = "2 1/s"
bound_initial = "0.1 N*m"

[target]
sample_time = "1 ms"
torque_limit = "50 N*m"
singular_threshold = "0.01 1/(kg*m^2)"
""",
    "everykind": """mass = "1 kg"
inertia = "0.2 kg*m^2"
k = "50 N/m"
r = "0.3 m"
e = "2 J"

[gains]
rate_x = "3 1/s"
rate_a = "4 1/s"
sigma = "5 1/s"
eta = "0.001 m/s^2"
kappa = "5 kg^2/s"
epsilon = "1 m^2/s^3"
k1 = "0.1 kg^2/s^2"
k2 = "2 1/s"
bound_initial = "0.01 N"

[target]
sample_time = "1 ms"
push_limit = "50 N"
tau_limit = "50 N*m"
singular_threshold = "0.01 1/(kg^2*m^2)"
""",
}
BODIES = {"oblique": OBLIQUE_SPRING, "slider": SLIDER_CRANK, "everykind": EVERY_KIND}


def spec_text(name: str) -> str:
    """Return the specification of the plant called `name`."""
    return _HEAD.replace("NAME", name).replace("TITLE", name) + BODIES[name]


def set_text(name: str) -> str:
    """Return its one parameter set."""
    return f'title = "{name}"\nsource = "made up for a test"\n\n[parameters]\n{_SETS[name]}'


def written_plant(folder: Path, name: str) -> ModelFolder:
    """Write a plant into `folder`, and return it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "spec.py").write_text(spec_text(name), encoding="utf-8")
    (folder / "lab.toml").write_text(set_text(name), encoding="utf-8")
    return ModelFolder(name, folder)
