"""The manifest of a generated model: the contract between generated code and this runtime."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from pfaffian.runtime.errors import InputError

#: Version of the layout of generated structures and functions; `runtime/c` checks it too.
ABI_VERSION = 2
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
#: Roles that only some models have, numbered on from `ROLES`.
OPTIONAL_ROLES = ("reference",)
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
    plans: tuple[str, ...] = ()

    @property
    def real(self) -> str:
        """Return the NumPy type of a real number of the C code."""
        return REAL_TYPES[self.precision]

    def to_json(self) -> str:
        """Return the manifest as JSON; floats are written so that they read back to the bit."""
        document = asdict(self)
        if not self.plans:
            del document["plans"]
        return json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of the generated model in `folder`.

    Raises `InputError` where there is none, it is malformed, or its ABI is another one.
    """
    path = folder / MANIFEST_NAME
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        structures = {
            key: Structure(s["name"], tuple(Field(**f) for f in s["fields"]))
            for key, s in document.pop("structures").items()
        }
        document["parameters"] = tuple(Field(**f) for f in document["parameters"])
        for key in ("coordinates", "actuators", "limits", "status"):
            document[key] = tuple(document[key])
        document["plans"] = tuple(document.get("plans", ()))
        manifest = Manifest(structures=structures, **document)
        _check_structures(structures)
        if manifest.precision not in REAL_TYPES:
            raise ValueError(f"unknown precision {manifest.precision}")
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror})",
            remedy="generate the model first: pfaffian generate MODEL",
        ) from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(
            f"{path}: is not a manifest of this version ({error})", remedy="regenerate the model"
        ) from error
    if manifest.abi != ABI_VERSION:
        raise InputError(
            f"{path}: ABI {manifest.abi}, this runtime needs {ABI_VERSION}",
            remedy="regenerate the model",
        )
    return manifest


def _check_structures(structures: Mapping[str, Structure]) -> None:
    """Raise `ValueError` unless every role is there, with members of known types."""
    missing = [role for role in ROLES if role not in structures]
    if missing:
        raise ValueError(f"no structure {missing[0]}")
    for structure in structures.values():
        for member in structure.fields:
            if member.type not in MEMBER_TYPES:
                raise ValueError(f"{structure.name}.{member.name} has type {member.type}")
