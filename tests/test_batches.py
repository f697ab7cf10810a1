"""Arrays handed to the generated C are checked before their address leaves Python."""

import numpy as np
import pytest
from pfaffian.runtime.errors import InputError
from pfaffian.runtime.generated_model import fill_records, host_model, open_generated


@pytest.fixture(scope="module")
def host():
    return host_model(open_generated("pendubot"))


def test_an_array_shorter_than_the_batch_is_refused_not_read_past_its_end(host):
    params = fill_records(host.records("params", 3), host.folder.parameters("sim"))
    with pytest.raises(InputError, match="params"):
        host.init(host.records("state", 4), params, np.zeros(4, np.int32))


def test_an_array_of_another_type_is_refused_not_taken_for_the_right_one(host):
    params = fill_records(host.records("params"), host.folder.parameters("sim"))
    with pytest.raises(InputError, match="i4"):
        host.init(host.records("state"), params, np.zeros(1, np.int64))
    with pytest.raises(InputError, match="state"):
        host.init(host.records("output"), params, np.zeros(1, np.int32))
