"""What a person writes, a model, and what is checked of it before anything is derived.

Model files may import names of `model_spec` from here, as they did when it was one module; they are
looked up late, so that who only lists models does not load SymPy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pfaffian.derive.spec.model_spec import TIME as TIME


def __getattr__(name: str) -> object:
    if name.startswith("_"):
        raise AttributeError(name)
    from pfaffian.derive.spec import model_spec

    try:
        found: object = getattr(model_spec, name)
    except AttributeError:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
    return found
