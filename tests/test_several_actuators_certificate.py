"""Theorem 1 with two actuators: lmin as an eigenvalue, beta as a vector, flights of the PVTOL."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from pfaffian.derive.certificate import certify as stage
from pfaffian.derive.certificate import uncertainty
from pfaffian.derive.certificate.region import Region
from pfaffian.derive.certificate.theorem import Pursuit, Theorem
from pfaffian.derive.ir.evaluate_arrays import evaluate_at
from pfaffian.derive.ir.intervals import enclose
from pfaffian.derive.lower.to_program import lower
from pfaffian.derive.pipeline import derivation_of
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.symbolic.block import BlockBuilder
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.code.generated_model import host_model, open_generated
from pfaffian.runtime.flight.continuous import ContinuousLoop, fly_continuous, record
from pfaffian.runtime.flight.scenario import read_scenario

BOX = {
    "x": (-0.6, 0.6),
    "y": (-0.5, 0.5),
    "theta": (-0.5, 0.5),
    "dx": (-0.5, 0.5),
    "dy": (-0.5, 0.5),
    "dtheta": (-1.0, 1.0),
}
#: Loads and drag stronger than the library's scenario has, beside that one's own.
PLANTS = {
    "as flown": {},
    "sideways": {"x_load": 0.4, "y_load": -0.2, "x_drag": 0.1, "theta_damping": 0.2},
}


@pytest.fixture(scope="module")
def derivation():
    return derivation_of(find_model("pvtol"))


@pytest.fixture(scope="module")
def program(derivation):
    return uncertainty.assumption_program(derivation)


@pytest.fixture(scope="module")
def host():
    return host_model(open_generated("pvtol"))


def scenario_of(case, steps=2500, **controller):
    base = read_scenario("pvtol-hover")
    return replace(
        base,
        name=case,
        steps=steps,
        controller={**base.controller, **controller},
        plant={**base.plant, **PLANTS[case]},
    )


def gain_at(k, theta):
    """ADB (N, 2, 2), by hand."""
    m, j, eps, w = (k[n] for n in ("mass", "inertia", "coupling", "weight_x"))
    sine, cosine = np.sin(theta), np.cos(theta)
    first = np.stack([cosine / m, eps * sine / m], -1)
    second = np.stack([-w * sine / m, w * eps * cosine / m + 1.0 / j], -1)
    return np.stack([first, second], -2)


def matched_at(scenario, points):
    """Fhat (N, 2) from ADB Fhat = AD F, by hand."""
    k, p = scenario.controller, scenario.plant
    m, j, w = (k[n] for n in ("mass", "inertia", "weight_x"))
    fx = p["x_load"] + p["x_drag"] * points["dx"]
    fy = p["y_load"] + p["y_drag"] * points["dy"]
    ft = p["theta_damping"] * points["dtheta"]
    adf = np.stack([fy / m, w * fx / m + ft / j], -1)
    return np.linalg.solve(gain_at(k, points["theta"]), adf[..., None])[..., 0]


def regressor_at(points):
    speed = np.sqrt(points["dx"] ** 2 + points["dy"] ** 2 + points["dtheta"] ** 2)
    away = np.sqrt(points["x"] ** 2 + points["y"] ** 2 + points["theta"] ** 2)
    return (speed + 1.0) ** 2 + (away + 1.0) ** 2


def random_points(count, seed=1):
    rng = np.random.default_rng(seed)
    return {n: rng.uniform(a, b, count) for n, (a, b) in BOX.items()}


@pytest.mark.parametrize("case", PLANTS)
def test_assumptions_hold_at_random_points_and_are_nearly_attained(case, program):
    scenario = scenario_of(case)
    found = stage.check_assumptions(program, scenario, Region(BOX))
    for extremum in (found.gain, found.force, found.alpha, found.pursuit):
        assert extremum.attained == pytest.approx(extremum.bound, rel=1.1e-2)
    points = random_points(100_000)
    gain = gain_at(scenario.controller, points["theta"])
    sizes = np.linalg.svd(gain, compute_uv=False)[:, -1]
    eigenvalues = np.linalg.eigvalsh(gain @ np.swapaxes(gain, 1, 2))[:, 0]
    fhat = np.linalg.norm(matched_at(scenario, points), axis=1)
    assert (eigenvalues >= found.lmin).all()
    assert (sizes >= found.gain.bound).all()
    assert (fhat <= found.force.bound).all()
    assert (fhat <= found.alpha.bound * regressor_at(points)).all()
    assert (fhat <= found.pursuit.bound * scenario.controller["kappa"] * sizes).all()
    worst = np.array([found.gain.at["theta"]])
    there = np.linalg.svd(gain_at(scenario.controller, worst), compute_uv=False)
    assert found.gain.attained == pytest.approx(there[0, -1], rel=1e-12)


def test_enclosures_hold_the_values_of_every_sample(program):
    scenario = scenario_of("sideways")
    fixed = {**scenario.plant, **scenario.controller}
    rng = np.random.default_rng(2)
    centre = random_points(2000)
    width = {n: rng.uniform(0.0, 1.0, 2000) ** 4 for n in centre}
    box = {n: (centre[n] - width[n], centre[n] + width[n]) for n in centre}
    found = enclose(program, {**{n: (v, v) for n, v in fixed.items()}, **box})
    for _ in range(10):
        at = {n: rng.uniform(*box[n]) for n in box}
        for name, value in evaluate_at(program, {**fixed, **at}).items():
            low, high = found[name]
            assert ((low <= value) & (value <= high)).all(), name


def test_derivatives_of_the_force_are_its_difference_quotients(program):
    scenario = scenario_of("sideways")
    fixed = {**scenario.plant, **scenario.controller}
    points = random_points(200, seed=8)
    found = evaluate_at(program, {**fixed, **points})
    for name in BOX:
        moved = {s: {**points, name: points[name] + s * 1e-6} for s in (1.0, -1.0)}
        above, below = (evaluate_at(program, {**fixed, **m})["fhat"] for m in moved.values())
        slope = np.broadcast_to(found[f"fhat_by_{name}"], above.shape)
        assert slope == pytest.approx((above - below) / 2e-6, abs=1e-7)


def test_a_region_through_the_singular_set_names_the_place(program):
    box = {**BOX, "theta": (-0.5, 1.6)}
    with pytest.raises(CheckError, match=r"assumption 1 fails.*singular value.*theta = 1\.463"):
        stage.check_assumptions(program, scenario_of("as flown"), Region(box))


@pytest.mark.parametrize("size", [3, 4])
def test_with_more_actuators_the_bound_stays_below_the_least_singular_value(size):
    """ADB = B(t) with entries of one angle; at points and on boxes around them."""
    t = sp.Symbol("t", real=True)
    rng = np.random.default_rng(size)
    numbers = [[sp.Rational(int(v), 10) for v in row] for row in rng.integers(-9, 9, (size, size))]
    b = sp.Matrix(numbers) + 2 * sp.eye(size) + sp.sin(t) * sp.ones(size, size) / 5
    stub = SimpleNamespace(
        constraint=SimpleNamespace(jacobian=sp.eye(size)),
        dynamics=SimpleNamespace(mass_matrix=sp.eye(size), input_matrix=b),
        input_gain=b.det(),
    )
    builder = BlockBuilder("least", "a test")
    builder.take(t, "", "", "input")
    least = uncertainty._define_least_gain(builder, stub)
    builder.give(least.name, least, "", "")
    tape = lower(builder.build())
    angles = np.linspace(-3.0, 3.0, 301)
    matrices = np.array([np.array(b.subs(t, a), float) for a in angles])
    sizes = np.linalg.svd(matrices, compute_uv=False)[:, -1]
    bound = evaluate_at(tape, {"t": angles})["adb"]
    assert (bound <= sizes * (1.0 + 1e-12)).all()
    assert (bound > 0.3 * sizes).all()
    low, _ = enclose(tape, {"t": (angles - 1e-3, angles + 1e-3)})["adb"]
    assert (low <= sizes).all()


@pytest.mark.parametrize(
    ("case", "changes"),
    [("as flown", {}), ("sideways", {}), ("sideways", {"bound_initial": 20.0, "k2": 4.0})],
)
def test_flights_stay_within_their_certificate(case, changes, derivation, host):
    flight = fly_continuous(scenario_of(case, **changes), host)
    certificate = stage.certify(derivation, flight)
    theorem, pursuit = certificate.theorem, certificate.pursuit
    assert certificate.failure() == ""
    assert certificate.samples == 2501
    assert certificate.least_slack >= 0.0
    size = np.hypot(flight.beta[:, 0], flight.beta[:, 1])
    assert size == pytest.approx(flight.beta_size, rel=1e-15)
    assert (size <= pursuit.ultimate * (1.0 + 1e-6)).all()
    # V' by hand at every sample, and |delta| below dbar from T on.
    rate = stage.beta_rate(uncertainty.following_program(derivation), flight)
    x = flight.bound - theorem.alpha
    fall = 2.0 * (flight.beta * rate).sum(axis=1) + 2.0 / theorem.k1 * x * flight.bound_rate
    leak = 2.0 * theorem.k2 / theorem.k1
    bound = theorem.epsilon / 2.0 - 2.0 * theorem.kappa * theorem.lmin * size**2
    bound = bound - leak * x**2 + leak * theorem.alpha * np.abs(x)
    assert (fall <= bound + 1e-9 * (1.0 + np.abs(fall))).all()
    for of, weight in ((theorem.printed(), 1.0), (theorem.scaled(), 1.0 / math.sqrt(theorem.k1))):
        delta = np.hypot(size, weight * x)
        assert (delta <= of.d(delta[0]) * (1.0 + 1e-6)).all()
        dbar = 1.1 * of.dunder
        assert (delta[flight.time >= of.settling(dbar, delta[0])] <= dbar * (1.0 + 1e-6)).all()


def test_beta_rate_is_the_closed_loop_s(derivation, host):
    """beta' from A q'' - b against ADB (p2 + p3 - Fhat), both vectors."""
    scenario = scenario_of("sideways", steps=300)
    flight = fly_continuous(scenario, host)
    rate = stage.beta_rate(uncertainty.following_program(derivation), flight)
    at, k = stage.channels(flight), scenario.controller
    gain = gain_at(k, at["theta"])
    bhat = np.einsum("nji,nj->ni", gain, flight.beta)
    effort = flight.bound * regressor_at(at)
    mu = bhat * effort[:, None]
    size = np.maximum(np.linalg.norm(mu, axis=1), k["epsilon"])
    push = -k["kappa"] * bhat - mu * (effort / size)[:, None] - matched_at(scenario, at)
    assert rate == pytest.approx(np.einsum("nij,nj->ni", gain, push), abs=1e-9)
    middle = (flight.beta[2:] - flight.beta[:-2]) / (flight.time[2:] - flight.time[:-2])[:, None]
    assert middle[20:] == pytest.approx(rate[21:-1], abs=5e-3 * np.abs(rate).max())
    assert flight.adb == pytest.approx(np.linalg.det(gain), rel=1e-12)


@pytest.fixture(scope="module")
def crafted(derivation, program, host):
    """States anywhere in the region, any ahat, beta of any size: half along the weakest direction
    of ADB, half where Fhat pushes it outward.
    """
    scenario = scenario_of("sideways")
    found = stage.check_assumptions(program, scenario, Region(BOX))
    k = scenario.controller
    gains = (k[n] for n in ("kappa", "epsilon", "k1", "k2"))
    theorem = Theorem(*gains, found.lmin, found.alpha.bound)
    pursuit = Pursuit(found.pursuit.bound, k["kappa"], found.lmin, found.force.bound)
    rng = np.random.default_rng(7)
    n = 3000
    points = random_points(n, seed=9)
    worst = rng.random(n) < 0.4
    place = np.where(rng.random(n) < 0.5, BOX["theta"][0], BOX["theta"][1])
    for name in BOX:
        points[name] = np.where(worst, found.alpha.at[name], points[name])
    points["theta"] = np.where(rng.random(n) < 0.4, place, points["theta"])
    weak = np.linalg.svd(gain_at(k, points["theta"]))[0][:, :, -1]
    force = matched_at(scenario, points)
    turned = gain_at(k, points["theta"]).swapaxes(1, 2)
    pushed = -np.linalg.solve(turned, force[..., None])[..., 0]
    way = np.where((rng.random(n) < 0.5)[:, None], weak, pushed)
    way = way / np.linalg.norm(way, axis=1)[:, None]
    beta = way * (10.0 ** rng.uniform(-5.0, 4.0, n))[:, None]
    bound = np.where(rng.random(n) < 0.5, theorem.alpha, rng.uniform(0.0, 5.0, n))
    loop = ContinuousLoop(scenario, host)
    states = np.array([*points.values(), np.zeros(n), np.zeros(n), bound]).T
    for y, wanted in zip(states, beta, strict=True):
        loop.observe(y)
        y[6:8] = wanted - [loop.output["beta1"][0], loop.output["beta2"][0]]
    flight = record(loop, np.arange(n, dtype=float), states)
    assert flight.beta == pytest.approx(beta, rel=1e-6, abs=1e-12)
    return theorem, pursuit, flight, derivation


def least_slack(crafted, theorem=None, pursuit=None):
    original, other, flight, derivation = crafted
    rate = stage.beta_rate(uncertainty.following_program(derivation), flight)
    return stage.slack(theorem or original, pursuit or other, flight, rate).min()


def test_bounds_hold_at_any_state_of_the_region(crafted):
    assert least_slack(crafted) >= 0.0


WRONG = {
    "K3 = 0": lambda t: replace(t, epsilon=0.0),
    "2 lmin": lambda t: replace(t, lmin=2.0 * t.lmin),
    "1.05 lmin": lambda t: replace(t, lmin=1.05 * t.lmin),
    "0.8 alpha": lambda t: replace(t, alpha=0.8 * t.alpha),
    "0.8 k2": lambda t: replace(t, k2=0.8 * t.k2),
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_a_wrong_constant_of_the_theorem_is_found_out(crafted, wrong):
    assert least_slack(crafted, theorem=wrong(crafted[0])) < 0.0


@pytest.mark.parametrize(("name", "factor"), [("fbar", 0.3), ("kappa", 4.0), ("lmin", 4.0)])
def test_a_wrong_constant_of_the_bound_by_p2_is_found_out(crafted, name, factor):
    pursuit = crafted[1]
    wrong = replace(pursuit, **{name: factor * getattr(pursuit, name)})
    assert least_slack(crafted, pursuit=wrong) < 0.0


def test_a_flight_that_leaves_the_region_fails_the_certificate(derivation, host):
    flight = fly_continuous(scenario_of("as flown", steps=500), host)
    certificate = stage.certify(derivation, flight, {"dtheta": (-0.1, 0.1)})
    assert "left the region" in certificate.failure()
    assert "dtheta" in certificate.failure()


def test_the_command_states_every_symbol(run):
    outcome = run("certify", "pvtol", "--json")
    assert outcome.code == 0
    document = json.loads(outcome.out)
    assert document["scenario"] == "pvtol-hover"
    assert document["variant"] == "p1 + p2 + p3"
    assert document["holds_in_flight"] is True
    assert document["units"] == {"[beta]": "m/s, rad/s", "[tau]": "N, N*m"}
    symbols = {(s["form"], s["symbol"]): s for s in document["symbols"]}
    sigma = symbols["", "min sigma(ADB)"]["value"]
    assert symbols["", "lmin"]["value"] == pytest.approx(sigma**2, rel=1e-12)
    assert symbols["", "lmin"]["meaning"].startswith("least eigenvalue of ADB (ADB)^T")
    for name in ("K1", "K2", "K3", "R", "gm", "gM", "r", "d(r)", "dunder", "dbar", "T"):
        for form in ("printed", "scaled"):
            assert math.isfinite(symbols[form, name]["value"])
    assert [c["form"] for c in document["flight"]["claims"]] == ["p2", "printed", "scaled"]
    assert document["flight"]["least_slack"] >= 0.0
    assert document["flight"]["left_region"] == ""
