"""From a Lagrangian and a servo-constraint to verified controller code, from Python.

    import pfaffian as pf

    pf.models()                          # what comes with it
    model = pf.load("pendubot")          # or the folder of a plant of one's own
    p = model.parameters("sim-designed", m2="0.8 kg")
    model.controller(p).step(q1=1.0, q2=0.5, dq1=0.0, dq2=0.0)

Nothing else is imported until it is asked for.
"""

from __future__ import annotations

TYPE_CHECKING = False  # as `typing` has it, without the time it takes to import
if TYPE_CHECKING:
    from pfaffian.api import (CheckError, InputError, MissingToolError, Model, PfaffianError, load, models)

    __version__: str
else:

    def __getattr__(name):
        """Import the public name `name` when it is first used."""
        from importlib import import_module

        if name == "__version__":
            value = import_module("importlib.metadata").version("pfaffian")
        elif name in __all__:
            value = getattr(import_module("pfaffian.api"), name)
        else:
            raise AttributeError(f"module 'pfaffian' has no attribute {name!r}")
        globals()[name] = value
        return value

    def __dir__():
        """Return the public names."""
        return sorted(__all__)


__all__ = [
    "CheckError",
    "InputError",
    "MissingToolError",
    "Model",
    "PfaffianError",
    "__version__",
    "load",
    "models",
]
