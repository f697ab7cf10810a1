"""A plant with two actuators and two servo-constraints: the PVTOL aircraft."""

import numpy as np
import pytest
import sympy as sp
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.verify.compare import verify
from pfaffian.derive.verify.subjects import CompiledUnderTest, PythonUnderTest
from pfaffian.runtime.code.generated_model import (
    fill_records,
    host_model,
    open_generated,
    ppc750_model,
)
from pfaffian.runtime.flight.closed_loop import differing_bits, fly
from pfaffian.runtime.flight.metrics import tracking_metrics
from pfaffian.runtime.flight.scenario import read_scenario

COUNT = 2000


@pytest.fixture(scope="module")
def source():
    folder = find_model("pvtol")
    model = lowered_model(folder)
    return derivation_of(folder), model, [s.as_dict() for s in library_sets(model, folder)]


@pytest.fixture(scope="module")
def code():
    return open_generated("pvtol")


@pytest.fixture(scope="module")
def host(code):
    return host_model(code)


def test_dynamics_are_the_published_ones(source):
    """Hauser, Sastry and Meyer 1992: x'' = -sin u1 + eps cos u2, y'' = cos u1 + eps sin u2 - g."""
    derivation, _, _ = source
    dynamics = derivation.dynamics
    m, j, eps, g = sp.symbols("mass inertia coupling g", positive=True)
    theta, u1, u2 = sp.symbols("theta u1 u2", real=True)
    forces = dynamics.input_matrix * sp.Matrix([u1, u2]) - dynamics.gravity
    found = dynamics.mass_matrix.inv() * forces
    wanted = sp.Matrix(
        [
            (-sp.sin(theta) * u1 + eps * sp.cos(theta) * u2) / m,
            (sp.cos(theta) * u1 + eps * sp.sin(theta) * u2) / m - g,
            u2 / j,
        ]
    )
    assert sp.simplify(found - wanted) == sp.zeros(3, 1)
    assert dynamics.coriolis_matrix == sp.zeros(3, 3)
    assert all(identity.proved for identity in derivation.identities)


def test_sideways_motion_has_the_zero_dynamics_worked_out_by_hand(source):
    """(p + rate_y) times the cubic of x and theta under s2 = 0, without drag."""
    derivation, _, _ = source
    p, m, j, eps, g = sp.symbols("p mass inertia coupling g", positive=True)
    w, rx, ry, rt = sp.symbols("weight_x rate_x rate_y rate_theta", real=True)
    lead = m + eps * j * w
    cubic = lead * p**3 + (m * rt + eps * j * w * rx) * p**2 - g * m * w * p - g * m * w * rx
    still = {s: 0 for c in derivation.zero_dynamics.coefficients for s in c.free_symbols
             if s.name.endswith(("drag", "damping", "load"))}  # fmt: skip
    found = [sp.expand(c.subs(still)) for c in derivation.zero_dynamics.coefficients]
    named = {s.name: s for c in found for s in c.free_symbols}
    ours = {s: named.get(s.name, s) for s in (m, j, eps, g, w, rx, ry, rt)}
    wanted = sp.Poly(sp.expand((cubic * (p + ry)).xreplace(ours)), p).all_coeffs()
    assert [sp.expand(a - b) for a, b in zip(found, wanted, strict=True)] == [0] * 5


@pytest.mark.target
def test_generated_code_is_verified_in_every_language(source, code, host):
    subjects = [PythonUnderTest(code), CompiledUnderTest(host, "c-host")]
    target = CompiledUnderTest(ppc750_model(code), "c-ppc750")
    found = verify(*source, subjects, target, samples=600, target_samples=600)
    assert found.passed, found.worst_scaled_ulp


def test_p1_follows_both_constraints_and_beta_contracts(code, host):
    """One step from random states: the implicit p2, p3 never move beta away from zero."""
    rng = np.random.default_rng(11)
    values = code.parameters("hauser") | {"thrust_limit": 1e4, "moment_limit": 1e4}
    params = fill_records(host.records("params", COUNT), values)
    state, status = host.records("state", COUNT), np.zeros(COUNT, np.int32)
    host.init(state, params, status)
    state["engaged"] = 1
    for name in ("constraint_offset1", "constraint_offset2"):
        state[name] = rng.normal(0.0, 3.0, COUNT)
    state["bound_estimate"] = np.exp(rng.uniform(-8.0, 1.0, COUNT))
    measured = host.records("input", COUNT)
    for name in measured.dtype.names:
        measured[name] = rng.normal(0.0, 0.4, COUNT)
    output = host.records("output", COUNT)
    host.step(state, params, measured, output, status)
    assert (status == 0).all()
    theta = measured["theta"]
    m, j, eps, w = (values[n] for n in ("mass", "inertia", "coupling", "weight_x"))
    gain = np.array(
        [
            [np.cos(theta) / m, eps * np.sin(theta) / m],
            [-w * np.sin(theta) / m, w * eps * np.cos(theta) / m + 1 / j],
        ]
    )
    np.testing.assert_allclose(
        output["adb"], gain[0, 0] * gain[1, 1] - gain[0, 1] * gain[1, 0], rtol=1e-12
    )
    pushed = np.array([output[f"p2_{a}"] + output[f"p3_{a}"] for a in ("thrust", "moment")])
    moved = values["sample_time"] * np.einsum("ijk,jk->ik", gain, pushed)
    beta = np.array([output["beta1"], output["beta2"]])
    before, after = np.sum(beta**2, axis=0), np.sum((beta + moved) ** 2, axis=0)
    assert (after <= before * (1.0 + 1e-12)).all()
    assert np.median(after / before) < 0.99


@pytest.mark.target
def test_it_returns_to_hover_with_the_host_s_bits_on_the_target(host):
    scenario = read_scenario("pvtol-hover")
    here = fly(scenario, host, host, "host")
    figures = tracking_metrics(here)
    assert max(figures[f"mae2_{q}"] for q in ("x", "y", "theta")) < 1e-5
    assert set(here.status) == {0}
    there = fly(scenario, ppc750_model(scenario.folder), host, "pil-unicorn")
    assert differing_bits(here, there) == 0
