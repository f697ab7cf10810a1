"""The control step by generators that need not be installed: SymForce and wrenfold, on the host.

Both emit C++ templates over scalars. Each import is inside its function, which raises
`ImportError` where the tool is missing.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import sympy as sp
from pfaffian.benchmarks.step import StepTool
from pfaffian.benchmarks.step_peers import (
    SIGNATURE,
    constant_names,
    given_names,
    over_arrays,
    taken_names,
)
from pfaffian.derive.symbolic.block import Block
from pfaffian.derive.symbolic.functions import side


def symforce_step(block: Block) -> StepTool:
    """Return SymForce's C++ of the step. Raises `ImportError` without SymForce."""
    import symforce

    symforce.set_epsilon_to_number()  # unused here; left unset, it warns
    import symforce.symbolic as sf
    from symforce import codegen
    from symforce.values import Values

    known: dict[sp.Symbol, Any] = {s: sf.Symbol(s.name) for s in block.symbols}
    inputs = Values(**{s.name: known[s] for s in block.symbols})
    for symbol, expression in _plain_definitions(block):
        used = {sf.sympify(f): known[f] for f in _sorted_symbols(expression)}
        known[symbol] = sf.sympify(expression).xreplace(used)
    outputs = Values(**dict(zip(_results(block), (known[r] for r in block.results), strict=True)))
    generator = codegen.Codegen(
        inputs=inputs, outputs=outputs, config=codegen.CppConfig(), name="generated_step"
    )
    with tempfile.TemporaryDirectory(prefix="pfaffian-") as scratch:
        made = generator.generate_function(output_dir=scratch, skip_directory_nesting=True)
        text = Path(made.generated_files[0]).read_text(encoding="utf-8")
    # Scalars alone need nothing of Eigen but the headers that it includes.
    text = text.replace("#include <Eigen/Core>", "#include <algorithm>\n#include <cmath>")
    return _tool(block, "symforce", text, "sym::GeneratedStep<double>", "&")


def wrenfold_step(block: Block) -> StepTool:
    """Return wrenfold's C++ of the step. Raises `ImportError` without wrenfold."""
    from wrenfold import code_generation, type_info
    from wrenfold.sympy_conversion import from_sympy

    description = code_generation.FunctionDescription("generated_step")
    scalar = type_info.ScalarType(type_info.NumericType.Float)
    known = {s: description.add_input_argument(s.name, scalar) for s in block.symbols}
    for symbol, expression in _plain_definitions(block):
        used = [(from_sympy(f), known[f]) for f in _sorted_symbols(expression)]
        known[symbol] = from_sympy(expression).subs(used)
    for name, result in zip(_results(block), block.results, strict=True):
        description.add_output_argument(name, False, known[result])
    definition = code_generation.transpile(description)
    text = code_generation.CppGenerator().generate(definition)
    headers = "#include <cmath>\n#include <cstdint>\n"
    return _tool(block, "wrenfold", f"{headers}{text}", "generated_step<double>", "")


OPTIONAL_PEERS: dict[str, Callable[[Block], StepTool]] = {
    "symforce": symforce_step,
    "wrenfold": wrenfold_step,
}


def _results(block: Block) -> list[str]:
    """Return a name of its own for each output: a state goes in and out under one name."""
    return [f"result_{k}" for k in range(len(block.outputs))]


def _sorted_symbols(expression: sp.Basic) -> list[sp.Symbol]:
    return sorted(expression.free_symbols, key=lambda s: str(s.name))


def _plain_definitions(block: Block) -> Iterator[tuple[sp.Symbol, sp.Basic]]:
    """Give the definitions with `a and b` as a branch in a branch: neither tool knows `and`.

    Fractions become floating-point numbers: one of them holds integers of 64 bits only.
    """
    for definition in block.definitions:
        value = definition.expression.rewrite(side, sp.Piecewise).replace(
            lambda e: isinstance(e, sp.Piecewise) and isinstance(e.args[0].cond, sp.And), _nested
        )
        value = value.replace(
            lambda e: isinstance(e, sp.Rational) and not isinstance(e, sp.Integer),
            lambda e: sp.Float(e, 17),
        )
        yield definition.symbol, value


def _nested(choice: sp.Piecewise) -> sp.Basic:
    (value, condition), (otherwise, _) = choice.args
    for part in condition.args:
        value = sp.Piecewise((value, part), (otherwise, True))
    return value


def _tool(block: Block, name: str, text: str, function: str, reference: str) -> StepTool:
    """Return the tool whose C++ is `text`, behind a function of C that takes arrays."""
    entry = f"{name}_step"
    places = {n: f"given[{k}]" for k, n in enumerate(given_names(block))}
    places |= {n: f"constant[{k}]" for k, n in enumerate(constant_names(block))}
    passed = [places[s.name] for s in block.inputs]
    passed += [f"{reference}result[{k}]" for k in range(len(block.outputs))]
    wrapper = f'extern "C" void {entry}({SIGNATURE})\n{{\n{function}({", ".join(passed)});\n}}\n'
    adapter = over_arrays(
        block,
        (f"void {entry}({SIGNATURE});",),
        (f"{entry}(given_of[i], constant, result_of[i]);",),
    )
    sources = {f"{entry}.cc": f"{text}\n{wrapper}", "adapter.c": adapter.text(block)}
    units = (f"{entry}.cc",)
    return StepTool(name, sources, units, entry, taken_names(block), libm=True, on_target=False)
