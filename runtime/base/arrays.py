"""The one type of arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

#: Any shape, any type of element: the functions that take and return it say which.
Array = np.ndarray[Any, Any]
