"""The limits of the sampled law: slew, what saturation does to its memory, and ADB = 0.

The propositions are those of docs/sampled-law.md.
"""

import numpy as np
import pytest
import sympy as sp
from pfaffian.derive.pipeline import derivation_of
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.code.generated_model import (
    fill_records,
    host_model,
    open_generated,
    ppc750_model,
)
from pfaffian.runtime.flight.scenario import read_scenario
from test_c_safety import AT_ZERO, LARGEST, NEAR_SINGULAR, OK, SATURATED, TINY, sensible

FOLDER = open_generated("pendubot")
#: With a slow drift, where the integral matters most: the figures of docs/sampled-law.md.
RIG = FOLDER.parameters("rig") | {"sigma": 2.0, "kappa": 0.0045}
PERIOD = RIG["sample_time"]
UPRIGHT = np.pi / 2


@pytest.fixture(scope="module")
def host():
    return host_model(FOLDER)


def started(model, values, count):
    """Return (state, params, input, output, status) records after init."""
    roles = ("state", "params", "input", "output")
    state, params, measured, output = (model.records(r, count) for r in roles)
    fill_records(params, values)
    status = np.zeros(count, np.int32)
    model.init(state, params, status)
    assert (status == OK).all()
    return state, params, measured, output, status


def total(output):
    return output["p1"] + output["p2"] + output["p3"]


# Slew


def test_the_torque_moves_no_faster_than_the_slew_limit_and_says_when_that_binds(host):
    rng = np.random.default_rng(1)
    state, params, measured = sensible(FOLDER, rng, 20_000)
    status = np.zeros(20_000, np.int32)
    params["slew_limit"] = np.exp(rng.uniform(0.0, 12.0, 20_000))
    host.init(state, params, status)
    limit = params["torque_limit"]
    before = state["tau_previous"] = rng.uniform(-1.0, 1.0, 20_000) * limit
    output = host.records("output", 20_000)
    host.step(state, params, measured, output, status)
    reach = params["sample_time"] * params["slew_limit"]
    wanted, rounding = total(output), 1e-14 * np.abs(total(output))
    expected = np.clip(np.clip(wanted, before - reach, before + reach), -limit, limit)
    assert (np.abs(output["tau"] - expected) <= rounding).all()
    assert (np.abs(output["tau"]) <= limit).all()
    assert (np.abs(output["tau"] - before) <= reach * (1.0 + 1e-15) + 1e-15 * limit).all()
    assert (state["tau_previous"] == output["tau"]).all()
    withheld = np.abs(output["tau"] - wanted) > 1e-12 * np.abs(wanted)
    regular = status != NEAR_SINGULAR
    assert (status[regular] == np.where(withheld, SATURATED, OK)[regular]).all()
    by_slew = withheld & (np.abs(output["tau"]) < limit)
    assert min(by_slew.sum(), (withheld & ~by_slew).sum(), (~withheld).sum()) > 500


def test_the_torque_starts_from_zero_after_init(host):
    state, params, measured, output, status = started(host, RIG | {"slew_limit": 10.0}, 1)
    measured["q1"], measured["q2"] = 1.4, 0.2
    assert state["tau_previous"] == 0.0
    reach = PERIOD * 10.0
    torques = []
    for _ in range(3):
        host.step(state, params, measured, output, status)
        torques.append(abs(output["tau"][0]))
    assert torques == pytest.approx([reach, 2.0 * reach, 3.0 * reach], rel=1e-15)


_WILD = (np.nan, np.inf, -np.inf, LARGEST, -LARGEST, TINY, -0.0, 1e3, -1e3)


@pytest.mark.parametrize("previous", _WILD)
def test_whatever_the_previous_torque_is_the_command_is_finite_and_within_the_limit(host, previous):
    state, params, measured, output, status = started(host, RIG, 41)
    measured["q1"], measured["q2"] = np.linspace(1.2, 1.9, 41), 0.2
    state["tau_previous"] = previous
    host.step(state, params, measured, output, status)
    assert (status <= NEAR_SINGULAR).all()  # not refused, so that it recovers by itself
    assert np.isfinite(output["tau"]).all()
    assert (np.abs(output["tau"]) <= RIG["torque_limit"]).all()
    assert (state["tau_previous"] == output["tau"]).all()
    if np.isnan(previous):  # no number asks for nothing
        free = np.clip(total(output), -RIG["torque_limit"], RIG["torque_limit"])
        np.testing.assert_allclose(output["tau"], free, rtol=1e-14)


@pytest.mark.parametrize("reach", [np.nan, np.inf, -np.inf, -1.0, 0.0, LARGEST, -LARGEST])
def test_whatever_the_slew_limit_is_the_command_is_finite_and_within_the_limit(host, reach):
    state, params, measured, output, status = started(host, RIG, 41)
    measured["q1"], measured["q2"] = np.linspace(1.2, 1.9, 41), 0.2
    state["tau_previous"] = np.linspace(-3.0, 3.0, 41)
    state["sample_time_slew_limit"], params["slew_limit"] = reach, reach
    host.step(state, params, measured, output, status)
    assert np.isfinite(output["tau"]).all()
    assert (np.abs(output["tau"]) <= RIG["torque_limit"]).all()


def test_a_model_without_slew_limits_remembers_no_torque():
    for name in ("pvtol", "chain"):
        manifest = open_generated(name).manifest
        assert not [n for n in manifest.structures["state"].names() if n.endswith("_previous")
                    and not n.startswith("drift")]  # fmt: skip
        assert "slew_limit" not in manifest.structures["params"].names()


def test_the_slew_limit_of_section_5_never_binds_and_that_of_the_rig_not_in_balance():
    for name in ("sim", "sim-designed"):
        values = FOLDER.parameters(name)
        assert values["sample_time"] * values["slew_limit"] > 2.0 * values["torque_limit"]
    from pfaffian.runtime.flight.closed_loop import fly

    model = host_model(FOLDER)
    flight = fly(read_scenario("rig-balance"), model, model, "host")
    assert set(flight.status) == {OK}


# Integral and adaptation under saturation


def test_sixty_seconds_at_the_limit_leave_the_memory_where_it_was(host):
    """A stuck plant: nothing moves whatever the torque is."""
    state, params, measured, output, status = started(host, RIG, 64)
    rng = np.random.default_rng(3)
    measured["q1"] = UPRIGHT + rng.uniform(-0.6, 0.6, 64)
    measured["q2"] = rng.uniform(-0.5, 0.5, 64)
    params["torque_limit"] = rng.uniform(0.05, 2.0, 64)
    names = ("constraint_offset", "bound_estimate")
    at_ten: dict[str, np.ndarray] = {}
    for k in range(60_000):
        host.step(state, params, measured, output, status)
        if k == 10_000:
            held = (status == SATURATED).copy()
            at_ten = {n: state[n].copy() for n in names}
    assert held.sum() > 48
    for name in names:
        assert np.isfinite(state[name]).all()
        assert (state[name][held] == at_ten[name][held]).all()
        assert (np.abs(state[name]) < 10.0).all()
    assert (status[held] == SATURATED).all()


def test_back_calculation_leaves_beta_as_if_nothing_were_withheld():
    """What it would add to the integral, -T ADB (c - u), to first order in T and for any m.

    s' = ADB tau + r with r free of the torque, z' = drift.
    """
    for m in (1, 2):
        period = sp.Symbol("T", positive=True)
        gain = sp.Matrix(m, m, sp.symbols(f"a:{m * m}"))
        s, z, drift, rest, torque, command = (
            sp.Matrix(sp.symbols(f"{n}:{m}")) for n in ("s", "z", "d", "r", "u", "c")
        )
        residual = s + period * (gain * command + rest)
        integral = z + period * drift - period * gain * (command - torque)
        free = s + period * (gain * torque + rest) + z + period * drift
        assert (residual + integral - free).expand() == sp.zeros(m, 1)


def pushed_flights(host, rule):
    """Return (IAE, whether the plant stands) of the rig after pushes on joint 1, shape (N,).

    `rule(period, held, moved, gain, withheld)` gives the next integral where a limit binds.
    """
    push, length, limit = (
        g.ravel()
        for g in np.meshgrid(np.linspace(0.2, 2.0, 10), [0.02, 0.05, 0.1, 0.2], [0.5, 1.0])
    )
    count = len(push)
    wide = RIG | {"torque_limit": 1e4, "slew_limit": 1e9}
    state, params, measured, output, status = started(host, wide, count)
    plant = {n: RIG[n] for n in FOLDER.manifest.structures["plant_params"].names()}
    plant |= {"joint1_viscous": 0.001, "joint2_viscous": 0.0002}
    constants = fill_records(host.records("plant_params", count), plant)
    at, applied = host.records("plant_state", count), host.records("plant_input", count)
    at["q1"] = UPRIGHT + 0.01
    before, area, lost = np.zeros(count), np.zeros(count), np.zeros(count, bool)
    late, steps = np.zeros(count), 4000
    for k in range(steps):
        constants["joint1_load"] = np.where(
            (k >= 100) & (k * PERIOD < 0.1 + length), push * limit, 0.0
        )
        for name in measured.dtype.names:
            measured[name] = at[name]
        held, bound = state["constraint_offset"].copy(), state["bound_estimate"].copy()
        host.step(state, params, measured, output, status)
        reach = PERIOD * RIG["slew_limit"]
        command = np.clip(np.clip(output["tau"], before - reach, before + reach), -limit, limit)
        withheld = command - output["tau"]
        binding = withheld != 0.0
        moved = output["beta"] - output["s"]
        chosen = rule(PERIOD, held, moved, output["adb"], withheld)
        state["constraint_offset"] = np.where(binding, chosen, moved)
        state["bound_estimate"] = np.where(binding, bound, state["bound_estimate"])
        applied["tau"] = before = command
        errors = np.abs(at["q1"] - UPRIGHT), np.abs(at["q2"])
        area += PERIOD * (errors[0] + errors[1])
        late = np.where(k > steps - 500, np.maximum(late, errors[0] + errors[1]), 0.0)
        lost |= np.maximum(*errors) > 2.0
        host.plant_step(at, constants, applied, host.reals(np.full(count, PERIOD / 5)), 5)
        for name in at.dtype.names:
            at[name][lost] = 0.0
    return area, ~lost & (late < 0.2)


def test_holding_the_integral_recovers_from_more_pushes_and_faster_than_back_calculation(host):
    rules = {
        "held": lambda period, held, moved, gain, withheld: held,
        "back": lambda period, held, moved, gain, withheld: moved - period * gain * withheld,
    }
    area, stands = zip(*(pushed_flights(host, rule) for rule in rules.values()), strict=True)
    both = stands[0] & stands[1]
    assert stands[0].sum() >= stands[1].sum()
    assert both.sum() > 20
    assert area[0][both].sum() < 0.8 * area[1][both].sum()


# ADB = 0

DEMAND, THRESHOLD, ADB, BETA, RHO, KAPPA, EPSILON, T = sp.symbols(
    "d theta a beta rho kappa epsilon T", real=True
)


def test_p1_is_linear_in_adb_below_the_threshold_and_no_steeper_above():
    below, above = ADB * DEMAND / THRESHOLD**2, DEMAND / ADB
    assert below.subs(ADB, 0) == 0
    assert sp.simplify((below - above).subs(ADB, THRESHOLD)) == 0
    assert below.diff(ADB) == DEMAND / THRESHOLD**2
    assert sp.simplify(above.diff(ADB).subs(ADB, THRESHOLD) + DEMAND / THRESHOLD**2) == 0
    derived = derivation_of(find_model("pendubot")).block("step")
    inverse = next(d for d in derived.definitions if d.symbol.name == "adb_inverse").expression
    a, least = sp.Symbol("adb", real=True), sp.Symbol("singular_threshold", positive=True)
    assert inverse == a / sp.Max(a**2, least**2)


@pytest.mark.parametrize("slope", [KAPPA + RHO**2 / EPSILON, KAPPA])
def test_the_slope_of_the_implicit_part_is_that_of_the_proposition(slope):
    """F(x) = c + slope x on either side of the layer's edge, x + T a^2 F = a beta.

    dF/da = F' (2 x/a - beta)/(1 + T a^2 F'), and x/a lies between 0 and beta.
    """
    constant = sp.Symbol("c", real=True)
    x = (ADB * BETA - T * ADB**2 * constant) / (1 + T * ADB**2 * slope)
    force = constant + slope * x
    assert sp.simplify(x + T * ADB**2 * force - ADB * BETA) == 0
    wanted = slope * (2 * x / ADB - BETA) / (1 + T * ADB**2 * slope)
    assert sp.simplify(force.diff(ADB) - wanted) == 0
    by_beta = slope * ADB / (1 + T * ADB**2 * slope)
    assert sp.simplify(force.diff(BETA) - by_beta) == 0
    if constant not in slope.free_symbols:  # its largest value is at T a^2 F' = 1
        y = sp.Symbol("y", positive=True)  # y = a sqrt(T F')
        assert sp.simplify(sp.Rational(1, 2) - y / (1 + y**2) - (y - 1) ** 2 / (2 + 2 * y**2)) == 0


def across_the_singular_set(model, count, offset=3.0):
    """Return params values, q2 and output of one engaged period along q2 through ADB = 0 twice."""
    values = FOLDER.parameters("sim") | AT_ZERO | {"lam": 1.8, "torque_limit": 1e4}
    state, params, measured, output, status = started(model, values, count)
    q2 = np.linspace(-1.6, 1.6, count)
    state["engaged"], state["constraint_offset"], state["bound_estimate"] = 1, offset, 0.05
    measured["q1"], measured["q2"], measured["dq1"], measured["dq2"] = 0.3, q2, 0.5, -0.7
    model.step(state, params, measured, output, status)
    return values, measured, output, status


def largest_moves(values, measured, output):
    """Return the proved bound of the torque's move between neighbours, shape (N - 1,)."""
    theta, period = values["singular_threshold"], values["sample_time"]
    a = output["adb"]
    demand = output["p1"] * np.maximum(a**2, theta**2) / np.where(a == 0.0, 1.0, a)
    speed = np.hypot(measured["dq1"], measured["dq2"])
    distance = np.hypot(measured["q1"] - values["q1d"], measured["q2"] - values["q2d"])
    effort = 0.05 * ((speed + 1.0) ** 2 + (distance + 1.0) ** 2)
    steepest = values["kappa"] + effort**2 / values["epsilon"]

    def larger(column):
        return np.maximum(np.abs(column[1:]), np.abs(column[:-1]))

    def move(column):
        return np.abs(np.diff(column))

    slope = larger(demand) / theta**2 + larger(steepest) * larger(output["beta"])
    return (
        slope * move(a)
        + move(demand) / theta
        + 0.5 * np.sqrt(larger(steepest) / period) * move(output["beta"])
        + 2.0 * move(effort)
    )


@pytest.mark.parametrize(
    ("machine", "count"),
    [("host", 400_001), pytest.param("ppc750", 4001, marks=pytest.mark.target)],
)
def test_torque_is_as_continuous_across_adb_zero_as_proved(machine, count):
    model = host_model(FOLDER) if machine == "host" else ppc750_model(FOLDER)
    values, measured, output, status = across_the_singular_set(model, count)
    a, near = output["adb"], np.abs(output["adb"]) < values["singular_threshold"]
    assert (np.diff(np.sign(a)) != 0).sum() == 2
    assert (status[near] == NEAR_SINGULAR).all()
    assert (status[~near] != NEAR_SINGULAR).all()
    moved, bound = np.abs(np.diff(output["tau"])), largest_moves(values, measured, output)
    rounding = 1e-13 * np.abs([output[p] for p in ("p1", "p2", "p3")]).sum(axis=0).max()
    assert (moved <= bound + rounding).all()
    assert moved[near[1:]].max() > 0.02 * bound[near[1:]].max()  # the bound is of the right size
    closest = np.abs(a).argmin()
    effort = np.abs(output["p3"]).max()
    assert np.abs(output["tau"][closest]) < np.abs(output["tau"]).max() * 0.05 + effort * 0.05
