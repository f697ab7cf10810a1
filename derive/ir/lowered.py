"""The lowered model: all that emission and the parameter checks need, free of SymPy and CasADi."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from pfaffian.derive.ir.own_names import OwnNames, own_names
from pfaffian.derive.ir.parameter import Parameter
from pfaffian.derive.ir.program import Program, program_from_json, program_to_json


@dataclass(frozen=True)
class CoordinateInterface:
    """A coordinate as the generated code sees it: name, unit, meaning and accepted domain."""

    name: str
    unit: str
    description: str
    bound: float
    rate_bound: float


@dataclass(frozen=True)
class ActuatorInterface:
    """An actuator as the generated code sees it."""

    name: str
    unit: str
    description: str


@dataclass(frozen=True)
class PassReport:
    """Operations of one program before and after one optimiser pass."""

    program: str
    name: str
    before: int
    after: int


@dataclass(frozen=True)
class LoweredModel:
    """Programs, declarations and readable documents of one model; `sha256` identifies it.

    `passes` says what the optimiser did to the emitted programs. `limits` names the parameter that
    limits each actuator, `slews` that which limits its rate of change, if any does. `elementary`
    holds the coefficients of the elementary functions, ready for their templates. `plant_sha256`
    identifies the equations of motion alone, as plans do.
    """

    name: str
    title: str
    source: str
    coordinates: tuple[CoordinateInterface, ...]
    actuators: tuple[ActuatorInterface, ...]
    parameters: tuple[Parameter, ...]
    limits: tuple[str, ...]
    slews: tuple[str, ...]
    programs: tuple[Program, ...]
    passes: tuple[PassReport, ...]
    documents: tuple[tuple[str, str], ...]
    tools: tuple[tuple[str, str], ...]
    elementary: Mapping[str, Any]
    sha256: str
    plant_sha256: str

    @property
    def own(self) -> OwnNames:
        """Return the names of what the laws compute, as the programs have them."""
        return own_names(self)

    def program(self, name: str) -> Program:
        """Return the program called `name`; raise `KeyError` if the model has none."""
        for program in self.programs:
            if program.name == name:
                return program
        raise KeyError(name)

    def has_program(self, name: str) -> bool:
        """Return whether the model has a program called `name`."""
        return any(program.name == name for program in self.programs)

    def parameters_of(self, name: str) -> tuple[Parameter, ...]:
        """Return the declared parameters that program `name` takes."""
        taken = {s.name for s in self.program(name).inputs if s.group == "parameter"}
        return tuple(p for p in self.parameters if p.name in taken)


def lowered_to_json(model: LoweredModel) -> str:
    """Return `model` as one line of JSON."""
    document = {k: v for k, v in vars(model).items() if k not in ("programs", "parameters")}
    document["coordinates"] = [asdict(c) for c in model.coordinates]
    document["actuators"] = [asdict(a) for a in model.actuators]
    document["parameters"] = [asdict(p) for p in model.parameters]
    document["passes"] = [asdict(p) for p in model.passes]
    document["programs"] = [program_to_json(p) for p in model.programs]
    return json.dumps(document, separators=(",", ":"), sort_keys=True)


def lowered_from_json(text: str) -> LoweredModel:
    """Rebuild the model that `lowered_to_json` wrote."""
    d = json.loads(text)
    return LoweredModel(
        name=d["name"],
        title=d["title"],
        source=d["source"],
        sha256=d["sha256"],
        plant_sha256=d["plant_sha256"],
        elementary=d["elementary"],
        coordinates=tuple(CoordinateInterface(**c) for c in d["coordinates"]),
        actuators=tuple(ActuatorInterface(**a) for a in d["actuators"]),
        parameters=tuple(Parameter(**p) for p in d["parameters"]),
        limits=tuple(d["limits"]),
        slews=tuple(d["slews"]),
        passes=tuple(PassReport(**p) for p in d["passes"]),
        programs=tuple(program_from_json(p) for p in d["programs"]),
        documents=tuple((k, v) for k, v in d["documents"]),
        tools=tuple((k, v) for k, v in d["tools"]),
    )
