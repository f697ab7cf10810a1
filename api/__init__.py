"""What `import pfaffian` gives: models, and what can be done with one. Each import is late.

The command line calls the same functions; nothing else imports this package.
"""

from pfaffian.api.listing import ModelRow, ModelTable, models
from pfaffian.api.model import Model, load
from pfaffian.runtime.base.errors import CheckError, InputError, MissingToolError, PfaffianError

__all__ = [
    "CheckError",
    "InputError",
    "MissingToolError",
    "Model",
    "ModelRow",
    "ModelTable",
    "PfaffianError",
    "load",
    "models",
]
