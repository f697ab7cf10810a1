"""The chain of links with a free hinge at its base and a motor in every other joint.

Angles are measured from the upright, each from the vertical and not from the link below. The
library's chain has three links; `chain_model` writes down any other number.
"""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.authoring import LABORATORY, ModelBuilder, ModelSpec
from pfaffian.derive.mechanics.chain import chain

LINKS = 3


def model() -> ModelSpec:
    """Return the specification of the triple inverted pendulum."""
    return chain_model(LINKS)


def chain_model(links: int) -> ModelSpec:
    """Return the specification of a chain of `links` links, two or more.

    Motor k turns link k + 1 against link k; belt and rotor turn with their relative rate. With m
    motors there are m servo-constraints s_k, each any row of rates and errors.
    """
    m = ModelBuilder(
        "chain",
        title=f"Chain of {links} links, inverted",
        source="K. Furuta, T. Ochiai, N. Ono, Attitude control of a triple inverted pendulum, "
        "Int. J. Control 39(6), 1984, with the parameters of D.-W. Gu, P. H. Petkov, "
        "M. M. Konstantinov, Robust Control Design with MATLAB; the servo-constraints are rows of "
        "a Riccati equation",
        domain=LABORATORY,
    )
    moving = [
        m.coordinate(
            f"q{k + 1}", "rad", f"link {k + 1} from the upright", bound=1e4, rate_bound=1e3
        )
        for k in range(links)
    ]
    q, dq = zip(*moving, strict=True)
    kinetic, potential = _energies(m, links, q)
    for k in range(links - 1):
        between = dq[k] - dq[k + 1]
        belt = m.parameter(
            f"belt{k + 1}",
            "kg*m^2",
            f"belt and reflected rotor of motor {k + 1}",
            latex=f"I_{{p{k + 1}}}",
        )
        kinetic += belt * between**2 / 2
        m.actuator(
            f"tau{k + 1}",
            "N*m",
            f"torque of motor {k + 1} on link {k + 2}, against link {k + 1}",
            on={f"q{k + 1}": -sp.S.One, f"q{k + 2}": sp.S.One},
        )
    for k in range(links):
        along = dq[0] if k == 0 else dq[k] - dq[k - 1]
        m.friction(
            along,
            m.uncertain(f"damping{k + 1}", "N*m*s", f"viscous friction of hinge {k + 1}") * along,
        )
    errors = [angle - sp.Symbol(f"{angle.name}d", real=True) for angle in q]
    for k in range(1, links):
        m.first_order(f"s{k}", "kg*m^2/s", _residual(m, k, dq, errors))
    return m.build(kinetic_energy=kinetic, potential_energy=potential)


def _energies(m: ModelBuilder, links: int, q: tuple[sp.Symbol, ...]) -> tuple[sp.Expr, sp.Expr]:
    """Return T and V of the links, in parameters declared here."""
    plant = chain(links)
    names = {"m": "mass", "len": "length", "c": "centre", "J": "inertia"}
    units = {"m": "kg", "len": "m", "c": "m", "J": "kg*m^2"}
    texts = {
        "m": "mass of link {}",
        "len": "length of link {}, hinge to hinge",
        "c": "hinge to centre of mass of link {}",
        "J": "inertia of link {} about its centre of mass",
    }
    # The chain of the benchmark measures angles from the horizontal.
    known: dict[sp.Basic, sp.Expr] = {a: a + sp.pi / 2 for a in plant.angles}
    used = plant.kinetic_energy.free_symbols | plant.potential_energy.free_symbols
    for symbol in plant.parameters:
        if symbol not in used or symbol == plant.gravity:
            continue
        kind, number = symbol.name.rstrip("0123456789"), symbol.name.lstrip("abcdefghijklmnJ")
        known[symbol] = m.parameter(
            f"{names[kind]}{number}",
            units[kind],
            texts[kind].format(number),
            latex=f"{kind[0]}_{number}",
        )
    known[plant.gravity] = m.parameter("g", "m/s^2", "acceleration of gravity", upper=100.0)
    return (
        plant.kinetic_energy.subs(known, simultaneous=True),
        plant.potential_energy.subs(known, simultaneous=True),
    )


def _residual(m: ModelBuilder, k: int, dq: tuple[sp.Symbol, ...], errors: list[sp.Expr]) -> sp.Expr:
    """Return s_k = sum_j (w_kj q_j' + r_kj e_j): with weights in kg m^2, ADB is a plain number."""
    value = sp.S.Zero
    for j, (rate, error) in enumerate(zip(dq, errors, strict=True)):
        weight, gain = f"weight{k}{j + 1}", f"rate{k}{j + 1}"
        value += rate * m.gain(
            weight, "kg*m^2", f"weight of the rate of q{j + 1} in s{k}", latex=f"w_{{{k}{j + 1}}}"
        )
        value += error * m.gain(
            gain, "kg*m^2/s", f"weight of the error of q{j + 1} in s{k}", latex=f"r_{{{k}{j + 1}}}"
        )
    return value
