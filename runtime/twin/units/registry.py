"""The controllers that a scenario on the twin can name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pfaffian.runtime.code.generated_model import GeneratedModel
from pfaffian.runtime.twin.settings import TwinScenario
from pfaffian.runtime.twin.unit import ControlUnit
from pfaffian.runtime.twin.units.balance import balance_unit
from pfaffian.runtime.twin.units.complete import complete_unit

#: Controllers by name: (scenario, the model on the host, machine) to unit.
CONTROLLERS: Mapping[str, Callable[[TwinScenario, GeneratedModel, str], ControlUnit]] = {
    "balance": balance_unit,
    "complete": complete_unit,
}
