"""The key of a stage holds the text of every module that the stage reaches."""

import subprocess
import sys

import pytest
from pfaffian.derive import pipeline
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.base import import_closure as closure_module
from pfaffian.runtime.base.import_closure import import_closure, modules_in

STAGES = {
    "derivation": (pipeline._DERIVATION, pipeline._AUTHORING),
    "lowering": (pipeline._LOWERING,),
    "jacobian": (pipeline._JACOBIAN,),
    "single": (pipeline._SINGLE,),
}
#: What runs each stage for real, cache off.
RUN = {
    "derivation": "from pfaffian.derive.derivation.derive import derive; derive(find().load())",
    "lowering": "from pfaffian.derive.derivation.derive import derive\n"
    "from pfaffian.derive.lower.model import lower_model\n"
    "lower_model(derive(find().load()), ())",
    "jacobian": "from pfaffian.derive.derivation.derive import derive\n"
    "from pfaffian.derive.lower.jacobian import jacobian_programs_of\n"
    "jacobian_programs_of(derive(find().load()))",
    "single": "from pfaffian.derive.elementary.single import single_render_context\n"
    "single_render_context()",
}
#: What the lines above import themselves to find the model.
FINDS = {"pfaffian.derive.spec.library"}


@pytest.mark.parametrize("stage", STAGES)
def test_every_module_that_a_stage_really_imports_is_in_its_closure(stage):
    code = (
        "def find():\n    from pfaffian.derive.spec.library import find_model\n"
        "    return find_model('cart_pole')\n"
        f"{RUN[stage]}\n"
        "import sys; print(*[n for n in sys.modules if n.startswith('pfaffian.')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    used = {n for n in done.stdout.split() if not n.startswith("pfaffian.derive.models")}
    known = set(import_closure((*STAGES["derivation"], *STAGES[stage])))
    assert used - known - set(import_closure(tuple(FINDS))) == set()
    assert used & known


KEYS = {
    "derivation": pipeline.derivation_of,
    "lowering": pipeline.lowered_model,
    "jacobian": pipeline.jacobian_programs,
    "single": lambda _: pipeline.single_elementary(),
}


class KeyedError(Exception):
    """Carries the key that a stage asks the cache for."""


def key_of(stage):
    """Return the key under which `stage` looks for the result of the cart and pole."""
    with pytest.raises(KeyedError) as raised:
        KEYS[stage](find_model("cart_pole"))
    return raised.value.args[0]


@pytest.mark.parametrize("stage", STAGES)
def test_another_text_of_any_module_of_a_stage_is_another_key(stage, monkeypatch):
    def ask(_, key, compute):
        raise KeyedError(key)

    monkeypatch.setattr(pipeline, "cached", ask)
    known = import_closure(STAGES[stage])
    keys = {key_of(stage)}
    for name in known:
        changed = name

        def altered(entries):
            texts = import_closure(entries)
            return {n: text + b"#" * (n == changed) for n, text in texts.items()}  # noqa: B023

        monkeypatch.setattr(closure_module, "_known_closure", altered)
        keys.add(key_of(stage))
    assert len(known) > 4
    assert len(keys) == len(known) + 1


def test_a_module_that_is_imported_in_whatever_way_is_followed(tmp_path, monkeypatch):
    texts = {
        "a": b"from pfaffian.room import b\nfrom pfaffian.room.c import (\n    x,\n    y,\n)\n",
        "b": b"def f():\n    import pfaffian.room.d\n",
        "c": b"if TYPE_CHECKING:\n    from pfaffian.room.inner.e import z\n",
        "d": b"",
        "inner/__init__": b"",
        "inner/e": b"from pfaffian.room.a import q",
        "other": b"",
        "__init__": b"",
    }
    for name, text in texts.items():
        path = tmp_path / f"{name}.py"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(text)
    monkeypatch.setattr(closure_module, "_root", lambda room: tmp_path if room == "room" else None)
    found = import_closure(("pfaffian.room.a",))
    inside = ("a", "b", "c", "d", "inner", "inner.e")
    assert list(found) == ["pfaffian.room", *(f"pfaffian.room.{n}" for n in inside)]
    assert found["pfaffian.room.c"] == texts["c"]
    with pytest.raises(ModuleNotFoundError, match=r"pfaffian\.room\.gone"):
        import_closure(("pfaffian.room.gone",))


def test_what_a_specification_imports_is_in_its_key():
    named = modules_in((find_model("chain").path / "spec.py").read_bytes())
    assert "pfaffian.derive.mechanics.chain" in named
    assert "pfaffian.derive.mechanics.chain" not in import_closure(STAGES["derivation"])
