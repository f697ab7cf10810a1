"""Sanitizers find nothing in generated code over random and wild inputs."""

import shutil
import subprocess

import numpy as np
import pytest
from conftest import REPOSITORY
from pfaffian.runtime.code.generated_model import open_generated
from pfaffian.runtime.contract.dtypes import layout_of
from pfaffian.runtime.machine.sources import controller_sources, harness_sources, runtime_c
from test_c_safety import garbage, sensible

CHECKS = "address,undefined,float-cast-overflow"
#: A quotient of finite numbers by zero is an answer of a wild sample, which the step then refuses.
FLOAT_CHECKS = f"{CHECKS},float-divide-by-zero"
COUNT = 20_000
PROGRAM = r"""
#include "pf_model.h"
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
uint32_t pf_target_check(void);

int main(void)
{
    struct { PF_STATE_T state; PF_PARAMS_T params; PF_INPUT_T input; } *one;
    PF_OUTPUT_T output;
    unsigned long taken = 0, status;
    one = malloc(sizeof *one); /* of its own, so that nothing beside it may be touched */
    while (fread(one, sizeof *one, 1, stdin) == 1) {
        status = (unsigned long)PF_STEP(&one->state, &one->params, &one->input, &output);
        (void)PF_INIT(&one->state, &one->params);
        taken += (status < 3U) ? 1U : 0U;
    }
    free(one);
    printf("%lu %u\n", taken, (unsigned)pf_target_check());
    return 0;
}
"""


COMPILERS = [
    pytest.param(
        name,
        marks=pytest.mark.skipif(
            not shutil.which(name), reason=f"needs {name}: apt-get install {name}"
        ),
    )
    for name in ("gcc", "clang")
]


def build(compiler, code, checks, folder):
    (folder / "main.c").write_text(PROGRAM)
    sources = harness_sources(code.path, code.manifest)
    assert set(controller_sources(code.path, code.manifest)) <= set(sources)
    command = [compiler, "-std=c99", "-O1", "-g", "-ffp-contract=off", "-fno-math-errno"]
    command += [f"-fsanitize={checks}", "-fno-sanitize-recover=all", f"-I{code.path / 'c'}"]
    command += ["main.c", *map(str, sources), "-o", "main", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode and "cannot find" in done.stderr + done.stdout:
        pytest.skip(f"needs the sanitizers' library of {compiler}: libclang-rt-14-dev")
    assert done.returncode == 0, done.stderr


def packed(code, state, params, measured):
    """Return the records one after the other, as the program reads them."""
    structures = code.manifest.structures
    kind = np.dtype(
        [(r, layout_of(structures[r])) for r in ("state", "params", "input")], align=True
    )
    rows = np.zeros(len(state), kind)
    rows["state"], rows["params"], rows["input"] = state, params, measured
    return rows.tobytes()


@pytest.mark.parametrize("wild", [False, True], ids=["sensible", "wild"])
@pytest.mark.parametrize("model", ["pendubot", "chain", "pvtol"])
@pytest.mark.parametrize("compiler", COMPILERS)
def test_sanitizers_find_nothing(compiler, model, wild, tmp_path):
    """Divisions by zero are watched over sensible samples; wild ones make them on purpose."""
    code = open_generated(model)
    build(compiler, code, CHECKS if wild else FLOAT_CHECKS, tmp_path)
    rng = np.random.default_rng(61)
    batch = samples(code, rng, wild)
    done = subprocess.run(
        ["./main"], cwd=tmp_path, input=packed(code, *batch), capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()[-3000:]
    taken, fault = map(int, done.stdout.split())
    assert fault == 0
    assert taken > (0 if wild else 0.5 * COUNT)


def samples(code, rng, wild):
    known = code.manifest.model == "pendubot"
    batch = sensible(code, rng, COUNT) if known else simple(code, rng)
    return [garbage(rng, b) for b in batch] if wild else batch


def simple(code, rng):
    from pfaffian.runtime.code.generated_model import fill_records, host_model

    model = host_model(code)
    values = next(iter(code.manifest.parameter_sets.values()))
    params = fill_records(model.records("params", COUNT), dict(values))
    state, measured = model.records("state", COUNT), model.records("input", COUNT)
    model.init(state, params, np.zeros(COUNT, np.int32))
    for name in measured.dtype.names:
        measured[name] = rng.normal(0.0, 1.0, COUNT)
    return state, params, measured


FAULTY = {
    "a write beside a structure": (
        "    output->tau = command;",
        "    (&output->adb)[1] = command;",
    ),
    "a division by zero": ("1.0 / det_m", "1.0 / (det_m - det_m)"),
    "a cast that does not fit": (
        "    output->tau = command;",
        "    output->tau = (double)(int)(1e20 * det_m);",
    ),
}


@pytest.mark.parametrize("fault", FAULTY)
@pytest.mark.parametrize("compiler", COMPILERS)
def test_a_planted_fault_is_found(compiler, fault, tmp_path):
    real = open_generated("pendubot")
    shutil.copytree(real.path, tmp_path / "code")
    path = tmp_path / "code" / "c" / "pendubot.c"
    old, new = FAULTY[fault]
    assert path.read_text().count(old) == 1
    path.write_text(path.read_text().replace(old, new))
    code = open_generated(str(tmp_path / "code"))
    build(compiler, code, FLOAT_CHECKS, tmp_path)
    batch = sensible(real, np.random.default_rng(61), 50)
    done = subprocess.run(
        ["./main"], cwd=tmp_path, input=packed(code, *batch), capture_output=True, check=False
    )
    assert done.returncode != 0


# --- Memory that init has not prepared ------------------------------------------------------

MODELS = sorted(p.parent.name for p in (REPOSITORY / "generated").glob("*/c"))
UNPREPARED = """
    {{
        static {model}_state_t state;
        {model}_params_t params = {model}_params_{name};
        {model}_input_t input;
        {model}_output_t output;

        memset(&input, 0, sizeof input);
        memset(&output, 1, sizeof output);
        printf("%d ", (int){model}_step(&state, &params, &input, &output));
        printf("%d ", (output.{torque} == 0.0) ? 0 : 1);
        params.sample_time = -1.0;
        printf("%d ", (int){model}_init(&state, &params)); /* leaves it zero */
        printf("%d\\n", (int){model}_step(&state, &params, &input, &output));
    }}
"""


@pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc: apt-get install gcc")
def test_a_zeroed_memory_is_refused_and_divides_nothing_by_zero_in_all_models(tmp_path):
    blocks, sources, includes, wanted = [], [], [], []
    for model in MODELS:
        code = open_generated(model)
        names, status = sorted(code.manifest.parameter_sets), code.manifest.status
        blocks.append(
            UNPREPARED.format(
                model=model, name=names[0].replace("-", "_"), torque=code.manifest.actuators[0]
            )
        )
        includes.append(f'#include "{code.path / "c" / model}.h"')
        sources += [code.path / "c" / f"{model}{end}.c" for end in ("", "_params")]
        unready, bad = status.index("NOT_READY"), status.index("BAD_PARAMETER")
        wanted.append([unready, 0, bad, unready])
    text = "\n".join(
        ["#include <stdio.h>", "#include <string.h>", *includes, "int main(void)", "{"]
    )
    text += "".join(blocks) + "    return 0;\n}\n"
    (tmp_path / "main.c").write_text(text)
    command = ["gcc", "-std=c99", "-O1", "-ffp-contract=off", "-fno-math-errno"]
    command += ["-fsanitize=undefined,float-divide-by-zero,float-cast-overflow"]
    command += ["-fno-sanitize-recover=all", "main.c", *map(str, sources)]
    command += [str(open_generated("pendubot").path / "c" / "pf_elementary.c"), "-o", "main", "-lm"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    if done.returncode and "cannot find" in done.stderr:
        pytest.skip("this gcc has no sanitizers")
    assert done.returncode == 0, done.stderr
    done = subprocess.run(["./main"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert [[int(w) for w in row.split()] for row in done.stdout.splitlines()] == wanted


@pytest.mark.skipif(not shutil.which("clang"), reason="needs clang: apt-get install clang")
def test_no_number_stands_where_a_condition_is_meant_in_any_model(tmp_path):
    """`if (state->near_singular_)` asked a double; clang and gcc tell it as a conversion."""
    command = ["clang", "-std=c99", "-fsyntax-only", "-ffp-contract=off", "-fno-math-errno"]
    command += ["-Wconversion", "-Wfloat-conversion", "-Wextra", "-Werror"]
    for model in MODELS:
        c = open_generated(model).path / "c"
        sources = sorted(p for p in c.glob("*.c") if p.name != "pf_elementary.c")
        runtime = f"-I{runtime_c()}"
        done = subprocess.run(
            [*command, f"-I{c}", runtime, *map(str, sources)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    (tmp_path / "planted.c").write_text(
        "int planted(double x);\nint planted(double x)\n{\n    return x ? 1 : 0;\n}\n"
    )
    done = subprocess.run(
        [*command, str(tmp_path / "planted.c")], capture_output=True, text=True, check=False
    )
    assert "-Wfloat-conversion" in done.stderr
