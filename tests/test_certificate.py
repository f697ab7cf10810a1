"""Theorem 1 in numbers: bounds that no sample passes, and that a wrong constant would break."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pfaffian.derive.certificate import certify as stage
from pfaffian.derive.certificate import uncertainty
from pfaffian.derive.certificate.region import Region
from pfaffian.derive.certificate.theorem import Pursuit, Theorem, Ultimate
from pfaffian.derive.ir.evaluate_arrays import evaluate_at
from pfaffian.derive.ir.intervals import enclose
from pfaffian.derive.pipeline import derivation_of
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.code.generated_model import host_model, open_generated
from pfaffian.runtime.flight.continuous import ContinuousLoop, fly_continuous, record
from pfaffian.runtime.flight.scenario import read_scenario
from scipy.integrate import solve_ivp

FRICTION = {f"friction{k + 1}": v for k, v in enumerate((4.18, 1.59, 3.15, 0.09, 3.52, 0.021))}
PLANTS = {
    "5.1": {"joint1_load": 2.0},
    "5.2": {f"joint1_{n}": v for n, v in FRICTION.items()},
    "5.3": {f"joint{j}_{n}": v for j in (1, 2) for n, v in FRICTION.items()},
    "viscous": {"joint1_viscous": 0.02, "joint2_viscous": 0.002},
}
SETS = ("sim", "sim-designed")
BOX = {"q1": (0.8, 2.0), "q2": (-0.6, 0.6), "dq1": (-6.0, 6.0), "dq2": (-6.0, 6.0)}
START = {"q1": 1.0, "q2": 0.5, "dq1": 1.0, "dq2": 0.0}


@pytest.fixture(scope="module")
def derivation():
    return derivation_of(find_model("pendubot"))


@pytest.fixture(scope="module")
def program(derivation):
    return uncertainty.assumption_program(derivation)


@pytest.fixture(scope="module")
def host():
    return host_model(open_generated("pendubot"))


def scenario_of(case, set_name, initial=START, **controller):
    """Return a section's scenario with adaptation, from `initial`, over 4 s."""
    base = read_scenario("section-5.1-paper", set_name=set_name)
    own = base.folder.parameters(set_name)
    still = {n: 0.0 for n in base.plant if n.startswith("joint")}
    return replace(
        base,
        name=f"{case}, {set_name}",
        steps=4000,
        initial=dict(initial),
        controller={n: own[n] for n in base.controller} | controller,
        plant={**base.plant, **still, **PLANTS[case]},
    )


def random_points(count, box=BOX, seed=1):
    rng = np.random.default_rng(seed)
    return {n: rng.uniform(a, b, count) for n, (a, b) in box.items()}


def test_enclosures_hold_the_values_of_every_sample(program):
    scenario = scenario_of("5.3", "sim")
    fixed = {**scenario.plant, **scenario.controller}
    rng = np.random.default_rng(2)
    centre = random_points(4000)
    width = {n: rng.uniform(0.0, 1.0, 4000) ** 4 for n in centre}
    box = {n: (centre[n] - width[n], centre[n] + width[n]) for n in centre}
    found = enclose(program, {**{n: (v, v) for n, v in fixed.items()}, **box})
    for _ in range(20):
        at = {n: rng.uniform(*box[n]) for n in box}
        for name, value in evaluate_at(program, {**fixed, **at}).items():
            low, high = found[name]
            assert ((low <= value) & (value <= high)).all(), name


@pytest.mark.parametrize("set_name", SETS)
@pytest.mark.parametrize("case", PLANTS)
def test_assumptions_hold_at_random_points_and_are_nearly_attained(case, set_name, program):
    scenario = scenario_of(case, set_name)
    found = stage.check_assumptions(program, scenario, Region(BOX))
    for extremum in (found.gain, found.force, found.alpha, found.pursuit):
        assert extremum.attained == pytest.approx(extremum.bound, rel=6e-3)
    points = random_points(200_000)
    theta = [scenario.controller[f"theta{k}"] for k in (1, 2, 3)]
    lam, cosine = scenario.controller["lam"], np.cos(points["q2"])
    det = theta[0] * theta[1] - (theta[2] * cosine) ** 2
    adb = ((lam - 1.0) * theta[1] - theta[2] * cosine) / det
    ad2 = (theta[0] + theta[1] + 2.0 * theta[2] * cosine) / det
    ad2 = ad2 - lam * (theta[1] + theta[2] * cosine) / det
    f = [_friction(scenario.plant, j, points[f"dq{j}"]) for j in (1, 2)]
    fhat = np.abs(f[0] + ad2 / adb * f[1])
    e = np.hypot(points["q1"] - np.pi / 2.0, points["q2"])
    regressor = (np.hypot(points["dq1"], points["dq2"]) + 1.0) ** 2 + (e + 1.0) ** 2
    assert (adb**2 >= found.lmin).all()
    assert (fhat <= found.force.bound).all()
    assert (fhat <= found.alpha.bound * regressor).all()
    assert (fhat <= found.pursuit.bound * scenario.controller["kappa"] * np.abs(adb)).all()


def _friction(plant, joint, rate):
    k = {n: plant[f"joint{joint}_{n}"] for n in ("load", "viscous", *FRICTION)}
    stribeck = np.tanh(k["friction2"] * rate) - np.tanh(k["friction3"] * rate)
    smooth = k["friction4"] * np.tanh(k["friction5"] * rate)
    smooth = smooth + (k["viscous"] + k["friction6"]) * rate
    return k["load"] + k["friction1"] * stribeck + smooth


def test_alpha_of_the_constant_load_and_the_place_of_lmin_are_known(program):
    """Pi is least, 2, at rest at the setpoint: alpha = 2/2; ADB is least nearest to q2*."""
    found = stage.check_assumptions(program, scenario_of("5.1", "sim"), Region(BOX))
    assert found.alpha.bound == pytest.approx(1.0, rel=1e-9)
    assert found.force.bound == pytest.approx(2.0, rel=1e-9)
    assert abs(found.gain.at["q2"]) == 0.6
    assert found.lmin == pytest.approx(found.gain.attained**2, rel=1e-6)


def test_a_region_through_the_singular_set_names_the_place(program):
    box = {**BOX, "q2": (-0.6, 1.0)}
    with pytest.raises(CheckError, match=r"assumption 1 fails.*q2 = 0\.8218"):
        stage.check_assumptions(program, scenario_of("5.1", "sim"), Region(box))


CASES = [
    ("5.1", "sim", {}),
    ("5.1", "sim-designed", {}),
    ("5.2", "sim", {}),
    ("5.2", "sim-designed", {}),
    ("viscous", "sim-designed", {}),
    ("5.1", "sim-designed", {"bound_initial": 30.0}),  # far outside dbar: T is put to the test
]


@pytest.mark.parametrize(("case", "set_name", "changes"), CASES)
def test_flights_stay_within_their_certificate(case, set_name, changes, derivation, host):
    flight = fly_continuous(scenario_of(case, set_name, **changes), host)
    certificate = stage.certify(derivation, flight)
    theorem = certificate.theorem
    assert certificate.failure() == ""
    _follow(theorem.printed(), flight, theorem, 1.0)
    _follow(theorem.scaled(), flight, theorem, 1.0 / math.sqrt(theorem.k1))
    if changes:
        assert all(c.settling > 0.0 and c.late is not None for c in certificate.claims[1:])
    assert (np.abs(flight.beta) <= certificate.pursuit.ultimate * (1.0 + 1e-6)).all()


def _follow(of, flight, theorem, weight):
    """Check |delta| <= d(r) at every sample, and <= dbar from T(dbar, r) on."""
    size = np.hypot(flight.beta, weight * (flight.bound - theorem.alpha))
    assert (size <= of.d(size[0]) * (1.0 + 1e-6)).all()
    for factor in (1.02, 1.1, 2.0):
        dbar = factor * of.dunder
        for wait in (of.settling(dbar, size[0]), of.settling_printed(dbar, size[0])):
            assert (size[flight.time >= wait] <= dbar * (1.0 + 1e-6)).all()


@pytest.mark.parametrize("set_name", SETS)
def test_flights_from_random_starts_stay_within_their_certificate(set_name, derivation, host):
    setpoint = {"q1": np.pi / 2.0, "q2": 0.0}
    rng = np.random.default_rng(5)
    stayed = 0
    for _ in range(4):
        near = {n: v + rng.uniform(-0.15, 0.15) for n, v in setpoint.items()}
        start = near | {n: rng.uniform(-0.3, 0.3) for n in ("dq1", "dq2")}
        scenario = scenario_of("5.2", set_name, start, bound_initial=rng.uniform(0.0, 1.0))
        flight = fly_continuous(replace(scenario, steps=1000), host)
        if flight.ended:
            continue  # through the singular set: the certificate says nothing of that
        assert stage.certify(derivation, flight).failure() == ""
        stayed += 1
    assert stayed >= 2


def test_beta_rate_is_the_closed_loop_s(derivation, host):
    """beta' from A q'' - b against (29), and against the difference quotient of beta."""
    scenario = scenario_of("5.2", "sim-designed")
    flight = fly_continuous(replace(scenario, steps=200), host)
    rate = stage.beta_rate(uncertainty.following_program(derivation), flight)
    at = stage.channels(flight)
    k, fixed = scenario.controller, {**scenario.plant, **scenario.controller}
    fhat = evaluate_at(uncertainty.assumption_program(derivation), {**fixed, **at})["fhat"]
    e = np.hypot(at["q1"] - np.pi / 2.0, at["q2"])
    regressor = (np.hypot(at["dq1"], at["dq2"]) + 1.0) ** 2 + (e + 1.0) ** 2
    mu = flight.adb * flight.beta * flight.bound * regressor
    p2 = -k["kappa"] * flight.adb * flight.beta
    p3 = -mu * flight.bound * regressor / np.maximum(np.abs(mu), k["epsilon"])
    scale = np.abs(flight.adb * fhat).max()
    assert rate == pytest.approx(flight.adb * (p2 + p3 - fhat), abs=1e-9 * scale)
    middle = (flight.beta[2:] - flight.beta[:-2]) / (flight.time[2:] - flight.time[:-2])
    assert middle[20:] == pytest.approx(rate[21:-1], abs=2e-3 * scale)


@pytest.fixture(scope="module")
def crafted(derivation, program, host):
    """States anywhere in the region, with any beta and ahat: each bound must hold there too."""
    scenario = scenario_of("5.2", "sim")
    found = stage.check_assumptions(program, scenario, Region(BOX))
    k = scenario.controller
    gains = (k[n] for n in ("kappa", "epsilon", "k1", "k2"))
    theorem = Theorem(*gains, found.lmin, found.alpha.bound)
    rng = np.random.default_rng(7)
    n = 4000
    points = {name: rng.uniform(*BOX[name], n) for name in BOX}
    worst = rng.random(n) < 0.5  # half of them where Fhat is worst
    for name in BOX:
        points[name] = np.where(worst, found.alpha.at[name], points[name])
    points["q2"] = np.where(rng.random(n) < 0.3, BOX["q2"][1], points["q2"])
    beta = rng.choice([-1.0, 1.0], n) * 10.0 ** rng.uniform(-6.5, 1.0, n)
    bound = np.where(rng.random(n) < 0.5, theorem.alpha, rng.uniform(0.0, 5.0, n))
    loop = ContinuousLoop(scenario, host)
    states = np.array([*points.values(), np.zeros(n), bound]).T
    for y, wanted in zip(states, beta, strict=True):
        loop.observe(y)
        y[-2] = wanted - loop.output["beta"][0]  # beta moves one to one with the integral
    flight = record(loop, np.arange(n, dtype=float), states)
    assert flight.beta == pytest.approx(beta, rel=1e-6, abs=1e-12)
    pursuit = Pursuit(found.pursuit.bound, k["kappa"], found.lmin, found.force.bound)
    return theorem, pursuit, flight, derivation


def _least_slack(crafted, theorem=None, pursuit=None):
    original, other, flight, derivation = crafted
    rate = stage.beta_rate(uncertainty.following_program(derivation), flight)
    return stage.slack(theorem or original, pursuit or other, flight, rate).min()


def test_bounds_hold_at_any_state_of_the_region(crafted):
    assert _least_slack(crafted) >= 0.0


WRONG = {
    "K3 = 0": lambda t: replace(t, epsilon=0.0),
    "eps/4": lambda t: replace(t, epsilon=0.5 * t.epsilon),
    "2 lmin": lambda t: replace(t, lmin=2.0 * t.lmin),
    "1.05 lmin": lambda t: replace(t, lmin=1.05 * t.lmin),
    "0.9 alpha": lambda t: replace(t, alpha=0.9 * t.alpha),
    "0.8 k2": lambda t: replace(t, k2=0.8 * t.k2),
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_a_wrong_constant_of_the_theorem_is_found_out(crafted, wrong):
    assert _least_slack(crafted, theorem=wrong(crafted[0])) < 0.0


@pytest.mark.parametrize("name", ["fbar", "kappa"])
def test_a_wrong_constant_of_the_bound_by_p2_is_found_out(crafted, name):
    pursuit = crafted[1]
    factor = {"fbar": 0.3, "kappa": 4.0}[name]
    wrong = replace(pursuit, **{name: factor * getattr(pursuit, name)})
    assert _least_slack(crafted, pursuit=wrong) < 0.0


ULTIMATES = [
    Ultimate(K1=200.0, K2=200.0, K3=0.0005, gm=1.0, gM=50.0),
    Ultimate(K1=4.0, K2=28.0, K3=0.0005, gm=1.0, gM=1.0),
    Ultimate(K1=3.0, K2=0.0, K3=0.5, gm=0.25, gM=1.0),
]


@pytest.mark.parametrize("of", ULTIMATES)
def test_R_solves_its_quadratic(of):  # noqa: N802
    assert of.rate_bound(np.array(of.R)) == pytest.approx(0.0, abs=1e-9 * (of.K2 + of.K3 + 1.0))
    assert of.rate_bound(np.array(1.01 * of.R)) < 0.0
    assert of.d(0.0) == of.dunder
    assert of.d(2.0 * of.R) == pytest.approx(2.0 * of.dunder)


@pytest.mark.parametrize("of", ULTIMATES)
@pytest.mark.parametrize("factor", [1.01, 1.5, 4.0])
def test_the_settling_time_is_that_of_the_slowest_fall_of_V(of, factor):  # noqa: N802
    """The worst V: |delta| as small as V allows. (46) as printed is later, never earlier."""
    dbar = factor * of.dunder
    r = 3.0 * dbar
    start, goal = of.gM * r**2, of.gm * dbar**2

    def fall(_t, v):
        return of.rate_bound(np.sqrt(v / of.gM))

    def there(_t, v):
        return v[0] - goal

    there.terminal = True
    expected, printed = of.settling(dbar, r), of.settling_printed(dbar, r)
    assert expected <= printed
    found = solve_ivp(
        fall, (0.0, 2.0 * printed), [start], "LSODA", events=there, rtol=1e-10, atol=1e-12
    )
    assert found.t_events[0][0] == pytest.approx(expected, rel=1e-6)
    assert of.settling(dbar, 0.9 * dbar * math.sqrt(of.gm / of.gM)) == 0.0
    assert of.settling(0.99 * of.dunder, r) == math.inf
    assert of.settling_printed(0.99 * of.dunder, r) == math.inf


def test_without_adaptation_the_bound_by_p2_stands_alone(derivation, host):
    scenario = scenario_of("5.1", "sim-designed", k1=0.0, bound_initial=0.0)
    certificate = stage.certify(derivation, fly_continuous(scenario, host))
    assert certificate.theorem is None
    assert certificate.failure() == ""
    (claim,) = certificate.claims
    assert 1.0 < claim.bound / claim.largest < 3.0
    assert certificate.pursuit.ultimate <= certificate.pursuit.coarse * (1.0 + 1e-9)


def test_a_flight_that_leaves_the_region_fails_the_certificate(derivation, host):
    flight = fly_continuous(scenario_of("5.1", "sim-designed"), host)
    certificate = stage.certify(derivation, flight, {"dq2": (-0.5, 0.5)})
    assert "left the region" in certificate.failure()
    assert "dq2" in certificate.failure()


def test_another_inertia_in_the_plant_is_outside_the_theorem(derivation, host):
    scenario = scenario_of("5.1", "sim-designed")
    other = replace(scenario, plant={**scenario.plant, "theta1": 0.025})
    flight = fly_continuous(replace(other, steps=10), host)
    with pytest.raises(CheckError, match="theta1"):
        stage.certify(derivation, flight)


MINE = """
model = "pendubot"
set = "sim-designed"
duration = "4 s"
initial = {q1 = "1 rad", q2 = "0.5 rad", dq1 = "1 rad/s"}
plant = {joint1_load = "2 N*m"}
"""


def test_the_command_states_every_symbol(run, workspace):
    (workspace / "mine.toml").write_text(MINE, encoding="utf-8")
    document = run("certify", "pendubot", "--scenario", "mine.toml", "--json").document()
    assert document["variant"] == "p1 + p2 + p3"
    symbols = {(s["form"], s["symbol"]): s for s in document["symbols"]}
    for name in ("K1", "K2", "K3", "R", "gm", "gM", "r", "d(r)", "dunder", "dbar", "T"):
        for form in ("printed", "scaled"):
            assert math.isfinite(symbols[form, name]["value"])
            assert symbols[form, name]["meaning"]
    assert symbols["", "alpha"]["value"] == pytest.approx(1.0, rel=1e-9)
    assert symbols["printed", "gM"]["value"] == pytest.approx(50.0)
    assert document["holds_in_flight"] is True
    assert document["conservative"]["p2, all time"] < 3.0
    plain = run("certify", "pendubot", "--scenario", "mine.toml")
    assert plain.code == 0
    assert "bounds delta, not q" in plain.out


def test_the_command_takes_a_region_and_a_start(run):
    outcome = run(
        *("certify", "pendubot", "--scenario", "section-5.1-designed", "--json"),
        *("--region", "q1=0.5:2.5,q2=0.9,rate=9", "--initial", "q1=1.3,q2=0.1,dq1=0"),
    )
    document = outcome.document()
    assert outcome.code == 0
    assert document["region"]["q1"] == [0.5, 2.5]
    assert document["region"]["q2"] == [-0.9, 0.9]
    assert document["region"]["dq2"] == [-9.0, 9.0]


MALFORMED = {"q3=1": "unknown coordinate 'q3'", "q1=one": "no number", "q1=2:1": "is empty"}
MALFORMED |= {"q2": "no number", "rate=inf": "not within", "q2=-0.5": "is empty"}


@pytest.mark.parametrize(("text", "says"), MALFORMED.items())
def test_a_malformed_region_is_bad_input(refused, text, says):
    refused("certify", "pendubot", "--region", text, says=("--region", says))


def test_a_region_through_the_singular_set_fails_with_the_place(run):
    call = ("certify", "pendubot", "--scenario", "section-5.1-paper", "--region", "q2=1")
    outcome = run(*call)
    assert outcome.code == 1
    assert "assumption 1 fails" in outcome.err
    assert "q2 = " in outcome.err
    assert "0.8218" in outcome.err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("pendubot", "--initial", "q9=1"), "unknown 'q9'"),
        (("pendubot", "--initial", "q1=up"), "is no number"),
        (("pendubot", "--scenario", "nowhere"), "unknown scenario nowhere"),
        (("pendubot", "--set", "sim", "--params", "mine.toml"), "exclude each other"),
        (("nobody",), "unknown model nobody"),
    ],
)
def test_bad_arguments_are_named(refused, arguments, says):
    refused("certify", *arguments, says=(says,))
