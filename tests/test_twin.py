"""The twin: exact without imperfections, each imperfection what it says, the same bits always."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pfaffian.runtime.base.errors import CheckError, InputError
from pfaffian.runtime.code.sensing import Encoder
from pfaffian.runtime.flight.closed_loop import fly
from pfaffian.runtime.twin import Twin, Wanted, balance_unit, fly_twin
from pfaffian.runtime.twin.rig import Rigs
from pfaffian.runtime.twin.settings import (
    Channel,
    Disturbance,
    Drive,
    DryFriction,
    Order,
    Push,
    Sampling,
)
from support_twin import Scripted, model, twin

#: Everything that is random or late at once.
EVERYTHING = {
    "drives": {"tau": Drive(2.0, 5e-4, 5e-4, 5e-4, 2000.0, 12)},
    "sampling": Sampling(0.3, 0.05),
    "channels": {n: Channel(Encoder(5000.0, counter_bits=16), 1e-3, 1, 0.02) for n in ("q1", "q2")},
    "frictions": (DryFriction("q2", 1e-4, 2e-4, 0.5, 0.2),),
    "spread": {"theta1": 0.05, "theta4": 0.05, "joint1_viscous": 0.5},
    "initial_spread": {"q1": 0.05, "dq2": 0.1},
    "disturbances": (Disturbance("q1", "sine", 0.01, frequency=3.0),),
    "pushes": (Push("q2", 0.2, impulse=1e-4),),
}


def balance(scenario):
    return balance_unit(scenario, model())


def bits(array):
    return np.ascontiguousarray(array).view(np.uint64)


def test_without_imperfections_the_twin_is_the_existing_flight_bit_for_bit():
    scenario = twin(3.0, substeps=10)
    flight = fly_twin(scenario, balance(scenario), model=model())
    known = fly(scenario.base, model(), model(), "host")
    for name in ("q1", "q2", "dq1", "dq2"):
        assert (bits(flight.signals[name][:, 0]) == bits(known.measured[name])).all()
    for name in ("tau", "p1", "p2", "p3", "s", "adb"):
        assert (bits(flight.signals[name][:, 0]) == bits(known.output[name])).all()
    assert (flight.time[:, 0] == known.time).all()
    assert (flight.signals["energy"][:, 0] == known.energy).all()
    error = np.abs(known.errors()["q1"])
    assert flight.statistics.iae[0, 0] == pytest.approx(np.trapezoid(error, known.time), rel=1e-12)
    assert flight.statistics.mae[0, 0] == error.max()
    assert flight.statistics.mae2[0, 0] == error[known.time >= known.time[-1] - 2.0].max()
    assert flight.statistics.peak_torque[0, 0] == np.abs(known.output["tau"]).max()


def substeps_of(drive, commands):
    """Return the mean torque on the shaft in each substep, and behind the lag at its end."""
    scenario = twin(1.0, drives={"tau": drive})
    rigs, one = Rigs(scenario, model()), np.ones(1, np.uint32)
    applied, behind = [], []
    for k, command in enumerate(commands):
        rigs.advance(one * np.uint32(k), one, np.array([[command]]))
        applied.append(rigs.applied[0, 0])
        behind.append(rigs._drive["torque"][0, 0])
    return np.array(applied), np.array(behind)


@pytest.mark.parametrize("delay", [0, 1, 3, 7, 20])
def test_a_delay_shifts_the_torque_by_exactly_its_substeps(delay):
    commands = np.sin(np.arange(60.0))
    applied, _ = substeps_of(Drive(delay=delay * 0.25e-3), commands)
    assert (applied[:delay] == 0.0).all()
    assert (applied[delay:] == commands[: 60 - delay]).all()


@pytest.mark.parametrize("milliseconds", [1, 2, 5])
def test_a_delay_of_whole_periods_shifts_what_a_controller_commands(milliseconds):
    scenario = twin(0.1, drives={"tau": Drive(delay=milliseconds * 1e-3)})
    flight = fly_twin(scenario, Scripted(0.1 * np.cos(np.arange(100.0))), model=model())
    commanded, applied = flight.signals["tau"][:, 0], flight.signals["tau_applied"][:, 0]
    assert (applied[:milliseconds] == 0.0).all()
    assert (applied[milliseconds:] == commanded[:-milliseconds]).all()


def test_a_lag_is_the_exponential_and_its_mean_acts():
    constant, h = 1.7e-3, 0.25e-3
    applied, behind = substeps_of(Drive(time_constant=constant), np.ones(40))
    k = np.arange(1, 41)
    assert behind == pytest.approx(1.0 - np.exp(-k * h / constant), rel=1e-13)
    mean = 1.0 - np.exp(-(k - 1) * h / constant) * (1.0 - math.exp(-h / constant)) * constant / h
    assert applied == pytest.approx(mean, rel=1e-12)


def test_a_drive_slews_by_its_rate_and_then_arrives_exactly():
    applied, _ = substeps_of(Drive(slew=400.0), [0.35] * 6)  # 0.1 N m a substep
    assert applied[:3] == pytest.approx([0.1, 0.2, 0.3], rel=1e-14)
    assert (applied[3:] == 0.35).all()


def test_a_converter_rounds_to_its_codes_and_stays_among_them():
    commands = [0.0, 0.124, 0.126, -0.126, 0.376, 0.99, 1.5, -1.5, math.nan, math.inf, -math.inf]
    applied, _ = substeps_of(Drive(limit=1.0, bits=3), commands)  # codes -4 to 3 of 0.25 N m
    wanted = [0.0, 0.0, 0.25, -0.25, 0.5, 0.75, 0.75, -1.0, 0.0, 0.75, -1.0]
    assert applied.tolist() == wanted


def test_a_motor_gives_its_limit_at_most():
    applied, _ = substeps_of(Drive(limit=0.5), [0.4, 0.6, -3.0, math.nan])
    assert applied.tolist() == [0.4, 0.5, -0.5, 0.0]


def test_jitter_keeps_to_its_bounds_and_to_the_period_in_the_mean():
    scenario = twin(4.0, substeps=20, rigs=2, sampling=Sampling(jitter=0.2))
    unit = Scripted()
    flight = fly_twin(scenario, unit, Wanted(rigs=(0, 1)), model=model())
    for rig in range(2):
        moved = flight.time[:, rig] - np.arange(4000) * 1e-3
        assert moved[0] == 0.0
        assert np.abs(moved).max() == pytest.approx(0.2e-3, rel=1e-6)
        assert abs(moved.mean()) < 4.0 * 0.2e-3 / math.sqrt(3 * 4000)
        assert moved.std() == pytest.approx(0.2e-3 * math.sqrt(1 / 3 + 1 / 12), rel=0.05)
        elapsed = unit.read("elapsed", rig)
        assert elapsed[0] == 1e-3
        assert elapsed[1:] == pytest.approx(np.diff(flight.time[:, rig]), abs=1e-12)
        assert elapsed.mean() == pytest.approx(1e-3, rel=1e-4)
    assert (flight.time[1:, 0] != flight.time[1:, 1]).mean() > 0.7


def test_a_flight_beyond_the_counter_of_substeps_is_refused():
    with pytest.raises(InputError, match="2500000000 substeps are more than a twin counts"):
        Twin(twin(10_000.0, substeps=250), model())


def test_missed_samples_are_as_many_as_told_and_elapsed_shows_them():
    scenario = twin(5.0, sampling=Sampling(missed=0.1))
    unit = Scripted(0.02)
    flight = fly_twin(scenario, unit, model=model())
    turns = int(flight.statistics.periods[0])
    assert abs(5000 - turns - 500) < 4.0 * math.sqrt(5000 * 0.09)
    frames, elapsed = unit.read("frame").astype(int)[:turns], unit.read("elapsed")[:turns]
    assert elapsed[1:] == pytest.approx(1e-3 * np.diff(frames), rel=1e-12)
    assert set(np.diff(frames)) >= {1, 2, 3}


def test_energy_falls_by_what_friction_takes():
    """E(0) - E(t) is the integral of F v: viscous in the model, dry beside it."""
    friction = DryFriction("q2", coulomb=1e-3, stiction=1e-3, stribeck=1.0, layer=0.3)
    scenario = twin(
        2.0,
        substeps=8,
        plant={"joint1_viscous": 2e-3, "joint2_viscous": 0.0},
        initial={"q1": -1.0, "q2": 0.3},
        frictions=(friction,),
    )
    flight = fly_twin(scenario, Scripted(), model=model())
    energy, rate1, rate2 = (flight.signals[n][:, 0] for n in ("energy", "dq1", "dq2"))
    power = 2e-3 * rate1**2 + 1e-3 * np.clip(rate2 / 0.3, -1.0, 1.0) * rate2
    lost = np.concatenate([[0.0], np.cumsum(0.5e-3 * (power[1:] + power[:-1]))])
    assert lost[-1] > 0.02
    assert np.abs(energy[0] - energy - lost).max() < 2e-3 * lost[-1]


def test_stiction_holds_a_joint_that_coulomb_friction_lets_go():
    def turned(stiction):
        friction = DryFriction("q1", 0.1, stiction, stribeck=0.05, layer=0.02)
        still = {"q1": -math.pi / 2, "q2": 0.0}
        scenario = twin(1.0, initial=still, substeps=100, frictions=(friction,))
        flight = fly_twin(scenario, Scripted(0.15), model=model())
        return abs(flight.signals["q1"][-1, 0] + math.pi / 2)

    assert turned(0.2) < 0.02 < 0.05 < turned(0.1)


def test_a_layer_too_thin_for_the_substep_is_refused():
    scenario = twin(1.0, frictions=(DryFriction("q1", 0.5, 0.5, 0.1, 1e-3),))
    with pytest.raises(InputError, match=r"friction\.q1: layer = 0.001 is too thin") as refused:
        Rigs(scenario, model())
    assert "plant_substeps" in refused.value.remedy


def mass_matrix(plant, q2):
    """M of (1), by hand."""
    a, b, c = (plant[n] for n in ("theta1", "theta2", "theta3"))
    return np.array(
        [
            [a + b + 2 * c * math.cos(q2), b + c * math.cos(q2)],
            [b + c * math.cos(q2), b],
        ]
    )


@pytest.mark.parametrize("joint", ["q1", "q2"])
def test_a_push_changes_the_rates_by_the_inverse_mass_matrix_times_the_impulse(joint):
    impulse, rates = 3e-3, {}
    for size in (0.0, impulse):
        pushes = (Push(joint, 1e-3, impulse=size),) if size else ()
        scenario = twin(2e-3, substeps=1000, initial={"q2": 0.7}, pushes=pushes)
        rigs, one = Rigs(scenario, model()), np.ones(1, np.uint32)
        for start, count in ((0, 1000), (1000, 1)):
            rigs.advance(one * np.uint32(start), one * np.uint32(count), np.zeros((1, 1)))
        rates[size] = rigs.truth[0, 2:].copy()
    unit = np.array([1.0, 0.0]) if joint == "q1" else np.array([0.0, 1.0])
    wanted = np.linalg.solve(mass_matrix(scenario.base.plant, 0.7), unit * impulse)
    assert rates[impulse] - rates[0.0] == pytest.approx(wanted, rel=2e-4)


def test_a_short_force_is_nearly_its_impulse():
    ends = []
    for push in (Push("q2", 0.01, impulse=1e-3), Push("q2", 0.009, force=0.5, duration=2e-3)):
        scenario = twin(0.02, substeps=20, pushes=(push,))
        flight = fly_twin(scenario, Scripted(), model=model())
        ends.append(flight.signals["dq2"][-1, 0])
    assert ends[0] == pytest.approx(ends[1], rel=0.02)
    assert abs(ends[0]) > 0.1


WINDOWS = {
    "constant": (Disturbance("q1", "constant", 0.03), range(200)),
    "step": (Disturbance("q1", "step", 0.03, start=0.05), range(50, 200)),
    "pulse": (Disturbance("q1", "pulse", 0.03, start=0.05, end=0.12), range(50, 120)),
}


@pytest.mark.parametrize("shape", WINDOWS)
def test_a_disturbance_on_the_motor_s_joint_is_torque_in_its_window(shape):
    disturbance, window = WINDOWS[shape]
    disturbed = fly_twin(twin(0.2, disturbances=(disturbance,)), Scripted(), model=model())
    torque = np.array([0.03 if k in window else 0.0 for k in range(200)])
    driven = fly_twin(twin(0.2), Scripted(torque), model=model())
    for name in ("q1", "q2", "dq1", "dq2"):
        assert (disturbed.signals[name] == driven.signals[name]).all()


def test_a_disturbance_on_the_passive_joint_is_the_model_s_load():
    disturbed = fly_twin(
        twin(0.2, disturbances=(Disturbance("q2", "constant", 0.002),)), Scripted(), model=model()
    )
    loaded = fly_twin(twin(0.2, plant={"joint2_load": -0.002}), Scripted(), model=model())
    assert (disturbed.signals["q2"] == loaded.signals["q2"]).all()


def test_a_sine_is_a_sine():
    one, rate, h = np.ones(1, np.uint32), 7.0, 0.25e-3
    sine = Disturbance("q1", "sine", 0.05, frequency=rate, phase=0.2)
    disturbed, driven = (Rigs(s, model()) for s in (twin(disturbances=(sine,)), twin()))
    for k in range(2000):
        torque = 0.05 * math.sin(2 * math.pi * (rate * (k + 0.5) * h + 0.2))
        disturbed.advance(one * np.uint32(k), one, np.zeros((1, 1)))
        driven.advance(one * np.uint32(k), one, np.array([[torque]]))
    assert disturbed.truth == pytest.approx(driven.truth, rel=1e-9)


def test_a_force_that_finds_no_way_in_is_refused():
    scenario = twin(0.1, "chain-balance", pushes=(Push("q3", 0.05, impulse=1e-3),))
    with pytest.raises(InputError, match="chain has neither a motor nor a load on q3") as refused:
        Rigs(scenario, model("chain"))
    assert "q3_load" in refused.value.remedy


#: Whether a joint is loaded, and not driven by a motor that acts on it alone.
LOADED = {
    ("rig-balance", "q1"): False,
    ("rig-balance", "q2"): True,
    ("crane-transport", "x"): False,
    ("crane-transport", "theta"): True,
    ("two-wheeled-balance", "phi"): True,  # its motor acts on both
    ("two-wheeled-balance", "psi"): True,
}


@pytest.mark.parametrize(("name", "joint"), LOADED)
def test_motors_are_told_from_passive_joints_by_the_plant(name, joint):
    scenario = twin(0.1, name, disturbances=(Disturbance(joint, "constant", 0.1),))
    rigs = Rigs(scenario, model(scenario.base.folder.manifest.model))
    assert bool(rigs._forces["is_load"][0]) is LOADED[name, joint]


def test_the_same_seed_gives_the_same_bits_and_another_one_others():
    scenario = twin(0.5, rigs=3, seed=7, **EVERYTHING)
    first, again = (fly_twin(scenario, balance(scenario), model=model()) for _ in range(2))
    assert first.sha256() == again.sha256()
    other = fly_twin(replace(scenario, seed=8), balance(scenario), model=model())
    assert not set(other.digests) & set(first.digests)


def test_rigs_fly_together_as_each_flies_alone_and_threads_change_nothing():
    scenario = twin(0.5, rigs=3, seed=7, **EVERYTHING)
    together = fly_twin(scenario, balance(scenario), Wanted(rigs=(0, 1, 2)), model=model())
    assert len(set(together.digests)) == 3
    for rig in range(3):
        one = scenario.alone(rig)
        alone = fly_twin(one, balance(one), model=model())
        assert alone.sha256() == together.digests[rig]
        turns = int(alone.statistics.periods[0])
        for name in ("q1", "tau_applied", "counts_q2"):
            assert (alone.signals[name][:turns, 0] == together.signals[name][:turns, rig]).all()
        for name, value in vars(alone.statistics).items():
            whole = getattr(together.statistics, name)[rig]
            assert np.array_equal(value[0], whole, equal_nan=True), name
    split = fly_twin(scenario, balance(scenario), model=model(), threads=2)
    assert split.digests == together.digests


def test_counts_are_the_encoder_s_with_offset_noise_and_a_wrap():
    encoder = Encoder(5000.0, offset=0.1, counter_bits=12, counter_zero=9, direction=-1)
    channels = {"q1": Channel(encoder), "q2": Channel(Encoder(4096.0), 0.01, noise=2)}
    scenario = twin(1.0, rigs=2, channels=channels, initial={"dq1": 20.0})
    unit = Scripted()
    fly_twin(scenario, unit, model=model())
    truth, counts = unit.read("truth", 1), unit.read("counts", 1)
    assert (counts[:, 0] == encoder.raw(truth[:, 0])).all()
    assert np.abs(np.diff(counts[:, 0].astype(int))).max() > 4000  # it wrapped
    off = counts[:, 1].astype(np.int32) - Encoder(4096.0).counts(truth[:, 1])
    bias = 0.01 * 4096 / (2 * math.pi)
    assert len(set(off)) >= 4
    assert np.ptp(off) <= 5
    assert 0.0 < abs(off.mean() + 0.5) < bias + 0.6


def test_dropouts_are_as_many_as_told():
    channels = {"q1": Channel(dropout=0.2), "q2": Channel()}
    unit = Scripted()
    fly_twin(twin(3.0, channels=channels), unit, model=model())
    valid = unit.read("valid")
    assert abs((valid[:, 0] == 0).mean() - 0.2) < 4.0 * math.sqrt(0.16 / 3000)
    assert (valid[:, 1] == 1).all()


def test_orders_of_the_operator_are_seen_once():
    orders = (Order(0.0, "start"), Order(0.02, "stop"), Order(0.03, "reset"))
    unit = Scripted()
    fly_twin(twin(0.05, orders=orders), unit, model=model())
    seen = unit.read("command")
    assert {int(k): int(seen[k]) for k in np.flatnonzero(seen)} == {0: 1, 20: 2, 30: 3}


def test_a_plant_that_flies_off_is_stopped_and_counted():
    flight = fly_twin(twin(0.5), Scripted(1e9), model=model())
    assert flight.statistics.lost.tolist() == [1]
    assert not flight.statistics.captured[0]
    assert all(np.isfinite(flight.signals[n]).all() for n in ("q1", "dq2", "energy"))


def test_a_torque_that_is_no_number_is_a_violation_and_moves_nothing():
    flight = fly_twin(twin(0.05), Scripted(math.nan), model=model())
    still = fly_twin(twin(0.05), Scripted(0.0), model=model())
    assert flight.statistics.violations[0] == 50
    assert (flight.signals["q1"] == still.signals["q1"]).all()
    assert fly_twin(twin(0.05), Scripted(5.0), model=model()).statistics.violations[0] == 50


def test_a_command_of_another_shape_is_refused():
    with pytest.raises(CheckError, match="torque has shape"):
        Twin(twin(0.05), model()).fly(Scripted(0.0, width=2))


def test_a_recording_keeps_what_was_wanted():
    scenario = twin(0.1, rigs=3, initial_spread={"q1": 0.01})
    wanted = Wanted(rigs=(2, 0), every=10, signals=("q1", "tau"))
    flight = fly_twin(scenario, balance(scenario), wanted, model=model())
    assert flight.rigs == (2, 0)
    assert flight.time.shape == (10, 2)
    assert set(flight.signals) == {"q1", "tau"}
    assert flight.signals["q1"][0, 0] != flight.signals["q1"][0, 1]
    for bad, match in ((Wanted(signals=("q9",)), "no signal q9"), (Wanted(rigs=(3,)), "rigs")):
        with pytest.raises(InputError, match=match):
            fly_twin(scenario, balance(scenario), bad, model=model())
