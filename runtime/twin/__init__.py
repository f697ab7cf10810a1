"""The digital twin: N rigs with their drives, encoders, clocks and faults, flown by a controller.

    from pfaffian.runtime.twin import Twin, balance_unit, read_twin

    scenario = read_twin("rig-balance-twin")
    twin = Twin(scenario)
    flight = twin.fly(balance_unit(scenario, twin.model))

The plant is the generated C. What decides a bit outside of it uses + - * / alone, and uniform
draws: a flight has the same bits on every machine.
"""

from pfaffian.runtime.twin.files.read import read_twin as read_twin
from pfaffian.runtime.twin.flight import Twin as Twin
from pfaffian.runtime.twin.flight import fly_twin as fly_twin
from pfaffian.runtime.twin.recording import Flight as Flight
from pfaffian.runtime.twin.recording import Wanted as Wanted
from pfaffian.runtime.twin.recording import differing_bits as differing_bits
from pfaffian.runtime.twin.rig import plant_model as plant_model
from pfaffian.runtime.twin.settings import TwinScenario as TwinScenario
from pfaffian.runtime.twin.statistics import Statistics as Statistics
from pfaffian.runtime.twin.unit import Command as Command
from pfaffian.runtime.twin.unit import ControlUnit as ControlUnit
from pfaffian.runtime.twin.unit import FlippableUnit as FlippableUnit
from pfaffian.runtime.twin.unit import Reading as Reading
from pfaffian.runtime.twin.units.balance import BalanceUnit as BalanceUnit
from pfaffian.runtime.twin.units.balance import StateFeedbackUnit as StateFeedbackUnit
from pfaffian.runtime.twin.units.balance import balance_unit as balance_unit
