"""The lowering stage as a whole: a derivation in, a `LoweredModel` out."""

from __future__ import annotations

import hashlib
import json

from pfaffian.derive.derivation.derive import Derivation
from pfaffian.derive.derivation.documents import (
    derivation_json,
    derivation_latex,
    derivation_markdown,
)
from pfaffian.derive.derivation.plant_digest import plant_digest
from pfaffian.derive.elementary.coefficients import render_context
from pfaffian.derive.ir.lowered import ActuatorInterface, CoordinateInterface, LoweredModel
from pfaffian.derive.ir.program import program_to_json
from pfaffian.derive.lower.to_program import lower
from pfaffian.derive.optimise.passes import optimise


def lower_model(derivation: Derivation, tools: tuple[tuple[str, str], ...]) -> LoweredModel:
    """Lower every block of `derivation` and write its readable documents."""
    spec = derivation.spec
    programs, passes = optimise([lower(block) for block in derivation.blocks], spec.own.declared)
    content = json.dumps([program_to_json(p) for p in programs], sort_keys=True)
    return LoweredModel(
        name=spec.name,
        title=spec.title,
        source=spec.source,
        coordinates=tuple(
            CoordinateInterface(c.name, c.unit, c.description, c.bound, c.rate_bound)
            for c in spec.coordinates
        ),
        actuators=tuple(ActuatorInterface(a.name, a.unit, a.description) for a in spec.actuators),
        parameters=spec.parameters,
        limits=tuple(limit.name for limit in spec.law.limits),
        slews=tuple(slew.name for slew in spec.law.slews),
        programs=programs,
        passes=passes,
        documents=(
            ("derivation.md", derivation_markdown(derivation)),
            ("derivation.tex", derivation_latex(derivation)),
            ("derivation.json", derivation_json(derivation)),
        ),
        tools=tools,
        elementary=render_context(),
        sha256=hashlib.sha256(content.encode()).hexdigest(),
        plant_sha256=plant_digest(derivation),
    )
