"""What the runtime refuses: arrays that C would read past, other manifests, files left over."""

import json

import numpy as np
import pytest
from pfaffian.derive.generation import Generation
from pfaffian.derive.writer import drift
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.generated_model import host_model, open_generated
from pfaffian.runtime.contract.manifest import ABI_VERSION, MANIFEST_NAME, read_manifest


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


@pytest.mark.parametrize("role", ["params", "plant_rate", "continuous_state"])
def test_a_manifest_without_a_structure_is_refused_by_its_role(role, tmp_path):
    document = json.loads((open_generated("pendubot").path / MANIFEST_NAME).read_text())
    del document["structures"][role]
    (tmp_path / MANIFEST_NAME).write_text(json.dumps(document))
    with pytest.raises(InputError, match=f"no structure {role}"):
        read_manifest(tmp_path)


def test_a_manifest_whose_period_is_zero_is_refused(tmp_path):
    document = json.loads((open_generated("pendubot").path / MANIFEST_NAME).read_text())
    document["parameter_sets"]["rig"]["sample_time"] = 0
    (tmp_path / MANIFEST_NAME).write_text(json.dumps(document))
    with pytest.raises(InputError, match="set rig has a sample_time of 0"):
        read_manifest(tmp_path)


@pytest.mark.parametrize("step", [-1, 1])
def test_a_manifest_of_the_next_or_the_last_abi_is_refused(step, tmp_path):
    document = json.loads((open_generated("pendubot").path / MANIFEST_NAME).read_text())
    document["abi"] = ABI_VERSION + step
    (tmp_path / MANIFEST_NAME).write_text(json.dumps(document))
    with pytest.raises(InputError, match=f"ABI {ABI_VERSION + step}"):
        read_manifest(tmp_path)


def test_a_file_that_is_no_longer_generated_is_drift(tmp_path):
    manifest = json.dumps({"files": {"m.py": "", "gone.c": ""}})
    wanted = Generation("m", (("m.py", "x\n"), (MANIFEST_NAME, manifest)))
    for name, text in (("m.py", "x\n"), (MANIFEST_NAME, manifest)):
        (tmp_path / name).write_text(text)
    assert drift(wanted, tmp_path) == ""
    (tmp_path / "gone.c").write_text("int left;\n")
    assert "-int left;" in drift(wanted, tmp_path)
    (tmp_path / "foreign.txt").write_text("of the user's own")
    assert "foreign" not in drift(wanted, tmp_path)
