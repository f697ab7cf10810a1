"""One control step by several tools, each as C with the same adapter around it, for the benchmark.

All of them get the block `step` of the same derivation; those written by hand are the law as an
engineer writes it. What differs is the code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path

import casadi as ca
import sympy as sp
from pfaffian.benchmarks.step import CAPACITY, StepTool
from pfaffian.derive.emit.templates import fill
from pfaffian.derive.lower.to_casadi import ToCasadi
from pfaffian.derive.symbolic.block import Block
from pfaffian.derive.symbolic.functions import side
from pfaffian.runtime.code.generated_model import GeneratedFolder
from pfaffian.runtime.machine.sources import controller_sources
from sympy.codegen.rewriting import create_expand_pow_optimization

#: Groups of inputs that stay the same from step to step.
_CONSTANT = ("parameter", "prepared")
#: Members of `hand_params_t`.
_HAND_PARAMETERS = (
    *("theta1", "theta2", "theta3", "theta4", "theta5", "g", "lam", "lam1", "lam2", "sigma"),
    *("eta", "kappa", "epsilon", "q1d", "q2d", "sample_time", "torque_limit"),
    "slew_limit",
    *("singular_threshold", "leakage_decay", "adaptation_step"),
)
#: Members of `hand_output_t`.
_HAND_OUTPUT = ("tau", "p1", "p2", "p3", "s", "beta", "adb")
#: Members of `hand_state_t` that are compared.
_HAND_STATE = ("constraint_offset", "drift_previous", "bound_estimate", "tau_previous")
#: How the step of a tool over arrays is called.
SIGNATURE = "const double *given, const double *constant, double *result"


@dataclass(frozen=True)
class Adapter:
    """What `adapter.c.j2` is filled with: lines of C, for one state `i` where not said otherwise.

    `declarations` and `storage` stand outside functions, `prepare` runs once.
    """

    declarations: tuple[str, ...]
    storage: tuple[str, ...]
    prepare: tuple[str, ...]
    load: tuple[str, ...]
    call: tuple[str, ...]
    store: tuple[str, ...]

    def text(self, block: Block) -> str:
        """Return the adapter as C."""
        given, taken = len(given_names(block)), len(self.store)
        return fill(
            "bench/adapter.c.j2",
            {"capacity": CAPACITY, "given": given, "taken": taken, **asdict(self)},
        )


def given_names(block: Block) -> tuple[str, ...]:
    """Return the inputs that change from step to step: measured and remembered."""
    return tuple(s.name for s in block.inputs if s.group not in _CONSTANT)


def constant_names(block: Block) -> tuple[str, ...]:
    """Return the inputs that stay: parameters and prepared values."""
    return tuple(s.name for s in block.inputs if s.group in _CONSTANT)


def taken_names(block: Block) -> tuple[str, ...]:
    """Return the outputs that are numbers of the plant or of the next state, not flags."""
    return tuple(s.name for s in block.outputs if s.group != "flag")


def ours(block: Block, folder: GeneratedFolder, parameters: Mapping[str, float]) -> StepTool:
    """Return the generated step as it is emitted, with all its checks, by its manifest's names."""
    manifest = folder.manifest
    name, members = manifest.model, {r: s.names() for r, s in manifest.structures.items()}
    given, taken = given_names(block), taken_names(block)
    after = {s.name for s in block.outputs if s.group == "next_state"}
    adapter = Adapter(
        declarations=(f'#include "{name}.h"',),
        storage=(
            *(f"static {name}_{r}_t {r}[CAPACITY];" for r in ("state", "input", "output")),
            f"static {name}_status_t status[CAPACITY];",
            f"static {name}_params_t params;",
            "static void set_params(void)",
            "{",
            *(f"    params.{n} = {parameters[n]!r};" for n in members["params"]),
            "}",
        ),
        prepare=("(void)constants;", "set_params();"),
        load=(
            f"(void){name}_init(&state[i], &params);",
            *(
                f"{role}[i].{n} = given[{given.index(n)}];"
                for role in ("input", "state")
                for n in members[role]
                if n in given
            ),
        ),
        call=(f"status[i] = {name}_step(&state[i], &params, &input[i], &output[i]);",),
        store=tuple(
            f"taken[{k}] = {'state' if n in after else 'output'}[i].{n};"
            for k, n in enumerate(taken)
        ),
    )
    headers = sorted((folder.path / "c").glob("*.h"))
    units: list[Path] = controller_sources(folder.path, manifest)
    sources = {p.name: p.read_text(encoding="utf-8") for p in (*units, *headers)}
    sources["adapter.c"] = adapter.text(block)
    return StepTool("ours", sources, tuple(p.name for p in units), f"{name}_step", taken)


def casadi_step(block: Block) -> StepTool:
    """Return CasADi's own C of the step: one function of measured and state, and of constants."""
    symbols = [ca.SX.sym(s.name) for s in block.symbols]
    convert = ToCasadi(dict(zip(block.symbols, symbols, strict=True)))
    for definition in block.definitions:
        convert.known[definition.symbol] = convert(definition.expression)
    by_name = {s.name: v for s, v in zip(block.inputs, symbols, strict=True)}
    values = ca.cse([convert(r) for r in block.results])
    step = ca.Function(
        "casadi_step",
        [
            ca.vertcat(*(by_name[n] for n in names(block)))
            for names in (given_names, constant_names)
        ],
        [ca.vertcat(*values)],
    )
    generator = ca.CodeGenerator("casadi_step.c", {"casadi_real": "double", "casadi_int": "int"})
    generator.add(step)
    adapter = over_arrays(
        block,
        ("int casadi_step(const double **arg, double **res, int *iw, double *w, int mem);",),
        (
            f"const double *arg[{max(step.sz_arg(), 1)}] = {{given_of[i], constant}};",
            f"double *res[{max(step.sz_res(), 1)}] = {{result_of[i]}};",
            f"static double work[{max(step.sz_w(), 1)}];",
            f"static int integers[{max(step.sz_iw(), 1)}];",
            "casadi_step(arg, res, integers, work, 0);",
        ),
    )
    sources = {"casadi_step.c": generator.dump(), "adapter.c": adapter.text(block)}
    return StepTool(
        "casadi", sources, ("casadi_step.c",), "casadi_step", taken_names(block), libm=True
    )


def sympy_step(block: Block) -> StepTool:
    """Return SymPy's C of the step: `cse` over the expanded outputs, small powers as products."""
    lines = [
        "#include <math.h>",
        "#ifndef M_PI",
        "#define M_PI 3.14159265358979323846",
        "#endif",
        f"void sympy_step({SIGNATURE});",
        f"void sympy_step({SIGNATURE})",
        "{",
        *_unpacked(block),
    ]
    powers = create_expand_pow_optimization(4)
    assignments, results = shared_assignments(block)
    lines += [f"const double {s.name} = {sp.ccode(powers(e))};" for s, e in assignments]
    lines += [f"result[{k}] = {sp.ccode(powers(e))};" for k, e in enumerate(results)]
    adapter = over_arrays(
        block,
        (f"void sympy_step({SIGNATURE});",),
        ("sympy_step(given_of[i], constant, result_of[i]);",),
    )
    sources = {"sympy_step.c": "\n".join([*lines, "}", ""]), "adapter.c": adapter.text(block)}
    return StepTool(
        "sympy", sources, ("sympy_step.c",), "sympy_step", taken_names(block), libm=True
    )


def shared_assignments(
    block: Block,
) -> tuple[list[tuple[sp.Symbol, sp.Basic]], list[sp.Basic]]:
    """Return SymPy's `cse` of the outputs: what to assign, in order, and the outputs.

    Definitions are expanded, but for those that branch: SymPy splits a comparison that contains a
    Piecewise into one for each branch, which would compute the torque twice.
    """
    known: dict[sp.Symbol, sp.Basic] = {}
    kept: list[tuple[sp.Symbol, sp.Basic]] = []
    used = set().union(*(d.expression.free_symbols for d in block.definitions))
    for definition in block.definitions:
        value = definition.expression.rewrite(side, sp.Piecewise).xreplace(known)
        if value.has(sp.Piecewise) and definition.symbol in used:
            kept.append((definition.symbol, value))
        else:
            known[definition.symbol] = value
    outputs = [known.get(r, r) for r in block.results]
    replaced, reduced = sp.cse([*(e for _, e in kept), *outputs])
    named = [(s, e) for (s, _), e in zip(kept, reduced, strict=False)]
    return _in_order([*replaced, *named]), list(reduced[len(kept) :])


def _in_order(
    assignments: Sequence[tuple[sp.Symbol, sp.Basic]],
) -> list[tuple[sp.Symbol, sp.Basic]]:
    """Return `assignments` so that each comes after those it uses, otherwise in their order."""
    value = dict(assignments)
    done: dict[sp.Symbol, sp.Basic] = {}

    def visit(symbol: sp.Symbol) -> None:
        if symbol in done or symbol not in value:
            return
        for used in sorted(value[symbol].free_symbols, key=sp.default_sort_key):
            visit(used)
        done[symbol] = value[symbol]

    for symbol, _ in assignments:
        visit(symbol)
    return list(done.items())


def by_hand(
    block: Block, folder: GeneratedFolder, *, libm: bool = False, checked: bool = False
) -> StepTool:
    """Return the step written by hand, on libm or on our elementary functions.

    `checked` gives it the contract of the generated step: ranges, finite results, status, outputs.
    """
    bench = files("pfaffian.templates").joinpath("bench")
    sources = {n: bench.joinpath(n).read_text(encoding="utf-8") for n in ("hand.c", "hand.h")}
    adapter, taken = _hand_adapter(block, checked), ("tau", *_HAND_STATE)
    sources["adapter.c"] = adapter.text(block)
    units, entry = ("hand.c",), "hand_step"
    if libm:
        sources["hand.c"] = "#define HAND_LIBM\n" + sources["hand.c"]
        return StepTool("hand_libm", sources, units, entry, taken, libm=True)
    sources |= _elementary(folder)
    if checked:
        sources["hand.h"] = "#define HAND_CHECKED\n" + sources["hand.h"]
        return StepTool("hand_checked", sources, units, entry, (*_HAND_OUTPUT, *_HAND_STATE))
    return StepTool("hand", sources, units, entry, taken)


def _hand_adapter(block: Block, checked: bool) -> Adapter:
    given, constants = given_names(block), constant_names(block)
    measured = tuple(n for n in given if n not in ("engaged", *_HAND_STATE))
    results = [f"output[i].{n}" for n in _HAND_OUTPUT] if checked else ["torque[i]"]
    results += [f"state[i].{n}" for n in _HAND_STATE]
    return Adapter(
        declarations=('#include "hand.h"',),
        storage=(
            "static hand_state_t state[CAPACITY];",
            "static hand_input_t input[CAPACITY];",
            *(
                ("static hand_output_t output[CAPACITY];", "static int status[CAPACITY];")
                if checked
                else ("static double torque[CAPACITY];",)
            ),
            "static hand_law_t law;",
        ),
        prepare=(
            "hand_params_t params;",
            *(f"params.{n} = constants[{constants.index(n)}];" for n in _HAND_PARAMETERS),
            "hand_init(&law, &params);",
        ),
        load=(
            *(f"input[i].{n} = given[{given.index(n)}];" for n in measured),
            *(f"state[i].{n} = given[{given.index(n)}];" for n in _HAND_STATE),
            f"state[i].engaged = (uint32_t)given[{given.index('engaged')}];",
        ),
        call=(
            "status[i] = hand_step(&state[i], &law, &input[i], &output[i]);"
            if checked
            else "(void)hand_step(&state[i], &law, &input[i], &torque[i]);",
        ),
        store=tuple(f"taken[{k}] = {result};" for k, result in enumerate(results)),
    )


def _elementary(folder: GeneratedFolder) -> dict[str, str]:
    """Return the elementary functions that the generated step calls, for a file to include whole.

    As one unit with the step they can be inlined.
    """
    code = folder.path / "c"
    found = [*sorted(code.glob("pf_elementary*")), *sorted(code.glob("pf_arithmetic*"))]
    names = {p: p.name.replace("pf_elementary.c", "pf_elementary_unit.h") for p in found}
    return {name: path.read_text(encoding="utf-8") for path, name in names.items()}


def _unpacked(block: Block) -> Iterator[str]:
    for array, names in (("given", given_names(block)), ("constant", constant_names(block))):
        for k, name in enumerate(names):
            yield f"const double {name} = {array}[{k}];"


def over_arrays(block: Block, declarations: tuple[str, ...], call: tuple[str, ...]) -> Adapter:
    """Return the adapter of a tool whose step takes and gives arrays of doubles."""
    given, constants, total = given_names(block), constant_names(block), len(block.outputs)
    wanted = [k for k, s in enumerate(block.outputs) if s.group != "flag"]
    return Adapter(
        declarations=declarations,
        storage=(
            f"static double given_of[CAPACITY][{len(given)}];",
            f"static double result_of[CAPACITY][{total}];",
            f"static double constant[{len(constants)}];",
        ),
        prepare=(f"for (i = 0u; i < {len(constants)}u; ++i) {{ constant[i] = constants[i]; }}",),
        load=(f"for (int k = 0; k < {len(given)}; ++k) {{ given_of[i][k] = given[k]; }}",),
        call=call,
        store=tuple(f"taken[{k}] = result_of[i][{index}];" for k, index in enumerate(wanted)),
    )


Make = Callable[[Block, GeneratedFolder, Mapping[str, float]], StepTool]

#: The tools of every run, in the order of the table.
PEERS: dict[str, Make] = {
    "ours": ours,
    "casadi": lambda block, *_: casadi_step(block),
    "sympy": lambda block, *_: sympy_step(block),
    "hand_libm": lambda block, folder, _: by_hand(block, folder, libm=True),
    "hand": lambda block, folder, _: by_hand(block, folder),
    "hand_checked": lambda block, folder, _: by_hand(block, folder, checked=True),
}
