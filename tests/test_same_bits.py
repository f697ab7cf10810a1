"""Identical bits: host gcc with and without FMA, host clang (zig), PowerPC gcc, PowerPC zig.

The reference is gcc without the fused multiply-add as an instruction: each is then a call of the C
library. Steps, init, plant and continuous law are compared on random samples, wild ones too, and a
whole flight of section 5.1, in which the controller runs as each compiler made it.
"""

import shutil
from importlib.util import find_spec

import numpy as np
import pytest
from pfaffian.runtime.code.generated_model import (
    GeneratedModel,
    host_model,
    open_generated,
    ppc750_model,
)
from pfaffian.runtime.flight.closed_loop import differing_bits, fly
from pfaffian.runtime.flight.scenario import read_scenario
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.host import HostMachine
from pfaffian.runtime.machine.sources import harness_sources
from pfaffian.runtime.machine.toolchain import GCC_PPC, host_target, processor_has_fma
from test_c_safety import garbage, raw, sensible

FOLDER = open_generated("pendubot")
SCENARIO = read_scenario("section-5.1-designed")
COUNT = 4000

needs_gcc = pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
needs_fma = pytest.mark.skipif(
    not processor_has_fma(), reason="needs an x86-64 with the fused multiply-add"
)
needs_zig = pytest.mark.skipif(
    not find_spec("ziglang"), reason="needs the package ziglang: pip install 'pfaffian[target]'"
)
needs_emulator = pytest.mark.skipif(
    not find_spec("unicorn"), reason="needs the package unicorn: pip install 'pfaffian[target]'"
)
needs_gcc_ppc = pytest.mark.skipif(
    not shutil.which(GCC_PPC), reason=f"needs {GCC_PPC}: apt-get install gcc-powerpc-linux-gnu"
)
pytestmark = needs_gcc


def on_host(toolchain, fma):
    image = compile_image(
        host_target(toolchain, fma=fma),
        harness_sources(FOLDER.path, FOLDER.manifest),
        FOLDER.path / "c",
    )
    return GeneratedModel(FOLDER, HostMachine(image))


BUILDS = {
    "host gcc": lambda: on_host("gcc", fma=False),
    "host gcc with FMA": lambda: on_host("gcc", fma=True),
    "host zig": lambda: on_host("zig", fma=False),
    "host zig with FMA": lambda: on_host("zig", fma=True),
    "PowerPC gcc": lambda: ppc750_model(FOLDER, "gcc"),
    "PowerPC zig": lambda: ppc750_model(FOLDER, "zig"),
}
EACH = [
    pytest.param("host gcc with FMA", marks=needs_fma),
    pytest.param("host zig", marks=needs_zig),
    pytest.param("host zig with FMA", marks=[needs_zig, needs_fma]),
    pytest.param("PowerPC gcc", marks=[needs_gcc_ppc, needs_emulator, pytest.mark.target]),
    pytest.param("PowerPC zig", marks=[needs_zig, needs_emulator, pytest.mark.target]),
]


@pytest.fixture(scope="module")
def reference():
    return BUILDS["host gcc"]()


def samples():
    """Sensible samples, then wild measurements and states under parameters that init accepts.

    A setpoint out of its bounds can leave the range of the 750's square root by arithmetic, where
    the results are safe but not the same.
    """
    rng = np.random.default_rng(41)
    good, bad = sensible(FOLDER, rng, COUNT), sensible(FOLDER, rng, COUNT)
    state, params, measured = bad
    wild = (garbage(rng, state), params, garbage(rng, measured))
    return [np.concatenate([g, b]) for g, b in zip(good, wild, strict=True)]


def stepped(model):
    state, params, measured = (b.copy() for b in samples())
    count = len(state)
    output, status = model.records("output", count), np.full(count, -1, np.int32)
    model.step(state, params, measured, output, status)
    fresh, ready = model.records("state", count), np.full(count, -1, np.int32)
    model.init(fresh, params, ready)
    return raw(state), raw(output), status, raw(fresh), ready


@pytest.mark.parametrize("name", EACH)
def test_steps_are_the_same_to_the_bit(reference, name):
    wanted, found = stepped(reference), stepped(BUILDS[name]())
    for one, other in zip(wanted, found, strict=True):
        assert (one == other).all()
    taken = {FOLDER.manifest.status[k] for k in np.unique(wanted[2])}
    assert taken == set(FOLDER.manifest.status) - {"BAD_PARAMETER", "BAD_ARITHMETIC"}


@pytest.fixture(scope="module")
def flight(reference):
    return fly(SCENARIO, reference, reference, "host")


@pytest.mark.parametrize("name", EACH)
def test_a_flight_is_the_same_to_the_bit(flight, reference, name):
    """The plant too is as that compiler made it, but on the emulator, where it stays here."""
    model = BUILDS[name]()
    found = fly(SCENARIO, model, model if name.startswith("host") else reference, name)
    assert differing_bits(flight, found) == 0
    assert found.sha256() == flight.sha256()
    assert (flight.energy.view(np.uint64) == found.energy.view(np.uint64)).all()


@needs_fma
def test_the_model_that_flies_is_built_with_the_fused_multiply_add(monkeypatch):
    from pfaffian.runtime.code import generated_model

    seen = []
    monkeypatch.setattr(
        generated_model,
        "compile_image",
        lambda target, *rest: seen.append(target.flags) or compile_image(target, *rest),
    )
    host_model(FOLDER)
    assert "-mfma" in seen[0]
