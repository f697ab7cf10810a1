"""The controllers that a scenario on the twin can name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pfaffian.runtime.generated_model import GeneratedModel
from pfaffian.runtime.twin.complete import complete_unit
from pfaffian.runtime.twin.control import ControlUnit
from pfaffian.runtime.twin.settings import TwinScenario
from pfaffian.runtime.twin.units import balance_unit

#: Controllers by name: (scenario, the model on the host, machine) to unit.
CONTROLLERS: Mapping[str, Callable[[TwinScenario, GeneratedModel, str], ControlUnit]] = {
    "balance": balance_unit,
    "complete": complete_unit,
}
