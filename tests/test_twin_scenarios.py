"""Scenario files with a [twin] table: what they mean, what is refused, how they fly."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.flight.closed_loop import fly
from pfaffian.runtime.flight.scenario import read_scenario
from pfaffian.runtime.flight.scenario_files import scenario_paths
from pfaffian.runtime.twin import Twin, Wanted, balance_unit, fly_twin, read_twin
from pfaffian.runtime.twin.settings import Disturbance, Order, Push
from support_twin import FULL, HEAD, Scripted, model


def test_every_key_is_read_into_si_units(written):
    scenario = read_twin(written(FULL))
    drive, one, two = scenario.drives["tau"], scenario.channels["q1"], scenario.channels["q2"]
    assert (drive.limit, drive.time_constant, drive.bits) == (1.5, 5e-4, 12)
    assert (drive.delay, drive.slew) == (2e-3, 1000.0)
    assert drive.delay_spread == pytest.approx(5e-4, rel=1e-15)
    assert (scenario.rigs, scenario.seed, scenario.base.steps) == (3, 5, 100)
    assert (scenario.sampling.jitter, scenario.sampling.missed) == (0.1, 0.01)
    assert (one.encoder.counts_per_turn, one.encoder.counter_bits, one.noise) == (4096.0, 16, 1)
    assert two.encoder.quantum == pytest.approx(1e-3, rel=1e-15)
    assert (two.encoder.direction, two.dropout, two.offset_spread) == (-1, 0.01, 1e-3)
    friction = scenario.frictions[0]
    assert (friction.joint, friction.stiction, friction.stribeck) == ("q1", 2e-3, 1.0)
    assert scenario.spread == {"theta1": 0.05, "joint2_viscous": 0.5}
    assert scenario.initial_spread["q1"] == pytest.approx(math.radians(1.0))
    assert scenario.tolerance["q1"] == pytest.approx(math.radians(10.0))
    assert scenario.disturbances == (
        Disturbance("q1", "sine", 0.01, 0.0, math.inf, 2.0, pytest.approx(0.5)),
    )
    assert scenario.pushes[0] == Push("q2", 0.02, 1e-3)
    assert scenario.pushes[1] == Push("q2", 0.03, 0.0, 0.01, 5e-3)
    fault = scenario.faults[0]
    assert (fault.kind, fault.counts, fault.rigs, fault.duration) == ("jump", 300, (1,), math.inf)
    assert scenario.orders == (Order(0.01, "start"),)


def test_an_empty_twin_is_the_plain_flight(written):
    path = written(HEAD + "[twin]\n")
    scenario = read_twin(path)
    flight = fly_twin(scenario, balance_unit(scenario, model()), model=model())
    known = fly(read_scenario(path), model(), model(), "host")
    assert (flight.signals["tau"][:, 0] == known.output["tau"]).all()


def test_a_scenario_without_a_twin_is_no_twin():
    with pytest.raises(InputError, match=r"rig-balance\.toml: missing twin") as refused:
        read_twin("rig-balance")
    assert "[twin]" in refused.value.remedy


def test_an_encoder_of_a_length_needs_a_quantum(written):
    text = HEAD.replace("pendubot", "crane").replace('"rig"', '"inteco"')
    text = text.replace("q1 =", "x =").replace("1.5 rad", "0.1 m").replace("= 4", "= 40")
    with pytest.raises(InputError, match=r"twin\.encoder: an encoder in m has no turns"):
        read_twin(written(text + "[twin.encoder]\n"))
    scenario = read_twin(written(text + '[twin.encoder]\n[twin.encoder.x]\nquantum = "0.1 mm"\n'))
    assert scenario.channels["x"].encoder.quantum == pytest.approx(1e-4)
    assert scenario.channels["theta"].encoder.counts_per_turn == 5000.0


def test_a_plant_of_single_precision_is_no_twin(workspace, run):
    assert run("generate", "pendubot", "--precision", "single", "-o", "made").code == 0
    with pytest.raises(InputError, match="single precision cannot be a twin"):
        Twin(read_twin("rig-balance-twin", workspace / "made"))


def with_faults(written, *tables):
    faults = "".join(f"[[twin.fault]]\n{t}\n" for t in tables)
    scenario = read_twin(written(HEAD + "[twin]\nrigs = 2\n[twin.encoder]\n" + faults))
    unit, plain = Scripted(), Scripted()
    flight = fly_twin(scenario, unit, Wanted(rigs=(0, 1)), model=model())
    fly_twin(replace(scenario, faults=()), plain, model=model())
    return flight, unit, plain


#: Fault: its table, the member of the reading, and what a faulty one follows from the plain one.
READ = {
    "freeze_encoder": (
        'joint = "q2"\nduration = "30 ms"',
        "counts",
        lambda x: np.concatenate([x[:20], [[a, x[19][1]] for a, _ in x[20:50]], x[50:]]),
    ),
    "jump": (
        'joint = "q1"\ncounts = -70',
        "counts",
        lambda x: np.concatenate([x[:20], x[20:] + np.array([2**32 - 70, 0], np.uint32)]),
    ),
    "drop_reading": (
        'joint = "q1"\nduration = "3 ms"',
        "valid",
        lambda x: np.concatenate([x[:20], [[0, 1]] * 3, x[23:]]),
    ),
    "nan_elapsed": ("", "elapsed", lambda x: np.concatenate([x[:20], [np.nan], x[21:]])),
    "stall_frame": ("", "frame", lambda x: np.concatenate([x[:20], [19] * 80])),
    "stop_heartbeat": (
        'duration = "10 ms"',
        "heartbeat",
        lambda x: np.concatenate([x[:20], [19] * 10, x[30:]]),
    ),
}


@pytest.mark.parametrize("kind", READ)
def test_an_injected_fault_arrives_in_the_reading_of_its_rig_alone(kind, written):
    more, member, expected = READ[kind]
    table = f'kind = "{kind}"\ntime = "20 ms"\nrigs = [1]\n{more}'
    _, unit, plain = with_faults(written, table)
    assert np.array_equal(unit.read(member, 0), plain.read(member, 0))
    wanted = expected(plain.read(member, 1))
    assert np.array_equal(unit.read(member, 1), wanted, equal_nan=member == "elapsed")
    assert not np.array_equal(wanted, plain.read(member, 1), equal_nan=member == "elapsed")


def test_skipped_periods_are_not_stepped_and_elapsed_and_frame_show_it(written):
    table = 'kind = "skip"\ntime = "20 ms"\nduration = "3 ms"\nrigs = [1]'
    flight, unit, _ = with_faults(written, table)
    assert flight.statistics.periods.tolist() == [100, 97]
    assert unit.read("frame", 1)[19:22].tolist() == [19, 23, 24]
    assert unit.read("elapsed", 1)[19:22] == pytest.approx([1e-3, 4e-3, 1e-3])
    assert np.isnan(flight.time[97:, 1]).all()
    assert flight.time[20, 1] == 23 * 1e-3


def test_a_flipped_bit_reaches_the_controller_s_memory(written):
    table = 'kind = "flip"\ntime = "20 ms"\nparameter = "kappa"\nbit = 52\nrigs = [1]'
    text = HEAD + f"[twin]\nrigs = 2\n[[twin.fault]]\n{table}\n"
    scenario = read_twin(written(text))
    unit = balance_unit(scenario, model())
    flight = fly_twin(scenario, unit, Wanted(rigs=(0, 1)), model=model())
    tau = flight.signals["tau"]
    assert (tau[:20, 0] == tau[:20, 1]).all()
    assert (tau[20:, 0] != tau[20:, 1]).any()
    assert unit._params["kappa"][1] in (
        2.0 * unit._params["kappa"][0],
        unit._params["kappa"][0] / 2,
    )
    with pytest.raises(InputError, match="fault flip: the controller has no parameter memory"):
        fly_twin(scenario, Scripted(), model=model())


def test_a_jump_blinds_the_balance_unit_which_says_so(written):
    table = 'kind = "jump"\ntime = "20 ms"\njoint = "q1"\ncounts = 900\nrigs = [1]'
    scenario = read_twin(
        written(HEAD + f"[twin]\nrigs = 2\n[twin.encoder]\n[[twin.fault]]\n{table}")
    )
    unit = balance_unit(scenario, model())
    flight = fly_twin(scenario, unit, Wanted(rigs=(0, 1)), model=model())
    assert (flight.signals["fault"][:, 0] == 0).all()
    assert flight.signals["fault"][20, 1] == 2 << 8
    assert (flight.signals["tau"][20:28, 1] == 0.0).all()
    assert flight.statistics.first_fault.tolist() == [0, 2 << 8]


def test_the_packaged_twins_are_found_after_the_plain_scenarios():
    names = list(scenario_paths())
    twins = [n for n, p in scenario_paths().items() if p.parent.name == "twin"]
    assert twins == names[-len(twins) :] == ["rig-balance-twin", "rig-pushed-twin", "rig-swing-up"]


KEYS = (
    *("steps", "mode", "iae_q1", "iae_q2", "mae2_q1", "mae2_q2", "peak_torque"),
    *("trajectory_sha256", "captured", "time_to_capture"),
)


def test_simulate_flies_a_twin_and_prints_the_keys_of_the_contract(run):
    document = run("simulate", "rig-balance-twin", "--json").document()
    assert set(document) >= set(KEYS)
    assert document["captured"] is True
    assert 0.0 < document["time_to_capture"] < 5.0
    assert 0.0 < document["mae2_q2"] < 0.01
    assert document["limit_violations"] == document["lost_rigs"] == 0
    assert 9950 < document["steps"] < 10_000


def test_pushed_rigs_are_all_caught_again(run):
    document = run("simulate", "rig-pushed-twin", "--json").document()
    assert document["captured_rigs"] == document["rigs"] == 20
    assert document["time_to_capture"] > 5.0  # the second push threw one out
    assert document["lost_rigs"] == document["fault_periods"] == 0
    alone = read_twin("rig-pushed-twin").alone(3)
    flight = fly_twin(alone, balance_unit(alone, model()), model=model())
    assert flight.statistics.mae2.max() <= max(document["mae2_q1"], document["mae2_q2"])


@pytest.mark.target
def test_pil_of_a_twin_has_the_host_s_bits(run, written):
    written(FULL.replace("counts = 300", "counts = 3").replace("rigs = 3\n", "rigs = 2\n"))
    document = run("pil", "flight.toml", "--json").document()
    assert document["differing_bits"] == 0
    assert document["trajectory_sha256"] == document["host_trajectory_sha256"]
    assert document["mode"] == "pil-unicorn"
    again = run("simulate", "flight.toml", "--json").document()
    assert again["trajectory_sha256"] == document["trajectory_sha256"]


def test_a_start_beyond_the_singular_set_is_for_controllers_that_do_more(written, monkeypatch):
    from pfaffian.runtime.twin.files import read

    text = HEAD.replace("[initial]", '[initial]\nq2 = "180 deg"') + "[twin]\n"
    with pytest.raises(InputError, match="the start lies in the singular set"):
        read_twin(written(text))
    monkeypatch.setitem(read.CONTROLLERS, "swing", balance_unit)
    scenario = read_twin(written(text + 'controller = "swing"\n'))
    assert scenario.base.initial["q2"] == pytest.approx(math.pi)
