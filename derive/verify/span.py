"""Every value on the way from inputs to outputs, in double: what single may not hold.

These are the values that the derivation names, and those that the generated code computes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import sympy as sp
from pfaffian.derive.block import Block
from pfaffian.derive.emit.precision import STAND_INS
from pfaffian.derive.lowered import LoweredModel
from pfaffian.derive.numeric import function_of
from pfaffian.derive.program import Op, Program
from pfaffian.derive.verify.condition import NUMPY

Array = np.ndarray[Any, Any]

_EVALUATE: dict[Op, Callable[..., Any]] = {
    Op.ADD: np.add,
    Op.SUB: np.subtract,
    Op.MUL: np.multiply,
    Op.DIV: np.divide,
    Op.FMA: lambda a, b, c: a * b + c,
    Op.FMS: lambda a, b, c: a * b - c,
    Op.FNMS: lambda a, b, c: c - a * b,
    Op.NEG: np.negative,
    Op.ABS: np.abs,
    Op.SIGN: np.sign,
    Op.MIN: lambda a, b: np.where(a < b, a, b),
    Op.MAX: lambda a, b: np.where(a > b, a, b),
    Op.SQRT: np.sqrt,
    Op.SIN: np.sin,
    Op.COS: np.cos,
    Op.ATAN: np.arctan,
    Op.EXP: np.exp,
    Op.EXPM1: np.expm1,
    Op.TANH: np.tanh,
    Op.LOG: np.log,
    Op.ASIN: np.arcsin,
    Op.ACOS: np.arccos,
    Op.SINH: np.sinh,
    Op.COSH: np.cosh,
    Op.LESS: np.less,
    Op.LESS_EQUAL: np.less_equal,
    Op.EQUAL: np.equal,
    Op.NOT: np.logical_not,
    Op.AND: np.logical_and,
    Op.OR: np.logical_or,
    Op.SELECT: np.where,
}
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
    names = iter(program.inputs)
    slots: list[Array | None] = []
    with np.errstate(all="ignore"):
        for i in program.instructions:
            if i.op is Op.INPUT:
                value: Any = inputs.get(next(names).name)
            elif i.op is Op.CONST:
                value = STAND_INS.get(i.value, i.value)  # as single has it
            else:
                arguments = [slots[a] for a in i.args]
                known = all(a is not None for a in arguments)
                value = _EVALUATE[i.op](*arguments) if known else None
            if value is not None:
                value = np.broadcast_to(np.asarray(value, float), (count,))
            slots.append(value)
    return slots
