"""Derivatives of plant, step and closed loop: CasADi differentiates the graphs of the blocks.

    plant_jacobian        d(q'')/d(q, q', tau)                                 of (1)
    step_jacobian         d(tau)/d(q, q')                                      of the sampled law
    closed_loop_jacobian  d(x')/dx, x = (q, q', integrals of drift, ahat)      of (1), (15)-(23)

Where a function has a corner (|x| at 0, a limit just reached) the derivative is that of one side,
and 0 for |x| and norms at 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import casadi as ca
import sympy as sp
from pfaffian.derive.derivation.derive import Derivation
from pfaffian.derive.ir.names import PLANT_PARAMETER, PLANT_PREFIX
from pfaffian.derive.ir.own_names import derivative_name
from pfaffian.derive.ir.program import LOGICAL, Instruction, Op, Program, Signal
from pfaffian.derive.lower.to_casadi import ToCasadi
from pfaffian.derive.lower.to_program import program_of_graph
from pfaffian.derive.optimise.passes import optimised
from pfaffian.derive.optimise.tape import Tape, rewritten
from pfaffian.derive.symbolic.block import Block, Definition

#: What stands in for a radicand below it: the root's derivative stays finite where a norm is 0.
_LEAST_RADICAND = 2.0**-120


class _Differentiable(ToCasadi):
    """As `ToCasadi`, in a form whose derivatives are choices between those of the branches.

    A square root gets a finite derivative everywhere, 0 at 0. CasADi's own of a maximum averages
    both sides where they are equal, which would be arithmetic on truth values.
    """

    def _build(self, e: sp.Basic) -> Any:
        if isinstance(e, sp.Max | sp.Min):
            larger = isinstance(e, sp.Max)
            return reduce(
                lambda a, b: ca.if_else(a > b if larger else a < b, a, b), (self(a) for a in e.args)
            )
        return super()._build(e)

    def _power(self, e: sp.Pow) -> Any:
        base, exponent = e.args
        if exponent == sp.Rational(1, 2):
            inside = self(base)
            return ca.sqrt(ca.if_else(inside < _LEAST_RADICAND, _LEAST_RADICAND, inside))
        return super()._power(e)


@dataclass(frozen=True)
class _Variable:
    """A scalar that is differentiated, or by which: its name, unit and graph."""

    name: str
    unit: str
    graph: Any


@dataclass(frozen=True)
class _Graph:
    """The graph of a block: its definitions, named, and its outputs by name."""

    definitions: tuple[tuple[Definition, Any], ...]
    outputs: Mapping[str, _Variable]


def jacobian_programs_of(derivation: Derivation) -> tuple[Program, ...]:
    """Return the programs of all derivatives of `derivation`, optimised."""
    programs = (_plant(derivation), _step(derivation), _closed_loop(derivation))
    return tuple(optimised(p) for p in programs)


def _symbols(signals: Sequence[Signal]) -> dict[str, Any]:
    return {s.name: ca.SX.sym(s.name) for s in signals}


def _graph(block: Block, inputs: Mapping[str, Any], prefix: str = "") -> _Graph:
    """Return the graph of `block` on `inputs`, by signal name; definitions get the prefix."""
    convert = _Differentiable()
    for signal, symbol in zip(block.inputs, block.symbols, strict=True):
        convert.known[symbol] = inputs[signal.name]
    named = []
    for d in block.definitions:
        convert.known[d.symbol] = convert(d.expression)
        symbol = sp.Symbol(prefix + d.symbol.name, real=True)
        named.append((replace(d, symbol=symbol), convert.known[d.symbol]))
    outputs = {
        s.name: _Variable(s.name, s.unit, convert.known[symbol])
        for s, symbol in zip(block.outputs, block.results, strict=True)
    }
    return _Graph(tuple(named), outputs)


def _motion(derivation: Derivation, inputs: Mapping[str, Any]) -> list[_Variable]:
    """Return q and q'; what no equation depends on gets a symbol of its own."""
    coordinates = derivation.spec.coordinates
    wanted = [(c.name, c.unit) for c in coordinates]
    wanted += [(c.velocity.name, f"{c.unit}/s") for c in coordinates]
    return [_Variable(n, u, inputs[n] if n in inputs else ca.SX.sym(n)) for n, u in wanted]


def _plant(derivation: Derivation) -> Program:
    block = derivation.block("acceleration")
    inputs = _symbols(block.inputs)
    graph = _graph(block, inputs)
    torques = [_Variable(a.name, a.unit, inputs[a.name]) for a in derivation.spec.actuators]
    return _program(
        "plant_jacobian",
        f"{derivation.spec.title}: derivatives of the forward dynamics",
        dict(zip(block.inputs, inputs.values(), strict=True)),
        graph.definitions,
        list(graph.outputs.values()),
        [*_motion(derivation, inputs), *torques],
    )


def _step(derivation: Derivation) -> Program:
    block = derivation.block("step")
    inputs = _symbols(block.inputs)
    graph = _graph(block, inputs)
    return _program(
        "step_jacobian",
        f"{derivation.spec.title}: derivatives of the commanded torque",
        dict(zip(block.inputs, inputs.values(), strict=True)),
        graph.definitions,
        [graph.outputs[a.name] for a in derivation.spec.actuators],
        _motion(derivation, inputs),
    )


def _closed_loop(derivation: Derivation) -> Program:
    """Put the continuous law's torque into the plant, whose parameters are its own."""
    law, plant = derivation.block("continuous"), derivation.block("acceleration")
    inputs = _symbols(law.inputs)
    signals = dict(zip(law.inputs, inputs.values(), strict=True))
    control = _graph(law, inputs)
    torques = {a.name: control.outputs[a.name].graph for a in derivation.spec.actuators}
    inside: dict[str, Any] = dict(torques)
    for signal in plant.inputs:
        if signal.group == "parameter":
            own = replace(signal, name=PLANT_PREFIX + signal.name, group=PLANT_PARAMETER)
            signals[own] = inside[signal.name] = ca.SX.sym(own.name)
        elif signal.name in inputs:
            inside[signal.name] = inputs[signal.name]
        elif signal.name not in torques:
            signals[signal] = inputs[signal.name] = inside[signal.name] = ca.SX.sym(signal.name)
    motion = _graph(plant, inside, PLANT_PREFIX)
    rates = {s.name: derivation.spec.own(f"{s.name}_rate") for s in law.inputs}
    states = {
        s.name: s for s in law.inputs if s.group == "state" and rates[s.name] in control.outputs
    }
    own_states = [_Variable(n, s.unit, inputs[n]) for n, s in states.items()]
    return _program(
        "closed_loop_jacobian",
        f"{derivation.spec.title}: derivatives of the plant under the continuous law",
        signals,
        (*control.definitions, *motion.definitions),
        [*motion.outputs.values(), *(control.outputs[rates[n]] for n in states)],
        [*_motion(derivation, inputs), *own_states],
    )


def _program(
    name: str,
    title: str,
    inputs: Mapping[Signal, Any],
    definitions: Sequence[tuple[Definition, Any]],
    functions: Sequence[_Variable],
    variables: Sequence[_Variable],
) -> Program:
    """Differentiate every function by every variable and lower what comes out."""
    matrix = ca.densify(
        ca.jacobian(
            ca.vertcat(*(f.graph for f in functions)), ca.vertcat(*(v.graph for v in variables))
        )
    )
    outputs = {
        Signal(
            derivative_name(f.name, v.name),
            f"({f.unit})/({v.unit})",
            f"d({f.name})/d({v.name})",
            "output",
        ): matrix[i, j]
        for i, f in enumerate(functions)
        for j, v in enumerate(variables)
    }
    return _choices(program_of_graph(name, title, inputs, definitions, outputs))


def _choices(program: Program) -> Program:
    """Replace (condition) x by (condition ? x : 0): 0 times an infinity is no number."""

    def rewrite(tape: Tape, moved: dict[int, int], index: int, instruction: Instruction) -> int:
        args = tuple(moved[a] for a in instruction.args)
        logical = [tape.instructions[a].op in LOGICAL for a in args]
        if instruction.op is Op.MUL and any(logical):
            condition, value = args if logical[0] else args[::-1]
            return tape.emit(Op.SELECT, condition, value, tape.const(0.0))
        taken = logical[1:] if instruction.op is Op.SELECT else logical
        if any(taken) and instruction.op not in LOGICAL:
            raise NotImplementedError(f"{program.name}: {instruction.op} of a truth value")
        return tape.copy(instruction, args)

    return rewritten(program, rewrite)
