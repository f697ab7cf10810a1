"""The Linux harness flies the flight that the host flies, counts what it says, and stops safely.

`make soak` flies an hour at 1 kHz, as fast as it goes. No test asserts how long anything takes.
"""

import os
import shutil
from dataclasses import replace

import numpy as np
import pytest
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.code.generated_model import host_model
from pfaffian.runtime.flight.closed_loop import fly
from pfaffian.runtime.flight.flight_program import first_frame, record_type, trajectory_of
from pfaffian.runtime.flight.linux_harness import run_harness
from pfaffian.runtime.flight.scenario import read_scenario
from pfaffian.runtime.machine.toolchain import GCC_PPC

SOAK = int(os.environ.get("PFAFFIAN_SOAK_STEPS", "60000"))
SCENARIO = replace(read_scenario("section-5.1-designed"), steps=1500)
needs_ppc = pytest.mark.skipif(
    not (shutil.which(GCC_PPC) and shutil.which("qemu-ppc")),
    reason="needs powerpc-linux-gnu-gcc and qemu-ppc: apt-get install gcc-powerpc-linux-gnu "
    "libc6-dev-powerpc-cross qemu-user",
)
needs_cc = pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
WHERE = [
    pytest.param("host", "<", marks=needs_cc),
    pytest.param("ppc750", ">", marks=[needs_ppc, pytest.mark.target]),
]


def on_host(scenario):
    model = host_model(scenario.folder)
    return fly(scenario, model, model, "host")


@pytest.mark.parametrize(("reference", "order"), WHERE)
def test_a_free_run_is_the_flight_of_the_host(reference, order):
    ran = run_harness(SCENARIO, ["free"], reference)
    assert ran.code == 0
    flown = trajectory_of(SCENARIO, "harness", ran.records, order)
    assert flown.sha256() == on_host(SCENARIO).sha256()
    assert ran.report["periods"] == SCENARIO.steps
    assert not [k for k in ("dropped", "refused", "watchdog_trips", "error") if ran.report[k]]


@pytest.mark.parametrize(("reference", "order"), WHERE)
def test_a_run_on_the_clock_is_the_same_flight_and_takes_its_time(reference, order):
    """However late the machine is: the records are those of the periods, none is left out."""
    short = replace(SCENARIO, steps=200)
    ran = run_harness(short, ["watchdog=0"], reference)
    assert ran.code == 0
    assert ran.report["dropped"] == 0
    flown = trajectory_of(short, "harness", ran.records, order)
    assert flown.sha256() == on_host(short).sha256()
    assert ran.report["busy_ns"] > 0
    assert ran.report["locked"] in (0, 1)
    assert ran.report["fifo"] in (0, 1)


@needs_cc
def test_a_stall_is_an_overrun_and_what_was_missed_is_counted():
    ran = run_harness(replace(SCENARIO, steps=100), ["watchdog=0", "stall=50:80"])
    assert ran.code == 0
    assert ran.report["overruns"] >= 1
    assert ran.report["missed"] >= 70
    assert ran.report["busy_ns"] >= 80_000_000
    assert ran.report["periods"] == 100


@needs_cc
def test_the_watchdog_ends_a_loop_that_stands_still():
    ran = run_harness(replace(SCENARIO, steps=5000), ["free", "watchdog=100", "stall=50:2000"])
    assert ran.code == 4
    assert ran.report["watchdog_trips"] == 1
    assert ran.report["periods"] == 51
    kind = record_type(SCENARIO.folder.manifest, "<")
    assert len(ran.records) == 51 * kind.itemsize


@needs_cc
def test_a_signal_ends_the_flight_after_a_period_with_all_records():
    ran = run_harness(replace(SCENARIO, steps=10_000_000), [], interrupt_after=0.5)
    assert ran.code == 0
    kind = record_type(SCENARIO.folder.manifest, "<")
    assert 0 < ran.report["periods"] < 10_000_000
    kept = ran.report["periods"] - ran.report["dropped"]
    assert len(ran.records) == kept * kind.itemsize


@needs_cc
def test_a_refused_frame_flies_nothing():
    frame = first_frame(SCENARIO, "<")
    frame["record_size"] += 8
    with pytest.raises(CheckError, match="a structure has another size"):
        run_harness(SCENARIO, ["free"], frame=frame.tobytes())
    with pytest.raises(CheckError, match="bytes are in another order"):
        run_harness(SCENARIO, ["free"], frame=first_frame(SCENARIO, ">").tobytes())
    with pytest.raises(CheckError, match="cut short"):
        run_harness(SCENARIO, ["free"], frame=b"")


@needs_cc
@pytest.mark.parametrize("word", ["fast", "every=0", "every=x", "watchdog=", "stall=3"])
def test_an_unknown_argument_is_named(word):
    with pytest.raises(CheckError) as caught:
        run_harness(SCENARIO, [word])
    assert f"unknown: {word}" in caught.value.remedy


@needs_cc
def test_bad_parameters_command_nothing():
    scenario = replace(SCENARIO, steps=50, controller={**SCENARIO.controller, "torque_limit": -1.0})
    ran = run_harness(scenario, ["free"])
    assert ran.report["refused"] == 50
    records = np.frombuffer(ran.records, record_type(SCENARIO.folder.manifest, "<"))
    assert not records["output"]["tau"].any()


@needs_cc
def test_a_long_flight_neither_drifts_nor_grows():
    """At rest in the end as the host is; the last logged record is the host's to the bit."""
    every = 1000
    scenario = replace(read_scenario("section-5.1-designed"), steps=SOAK + 1)
    ran = run_harness(scenario, ["free", f"every={every}", "watchdog=0"])
    assert ran.code == 0
    assert ran.report["refused"] == ran.report["dropped"] == 0
    records = np.frombuffer(ran.records, record_type(scenario.folder.manifest, "<"))
    assert len(records) == SOAK // every + 1
    assert ran.report["grown_kib"] <= 64
    settled = records["input"][len(records) // 2 :]
    for name, goal in scenario.setpoint.items():
        spread = np.ptp(settled[name])
        print(
            f"\n{name}: {SOAK} periods, off by {abs(settled[name] - goal).max():.3g}, "
            f"moved by {spread:.3g} in the second half, grown {ran.report['grown_kib']} KiB"
        )
        assert spread < 1e-9
    if SOAK <= 100_000:
        flown = on_host(scenario)
        for name in records["state"].dtype.names:
            assert records["state"][name][-1] == flown.state[name][-1]
