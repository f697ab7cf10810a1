"""Frama-C Eva proves: no run-time error in a step over intervals, and a torque within its limit."""

import shutil

import numpy as np
import pytest
from pfaffian.runtime.code.generated_model import open_generated
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.host import HostMachine
from pfaffian.runtime.machine.toolchain import host_target
from support_eva import CONTRACTS, driver, intervals_of, prove

needs_eva = pytest.mark.skipif(
    not shutil.which("frama-c"), reason="needs frama-c: apt-get install frama-c-base"
)
#: What a law remembers, far beyond what a flight reaches.
REMEMBERED = {
    "constraint_offset": (-1e4, 1e4),
    "drift_previous": (-1e4, 1e4),
    "bound_estimate": (0.0, 1e3),
    "tau_previous": (-1e4, 1e4),
}
WHOLE = ("pendubot", "acrobot", "cart_pole", "furuta", "two_wheeled")
#: No alarm in these either; the choice of the limit is more than Eva's domains relate.
WITHOUT_THE_BOUND = ("crane", "tora")


def proved(model, name, spoil=lambda text: text, folder=None, scratch="."):
    code = open_generated(model)
    remembered = {
        n: REMEMBERED[n] for n in code.manifest.structures["state"].names() if n in REMEMBERED
    }
    text = driver(code.manifest, name, intervals_of(code.manifest, remembered))
    if folder:
        shutil.copytree(code.path / "c", folder)
        path = folder / f"{model}.c"
        path.write_text(spoil(path.read_text()))
    return prove(folder or code.path / "c", text, scratch)


def cases(models):
    return [(m, s) for m in models for s in open_generated(m).manifest.parameter_sets]


@needs_eva
@pytest.mark.parametrize(("model", "name"), cases(WHOLE))
def test_a_step_has_no_alarm_and_its_torque_is_within_the_limit(model, name, tmp_path):
    """Angles to 1000 rad, rates to 100 rad/s, any engagement, memory to 1e4."""
    verdict = proved(model, name, scratch=tmp_path)
    assert verdict.alarms == 0, verdict.said
    assert verdict.unproved == 0, verdict.said
    assert verdict.proved > 30


@needs_eva
@pytest.mark.parametrize(("model", "name"), cases(WITHOUT_THE_BOUND))
def test_a_step_has_no_alarm(model, name, tmp_path):
    verdict = proved(model, name, scratch=tmp_path)
    assert verdict.alarms == 0, verdict.said
    assert verdict.unproved == 1


FAULTS = {
    "a limit that is not kept": (
        "(torque_limit < pf_abs(torque_slewed))",
        "(9.0 < pf_abs(torque_slewed))",
    ),
    "a division by what may be zero": ("1.0 / det_m", "1.0 / (det_m - 4e-05)"),
    "a sign forgotten": (
        "((torque_slewed < 0.0) ? (-torque_limit) : torque_limit)",
        "torque_limit * 2.0",
    ),
}


@needs_eva
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_the_step_is_not_proved_away(fault, tmp_path):
    old, new = FAULTS[fault]

    def spoil(text):
        assert text.count(old) == 1
        return text.replace(old, new)

    verdict = proved("pendubot", "rig", spoil, tmp_path / "c", tmp_path)
    assert verdict.alarms + verdict.unproved > 0


CHECK = """
#include "pf_elementary.h"
#include <stdint.h>
void check_sine(uint32_t n, const double *x, double *y);
void check_cosine(uint32_t n, const double *x, double *y);
void check_sine(uint32_t n, const double *x, double *y)
{ uint32_t k; double c; for (k = 0U; k < n; ++k) { pf_sincos(x[k], &y[k], &c); } }
void check_cosine(uint32_t n, const double *x, double *y)
{ uint32_t k; double s; for (k = 0U; k < n; ++k) { pf_sincos(x[k], &s, &y[k]); } }
"""
ONE = """
void check_{f}(uint32_t n, const double *x, double *y);
void check_{f}(uint32_t n, const double *x, double *y)
{{ uint32_t k; for (k = 0U; k < n; ++k) {{ y[k] = {f}(x[k]); }} }}
"""


@pytest.fixture(scope="module")
def functions(tmp_path_factory):
    folder = tmp_path_factory.mktemp("contracts")
    text = CHECK + "".join(ONE.format(f=f) for f in CONTRACTS if f != "pf_sincos")
    (folder / "check.c").write_text(text)
    c = open_generated("pendubot").path / "c"
    return HostMachine(
        compile_image(host_target(fma=True), [folder / "check.c", c / "pf_elementary.c"], c)
    )


def arguments(low, high):
    """Both ends, what lies around zero, magnitudes of all sizes and multiples of pi/2."""
    rng = np.random.default_rng(31)
    sizes = np.exp(rng.uniform(-700.0, 700.0, 100_000)) * rng.choice([-1.0, 1.0], 100_000)
    near = rng.uniform(-50.0, 50.0, 100_000)
    quarters = np.arange(-60_000, 60_000) * (np.pi / 2)
    ends = [low, high, 0.0, -0.0, 5e-324, -5e-324, 1.0, -1.0, np.nextafter(1.0, 2.0)]
    x = np.concatenate([ends, sizes, near, quarters, np.nextafter(quarters, np.inf)])
    return np.ascontiguousarray(x[(x >= low) & (x <= high)])


@pytest.mark.parametrize("function", CONTRACTS)
def test_the_contracts_hold_of_the_compiled_functions(functions, function):
    """Beside the proofs of their errors: a contract that were wrong would prove anything."""
    (low, high), (least, most) = CONTRACTS[function]
    x = arguments(low, high)
    assert len(x) > 20_000
    for name in ("sine", "cosine") if function == "pf_sincos" else (function,):
        y = np.full(len(x), np.nan)
        functions.call(f"check_{name}", len(x), x, y)
        assert np.isfinite(y).all()
        assert (y >= least).all()
        assert (y <= most).all()
