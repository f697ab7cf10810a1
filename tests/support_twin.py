"""Units and scenarios for the tests of the twin."""

from dataclasses import replace
from functools import cache

import numpy as np
from pfaffian.runtime.code.generated_model import open_generated
from pfaffian.runtime.flight.scenario import read_scenario
from pfaffian.runtime.twin import TwinScenario, plant_model
from pfaffian.runtime.twin.unit import Command

HEAD = """
model = "pendubot"
set = "rig"
duration = "100 ms"
plant_substeps = 4

[initial]
q1 = "1.5 rad"
"""
FULL = (
    HEAD
    + """
[twin]
controller = "balance"
rigs = 3
seed = 5

[twin.tolerance]
q1 = "10 deg"

[twin.actuator]
limit = "1500 mN*m"
time_constant = "0.5 ms"
delay = "2 ms"
delay_spread = "500 us"
slew = "1000 N*m/s"
bits = 12

[twin.sampling]
jitter = 0.1
missed = 0.01

[twin.encoder]
counts_per_turn = 4096
counter_bits = 16
offset_spread = "1 mrad"
noise = 1
dropout = 0.01

[twin.encoder.q2]
quantum = "1 mrad"
direction = -1

[twin.friction.q1]
coulomb = "0.001 N*m"
stiction = "0.002 N*m"
layer = "0.1 rad/s"

[twin.spread.plant]
theta1 = 0.05
joint2_viscous = 0.5

[twin.spread.initial]
q1 = "1 deg"

[[twin.disturbance]]
joint = "q1"
shape = "sine"
amplitude = "0.01 N*m"
frequency = "2 Hz"
phase = "180 deg"

[[twin.push]]
joint = "q2"
time = "20 ms"
impulse = "0.001 N*m*s"

[[twin.push]]
joint = "q2"
time = "30 ms"
force = "0.01 N*m"
duration = "5 ms"

[[twin.fault]]
kind = "jump"
time = "50 ms"
joint = "q1"
counts = 300
rigs = [1]

[[twin.command]]
time = "10 ms"
value = "start"
"""
)


@cache
def model(name="pendubot"):
    return plant_model(open_generated(name))


def twin(seconds=1.0, name="rig-balance", substeps=4, plant=None, initial=None, **more):
    """Return the scenario `name` on a twin without any imperfection but those in `more`."""
    base = read_scenario(name)
    base = replace(
        base,
        steps=round(seconds / base.sample_time),
        plant_substeps=substeps,
        plant=base.plant | (plant or {}),
        initial=base.initial | (initial or {}),
    )
    return TwinScenario(base=base, **more)


class Scripted:
    """Commands what it is told, `torque` (turns,) or a number, and remembers what it read."""

    def __init__(self, torque=0.0, width=1):
        self.torque, self.width, self.readings = torque, width, []

    def start(self, count):
        self.count = count

    def step(self, reading):
        turn = len(self.readings)
        self.readings.append(reading)
        value = self.torque if np.isscalar(self.torque) else self.torque[turn]
        n = reading.counts.shape[1]
        return Command(
            np.full((self.count, self.width), value),
            np.zeros(self.count, np.uint32),
            np.zeros(self.count, np.uint32),
            reading.truth[:, :n],
            reading.truth[:, n:],
        )

    def read(self, name, rig=0):
        """Return one member of all readings, (turns, ...)."""
        return np.array([getattr(r, name)[rig] for r in self.readings])
