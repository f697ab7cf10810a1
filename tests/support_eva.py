"""Frama-C Eva on a generated step: a driver with interval inputs, and what Eva says of it.

The elementary functions are given by contracts, whose bounds `test_eva.py` holds against their
compiled code. A fused multiply-add is analysed as a product and a sum: one rounding more, so what
Eva bounds holds of the one rounding too (each is monotonic, and Eva rounds outwards).
"""

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

#: Function, its domain, and its results' bounds: what the contracts say, one unit in the last place
#: beyond what the functions reach.
ONE = 1.0000000000000002
CONTRACTS = {
    "pf_sincos": ((-1e5, 1e5), (-ONE, ONE)),
    "pf_atan": ((-1.7e308, 1.7e308), (-1.5707963267948970, 1.5707963267948970)),
    "pf_sqrt": ((2.0**-126, 2.0**127), (2.0**-64, 2.0**64)),
    "pf_exp": ((-1e10, 0.0), (0.0, ONE)),
    "pf_expm1": ((-1e10, 0.0), (-ONE, 0.0)),
    "pf_tanh": ((-1.7e308, 1.7e308), (-ONE, ONE)),
}
_INLINE = {
    "pf_sincos_within_inline": "pf_sincos",
    "pf_sincos_inline": "pf_sincos",
    "pf_atan_inline": "pf_atan",
    "pf_sqrt_normal_inline": "pf_sqrt",
    "pf_sqrt_inline": "pf_sqrt",
}
_PROLOGUE = """\
/* Written by the tests: one step of {model} over intervals, for Frama-C Eva. */
#define __builtin_expect(a, b) (a)
#define __builtin_fabs generated_fabs
#define __builtin_fma generated_fma_builtin
static double generated_fabs(double a) {{ return (a < 0.0) ? -a : a; }}
static double generated_fma_builtin(double a, double b, double c) {{ return a * b + c; }}
{hidden}
#include "pf_elementary_inline.h"
#include "pf_scalar.h"
{shown}
#define pf_arithmetic_holds() 1
#define pf_arithmetic_fuses() 1
#define pf_abs(x) (((x) < 0.0) ? -(x) : (x))
#define pf_fma(a, b, c) ((a) * (b) + (c))
#define pf_fms(a, b, c) ((a) * (b) - (c))
#define pf_fnms(a, b, c) ((c) - (a) * (b))
#include "__fc_builtin.h"
{contracts}
#include "{model}.c"
#include "{model}_params.c"
int main(void)
{{
    {model}_params_t params = {model}_params_{name};
    {model}_state_t state;
    {model}_input_t input;
    {model}_output_t output;
    {model}_status_t status = {model}_init(&state, &params);

    if (status != 0) {{
        return -1;
    }}
{intervals}
    status = {model}_step(&state, &params, &input, &output);
{assertions}
    return (int)status;
}}
"""


@dataclass(frozen=True)
class Verdict:
    """What Eva found: alarms, and how many properties it proved and did not prove."""

    alarms: int
    proved: int
    unproved: int
    said: str


def contracts():
    """Return the ACSL contracts of the elementary functions."""
    rows = []
    for name, function in (*_INLINE.items(), *((n, n) for n in CONTRACTS if n not in _INLINE)):
        (low, high), (least, most) = CONTRACTS[function]
        asked = f"requires \\is_finite(x) && {low!r} <= x <= {high!r};"
        within = f"{least!r} <= {{0}} <= {most!r}"
        if function == "pf_sincos":
            given = " ".join(
                f"ensures \\initialized({p}) && \\is_finite(*{p}) && {within.format(f'*{p}')};"
                for p in ("s", "c")
            )
            rows += [
                f"/*@ {asked} requires \\valid(s) && \\valid(c);",
                f"    assigns *s, *c \\from x; {given} */",
                f"void {name}(double x, double *s, double *c);",
            ]
        else:
            given = f"ensures \\is_finite(\\result) && {within.format(chr(92) + 'result')};"
            rows += [
                f"/*@ {asked} assigns \\result \\from x; {given} */",
                f"double {name}(double x);",
            ]
    return "\n".join(rows)


def driver(manifest, name, intervals):
    """Return the driver for one parameter set; `intervals` are (low, high) by member's path."""
    words = [*_INLINE, "pf_abs", "pf_fma", "pf_fms", "pf_fnms"]
    words += ["pf_arithmetic_holds", "pf_arithmetic_fuses"]
    lines = [
        f"    {path} = Frama_C_double_interval({low!r}, {high!r});"
        for path, (low, high) in intervals.items()
    ]
    lines.append("    state.engaged = Frama_C_unsigned_int_interval(0, 1);")
    asserted = [
        f"    /*@ assert within: -params.{limit} <= output.{torque} <= params.{limit}; */"
        for torque, limit in zip(manifest.actuators, manifest.limits, strict=True)
    ]
    asserted += [
        f"    /*@ assert finite: \\is_finite({path}.{f.name}); */"
        for path in ("output", "state")
        for f in manifest.structures[path].fields
        if f.type == "double"
    ]
    return _PROLOGUE.format(
        model=manifest.model,
        name=re.sub(r"\W", "_", name),
        hidden="\n".join(f"#define {w} generated_{w}" for w in words),
        shown="\n".join(f"#undef {w}" for w in words),
        contracts=contracts(),
        intervals="\n".join(lines),
        assertions="\n".join(asserted),
    )


def intervals_of(manifest, remembered, angle=1000.0, rate=100.0):
    """Return the intervals of measurements, and of what the law remembers."""
    found = {}
    for n in manifest.structures["input"].names():
        found[f"input.{n}"] = (-rate, rate) if n.startswith("d") else (-angle, angle)
    return found | {f"state.{n}": r for n, r in remembered.items()}


def prove(folder, text, scratch):
    """Run Eva on the driver `text` with the sources in `folder`."""
    path = Path(scratch) / "driver.c"
    path.write_text(text)
    options = ["-eva-precision", "2", "-eva-subdivide-non-linear", "64"]
    options += ["-eva-domains", "equality", "-warn-special-float", "non-finite"]
    return run_eva([path], [folder], options)


def run_eva(sources, folders, options, before=""):
    """Run Eva on `sources`, as a 32-bit PowerPC compiles them; `before` is for the preprocessor."""
    share = subprocess.run(
        ["frama-c", "-print-share-path"], capture_output=True, text=True, check=True
    ).stdout.strip()
    included = " ".join(f"-I{f}" for f in (*folders, f"{share}/libc"))
    command = ["frama-c", "-machdep", "ppc_32"]
    command += [f"-cpp-extra-args=-U__FLT_EVAL_METHOD__ {before} {included}"]
    command += ["-eva", *options, *map(str, sources)]
    scratch = Path(sources[0]).parent
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=scratch)
    said = done.stdout + done.stderr
    alarms = re.search(r"(\d+) alarms? generated by the analysis", said)
    counts = re.findall(
        r"(?:Assertions|Preconditions) +(\d+) valid +(\d+) unknown +(\d+) invalid", said
    )
    assert alarms, said
    assert counts, said
    return Verdict(
        int(alarms[1]),
        sum(int(c[0]) for c in counts),
        sum(int(c[1]) + int(c[2]) for c in counts),
        said,
    )
