"""Emitted derivatives are those of the symbolic source, of the generated plant, and of design."""

import mpmath as mp
import numpy as np
import pytest
from conftest import tree
from pfaffian.derive.design.place.linear_plant import state_space
from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.generation import generate
from pfaffian.derive.ir.names import PLANT_PREFIX
from pfaffian.derive.ir.program import LOGICAL, Op
from pfaffian.derive.pipeline import derivation_of, jacobian_programs, library_sets, lowered_model
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.verify.sampling import draw
from pfaffian.derive.writer import write_generation
from pfaffian.runtime.code.generated_model import GeneratedFolder, host_model
from pfaffian.runtime.contract.manifest import read_manifest
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.emulator import Ppc750Machine
from pfaffian.runtime.machine.host import HostMachine
from pfaffian.runtime.machine.sources import harness_sources
from pfaffian.runtime.machine.toolchain import host_target, ppc750_target
from support_derivatives import DIGITS, Forward, at_50_digits, unit

MODELS = ("pendubot", "pvtol")


@pytest.fixture(scope="module", params=MODELS)
def made(request, tmp_path_factory):
    """A model generated with its derivatives: folder, programs, lowered model, derivation."""
    source = find_model(request.param)
    model = lowered_model(source)
    programs = jacobian_programs(source)
    emission = Emission(model, library_sets(model, source), jacobians=programs)
    path = tmp_path_factory.mktemp("jacobians") / request.param
    write_generation(generate(emission), path)
    folder = GeneratedFolder(path, read_manifest(path))
    return folder, {p.name: p for p in programs}, model, derivation_of(source)


def variables_of(program):
    """Return the names that the outputs of `program` are derived by, in order."""
    return list(dict.fromkeys(s.name.split("_by_")[1] for s in program.outputs))


def functions_of(program):
    return list(dict.fromkeys(s.name.split("_by_")[0] for s in program.outputs))


def samples(model, program, sets, count, seed):
    """Return inputs of `program`: around the parameter sets, and others."""
    plain = [
        s
        if s.group != "plant_parameter"
        else type(s)(s.name.removeprefix(PLANT_PREFIX), s.unit, s.description, "parameter")
        for s in program.inputs
    ]
    drawn = draw(model, plain, sets, count, np.random.default_rng(seed)).values
    return [
        {s.name: float(drawn[p.name][k]) for s, p in zip(program.inputs, plain, strict=True)}
        for k in range(count)
    ]


def compare(program, values, found):
    """Compare 50-digit derivatives; found is {function: (value, slopes)} from SymPy."""
    ours = at_50_digits(program, values)
    variables = variables_of(program)
    for f in functions_of(program):
        size = max(abs(slope) for slope in found[f][1]) + mp.mpf(10) ** -30
        for v, exact in zip(variables, found[f][1], strict=True):
            got = ours[f"{f}_by_{v}"]
            # Constants that are no pi are exact; what is left is the rounding of 50 digits.
            assert abs(got - exact) <= mp.mpf(10) ** -35 * size, (program.name, f, v, got, exact)


def whole(model, values):
    """Return `values` with what no equation depends on at rest."""
    names = [n for c in model.coordinates for n in (c.name, f"d{c.name}")]
    return dict.fromkeys(names, 0.0) | values


def exactly(values):
    return {n: mp.mpf(v) for n, v in values.items()}


@pytest.mark.parametrize(("name", "block"), [("plant", "acceleration"), ("step", "step")])
def test_the_program_is_what_sympy_differentiates_to_at_50_digits(made, name, block):
    _, programs, model, derivation = made
    program = programs[f"{name}_jacobian"]
    forward = Forward(derivation.block(block))
    variables = variables_of(program)
    seeds = {v: unit(k, len(variables)) for k, v in enumerate(variables)}
    sets = [s.as_dict() for s in library_sets(model, find_model(model.name))]
    for values in samples(model, program, sets, 40, 1):
        # Parameters that cancel in the derivatives are still inputs of the block.
        with mp.workdps(DIGITS):
            compare(program, values, forward(exactly(whole(model, values)), seeds))


def test_the_closed_loop_is_what_sympy_differentiates_to_at_50_digits(made):
    _, programs, model, derivation = made
    program = programs["closed_loop_jacobian"]
    law, plant = Forward(derivation.block("continuous")), Forward(derivation.block("acceleration"))
    variables = variables_of(program)
    seeds = {v: unit(k, len(variables)) for k, v in enumerate(variables)}
    sets = [s.as_dict() for s in library_sets(model, find_model(model.name))]
    for values in samples(model, program, sets, 30, 2):
        with mp.workdps(DIGITS):
            given = exactly(whole(model, values))
            found = law(given, seeds)
            own = {
                n.removeprefix(PLANT_PREFIX): v
                for n, v in given.items()
                if n.startswith(PLANT_PREFIX)
            }
            torques = {a.name: found[a.name] for a in model.actuators}
            moved = plant(
                given | own | {n: v for n, (v, _) in torques.items()},
                seeds | {n: slopes for n, (_, slopes) in torques.items()},
            )
            compare(program, values, found | moved)


def test_no_derivative_computes_with_truth_values(made):
    for program in made[1].values():
        logical = {k for k, i in enumerate(program.instructions) if i.op in LOGICAL}
        assert not logical & set(program.results)
        for i in program.instructions:
            taken = i.args[1:] if i.op is Op.SELECT else i.args
            assert i.op in LOGICAL or not logical & set(taken), i


# ---- the emitted code ---------------------------------------------------------------------------

ROLES = {
    "plant_jacobian": ("plant_params", "plant_state", "plant_input"),
    "step_jacobian": ("state", "params", "input"),
    "closed_loop_jacobian": ("continuous_state", "params", "plant_params", "input"),
}


def sources(folder):
    return [
        *harness_sources(folder.path, folder.manifest),
        folder.path / "c" / f"{folder.manifest.model}_jacobian.c",
    ]


def on_host(folder):
    image = compile_image(host_target(fma=True), sources(folder), folder.path / "c")
    return HostMachine(image)


def records_of(host, roles, program, values):
    """Fill one record of each role from the inputs of `program`."""
    found = []
    for role in roles:
        record = host.records(role)
        for name in record.dtype.names or ():
            own = f"{PLANT_PREFIX}{name}"
            key = own if role == "plant_params" and own in values else name
            record[name] = values.get(key, 0.0)
        found.append(record)
    return found


def run_c(machine, folder, program, records):
    """Return the derivatives by name that the emitted C computes on `machine`."""
    order = machine.byte_order
    passed = [r.astype(r.dtype.newbyteorder(order)) for r in records]
    out = np.zeros(len(program.outputs), f"{order}f8")
    machine.call(f"{folder.manifest.model}_{program.name}", *passed, out)
    return out.astype("f8")


def test_emitted_c_and_numpy_are_the_program_to_rounding(made):
    folder, programs, model, _ = made
    host, machine = host_model(folder), on_host(folder)
    space = {}
    exec((folder.path / f"{model.name}_jacobian.py").read_text(), space)
    sets = [s.as_dict() for s in library_sets(model, find_model(model.name))]
    for name, roles in ROLES.items():
        program = programs[name]
        for values in samples(model, program, sets, 200, 3):
            records = records_of(host, roles, program, values)
            c = run_c(machine, folder, program, records)
            views = [type("S", (), {n: float(r[n][0]) for n in r.dtype.names}) for r in records]
            numpy = space[name](*views)
            python = np.array([float(getattr(numpy, s.name)) for s in program.outputs])
            with mp.workdps(DIGITS):
                exact = at_50_digits(program, values)
            exact = np.array([float(exact[s.name]) for s in program.outputs])
            size = np.abs(exact.reshape(len(functions_of(program)), -1)).max(axis=1)
            size = np.repeat(size, len(variables_of(program)))
            worst = np.maximum(np.abs(c - exact), np.abs(python - exact)) / (size + 1e-300)
            assert np.isfinite(c).all()
            assert (worst <= 1e-9).all(), (name, worst.max())


@pytest.mark.target
def test_host_and_powerpc_give_the_same_bits(made):
    folder, programs, model, _ = made
    host, machine = host_model(folder), on_host(folder)
    whole_image = ("-Wl,-e,pf_target_check", "-Wl,--no-gc-sections")
    image = compile_image(ppc750_target(), sources(folder), folder.path / "c", whole_image)
    target = Ppc750Machine(image)
    sets = [s.as_dict() for s in library_sets(model, find_model(model.name))]
    for name, roles in ROLES.items():
        for values in samples(model, programs[name], sets, 60, 4):
            records = records_of(host, roles, programs[name], values)
            one = run_c(machine, folder, programs[name], records)
            other = run_c(target, folder, programs[name], records)
            assert one.tobytes() == other.tobytes(), name


# ---- beside numerical differences and the design stage -----------------------------------------


def test_the_plant_derivatives_are_numerical_differences_of_the_generated_plant(made):
    folder, programs, model, _ = made
    host, machine = host_model(folder), on_host(folder)
    program = programs["plant_jacobian"]
    sets = [s.as_dict() for s in library_sets(model, find_model(model.name))]
    compared = 0
    for values in samples(model, program, sets, 60, 5):
        if any(abs(values[s.name]) > 20.0 for s in program.inputs if s.group == "input"):
            continue  # the far half of the samples turns too fast for a difference of fixed step
        compared += 1
        records = records_of(host, ROLES["plant_jacobian"], program, values)
        found = run_c(machine, folder, program, records)
        found = found.reshape(len(functions_of(program)), -1)
        rate, step = host.records("plant_rate"), 1e-5
        for k, variable in enumerate(variables_of(program)):
            sides = []
            for sign in (1.0, -1.0):
                params, state, applied = (r.copy() for r in records)
                place = state if variable in state.dtype.names else applied
                place[variable] += sign * step
                host.acceleration(params, state, applied, rate)
                sides.append(np.array(rate.tolist()[0]))
            difference = (sides[0] - sides[1]) / (2.0 * step)
            scale = np.abs(found).max() + np.abs(sides).max()
            assert np.abs(found[:, k] - difference).max() <= 1e-6 * scale, variable
    assert compared > 20


def numpy_module(folder):
    space = {}
    exec((folder.path / f"{folder.manifest.model}_jacobian.py").read_text(), space)
    return space


def filled(kind, values):
    return kind(**{n: values.get(n, 0.0) for n in kind.__annotations__})


def complete(model, parameters):
    defaults = {p.name: p.default for p in model.parameters if p.default is not None}
    return defaults | parameters.as_dict()


def held_at_the_setpoint(folder, values):
    """Return arguments of the plant at rest at the setpoint, under the torque that holds it."""
    module, code = folder.python_module(), numpy_module(folder)
    params = filled(module.PlantParams, values)
    state = filled(module.PlantState, module.setpoint(filled(module.Params, values)))
    still = filled(module.PlantInput, {})
    _, b = code["plant_matrices"](code["plant_jacobian"](params, state, still))
    rate = module.acceleration(params, state, still)
    falling = np.array([float(getattr(rate, n)) for n in module.PlantRate.__annotations__])
    torque = -np.linalg.lstsq(b[len(falling) :], falling, rcond=None)[0]
    names = module.PlantInput.__annotations__
    return params, state, module.PlantInput(**dict(zip(names, torque, strict=True)))


def test_at_the_setpoint_they_are_the_linear_plant_of_the_design(made):
    folder, _, model, _ = made
    code = numpy_module(folder)
    for parameters in library_sets(model, find_model(model.name)):
        held = held_at_the_setpoint(folder, complete(model, parameters))
        a, b = code["plant_matrices"](code["plant_jacobian"](*held))
        wanted_a, wanted_b = state_space(model, parameters.as_dict())
        assert np.abs(a - wanted_a).max() <= 1e-12 * np.abs(wanted_a).max()
        assert np.abs(b - wanted_b).max() <= 1e-12 * np.abs(wanted_b).max()


def test_the_closed_loop_at_rest_at_the_setpoint_is_finite(made):
    """There |e| and |e'| have a corner: 0, which lies between the slopes around, is taken."""
    folder, programs, model, _ = made
    module, code = folder.python_module(), numpy_module(folder)
    values = complete(model, library_sets(model, find_model(model.name))[0])
    params = filled(module.Params, values)
    jacobian = code["closed_loop_jacobian"](
        filled(module.ContinuousState, {"bound_estimate": 0.1}),
        params,
        filled(module.PlantParams, values),
        filled(module.Input, module.setpoint(params)),
    )
    matrix = code["closed_loop_matrix"](jacobian)
    assert matrix.shape == (len(variables_of(programs["closed_loop_jacobian"])),) * 2
    assert np.isfinite(matrix).all()
    assert matrix[-1, -1] == -values["k2"]  # the estimate leaks, and at rest nothing feeds it


def test_without_the_option_nothing_of_it_is_generated(tmp_path, run):
    assert run("generate", "pendubot", "-o", tmp_path / "plain").code == 0
    assert run("generate", "pendubot", "--jacobians", "-o", tmp_path / "with").code == 0
    plain, more = tree(tmp_path / "plain"), tree(tmp_path / "with")
    assert set(more) - set(plain) == {
        "c/pendubot_jacobian.c",
        "c/pendubot_jacobian.h",
        "pendubot_jacobian.py",
    }
    listing = ("manifest.json", "c/Makefile", "c/CMakeLists.txt")  # of what there is
    assert all(more[p] == plain[p] for p in plain if p not in listing)
    assert run("generate", "pendubot", "--jacobians", "--check", "-o", tmp_path / "with").code == 0
