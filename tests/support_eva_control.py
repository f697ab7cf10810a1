"""Frama-C Eva on the complete controller: every bit of memory, parameters and inputs arbitrary.

Numbers may be infinite or NaN here, and a fused multiply-add may give any bits at all; the
elementary functions are analysed as they are. Eva is helped in two ways, in a copy of the sources:

- Its release 25 does not conclude from a comparison that held that neither side is NaN. Where a
  result depends on it, an `admit` right behind the comparison says so: IEEE 754 does.
- `split` has it look at the modes one by one instead of at all of them together.
"""

import shutil
from dataclasses import dataclass

from pfaffian.runtime.machine.sources import control_sources, runtime_c
from support_eva import run_eva

_BUILTINS = """\
#define __builtin_expect(a, b) (a)
#define __builtin_fabs generated_fabs
#define __builtin_fma generated_fma
#define __builtin_nan(tag) (0.0 / 0.0)
#define __builtin_inf() (1.0 / 0.0)
extern double generated_fabs(double a);
extern double generated_fma(double a, double b, double c);
"""
_DEFINED = """\
#include "__fc_builtin.h"
double generated_fabs(double a)
{
    return (a < 0.0) ? -a : ((a > 0.0) ? a : a * a); /* of -0 too, and of NaN */
}
double generated_fma(double a, double b, double c)
{
    double any;
    (void)a;
    (void)b;
    (void)c;
    Frama_C_make_unknown((char *)&any, sizeof any);
    return any;
}
"""
#: Any bytes in a supervisor's memory; the cases are all there are.
_ANY_MODE = """\
    Frama_C_make_unknown((char *)&state, sizeof state);
    Frama_C_make_unknown((char *)&params, sizeof params);
    Frama_C_make_unknown((char *)&input, sizeof input);
    mode = Frama_C_unsigned_int_interval(0U, 4U);
    /*@ split mode; */
    {at}.mode = (mode < 4U) ? mode : Frama_C_unsigned_int_interval(4U, 0xffffffffU);
    if (Frama_C_interval(0, 1)) {{
        {at}.fault = 0U;
    }} else {{
        {at}.fault = Frama_C_unsigned_int_interval(1U, 0xffffffffU);
    }}
"""
_CONSISTENT = """\
    /*@ assert mode: output.mode <= 3; */
    /*@ assert fault: output.fault <= 15; */
    /*@ assert reason: output.reason <= 9; */
    /*@ assert faulty: (output.fault != 0) <==> (output.mode == 3); */
"""
SUPERVISOR = f"""\
#include "pf_supervisor.h"
{_DEFINED}
int main(void)
{{
    pf_supervisor_state_t state;
    pf_supervisor_params_t params;
    pf_supervisor_input_t input;
    pf_supervisor_output_t output;
    pf_transition_t entry;
    uint32_t mode;
{_ANY_MODE.format(at="state")}
    pf_supervisor_step(&state, &params, &input, &output);
{_CONSISTENT}
    /*@ assert allowed: output.torque_allowed == 1 <==> (output.mode == 1 || output.mode == 2); */
    /*@ assert entered: output.entered <= 1; */
    (void)pf_supervisor_log_read(&state, Frama_C_unsigned_int_interval(0U, 0xffffffffU), &entry);
    pf_supervisor_trip(&state, (pf_fault_t)Frama_C_interval(0, 0x7fffffff), &output);
    /*@ assert tripped: output.mode == 3 && output.torque_allowed == 0; */
    (void)pf_supervisor_init(&state, &params);
    /*@ assert begun: state.mode == 0 || state.mode == 3; */
    return 0;
}}
"""
SENSING = f"""\
#include "pf_sensing.h"
{_DEFINED}
int main(void)
{{
    pf_sensing_state_t state;
    pf_sensing_params_t params;
    pf_sensing_input_t input;
    pf_sensing_output_t output;
    pf_sensing_status_t status;

    Frama_C_make_unknown((char *)&state, sizeof state);
    Frama_C_make_unknown((char *)&params, sizeof params);
    Frama_C_make_unknown((char *)&input, sizeof input);
    if (Frama_C_interval(0, 1)) {{
        (void)pf_sensing_retune(&state, &params);
    }}
    status = pf_sensing_step(&state, &input, &output);
    /*@ assert status: 0 <= status <= 7; */
    /*@ assert written: \\initialized(&output.angle) && \\initialized(&output.velocity); */
    params.offset = Frama_C_double_interval(-1000.0, 1000.0);
    params.counts_per_turn = Frama_C_double_interval(4.0, 4294967296.0);
    status = pf_sensing_init(&state, &params);
    /*@ assert status: status == 0 || status == 4 || status == 6; */
    status = pf_sensing_step(&state, &input, &output);
    /*@ assert first: \\is_finite(output.angle) && \\is_finite(output.velocity); */
    return 0;
}}
"""
_CONTROL = """\
#include "{model}_control.h"
{defined}
int main(void)
{{
    static {model}_control_state_t state;
    static {model}_control_params_t params;
    static {model}_control_input_t input;
    {model}_control_output_t output;
    uint32_t mode;
{any_mode}
{limits}
    {before}
    {model}_control_step(&state, &params, &input, &output);
{consistent}
    /*@ assert phase: output.phase <= 2; */
{assertions}
    return 0;
}}
"""
_STEP = """\
#include "{model}.h"
{defined}
int main(void)
{{
    static {model}_state_t state;
    static {model}_params_t params;
    static {model}_input_t input;
    {model}_output_t output;

    Frama_C_make_unknown((char *)&state, sizeof state);
    Frama_C_make_unknown((char *)&params, sizeof params);
    Frama_C_make_unknown((char *)&input, sizeof input);
    if (Frama_C_interval(0, 1)) {{
        (void){model}_init(&state, &params);
    }}
    (void){model}_step(&state, &params, &input, &output);
{assertions}
    return 0;
}}
"""
#: What stands in the copy instead, by file: (before, after).
_HELP = {
    "pf_supervisor.c": (
        (
            "    return lies_within(value, -limit, limit) ? value : 0.0;",
            "    if (lies_within(value, -limit, limit)) {\n        /*@ admit !\\is_NaN(value); */\n"
            "        return value;\n    }\n    return 0.0;",
        ),
        (
            "    if (value > limit) {",
            "    /*@ admit !\\is_NaN(limit) && \\is_finite(limit) && limit >= 0.0; */\n"
            "    if (value > limit) {",
        ),
        (
            "    whole = (double)(int32_t)",
            "    /*@ admit !\\is_NaN(turns); */\n    whole = (double)(int32_t)",
        ),
        (
            "    state->outside = 0U;\n}\n\npf_supervisor_status_t",
            "    state->outside = 0U;\n    /*@ split state->mode; */\n}\n\npf_supervisor_status_t",
        ),
    ),
    "{model}_plan.c": (
        (
            "    if (!(time < plan->end_time)) {",
            "    /*@ admit !\\is_NaN(time); */\n    if (!(time < plan->end_time)) {",
        ),
    ),
}


@dataclass(frozen=True)
class Limits:
    """The torque limits in the parameter block: one that is given, or whatever bits stand there."""

    value: float | None


def control_driver(manifest, limits, init):
    """Return the driver of a complete control step; `init` has the memory made by init."""
    rows, asserted = [], []
    for torque, limit in zip(manifest.actuators, manifest.limits, strict=True):
        within = f"\\is_finite(output.{torque})"
        if limits.value is not None:
            bits = limits.value.hex()  # in a contract a decimal is a real number, not a double
            rows.append(f"    params.law.{limit} = {bits};")
            within += f" && -{bits} <= output.{torque} <= {bits}"
        asserted += [
            f"    /*@ assert within: {within}; */",
            f"    /*@ assert allowed: output.{torque} != 0 ==> (1 <= output.mode <= 2); */",
        ]
    asserted += [
        f"    /*@ assert written: \\initialized(&output.{field.name}); */"
        for field in manifest.control_structures["control_output"].fields
        if field.type in ("double", "uint32_t")
    ]
    begun = f"(void){manifest.model}_control_init(&state, &params);" if init else ""
    return _CONTROL.format(
        model=manifest.model,
        defined=_DEFINED,
        any_mode=_ANY_MODE.format(at="state.supervisor"),
        limits="\n".join(rows),
        before=begun,
        consistent=_CONSISTENT,
        assertions="\n".join(asserted),
    )


def prove_step(code, scratch):
    """Run Eva on one step of a law in `scratch`, from any bits and from what init makes of them."""
    model, folder = code.manifest.model, scratch / "c"
    folder.mkdir()
    for path in (code.path / "c").glob("*.[ch]"):
        shutil.copy(path, folder)
    written = [
        f"    /*@ assert written: \\initialized(&output.{f.name}); */"
        for f in code.manifest.structures["output"].fields
    ]
    text = _STEP.format(model=model, defined=_DEFINED, assertions="\n".join(written))
    (folder / "builtins.h").write_text(_BUILTINS)
    driver = folder / "driver.c"
    driver.write_text(text)
    options = ["-eva-precision", "2", "-eva-domains", "equality,symbolic-locations"]
    options += ["-warn-special-float", "none", "-eva-split-return", "auto", "-eva-slevel", "100"]
    sources = [driver, folder / f"{model}.c", folder / "pf_elementary.c"]
    return run_eva(sources, [folder], options, f"-include {folder / 'builtins.h'}")


def prove_any(code, text, scratch, only=(), spoil=None):
    """Run Eva on the driver `text` with the sources of a complete controller in `scratch`.

    `only` names the files to be analysed, all of them if empty; `spoil` is (file, before, after).
    """
    model = code.manifest.model
    sources = control_sources(code.path, code.manifest)
    folder = scratch / "c"
    folder.mkdir()
    for path in (*sources, *(code.path / "c").glob("*.h"), *runtime_c().glob("pf_s*.h")):
        shutil.copy(path, folder)
    changes = [(n.format(model=model), *c) for n, cases in _HELP.items() for c in cases]
    for name, old, new in [*changes, *([spoil] if spoil else [])]:
        path = folder / name
        whole = path.read_text()
        assert whole.count(old) == 1, (name, old)
        path.write_text(whole.replace(old, new))
    (folder / "builtins.h").write_text(_BUILTINS)
    driver = folder / "driver.c"
    driver.write_text(text)
    asked = [folder / p.name for p in sources if not only or p.name in only]
    options = ["-eva-precision", "2", "-eva-domains", "equality,symbolic-locations"]
    options += ["-warn-special-float", "none", "-eva-split-return", "auto"]
    options += ["-eva-interprocedural-splits", "-eva-slevel", "500" if only else "50"]
    return run_eva([driver, *asked], [folder], options, f"-include {folder / 'builtins.h'}")
