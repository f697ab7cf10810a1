"""The emulated PowerPC 750 computes what the host computes, bit for bit; faults are reported."""

import io
import shutil
import sys
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from pfaffian.runtime.base.errors import CheckError, InputError, MissingToolError
from pfaffian.runtime.code.firmware import build_controller, measure_step
from pfaffian.runtime.code.generated_model import (
    GeneratedFolder,
    GeneratedModel,
    fill_records,
    host_model,
    open_generated,
    ppc750_model,
)
from pfaffian.runtime.contract.dtypes import layout_of
from pfaffian.runtime.contract.manifest import OPTIONAL_ROLES, ROLES, Field, Structure
from pfaffian.runtime.machine import toolchain
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.emulator import Ppc750Machine
from pfaffian.runtime.machine.sources import harness_sources
from pfaffian.runtime.machine.toolchain import Target, ppc750_target
from test_c_safety import assert_safe, garbage, raw, sensible

pytestmark = pytest.mark.target
pytest.importorskip("unicorn", reason="needs the package unicorn: pip install 'pfaffian[target]'")
if not find_spec("ziglang") and not shutil.which(toolchain.GCC_PPC):
    pytest.skip("needs zig (pip install ziglang) or gcc-powerpc-linux-gnu", allow_module_level=True)
FOLDER = open_generated("pendubot")
MANIFEST = FOLDER.manifest
COUNT = 10_000
needs_gcc = pytest.mark.skipif(
    not shutil.which(toolchain.GCC_PPC),
    reason="needs powerpc-linux-gnu-gcc: apt-get install gcc-powerpc-linux-gnu",
)
needs_zig = pytest.mark.skipif(
    not find_spec("ziglang"),
    reason="needs the package ziglang: pip install 'pfaffian[target]'",
)
TOOLCHAINS = [
    pytest.param("zig", marks=needs_zig),
    pytest.param("gcc", marks=needs_gcc),
]


@pytest.fixture(scope="module")
def host():
    return host_model(FOLDER)


@pytest.fixture(scope="module")
def target():
    return ppc750_model(FOLDER)


def image_of(name):
    sources = harness_sources(FOLDER.path, MANIFEST)
    extra = ("-Wl,-e,pf_target_check",)
    return compile_image(ppc750_target(name), sources, FOLDER.path / "c", extra)


def elf_of(image):
    from elftools.elf.elffile import ELFFile

    return ELFFile(io.BytesIO(image))


@pytest.mark.parametrize("name", TOOLCHAINS)
def test_image_is_for_the_processor_and_needs_and_writes_nothing(name):
    for image in (image_of(name), build_controller(FOLDER, "ppc750", name)[0]):
        elf = elf_of(image)
        assert (elf.elfclass, elf.little_endian, elf["e_machine"]) == (32, False, "EM_PPC")
        table = list(elf.get_section_by_name(".symtab").iter_symbols())
        assert not [s.name for s in table if s.name and s["st_shndx"] == "SHN_UNDEF"]
        assert {f"{MANIFEST.model}_init", f"{MANIFEST.model}_step"} <= {s.name for s in table}
        written = [s.name for s in elf.iter_sections() if s["sh_flags"] & 3 == 3 and s["sh_size"]]
        # Addresses in constants: the linker fills them in, and nothing writes them later.
        assert not set(written) - {".data.rel.ro", ".relro_padding"}
        assert not [s.name for s in elf.iter_sections() if s.name.startswith(".debug")]


@pytest.mark.parametrize("name", TOOLCHAINS)
def test_target_check_passes(name):
    assert Ppc750Machine(image_of(name)).call("pf_target_check") == 0


def test_sizes_agree_with_the_manifest(target):
    for number, role in enumerate(ROLES):
        wanted = layout_of(MANIFEST.structures[role], ">").itemsize
        assert target.machine.call("pf_sizeof", number) == wanted
    for number, role in enumerate(OPTIONAL_ROLES, len(ROLES)):
        wanted = layout_of(MANIFEST.structures[role], ">").itemsize
        assert target.machine.call("pf_sizeof", number) == wanted
    assert target.machine.call("pf_sizeof", len(ROLES) + len(OPTIONAL_ROLES)) == 0
    assert {*ROLES, *OPTIONAL_ROLES} == set(MANIFEST.structures)


@pytest.mark.parametrize("role", ROLES)
def test_image_of_another_layout_is_refused(target, role):
    old = MANIFEST.structures[role]
    longer = Structure(old.name, (*old.fields, Field("extra", "double", "", "one more")))
    manifest = replace(MANIFEST, structures={**MANIFEST.structures, role: longer})
    with pytest.raises(CheckError, match=f"{old.name} has"):
        GeneratedModel(GeneratedFolder(FOLDER.path, manifest), target.machine)


def test_target_whose_arithmetic_is_not_ieee_is_refused(target, monkeypatch):
    call = target.machine.call
    faulty = lambda name, *args: 2 if name == "pf_target_check" else call(name, *args)  # noqa: E731
    monkeypatch.setattr(target.machine, "call", faulty)
    with pytest.raises(CheckError, match="fault 0x2"):
        GeneratedModel(FOLDER, target.machine)


def one_step(model, q1=1.0):
    params = fill_records(model.records("params"), MANIFEST.parameter_sets["sim"])
    state, status = model.records("state"), np.zeros(1, np.int32)
    model.init(state, params, status)
    measured, output = model.records("input"), model.records("output")
    measured["q1"], measured["q2"], measured["dq1"] = q1, 0.2, -0.3
    return lambda: model.step(state.copy(), params, measured, output, status)


@pytest.mark.parametrize("name", TOOLCHAINS)
def test_a_step_costs_the_same_each_time_and_little_stack(name):
    model = GeneratedModel(FOLDER, Ppc750Machine(image_of(name)))
    entry = f"{MANIFEST.model}_step"
    first = model.machine.measure(entry, one_step(model))
    assert first == model.machine.measure(entry, one_step(model))
    assert first[0] > MANIFEST.operations["step"]  # each operation takes an instruction
    refused = model.machine.measure(entry, one_step(model, q1=np.nan))
    assert refused[0] < 0.2 * first[0]
    worst, stack = measure_step(model)
    assert first[0] * 0.8 < worst < 3000
    assert 0 < stack < 1024


@pytest.mark.parametrize("name", TOOLCHAINS)
def test_firmware_report_holds_what_scripts_read(name):
    image, report = build_controller(FOLDER, "ppc750", name)
    assert image.startswith(b"\x7fELF")
    assert 1000 < report["text_bytes"] < 20_000
    assert 0 < report["stack_bytes"] < 1024
    assert report["instructions_per_step"] > MANIFEST.operations["step"]
    assert "/" not in report["compiler"]


def test_unknown_targets_and_toolchains_are_bad_input():
    with pytest.raises(InputError, match="unknown target mips"):
        build_controller(FOLDER, "mips")
    with pytest.raises(InputError, match="unknown toolchain tcc"):
        build_controller(FOLDER, "ppc750", "tcc")


def test_structures_survive_the_change_of_byte_order(target):
    """A refused measurement leaves the state as it was, and so shows what arrived."""
    rng = np.random.default_rng(21)
    state, params, measured = sensible(FOLDER, rng, COUNT)
    for name in state.dtype.names:
        bits = rng.integers(0, 2**64, COUNT, dtype=np.uint64)
        state[name] = bits.view(float) if name != "engaged" else bits >> 32
    measured["q1"] = np.nan
    before = raw(state)
    output, status = target.records("output", COUNT), np.zeros(COUNT, np.int32)
    target.step(state, params, measured, output, status)
    assert (status == 3).all()
    assert (raw(state) == before).all()


def test_values_arrive_in_the_members_they_were_written_to(target):
    values = {n: float(k + 1) for k, n in enumerate(MANIFEST.structures["params"].names())}
    values["sample_time"] = 0.5
    state, status = target.records("state"), np.full(1, -1, np.int32)
    target.init(state, fill_records(target.records("params"), values), status)
    assert status[0] == 0
    assert state["bound_estimate"] == values["bound_initial"]
    assert state["leakage_decay"] == pytest.approx(np.exp(-values["k2"] * 0.5), rel=1e-15)


def step_and_init(model, batch):
    state, params, measured = (b.copy() for b in batch)
    output, status = model.records("output", COUNT), np.full(COUNT, -1, np.int32)
    model.step(state, params, measured, output, status)
    fresh, init_status = model.records("state", COUNT), np.full(COUNT, -1, np.int32)
    model.init(fresh, params, init_status)
    return raw(state), raw(output), status, raw(fresh), init_status


def sane(rng):
    return sensible(FOLDER, rng, COUNT)


def wild(rng):
    """Garbage in all that reaches a step; the parameters of every other sample are sensible."""
    good = sensible(FOLDER, rng, COUNT)
    batch = [garbage(rng, b) for b in good]
    batch[1][::2] = good[1][::2]
    return batch


@pytest.mark.parametrize("name", TOOLCHAINS)
@pytest.mark.parametrize("draw", [sane, wild])
def test_steps_are_bit_identical_on_host_and_target(host, name, draw):
    there = GeneratedModel(FOLDER, Ppc750Machine(image_of(name)))
    batch = draw(np.random.default_rng(22))
    wanted, found = step_and_init(host, batch), step_and_init(there, batch)
    # The plain root of the step has no bits to agree on beyond what bounded parameters lead to.
    accepted = wanted[4] == 0
    assert accepted.sum() > (3000 if draw is wild else COUNT - 1)
    for here, seen in zip(wanted[:3], found[:3], strict=True):
        assert (here[..., accepted] == seen[..., accepted]).all()
    for here, seen in zip(wanted[3:], found[3:], strict=True):
        assert (here == seen).all()
    assert len(np.unique(wanted[2])) == (7 if draw is wild else 3)


@pytest.mark.parametrize("name", TOOLCHAINS)
def test_garbage_gives_no_torque_beyond_the_limit_on_the_target(name):
    there = GeneratedModel(FOLDER, Ppc750Machine(image_of(name)))
    before, params, measured = wild(np.random.default_rng(26))
    after, output = before.copy(), there.records("output", COUNT)
    status = np.full(COUNT, -1, np.int32)
    there.step(after, params, measured, output, status)
    assert_safe(before, params, after, output, status)


def plant_and_law(model, batch):
    """Return the bits of the other functions; a NaN has no sign or payload to agree on."""
    rng = np.random.default_rng(23)
    _, params, measured = batch
    plant, motion, applied, rate = (
        model.records(f"plant_{r}", COUNT) for r in ("params", "state", "input", "rate")
    )
    for name in plant.dtype.names:
        known = name in params.dtype.names
        plant[name] = params[name] if known else rng.normal(0.0, 1.0, COUNT)
    for name in motion.dtype.names:
        motion[name] = measured[name]
    applied["tau"] = rng.normal(0.0, 5.0, COUNT)
    inner, law = (model.records(f"continuous_{r}", COUNT) for r in ("state", "output"))
    for name in inner.dtype.names:
        inner[name] = rng.normal(0.0, 1.0, COUNT)
    energy = np.zeros(COUNT)
    model.acceleration(plant, motion, applied, rate)
    model.energy(plant, motion, energy)
    model.continuous(inner, params, measured, law)
    model.plant_step(motion, plant, applied, np.full(COUNT, 0.001), 2)
    columns = {n: r[n] for r in (rate, law, motion) for n in r.dtype.names} | {"energy": energy}
    return {n: np.where(np.isnan(c), 0.125, c).view(np.uint64) for n, c in columns.items()}


@pytest.mark.parametrize("name", TOOLCHAINS)
@pytest.mark.parametrize("draw", [sane, wild])
def test_plant_and_continuous_law_are_bit_identical_on_host_and_target(host, name, draw):
    there = GeneratedModel(FOLDER, Ppc750Machine(image_of(name)))
    batch = draw(np.random.default_rng(24))
    wanted, found = plant_and_law(host, batch), plant_and_law(there, batch)
    assert not [n for n in wanted if (wanted[n] != found[n]).any()]


@needs_gcc
@needs_zig
def test_gcc_and_zig_images_give_the_same_bits():
    models = [GeneratedModel(FOLDER, Ppc750Machine(image_of(n))) for n in ("gcc", "zig")]
    batch = wild(np.random.default_rng(25))
    for one, other in zip(*(step_and_init(m, batch) for m in models), strict=True):
        assert (one == other).all()


@pytest.fixture
def machine():
    return Ppc750Machine(image_of("auto"))


def test_a_jump_to_nowhere_is_reported_and_the_machine_lives_on(machine):
    machine.symbols["nowhere"] = 0x10
    with pytest.raises(CheckError, match="the target stopped at 0x10"):
        machine.call("nowhere")
    assert machine.call("pf_target_check") == 0


def test_a_bad_pointer_is_reported(machine):
    with pytest.raises(CheckError, match="the target stopped at 0x"):
        machine.call("pf_batch_energy", 1, 16, 16, 16)


def test_data_run_as_code_is_reported(machine):
    machine.symbols["data"] = 0x4000_0000  # where arguments are placed: zeros, no instruction
    with pytest.raises(CheckError, match="the target stopped"):
        machine.call("data")


def test_a_batch_larger_than_the_memory_is_reported(target):
    count = 400_000
    arrays = [target.records(f"plant_{r}", count) for r in ("params", "state")]
    with pytest.raises(CheckError, match="larger than the emulated memory"):
        target.energy(*arrays, np.zeros(count))
    assert target.machine.call("pf_target_check") == 0


def test_host_refuses_an_array_with_gaps(host):
    """C would take what lies between the records for records."""
    params = fill_records(host.records("params", 4), MANIFEST.parameter_sets["sim"])[::2]
    with pytest.raises(CheckError, match="not contiguous"):
        host.init(host.records("state", 2), params, np.zeros(2, np.int32))


def test_missing_emulator_is_named(monkeypatch):
    image = image_of("auto")
    monkeypatch.setitem(sys.modules, "unicorn", None)
    with pytest.raises(MissingToolError, match="unicorn") as caught:
        Ppc750Machine(image)
    assert "pip install" in caught.value.remedy


@pytest.mark.parametrize("name", ["auto", "zig", "gcc"])
def test_missing_compilers_are_named(monkeypatch, name):
    monkeypatch.setattr(toolchain.shutil, "which", lambda _: None)
    monkeypatch.setattr(toolchain.importlib.util, "find_spec", lambda _: None)
    for find in (toolchain.ppc750_target, toolchain.host_target):
        with pytest.raises(MissingToolError) as caught:
            find(name)
        assert ("pip install" if name == "zig" else "apt-get install") in caught.value.remedy


def test_compiler_that_refuses_is_quoted(tmp_path):
    (tmp_path / "wrong.c").write_text("int wrong(void) { return nothing; }\n")
    with pytest.raises(CheckError, match="nothing"):
        compile_image(ppc750_target(), [tmp_path / "wrong.c"], tmp_path)


@pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
def test_images_of_compilers_that_differ_in_a_flag_are_kept_apart(tmp_path):
    (tmp_path / "answer.c").write_text("int answer(void);\nint answer(void) { return ANSWER; }\n")
    images = [
        compile_image(
            Target("host", ("gcc", f"-DANSWER={n}"), ("-fPIC", "-shared"), "="),
            [tmp_path / "answer.c"],
            tmp_path,
        )
        for n in (1, 2)
    ]
    assert images[0] != images[1]
