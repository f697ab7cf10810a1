"""Every value on the way from inputs to outputs, in double: what single may not hold.

These are the values that the derivation names, and those that the generated code computes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import sympy as sp
from pfaffian.derive.emit.precision import STAND_INS
from pfaffian.derive.ir.evaluate import interpret
from pfaffian.derive.ir.evaluate_arrays import OPERATIONS
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.program import Instruction, Program
from pfaffian.derive.symbolic.block import Block
from pfaffian.derive.symbolic.numeric import function_of
from pfaffian.derive.verify.condition import NUMPY
from pfaffian.runtime.base.arrays import Array

#: Functions of real numbers that are not real everywhere; powers where the exponent is none.
_WITH_DOMAINS = (sp.Pow, sp.log, sp.asin, sp.acos)


class NamedValues:
    """Evaluates the values that a block names; `angles` are those with a sine or cosine taken."""

    def __init__(self, block: Block) -> None:
        """Prepare a function a definition, with the constants that single has for others."""
        swapped = {sp.Rational(a): sp.Rational(b) for a, b in STAND_INS.items()}
        self._steps = []
        taken = set().union(*(d.expression.atoms(sp.sin, sp.cos) for d in block.definitions))
        arguments = {f.args[0] for f in taken}
        self.angles = [d.symbol.name for d in block.definitions if d.symbol in arguments]
        for d in block.definitions:
            expression = d.expression.xreplace(swapped)
            needs = sorted(expression.free_symbols, key=lambda s: s.name)
            function = function_of(needs, expression, NUMPY)
            self._steps.append((d.symbol.name, [s.name for s in needs], function))

    def are_real(self, inputs: Mapping[str, Array]) -> Array:
        """Return the samples of `inputs` where every named value is a number, shape (N,)."""
        strange: Array = np.isnan(np.stack([*self(inputs).values()])).any(axis=0)
        return ~strange

    def __call__(self, inputs: Mapping[str, Array]) -> dict[str, Array]:
        """Return each named value at `inputs` by name, inputs included, float64 of shape (N,)."""
        known = dict(inputs)
        with np.errstate(all="ignore"):
            for name, needs, function in self._steps:
                known[name] = function(*(known[n] for n in needs))
        count = len(next(iter(inputs.values())))
        return {n: np.broadcast_to(np.asarray(v, float), (count,)) for n, v in known.items()}


def has_domains(block: Block) -> bool:
    """Return whether a definition takes a root, a logarithm or an arcsine of what may vary."""
    parts = set().union(*(d.expression.atoms(*_WITH_DOMAINS) for d in block.definitions))
    return any(p.free_symbols and not (p.is_Pow and p.exp.is_Integer) for p in parts)


def values_of(model: LoweredModel, function: str, inputs: Mapping[str, Array]) -> list[Array]:
    """Return each value that `function` of `model` computes at `inputs`, float64 of shape (N,).

    What it takes prepared from the parameters is computed first, where `inputs` does not give it.
    What depends on an input that is not given is left out.
    """
    program = model.program(function)
    missing = [s.name for s in program.inputs if s.name not in inputs]
    given = dict(inputs)
    if missing:
        prepare = model.program("prepare")
        slots = _slots(prepare, inputs)
        prepared = zip(prepare.outputs, prepare.results, strict=True)
        values = {s.name: slots[k] for s, k in prepared if s.name in missing}
        given |= {name: v for name, v in values.items() if v is not None}
    return [v for v in _slots(program, given) if v is not None]


def _slots(program: Program, inputs: Mapping[str, Array]) -> list[Array | None]:
    count = len(next(iter(inputs.values())))

    def whole(value: Any) -> Array:
        return np.broadcast_to(np.asarray(value, float), (count,))

    def given(name: str) -> Array | None:
        value = inputs.get(name)
        return None if value is None else whole(value)

    def operate(instruction: Instruction, arguments: list[Array | None]) -> Array | None:
        if any(a is None for a in arguments):
            return None
        return whole(OPERATIONS[instruction.op](*arguments))

    with np.errstate(all="ignore"):  # constants are those that single has
        return interpret(program, given, lambda x: whole(STAND_INS.get(x, x)), operate)
