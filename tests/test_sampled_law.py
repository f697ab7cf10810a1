"""The sampled law: it solves the implicit equation it claims to, and tends to the printed law."""

import numpy as np
import pytest
from pfaffian.runtime.code.generated_model import fill_records, host_model, open_generated

COUNT = 4000


@pytest.fixture(scope="module")
def folder():
    return open_generated("pendubot")


@pytest.fixture(scope="module")
def host(folder):
    return host_model(folder)


def random_motion(host, rng, count=COUNT):
    measured = host.records("input", count)
    measured["q1"] = np.pi / 2 + rng.uniform(-0.5, 0.5, count)
    measured["q2"] = rng.uniform(-0.5, 0.5, count)
    measured["dq1"], measured["dq2"] = rng.normal(0.0, 2.0, (2, count))
    return measured


def engaged_state(host, rng, params, count=COUNT):
    state, status = host.records("state", count), np.zeros(count, np.int32)
    host.init(state, params, status)
    state["engaged"] = 1
    state["constraint_offset"] = rng.normal(0.0, 2.0, count)
    state["bound_estimate"] = np.exp(rng.uniform(-12.0, 0.0, count))
    return state


def regressor(measured, values):
    speed = np.hypot(measured["dq1"], measured["dq2"])
    distance = np.hypot(measured["q1"] - values["q1d"], measured["q2"] - values["q2d"])
    return (speed + 1.0) ** 2 + (distance + 1.0) ** 2


def stepped(host, values, rng, bound=None):
    params = fill_records(host.records("params", COUNT), values)
    measured, state = random_motion(host, rng), engaged_state(host, rng, params)
    if bound is not None:
        state["bound_estimate"] = bound
    before = state.copy()
    output, status = host.records("output", COUNT), np.zeros(COUNT, np.int32)
    host.step(state, params, measured, output, status)
    return measured, before, state, output, status


def test_p2_and_p3_solve_backward_euler_for_beta(host, folder):
    values = folder.parameters("sim") | {"torque_limit": 1e4}
    measured, before, _, output, status = stepped(host, values, np.random.default_rng(1))
    assert (status == 0).all()
    rho = before["bound_estimate"] * regressor(measured, values)
    after = -output["p2"] / values["kappa"]
    layer = rho * np.clip(rho * after / values["epsilon"], -1.0, 1.0)
    inside = np.abs(rho * after) < values["epsilon"]
    assert 100 < inside.sum() < COUNT - 100  # both sides of the layer occur
    np.testing.assert_allclose(-output["p3"], layer, rtol=1e-9, atol=1e-12)
    beta_after = after / output["adb"]
    moved = output["beta"] + values["sample_time"] * output["adb"] * (output["p2"] + output["p3"])
    scale = np.abs(output["beta"]) + values["sample_time"] * np.abs(
        output["adb"] * (np.abs(output["p2"]) + np.abs(output["p3"]))
    )
    assert (np.abs(beta_after - moved) <= 1e-13 * scale).all()


def test_it_tends_to_the_printed_law_with_the_period(host, folder):
    errors = []
    for period in (1e-4, 1e-5, 1e-6):
        values = folder.parameters("sim") | {"torque_limit": 1e4, "sample_time": period}
        rng = np.random.default_rng(2)
        measured, _, state, output, _ = stepped(host, values, rng, bound=0.0)
        printed, continuous = (
            host.records(r, COUNT) for r in ("continuous_state", "continuous_output")
        )
        printed["residual_initial"] = 0.0
        printed["drift_integral"] = output["beta"] - output["s"]
        printed["bound_estimate"] = 0.0
        params = fill_records(host.records("params", COUNT), values)
        host.continuous(printed, params, measured, continuous)
        np.testing.assert_allclose(output["p1"], continuous["p1"], rtol=1e-14)
        errors.append(np.max(np.abs(output["p2"] / continuous["p2"] - 1.0)))
        assert state["engaged"].all()
    assert errors[0] > 5.0 * errors[1] > 25.0 * errors[2]
    assert errors[2] < 0.05


def test_leakage_is_exact_and_adaptation_uses_bhat_after_the_period(host, folder):
    values = folder.parameters("sim") | {"torque_limit": 1e4}
    measured, before, state, output, _ = stepped(host, values, np.random.default_rng(3))
    decay = np.exp(-values["k2"] * values["sample_time"])
    after = np.abs(output["p2"]) / values["kappa"]
    gained = values["k1"] * (1.0 - decay) / values["k2"] * regressor(measured, values) * after
    np.testing.assert_allclose(
        state["bound_estimate"], decay * before["bound_estimate"] + gained, rtol=1e-12
    )


def test_the_first_period_captures_s_so_that_beta_starts_at_zero(host, folder):
    params = fill_records(host.records("params"), folder.parameters("sim"))
    state, status = host.records("state"), np.zeros(1, np.int32)
    host.init(state, params, status)
    measured, output = host.records("input"), host.records("output")
    measured["q1"], measured["q2"], measured["dq1"] = 1.0, 0.5, 1.0
    host.step(state, params, measured, output, status)
    assert output["beta"][0] == 0.0
    assert output["p2"][0] == 0.0
    assert output["tau"][0] == output["p1"][0]
    assert state["constraint_offset"][0] == -output["s"][0]


def test_integral_is_the_trapezoidal_rule_on_the_drift(host, folder):
    values = folder.parameters("sim")
    params = fill_records(host.records("params"), values)
    state, status = host.records("state"), np.zeros(1, np.int32)
    host.init(state, params, status)
    measured, output = host.records("input"), host.records("output")
    drifts, first = [], None
    for k in range(50):
        measured["q1"] = np.pi / 2 + 0.05 * np.sin(0.1 * k)
        measured["q2"] = 0.04 * np.cos(0.2 * k)
        host.step(state, params, measured, output, status)
        s = output["s"][0]
        first = s if first is None else first
        drifts.append(values["sigma"] * s + 2.0 * values["eta"] / np.pi * np.arctan(s))
        integral = values["sample_time"] * (np.sum(drifts) - 0.5 * (drifts[0] + drifts[-1]))
        assert output["beta"][0] == pytest.approx(s - first + integral, rel=1e-10, abs=1e-13)
