"""What the runtime refuses before C code would read or write beyond an array."""

import numpy as np
import pytest
from pfaffian.runtime.errors import InputError
from pfaffian.runtime.generated_model import host_model, open_generated


def test_an_array_of_another_length_is_refused():
    model = host_model(open_generated("pendubot"))
    roles = ("state", "params", "input", "output")
    state, params, measured, output = (model.records(r, 3) for r in roles)
    status = np.zeros(3, np.int32)
    with pytest.raises(InputError, match="params has type"):
        model.init(state, model.records("params", 2), status)
    with pytest.raises(InputError, match="i4 has type"):
        model.init(state, params, np.zeros(2, np.int32))
    with pytest.raises(InputError, match="output has type"):
        model.step(state, params, measured, model.records("output", 1), status)
    with pytest.raises(InputError, match="input has type"):
        model.step(state, params, output, output, status)
