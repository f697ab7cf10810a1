"""The manifest of a generated model: the contract between generated code and this runtime."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from pfaffian.runtime.base.errors import InputError

#: Version of the layout of generated structures and functions; `runtime/c` checks it too.
ABI_VERSION = 3
MANIFEST_NAME = "manifest.json"
#: Roles in the order in which `pf_sizeof` of the harness numbers them.
ROLES = (
    "params",
    "input",
    "state",
    "output",
    "continuous_state",
    "continuous_output",
    "plant_params",
    "plant_state",
    "plant_input",
    "plant_rate",
)
#: Roles of structures that only some models have, numbered on from `ROLES`.
OPTIONAL_ROLES = ("swing_up_output", "reference")
#: C types of structure members, by the NumPy type of their bytes.
MEMBER_TYPES = {"double": "f8", "float": "f4", "uint32_t": "u4"}
#: The NumPy type of a real number by the precision of the C code.
REAL_TYPES = {"double": "f8", "single": "f4"}


@dataclass(frozen=True)
class Field:
    """A structure member: name, C type (`double`, `float` or `uint32_t`), unit and meaning."""

    name: str
    type: str
    unit: str
    description: str


@dataclass(frozen=True)
class Structure:
    """A generated C structure with its members in order."""

    name: str
    fields: tuple[Field, ...]

    def names(self) -> tuple[str, ...]:
        """Return the names of the members in order."""
        return tuple(f.name for f in self.fields)


@dataclass(frozen=True)
class Manifest:
    """What one generation consists of; written by the emitter, read by the runtime.

    `baked` names the parameter set that is folded into the step; it is empty where none is. `plans`
    names the parameter sets whose planned motion is there, in the order of the harness.
    `control_structures` are those of the complete controller, by role, some members structures
    themselves; `control_sets` its constants by parameter set. Both are empty where there is none.
    `own_names` are the members of the law whose usual name the plant has, by that usual name.
    """

    abi: int
    model: str
    title: str
    source: str
    model_sha256: str
    parameters_sha256: str
    tools: Mapping[str, str]
    coordinates: tuple[str, ...]
    actuators: tuple[str, ...]
    limits: tuple[str, ...]
    status: tuple[str, ...]
    structures: Mapping[str, Structure]
    parameters: tuple[Field, ...]
    parameter_sets: Mapping[str, Mapping[str, float]]
    set_titles: Mapping[str, str]
    domain: Mapping[str, float]
    operations: Mapping[str, int]
    baked: str
    files: Mapping[str, str]
    precision: str = "double"
    control_structures: Mapping[str, Structure] = field(default_factory=dict)
    control_sets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    plans: tuple[str, ...] = ()
    own_names: Mapping[str, str] = field(default_factory=dict)

    def own(self, name: str) -> str:
        """Return the member that holds what the law calls `name`: `s`, `beta`, `p1`, `engaged`.

        It is `name` itself, unless the plant has that name already and ours gave way.
        """
        return self.own_names.get(name, name)

    def numbered(self, base: str) -> tuple[str, ...]:
        """Return the members of `base` by servo-constraint: itself for one, numbered for more."""
        count = len(self.actuators)
        bare = [base] if count == 1 else [f"{base}{k + 1}" for k in range(count)]
        return tuple(self.own(name) for name in bare)

    def of_actuator(self, base: str, actuator: str) -> str:
        """Return the member of `base` that belongs to `actuator`: `p1`, or `p1_thrust`."""
        return self.own(base if len(self.actuators) == 1 else f"{base}_{actuator}")

    @property
    def real(self) -> str:
        """Return the NumPy type of a real number of the C code."""
        return REAL_TYPES[self.precision]

    def to_json(self) -> str:
        """Return the manifest as JSON; floats are written so that they read back to the bit."""
        document = asdict(self)
        if not self.plans:
            del document["plans"]
        if not self.own_names:
            del document["own_names"]
        return json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of the generated model in `folder`.

    Raises `InputError` where there is none, it is malformed, or its ABI is another one.
    """
    path = folder / MANIFEST_NAME
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        structures = _structures(document.pop("structures"))
        document["control_structures"] = _structures(document.get("control_structures", {}))
        document["parameters"] = tuple(Field(**f) for f in document["parameters"])
        for key in ("coordinates", "actuators", "limits", "status"):
            document[key] = tuple(document[key])
        document["plans"] = tuple(document.get("plans", ()))
        manifest = Manifest(structures=structures, **document)
        _check_types(manifest)
        _check_structures(structures)
        _check_names(manifest)
        if manifest.precision not in REAL_TYPES:
            raise ValueError(f"unknown precision {manifest.precision}")
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror})",
            remedy="generate the model first: pfaffian generate MODEL",
        ) from error
    except (ValueError, TypeError, KeyError, AttributeError, ArithmeticError) as error:
        raise InputError(
            f"{path}: is not a manifest of this version ({error})", remedy="regenerate the model"
        ) from error
    if manifest.abi != ABI_VERSION:
        raise InputError(
            f"{path}: ABI {manifest.abi}, this runtime needs {ABI_VERSION}",
            remedy="regenerate the model",
        )
    return manifest


def _structures(document: Mapping[str, Any]) -> dict[str, Structure]:
    return {
        key: Structure(s["name"], tuple(Field(**f) for f in s["fields"]))
        for key, s in document.items()
    }


def _check_types(manifest: Manifest) -> None:
    """Raise `TypeError` naming the first entry of a type that no generation writes."""
    fields = [*manifest.parameters, *(f for s in manifest.structures.values() for f in s.fields)]
    texts = {
        name: [getattr(manifest, name)]
        for name in ("model", "title", "source", "model_sha256", "parameters_sha256", "baked")
    }
    texts |= {
        name: list(getattr(manifest, name))
        for name in ("coordinates", "actuators", "limits", "status", "plans")
    }
    for name in ("tools", "set_titles", "files", "own_names"):
        texts[name] = list(getattr(manifest, name).values())
    texts["fields"] = [text for f in fields for text in (f.name, f.type, f.unit, f.description)]
    numbers = {name: getattr(manifest, name) for name in ("domain", "operations")}
    numbers |= {f"parameter_sets.{n}": values for n, values in manifest.parameter_sets.items()}
    for name, found in texts.items():
        if not all(isinstance(text, str) for text in found):
            raise TypeError(f"{name} holds what is no text")
    for name, values in numbers.items():
        for key, value in values.items():
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise TypeError(f"{name}.{key} is no number")
            float(value)  # an integer of hundreds of digits is none either


def _check_names(manifest: Manifest) -> None:
    """Raise `ValueError` where names that belong together do not."""
    if not manifest.model.isidentifier():
        raise ValueError(f"the model is called {manifest.model!r}")
    state = manifest.structures["plant_state"].names()
    for name in (*manifest.coordinates, *manifest.domain):
        if name not in state:
            raise ValueError(f"the plant has no state {name}")
    for name, values in manifest.parameter_sets.items():
        for role in ("params", "plant_params"):
            for member in manifest.structures[role].names():
                if member not in values:
                    raise ValueError(f"set {name} has no {member}")
        if not values.get("sample_time", 1.0) > 0.0:
            raise ValueError(f"set {name} has a sample_time of {values['sample_time']}")


def _check_structures(structures: Mapping[str, Structure]) -> None:
    """Raise `ValueError` unless every role is there, with members of known types."""
    missing = [role for role in ROLES if role not in structures]
    if missing:
        raise ValueError(f"no structure {missing[0]}")
    for structure in structures.values():
        for member in structure.fields:
            if member.type not in MEMBER_TYPES:
                raise ValueError(f"{structure.name}.{member.name} has type {member.type}")
