"""Twins that cannot fly: refused with what, where and what to do, before anything is built."""

import pytest
from pfaffian.runtime.code import generated_model
from support_twin import FULL

#: The passage replaced in FULL, by what, and what the message must say.
REFUSED = {
    "a misspelt table": ("[twin.sampling]", "[twin.samplin]", "twin: unknown key samplin", "mean"),
    "a misspelt key": ("jitter", "jiter", "twin.sampling: unknown key jiter", "mean jitter?"),
    "an unknown controller": (
        'controller = "balance"',
        'controller = "magic"',
        "twin.controller = 'magic' is unknown",
        "known: balance",
    ),
    "no rigs": ("rigs = 3", "rigs = 0", "twin.rigs = 0 is no whole number", "give 1 to 1000000"),
    "half a rig": ("rigs = 3", "rigs = 2.5", "twin.rigs = 2.5 is no whole", "give 1 to"),
    "a negative seed": ("seed = 5", "seed = -5", "twin.seed = -5", "give 0 to"),
    "a bare delay": ('delay = "2 ms"', "delay = 2", "twin.actuator.delay: 2 has no unit", "1.0 s"),
    "a limit in newton": (
        '"1500 mN*m"',
        '"1500 N"',
        "twin.actuator.limit: N has dimension",
        "N*m",
    ),
    "a negative delay": (
        'delay = "2 ms"',
        'delay = "-2 ms"',
        "twin.actuator.delay = -0.002 is out of its bounds",
        "give a value from 0",
    ),
    "torque before its command": (
        '"500 us"',
        '"5 ms"',
        "twin.actuator.delay_spread = 0.005 is beyond the delay",
        "at most the delay",
    ),
    "a converter without a range": (
        'limit = "1500 mN*m"\n',
        "",
        "twin.actuator.bits = 12: a converter has 2 bits or more and a limit",
        "give limit",
    ),
    "a converter of one bit": ("bits = 12", "bits = 1", "twin.actuator.bits = 1:", "give limit"),
    "an unknown actuator": (
        "[twin.sampling]",
        "[twin.actuator.tau9]\n[twin.sampling]",
        "twin.actuator: unknown key tau9",
        "mean tau?",
    ),
    "instants out of order": (
        "jitter = 0.1",
        "jitter = 0.6",
        "twin.sampling.jitter = 0.6 is out of its bounds",
        "give a value from 0 to 0.4",
    ),
    "an unlikely probability": ("missed = 0.01", "missed = 2", "missed = 2 is out", "0 to 0.5"),
    "a counter of four bits": (
        "counter_bits = 16",
        "counter_bits = 4",
        "twin.encoder.counter_bits = 4 is no whole number from 8 to 32",
        "give 8 to 32",
    ),
    "no direction": (
        "direction = -1",
        "direction = 0",
        "twin.encoder.q2.direction = 0 is no direction",
        "give 1 or -1",
    ),
    "a count of no size": (
        'quantum = "1 mrad"',
        'quantum = "0 rad"',
        "twin.encoder.q2.quantum = 0 is out of its bounds",
        "above 0",
    ),
    "less stiction than friction": (
        'stiction = "0.002 N*m"',
        'stiction = "0.0002 N*m"',
        "twin.friction.q1.stiction = 0.0002 is out of its bounds",
        "from 0.001",
    ),
    "friction without a layer": (
        'layer = "0.1 rad/s"\n',
        "",
        "twin.friction.q1: missing layer",
        "add layer",
    ),
    "friction on no joint": (
        "friction.q1",
        "friction.q7",
        "twin.friction: unknown key q7",
        "known: q1",
    ),
    "a spread of no parameter": (
        "theta1 = 0.05",
        "theta9 = 0.05",
        "twin.spread.plant: unknown key theta9",
        "mean theta",
    ),
    "a spread beyond everything": (
        "theta1 = 0.05",
        "theta1 = 1.5",
        "twin.spread.plant.theta1 = 1.5 is out of its bounds",
        "from 0 to 0.9",
    ),
    "a spread that leaves no mechanism": (
        "theta1 = 0.05",
        "theta1 = 0.8",
        "twin.spread.plant: the mass matrix is not positive definite",
        "check the inertias",
    ),
    "a disturbance of no shape": (
        'shape = "sine"',
        'shape = "square"',
        "twin.disturbance[1].shape = 'square' is unknown",
        "known: constant, sine, step, pulse",
    ),
    "a sine without a frequency": (
        'frequency = "2 Hz"\n',
        "",
        "twin.disturbance[1]: missing frequency",
        "add frequency",
    ),
    "a push on no joint": (
        'joint = "q2"\ntime = "20 ms"',
        'joint = "q3"\ntime = "20 ms"',
        "twin.push[1].joint = 'q3' is unknown",
        "known: q1, q2",
    ),
    "a push of nothing": (
        'impulse = "0.001 N*m*s"',
        "",
        "twin.push[1]: needs either impulse or force",
        "give an impulse",
    ),
    "a force for no time": (
        'duration = "5 ms"\n',
        "",
        "twin.push[2]: missing duration",
        "add duration",
    ),
    "an impulse in newton metres": (
        '"0.001 N*m*s"',
        '"0.001 N*m"',
        "twin.push[1].impulse: N*m has dimension",
        "N*m*s",
    ),
    "an unknown fault": (
        'kind = "jump"',
        'kind = "jmp"',
        "twin.fault[1].kind = 'jmp' is unknown",
        "mean jump?",
    ),
    "a jump of no size": ("counts = 300\n", "", "twin.fault[1]: missing counts", "add counts"),
    "a flip of no bit": (
        'kind = "jump"',
        'kind = "flip"\nparameter = "kappa"',
        "twin.fault[1]: missing bit",
        "add bit",
    ),
    "a flip of no parameter": (
        'kind = "jump"',
        'kind = "flip"\nbit = 3\nparameter = "kapa"',
        "twin.fault[1].parameter = 'kapa' is unknown",
        "mean kappa?",
    ),
    "a fault in no rig": (
        "rigs = [1]",
        'rigs = ["all"]',
        "twin.fault[1].rigs is no list of rigs",
        "rigs = [0, 3]",
    ),
    "an unknown order": (
        'value = "start"',
        'value = "go"',
        "twin.command[1].value = 'go' is unknown",
        "known: start, stop, reset",
    ),
    "one push instead of several": (
        '[[twin.command]]\ntime = "10 ms"\nvalue = "start"',
        '[twin.command]\ntime = "10 ms"\nvalue = "start"',
        "twin.command must be an array of tables",
        "[[twin.command]]",
    ),
    "too coarse a plant": (
        "plant_substeps = 4",
        "plant_substeps = 3",
        "plant_substeps = 3 are too few for a twin",
        "take 4 or more",
    ),
}


def _too_early(*_):
    raise AssertionError("built before the scenario was judged")


@pytest.mark.parametrize("what", REFUSED)
def test_a_twin_is_refused_before_anything_is_built(what, written, refused, monkeypatch):
    right, wrong, *says = REFUSED[what]
    assert FULL.count(right) == 1
    written(FULL.replace(right, wrong))
    monkeypatch.setattr(generated_model, "compile_image", _too_early)
    refused("simulate", "flight.toml", says=("flight.toml", *says))
