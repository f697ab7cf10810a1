"""Every init gives one state, whatever the memory held before: after a reset that is anything.

The Python modules hand out memory of zeros, which hides what an init forgets to clear; here each
init runs over zeros, ones and random bits, and every member must come out the same.
"""

import numpy as np
import pytest
from pfaffian.runtime.code.controller import host_control
from pfaffian.runtime.code.generated_model import fill_records, host_model, open_generated
from pfaffian.runtime.code.sensing import host_sensing
from support_supervisor import HOST, init_in_place, parameters

FOLDER = open_generated("pendubot")


def memories(dtype):
    """Return four states of one record: zeros, ones, and two of random bits."""
    rng = np.random.default_rng(12)
    size = dtype.itemsize
    rows = [np.zeros(size), np.full(size, 255), *rng.integers(0, 256, (2, size))]
    return [np.frombuffer(np.asarray(r, np.uint8).tobytes(), dtype).copy() for r in rows]


def members(record, path=""):
    """Yield (path, bytes) of every member; padding belongs to none."""
    for name in record.dtype.names:
        column = record[name]
        if column.dtype.names:
            yield from members(column.reshape(-1), f"{path}{name}.")
        else:
            yield f"{path}{name}", np.ascontiguousarray(column).tobytes()


def outcomes(dtype, init):
    """Return what `init(state)` makes of each memory: its status and every member."""
    found = []
    for state in memories(dtype):
        status = int(init(state)[0])
        found.append((status, dict(members(state))))
    return found


def assert_alike(found, status):
    first = found[0]
    assert first[0] == status
    for other in found[1:]:
        assert other[0] == status
        differing = [n for n, v in first[1].items() if other[1][n] != v]
        assert differing == []


@pytest.mark.parametrize(("status", "changes"), [(0, {}), (1, {"sample_time": 0.0})])
def test_the_supervisor_forgets_what_its_memory_held(status, changes):
    params = parameters(**changes)
    assert_alike(outcomes(HOST.type("state"), lambda s: init_in_place(s, params)), status)


@pytest.mark.parametrize("good", [True, False])
def test_an_encoder_forgets_what_its_memory_held(good):
    module = host_sensing()
    params = np.zeros(1, module._type("params"))
    values = {"counts_per_turn": 5000.0, "sample_time": 1e-3, "bandwidth": 200.0, "damping": 1.0}
    values |= {"counter_bits": 32, "largest_jump": 100, "longest_gap": 8, "direction": 1}
    for name, value in (values if good else values | {"direction": 0}).items():
        params[name] = value

    def init(state):
        status = np.zeros(1, np.int32)
        module.machine.call("pf_sensing_batch_init", 1, state, params, status)
        return status

    found = outcomes(module._type("state"), init)
    assert_alike(found, found[0][0])
    assert (found[0][0] == 0) is good


@pytest.mark.parametrize("good", [True, False])
def test_a_law_forgets_what_its_memory_held(good):
    model = host_model(FOLDER)
    params = fill_records(model.records("params"), FOLDER.parameters("rig"))
    params["kappa"] = params["kappa"] if good else -1.0

    def init(state):
        status = np.zeros(1, np.int32)
        model.init(state, params, status)
        return status

    found = outcomes(model.records("state").dtype, init)
    assert_alike(found, found[0][0])
    assert (found[0][0] == 0) is good


@pytest.mark.parametrize("good", [True, False])
def test_the_complete_controller_forgets_what_its_memory_held(good):
    module = host_control(FOLDER)
    params = module.params("rig")
    params["law"]["kappa"] *= 1.0 if good else -1.0
    module.seal(params)

    def init(state):
        status = np.zeros(1, np.int32)
        module.machine.call("pf_control_batch_init", 1, state, params, status)
        return status

    found = outcomes(module.records("control_state").dtype, init)
    assert_alike(found, found[0][0])
    assert (found[0][0] == 0) is good
