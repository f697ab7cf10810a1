"""What identifies the equations of motion of a model, whatever law is derived for them."""

from __future__ import annotations

import hashlib
import json

from pfaffian.derive.derivation.derive import Derivation
from pfaffian.derive.symbolic.block import Block


def plant_digest(derivation: Derivation) -> str:
    """Return the SHA-256 of the equations of motion, as the derivation writes them."""
    block: Block = derivation.block("acceleration")
    lines = [[d.symbol.name, str(d.expression)] for d in block.definitions]
    text = json.dumps([[s.name for s in block.inputs], lines, [r.name for r in block.results]])
    return hashlib.sha256(text.encode()).hexdigest()
