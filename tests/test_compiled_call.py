"""The compiled path stands behind the NumPy module's call, with the bits of the C code."""

import importlib
import shutil
from dataclasses import fields, replace

import numpy as np
import pytest
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.code.compiled import BLOCK, compiled_model
from pfaffian.runtime.code.generated_model import fill_records, host_model, open_generated
from pfaffian.runtime.machine import toolchain
from test_c_safety import garbage, sensible

FOLDER = open_generated("pendubot")
MODEL = compiled_model("pendubot")
MODULE = MODEL.module
MEASURED = (1.6, 0.1, 0.2, -0.3)
needs_compiler = pytest.mark.skipif(not MODEL.compiled, reason="needs a C compiler")


def given(kind, records):
    return kind(**{n: records[n].copy() for n in records.dtype.names})


def bits(values):
    return np.asarray(values, float).view(np.uint64)


def assert_same_bits(found, records):
    for name in records.dtype.names:
        column = np.broadcast_to(getattr(found, name), records.shape)
        assert (bits(column.astype(float)) == bits(records[name].astype(float))).all(), name


@pytest.fixture
def without_compiler(monkeypatch):
    monkeypatch.setattr(toolchain.shutil, "which", lambda _: None)
    monkeypatch.setattr(toolchain.importlib.util, "find_spec", lambda _: None)
    with pytest.warns(RuntimeWarning, match=r"pendubot: NumPy instead of compiled C(.|\n)*apt-get"):
        return compiled_model("pendubot")


@needs_compiler
@pytest.mark.parametrize("count", [1, BLOCK, 2 * BLOCK + 3])
@pytest.mark.parametrize("spoil", [False, True])
def test_step_and_init_give_the_bits_of_the_c_code(count, spoil):
    """Over one block, a whole one, and several with a rest; what C refuses is refused."""
    rng = np.random.default_rng(31)
    batch = sensible(FOLDER, rng, count)
    if spoil:
        batch = tuple(garbage(rng, b) for b in batch)
    host = host_model(FOLDER)
    after, output = batch[0].copy(), host.records("output", count)
    status = np.zeros(count, np.int32)
    host.step(after, batch[1], batch[2], output, status)
    kinds = (MODULE.State, MODULE.Params, MODULE.Input)
    advanced, found, codes = MODEL.step(*map(given, kinds, batch))
    assert_same_bits(found, output)
    assert_same_bits(advanced, after)
    assert (codes == status).all()
    host.init(after, batch[1], status)
    fresh, codes = MODEL.init(given(MODULE.Params, batch[1]))
    assert_same_bits(fresh, after)
    assert (codes == status).all()


@needs_compiler
def test_numbers_and_arrays_broadcast_over_blocks_as_in_numpy():
    """A number in the state is given to every block anew, not what C made of it in the last."""
    state, _ = MODULE.init(MODULE.SIM)
    state = replace(state, engaged=1.0, constraint_offset=0.25)
    rng = np.random.default_rng(32)
    measured = MODULE.Input(rng.normal(size=(BLOCK + 5, 1)), 0.1, rng.normal(size=(1, 2)), -0.3)
    wanted, found = (m.step(state, MODULE.SIM, measured) for m in (MODULE, MODEL))
    for one, other in zip(wanted[:2], found[:2], strict=True):
        for field in fields(one):
            values = getattr(one, field.name), getattr(other, field.name)
            assert np.shape(values[0]) == np.shape(values[1]), field.name
            np.testing.assert_allclose(*values, rtol=1e-9, atol=1e-12, err_msg=field.name)
    assert (wanted[2] == found[2]).all()
    alone = MODEL.step(state, MODULE.SIM, MODULE.Input(measured.q1[-1, 0], 0.1, 0.5, -0.3))
    assert alone[1].tau.shape == alone[2].shape == ()


@needs_compiler
def test_continuous_law_and_plant_agree_with_numpy():
    rng = np.random.default_rng(33)
    law = MODULE.ContinuousState(rng.normal(size=40), 0.1, 0.2)
    motion = MODULE.PlantState(*rng.normal(size=(4, 40)))
    plant = MODULE.PlantParams(
        **{f.name: getattr(MODULE.SIM, f.name, 0.01) for f in fields(MODULE.PlantParams)}
    )
    arguments = {
        "continuous": (law, MODULE.SIM, motion),
        "acceleration": (plant, motion, MODULE.PlantInput(0.3)),
        "energy": (plant, motion),
    }
    for name, given_ in arguments.items():
        wanted, found = (getattr(m, name)(*given_) for m in (MODULE, MODEL))
        pairs = [(wanted, found)]
        if name != "energy":
            pairs = [(getattr(wanted, n), getattr(found, n)) for n in vars(wanted)]
        for one, other in pairs:
            np.testing.assert_allclose(other, np.broadcast_to(one, 40), rtol=1e-9, atol=1e-9)


@needs_compiler
def test_no_samples_give_no_results():
    state, _ = MODULE.init(MODULE.SIM)
    _, output, status = MODEL.step(state, MODULE.SIM, MODULE.Input(np.empty(0), 0.0, 0.0, 0.0))
    assert output.tau.shape == status.shape == (0,)


@needs_compiler
@pytest.mark.parametrize("engaged", [0.5, -1.0, float("nan"), 2.0**32, "yes"])
def test_what_does_not_fit_a_c_integer_is_refused(engaged):
    state, _ = MODULE.init(MODULE.SIM)
    with pytest.raises(InputError, match=r"state\.engaged"):
        MODEL.step(replace(state, engaged=engaged), MODULE.SIM, MODULE.Input(*MEASURED))


def test_an_imported_module_keeps_its_classes():
    module = importlib.import_module("pfaffian.generated.pendubot.pendubot")
    model = compiled_model(module)
    assert model.module is module
    assert type(model.init(module.SIM)[0]) is module.State


def test_reference_to_nothing_is_refused(tmp_path):
    with pytest.raises(InputError, match="no generated model"):
        compiled_model(tmp_path / "nothing")


def test_a_generation_of_an_older_version_is_refused(tmp_path):
    shutil.copytree(FOLDER.path, tmp_path / "old")
    path = tmp_path / "old" / "pendubot.py"
    path.write_text(path.read_text(encoding="utf-8").replace("_PREPARED", "_other"), "utf-8")
    with pytest.raises(InputError, match="older version"):
        compiled_model(tmp_path / "old")


@needs_compiler
def test_controller_gives_the_bits_of_the_c_code_step_after_step():
    host = host_model(FOLDER)
    params = fill_records(host.records("params"), FOLDER.manifest.parameter_sets["sim"])
    state, output, status = host.records("state"), host.records("output"), np.zeros(1, np.int32)
    measured = host.records("input")
    host.init(state, params, status)
    controller = MODEL.Controller(MODULE.SIM)
    for k in range(300):
        values = [np.sin(0.05 * k + j) * (40.0 if k % 50 == 49 else 1.0) for j in range(4)]
        values[0] = np.nan if k % 70 == 69 else values[0]
        measured[0] = tuple(values)
        host.step(state, params, measured, output, status)
        torque = controller.step(*values)
        assert bits(torque) == bits(output["tau"][0])
        assert controller.status == FOLDER.manifest.status[status[0]]
        assert_same_bits(controller.state, state)
        assert_same_bits(controller.output, output)


def controllers():
    return [pytest.param("compiled", marks=needs_compiler), "numpy"]


@pytest.fixture
def make(request):
    """Return the way to a controller of this machine, or of one without a compiler."""
    if request.param == "compiled":
        return MODEL.Controller
    plain = request.getfixturevalue("without_compiler")
    assert not plain.compiled
    return plain.Controller


each = pytest.mark.parametrize("make", controllers(), indirect=True)


@each
def test_measurements_come_in_order_or_by_name(make):
    names = [f.name for f in fields(MODULE.Input)]
    wanted = make(MODULE.RIG).step(*MEASURED)
    assert isinstance(wanted, float)
    assert make(MODULE.RIG).step(**dict(zip(names, MEASURED, strict=True))) == wanted
    assert make(MODULE.RIG).step(*MEASURED[:2], dq1=0.2, dq2=-0.3) == wanted


@each
@pytest.mark.parametrize(
    ("measured", "named"),
    [
        ((1.0,), {}),
        ((1.0,) * 5, {}),
        (MEASURED, {"q1": 1.0}),
        ((1.0, 2.0), {"q1": 1.0, "dq1": 2.0}),
        ((), {"q": 1.0, "q2": 1.0, "dq1": 1.0, "dq2": 1.0}),
    ],
)
def test_wrong_measurements_are_refused_and_change_nothing(make, measured, named):
    controller = make(MODULE.RIG)
    before = vars(controller.state)
    with pytest.raises(InputError, match="give q1, q2, dq1, dq2"):
        controller.step(*measured, **named)
    assert vars(controller.state) == before


@each
def test_reset_starts_again(make):
    controller = make(MODULE.RIG)
    first = [controller.step(*MEASURED) for _ in range(3)]
    controller.reset()
    assert controller.status == "OK"
    assert controller.output.tau == 0.0
    assert controller.state.engaged == 0
    assert [controller.step(*MEASURED) for _ in range(3)] == first


@each
def test_a_prepared_change_works_like_a_start_with_it_and_keeps_what_is_remembered(make):
    controller = make(MODULE.RIG)
    controller.step(*MEASURED)
    before = controller.state
    controller.prepare(k2=3.0, lam1=5.5)
    fresh = make(replace(MODULE.RIG, k2=3.0, lam1=5.5))
    assert controller.params == fresh.params
    prepared = MODULE._PREPARED
    assert {n: getattr(controller.state, n) for n in prepared} == {
        n: getattr(fresh.state, n) for n in prepared
    }
    for field in fields(MODULE.State):
        if field.name not in prepared:
            assert getattr(controller.state, field.name) == getattr(before, field.name)
    fresh.state = controller.state
    assert controller.step(*MEASURED) == fresh.step(*MEASURED)


@each
@pytest.mark.parametrize("change", [{"kappa": -1.0}, {"k2": float("nan")}, {"kapa": 1.0}])
def test_bad_parameters_are_refused_by_name_and_change_nothing(make, change):
    controller = make(MODULE.RIG)
    controller.step(*MEASURED)
    before = vars(controller.params), vars(controller.state)
    with pytest.raises(InputError, match=next(iter(change))):
        controller.prepare(**change)
    assert (vars(controller.params), vars(controller.state)) == before
    if "kapa" not in change:
        with pytest.raises(InputError, match=next(iter(change))):
            make(replace(MODULE.RIG, **change))


@needs_compiler
def test_controllers_share_nothing():
    one, other = MODEL.Controller(MODULE.RIG), MODEL.Controller(MODULE.SIM)
    torque = other.step(*MEASURED)
    one.step(*MEASURED)
    one.prepare(kappa=1.0)
    assert other.params == MODULE.SIM
    assert other.output.tau == torque


@needs_compiler
def test_several_actuators_give_a_tuple():
    model = compiled_model("pvtol")
    params = next(v for v in vars(model.module).values() if isinstance(v, model.Params))
    controller = model.Controller(params)
    torque = controller.step(*(0.1 for _ in fields(model.Input)))
    names = open_generated("pvtol").manifest.actuators
    assert torque == tuple(getattr(controller.output, n) for n in names)
    assert len(torque) == 2


def test_without_a_compiler_the_numpy_module_stands_behind_the_call(without_compiler):
    state, _ = without_compiler.init(without_compiler.SIM)
    found = without_compiler.step(state, without_compiler.SIM, MODULE.Input(*MEASURED))
    wanted = MODULE.step(MODULE.init(MODULE.SIM)[0], MODULE.SIM, MODULE.Input(*MEASURED))
    assert vars(found[1]) == vars(wanted[1])


def test_numpy_in_blocks_gives_the_bits_of_all_at_once():
    count = 2 * MODULE._BLOCK + 3
    rng = np.random.default_rng(34)
    state, params, measured = sensible(FOLDER, rng, count)
    batch = (
        given(MODULE.State, state),
        given(MODULE.Params, params),
        given(MODULE.Input, measured),
    )
    for arguments in (batch, (batch[0], MODULE.SIM, batch[2]), (batch[0], batch[1], MEASURED)):
        arguments = [MODULE.Input(*a) if isinstance(a, tuple) else a for a in arguments]
        for one, other in zip(MODULE.step(*arguments), MODULE._step(*arguments), strict=True):
            pairs = [(one, other)]
            if not isinstance(one, np.ndarray):
                pairs = [(getattr(one, n), getattr(other, n)) for n in vars(one)]
            for mine, whole in pairs:
                assert np.shape(mine) == np.shape(whole)
                if np.ndim(mine):
                    np.testing.assert_allclose(mine, whole, rtol=1e-13, atol=1e-13)
                else:
                    assert mine == whole
