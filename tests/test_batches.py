"""Arrays handed to the generated C are checked before their address leaves Python."""

import json
import shutil

import numpy as np
import pytest
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.generated_model import fill_records, host_model, open_generated


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


def broken_copy(tmp_path, change):
    source = open_generated("pendubot").path
    folder = tmp_path / "pendubot"
    shutil.copytree(source, folder, ignore=shutil.ignore_patterns("__pycache__"))
    change(folder)
    return folder


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["structures"].pop("params"),
        lambda d: d["structures"]["state"]["fields"][0].update(type="half"),
    ],
    ids=["a role is missing", "a type is unknown"],
)
def test_a_manifest_without_a_usable_layout_is_refused(tmp_path, change):
    def edit(folder):
        path = folder / "manifest.json"
        document = json.loads(path.read_text())
        change(document)
        path.write_text(json.dumps(document))

    with pytest.raises(InputError, match=r"manifest\.json"):
        open_generated(str(broken_copy(tmp_path, edit)))


def test_a_damaged_python_module_is_named_and_no_bytecode_is_left_behind(tmp_path):
    whole = broken_copy(tmp_path / "whole", lambda _folder: None)
    assert open_generated(str(whole)).python_module().OK == 0
    assert not list(whole.rglob("__pycache__"))
    broken = broken_copy(
        tmp_path / "broken", lambda folder: (folder / "pendubot.py").write_text("1 +\n")
    )
    with pytest.raises(InputError, match=r"pendubot\.py"):
        open_generated(str(broken)).python_module()
