"""The operations of a program on arrays in double, and programs run on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pfaffian.derive.ir.evaluate import interpret, outputs_of
from pfaffian.derive.ir.program import Op, Program
from pfaffian.runtime.base.arrays import Array

#: What each operation is on arrays; fused ones are rounded twice here.
OPERATIONS: dict[Op, Callable[..., Any]] = {
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


def evaluate_at(program: Program, values: Mapping[str, Any]) -> dict[str, Array]:
    """Return the outputs of `program` at points; `values` are scalars or arrays of shape (N,)."""
    with np.errstate(all="ignore"):
        slots = interpret(
            program,
            lambda name: np.asarray(values[name], float),
            np.asarray,
            lambda instruction, arguments: OPERATIONS[instruction.op](*arguments),
        )
    return outputs_of(program, slots)
