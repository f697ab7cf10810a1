"""Memory layout of the generated structures, as NumPy types of either byte order."""

from __future__ import annotations

import numpy as np
from pfaffian.runtime.contract.manifest import MEMBER_TYPES, Structure


def layout_of(structure: Structure, byte_order: str = "=") -> np.dtype[np.void]:
    """Return the structured type of `structure`; `byte_order` is `<`, `>` or `=` (native).

    Members are aligned as both the x86-64 and the PowerPC EABI align them: each to its own size.
    """
    members = [(f.name, f"{byte_order}{MEMBER_TYPES[f.type]}") for f in structure.fields]
    return np.dtype(members, align=True)
