"""One generation: every file of a model, as text, before anything is written."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

from pfaffian.derive.emit.emission import Emission, Emitter
from pfaffian.derive.emit.files.batch import emit_batch
from pfaffian.derive.emit.files.build_files import emit_build_files
from pfaffian.derive.emit.files.c import emit_c
from pfaffian.derive.emit.files.controller import (
    control_constants,
    control_structures,
    emit_control,
)
from pfaffian.derive.emit.files.follow import emit_follow
from pfaffian.derive.emit.files.jacobian import emit_jacobian
from pfaffian.derive.emit.files.python import emit_python
from pfaffian.derive.emit.precision import DOUBLE
from pfaffian.derive.emit.structures import STATUS, structures_of
from pfaffian.runtime.contract.manifest import (
    ABI_VERSION,
    MANIFEST_NAME,
    Field,
    Manifest,
    Structure,
)

EMITTERS: tuple[Emitter, ...] = (emit_c, emit_python, emit_control)


@dataclass(frozen=True)
class Generation:
    """The files of one generation: text by path relative to the model's folder, sorted."""

    model: str
    files: tuple[tuple[str, str], ...]


def generate(emission: Emission) -> Generation:
    """Emit every file of `emission`: code, readable derivation and manifest."""
    files: dict[str, str] = dict(emission.model.documents)
    on_request = (
        (emission.jacobians, emit_jacobian),
        (emission.batch, emit_batch),
        (emission.plans, emit_follow),
    )
    for emitter in (*EMITTERS, *(emit for wanted, emit in on_request if wanted)):
        files |= emitter(emission)
    files |= emit_build_files(emission, files)
    digests = {
        path: hashlib.sha256(text.encode()).hexdigest() for path, text in sorted(files.items())
    }
    files[MANIFEST_NAME] = _manifest(emission, digests).to_json()
    return Generation(emission.model.name, tuple(sorted(files.items())))


def _given_way(emission: Emission, structures: Mapping[str, Structure]) -> dict[str, str]:
    """Return the members and flags of the laws that gave way, by the names they usually have."""
    ours = {n for s in structures.values() for n in s.names()}
    ours |= {s.name for p in emission.model.programs for s in p.outputs if s.group == "flag"}
    return emission.model.own.given_way(ours)


def _manifest(emission: Emission, digests: dict[str, str]) -> Manifest:
    model, real = emission.model, emission.precision.real
    controls = emission.controls if emission.precision is DOUBLE else ()
    structures = structures_of(
        model, real, emission.step, emission.prepare, follow=bool(emission.plans)
    )
    domain = {c.name: c.bound for c in model.coordinates}
    domain |= {f"d{c.name}": c.rate_bound for c in model.coordinates}
    return Manifest(
        abi=ABI_VERSION,
        model=model.name,
        title=model.title,
        source=model.source,
        model_sha256=model.sha256,
        parameters_sha256=emission.parameters_sha256(),
        tools=dict(model.tools),
        coordinates=tuple(c.name for c in model.coordinates),
        actuators=tuple(a.name for a in model.actuators),
        limits=model.limits,
        status=STATUS,
        structures=structures,
        parameters=tuple(Field(p.name, real, p.unit, p.description) for p in model.parameters),
        parameter_sets={s.name: s.as_dict() for s in emission.sets},
        set_titles={s.name: s.title for s in emission.sets},
        domain=domain,
        operations={p.name: sum(p.op_count().values()) for p in model.programs}
        | {"step": emission.operations()},
        baked=emission.sets[0].name if emission.bake else "",
        files=digests,
        precision=emission.precision.name,
        control_structures=control_structures(model) if controls else {},
        control_sets={c.name: control_constants(emission, c) for c in controls},
        plans=tuple(p.name for p in emission.plans),
        own_names=_given_way(emission, structures),
    )
