"""Lowering: a symbolic block becomes a CasADi SX graph, and the graph a `Program`.

CasADi finds the common subexpressions; the names of the block's definitions are carried through to
the instructions that compute them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
from pfaffian.derive.ir.program import Instruction, Op, Program, Signal
from pfaffian.derive.lower.to_casadi import ToCasadi
from pfaffian.derive.symbolic.block import Block, Definition

_OPS: dict[int, Op] = {
    ca.OP_ADD: Op.ADD,
    ca.OP_SUB: Op.SUB,
    ca.OP_MUL: Op.MUL,
    ca.OP_DIV: Op.DIV,
    ca.OP_NEG: Op.NEG,
    ca.OP_FABS: Op.ABS,
    ca.OP_SIGN: Op.SIGN,
    ca.OP_FMIN: Op.MIN,
    ca.OP_FMAX: Op.MAX,
    ca.OP_SQRT: Op.SQRT,
    ca.OP_SIN: Op.SIN,
    ca.OP_COS: Op.COS,
    ca.OP_ATAN: Op.ATAN,
    ca.OP_EXP: Op.EXP,
    ca.OP_EXPM1: Op.EXPM1,
    ca.OP_TANH: Op.TANH,
    ca.OP_LOG: Op.LOG,
    ca.OP_ASIN: Op.ASIN,
    ca.OP_ACOS: Op.ACOS,
    ca.OP_SINH: Op.SINH,
    ca.OP_COSH: Op.COSH,
    ca.OP_LT: Op.LESS,
    ca.OP_LE: Op.LESS_EQUAL,
    ca.OP_EQ: Op.EQUAL,
    ca.OP_NOT: Op.NOT,
    ca.OP_AND: Op.AND,
    ca.OP_OR: Op.OR,
}


def lower(block: Block) -> Program:
    """Lower `block` to a program; definitions that no output needs are dropped."""
    convert = ToCasadi()
    inputs = [ca.SX.sym(symbol.name) for symbol in block.symbols]
    convert.known.update(zip(block.symbols, inputs, strict=True))
    for definition in block.definitions:
        convert.known[definition.symbol] = convert(definition.expression)
    values = [convert(d.symbol) for d in block.definitions]
    shared = ca.cse(values)
    by_symbol = {d.symbol: v for d, v in zip(block.definitions, shared, strict=True)}
    function = ca.Function(
        "f", [ca.vertcat(*inputs)], [ca.vertcat(*by_symbol.values())], {"cse": False}
    )
    tape, leaving = _read_tape(function, len(inputs), len(values))
    names = {d.symbol: leaving[i] for i, d in enumerate(block.definitions)}
    for definition in block.definitions:
        index = names[definition.symbol]
        if tape[index].op not in (Op.INPUT, Op.CONST):
            comment = definition.description + (f" [{definition.unit}]" if definition.unit else "")
            tape[index] = replace(tape[index], name=definition.symbol.name, comment=comment)
    for signal, i in zip(block.inputs, range(len(inputs)), strict=True):
        tape[i] = replace(tape[i], name=signal.name)
    results = tuple(names[symbol] for symbol in block.results)
    tape, results = _select_from_masks(tape, results)
    instructions, results = _without_dead(tape, results)
    return Program(
        block.name, block.title, block.inputs, tuple(instructions), block.outputs, results
    )


def lower_graph(
    name: str, inputs: Mapping[str, Any], outputs: Sequence[str], values: Sequence[Any]
) -> Program:
    """Lower a graph that some other tool built: named scalar inputs, and values by name."""
    shared = ca.cse(list(values))
    function = ca.Function(
        "f", [ca.vertcat(*inputs.values())], [ca.vertcat(*shared)], {"cse": False}
    )
    tape, leaving = _read_tape(function, len(inputs), len(values))
    for i, symbol in enumerate(inputs):
        tape[i] = replace(tape[i], name=symbol)
    tape, results = _select_from_masks(tape, tuple(leaving))
    instructions, results = _without_dead(tape, results)
    return Program(
        name,
        name,
        tuple(Signal(n, "", "", "input") for n in inputs),
        tuple(instructions),
        tuple(Signal(n, "", "", "output") for n in outputs),
        results,
    )


def program_of_graph(
    name: str,
    title: str,
    inputs: Mapping[Signal, Any],
    definitions: Sequence[tuple[Definition, Any]],
    outputs: Mapping[Signal, Any],
) -> Program:
    """Lower a graph given by scalar inputs and outputs; definitions name what they compute."""
    shared = ca.cse([*(graph for _, graph in definitions), *outputs.values()])
    function = ca.Function(
        "f", [ca.vertcat(*inputs.values())], [ca.vertcat(*shared)], {"cse": False}
    )
    tape, leaving = _read_tape(function, len(inputs), len(shared))
    for (definition, _), index in zip(definitions, leaving, strict=False):
        if tape[index].op not in (Op.INPUT, Op.CONST) and not tape[index].name:
            comment = definition.description + (f" [{definition.unit}]" if definition.unit else "")
            tape[index] = replace(tape[index], name=definition.symbol.name, comment=comment)
    for i, signal in enumerate(inputs):
        tape[i] = replace(tape[i], name=signal.name)
    tape, results = _select_from_masks(tape, tuple(leaving[len(definitions) :]))
    instructions, results = _without_dead(tape, results)
    return Program(name, title, tuple(inputs), tuple(instructions), tuple(outputs), results)


def _read_tape(function: Any, n_in: int, n_out: int) -> tuple[list[Instruction], list[int]]:
    """Turn CasADi's work-vector instructions into single assignments."""
    tape = [Instruction(Op.INPUT) for _ in range(n_in)]
    slot: dict[int, int] = {}
    leaving = [0] * n_out

    def emit(op: Op, *args: int, value: float = 0.0) -> int:
        tape.append(Instruction(op, args, value))
        return len(tape) - 1

    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        ins, outs = function.instruction_input(k), function.instruction_output(k)
        if code == ca.OP_INPUT:
            slot[outs[0]] = ins[1]
        elif code == ca.OP_OUTPUT:
            leaving[outs[1]] = slot[ins[0]]
        elif code == ca.OP_CONST:
            slot[outs[0]] = emit(Op.CONST, value=function.instruction_constant(k))
        else:
            args = [slot[i] for i in ins]
            slot[outs[0]] = _emit_operation(code, args, emit)
    return tape, leaving


def _emit_operation(code: int, args: list[int], emit: Callable[..., int]) -> int:
    """Emit one CasADi operation, spelling its shorthands out."""
    if code == ca.OP_SQ:
        return emit(Op.MUL, args[0], args[0])
    if code == ca.OP_TWICE:
        return emit(Op.ADD, args[0], args[0])
    if code == ca.OP_INV:
        return emit(Op.DIV, emit(Op.CONST, value=1.0), args[0])
    if code == ca.OP_IF_ELSE_ZERO:
        return emit(Op.SELECT, args[0], args[1], emit(Op.CONST, value=0.0))
    if code not in _OPS:
        raise NotImplementedError(f"no instruction for CasADi operation {code}")
    return emit(_OPS[code], *args)


def _select_from_masks(
    tape: list[Instruction], results: tuple[int, ...]
) -> tuple[list[Instruction], tuple[int, ...]]:
    """Replace (c ? a : 0) + (!c ? b : 0), CasADi's if_else, by (c ? a : b)."""

    def is_zero(i: int) -> bool:
        return tape[i].op is Op.CONST and tape[i].value == 0.0

    def mask(i: int) -> bool:
        return tape[i].op is Op.SELECT and is_zero(tape[i].args[2])

    for index, instruction in enumerate(tape):
        if instruction.op is not Op.ADD or not all(mask(a) for a in instruction.args):
            continue
        first, second = (tape[a] for a in instruction.args)
        if tape[first.args[0]].op is Op.NOT and tape[first.args[0]].args[0] == second.args[0]:
            first, second = second, first
        negation = tape[second.args[0]]
        if negation.op is Op.NOT and negation.args[0] == first.args[0]:
            tape[index] = replace(
                instruction, op=Op.SELECT, args=(first.args[0], first.args[1], second.args[1])
            )
    return tape, results


def _without_dead(
    tape: list[Instruction], results: tuple[int, ...]
) -> tuple[list[Instruction], tuple[int, ...]]:
    """Drop what no result needs, merge equal constants, and number again. Inputs all stay."""
    alive = set(results)
    for index in reversed(range(len(tape))):
        if index in alive:
            alive.update(tape[index].args)
    renumbered: dict[int, int] = {}
    constants: dict[str, int] = {}
    kept: list[Instruction] = []
    for index, instruction in enumerate(tape):
        if instruction.op is Op.CONST and instruction.value.hex() in constants:
            renumbered[index] = constants[instruction.value.hex()]
            continue
        if index not in alive and instruction.op is not Op.INPUT:
            continue
        renumbered[index] = len(kept)
        if instruction.op is Op.CONST:
            constants[instruction.value.hex()] = len(kept)
        kept.append(replace(instruction, args=tuple(renumbered[a] for a in instruction.args)))
    return kept, tuple(renumbered[r] for r in results)
