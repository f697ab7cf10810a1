"""Blocks: named definitions in order, the symbolic source that is lowered, printed and checked."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.ir.own_names import OwnNames
from pfaffian.derive.ir.program import Signal
from pfaffian.runtime.base.given_names import given_away


@dataclass(frozen=True)
class Definition:
    """`symbol` := `expression`, in terms of inputs and earlier definitions."""

    symbol: sp.Symbol
    expression: sp.Basic
    unit: str
    description: str


@dataclass(frozen=True)
class Block:
    """A straight-line symbolic program: inputs, definitions in order, and which of them leave.

    `symbols` are the SymPy symbols of `inputs`, in the same order. `results` are the symbols of
    the definitions that `outputs` take.
    """

    name: str
    title: str
    inputs: tuple[Signal, ...]
    symbols: tuple[sp.Symbol, ...]
    definitions: tuple[Definition, ...]
    outputs: tuple[Signal, ...]
    results: tuple[sp.Symbol, ...]

    def expanded(self, symbol: sp.Symbol) -> sp.Expr:
        """Return the expression of `symbol` in the inputs alone, every definition substituted."""
        known: dict[sp.Symbol, sp.Basic] = {}
        for definition in self.definitions:
            known[definition.symbol] = definition.expression.xreplace(known)
            if definition.symbol == symbol:
                return known[symbol]
        raise KeyError(symbol)


class BlockBuilder:
    """Collects inputs, definitions and outputs, and hands out a frozen `Block`.

    With `own` no definition has a name that the specification declares.
    """

    def __init__(self, name: str, title: str, own: OwnNames | None = None) -> None:
        """Start an empty block."""
        self._name, self._title = name, title
        self._declared = own.declared if own else frozenset()
        self._inputs: list[tuple[Signal, sp.Symbol]] = []
        self._definitions: list[Definition] = []
        self._outputs: list[tuple[Signal, sp.Symbol]] = []

    def take(self, symbol: sp.Symbol, unit: str, description: str, group: str) -> sp.Symbol:
        """Declare an input and return its symbol."""
        self._inputs.append((Signal(str(symbol.name), unit, description, group), symbol))
        return symbol

    def define(
        self, name: str, expression: sp.Basic, description: str, unit: str = ""
    ) -> sp.Symbol:
        """Name an intermediate value and return its symbol; the same value is named once.

        The name gives way to one that is declared; who needs the symbol takes the one returned.
        """
        return self._define(given_away(name, self._declared), expression, description, unit)

    def _define(self, name: str, expression: sp.Basic, description: str, unit: str) -> sp.Symbol:
        symbol = sp.Symbol(name, real=True)
        for definition in self._definitions:
            if definition.symbol == symbol:
                if definition.expression != expression:
                    raise ValueError(f"{self._name}: {name} is defined twice")
                return symbol
        self._definitions.append(Definition(symbol, expression, unit, description))
        return symbol

    def unused(self, base: str, expression: sp.Basic) -> str:
        """Return `base` with the first number that is free, or already holds `expression`."""
        taken = {d.symbol.name: d.expression for d in self._definitions}
        number = 1
        while taken.get(given_away(f"{base}{number}", self._declared), expression) != expression:
            number += 1
        return f"{base}{number}"

    def give(
        self, name: str, value: sp.Basic, unit: str, description: str, group: str = "output"
    ) -> None:
        """Let `value` leave as output `name`; an expression is given a definition first."""
        if value not in {d.symbol for d in self._definitions}:
            taken = {d.symbol.name for d in self._definitions} | {s.name for s, _ in self._inputs}
            # A declared name may stay: nothing else in this block is called so.
            inside = given_away(f"{name}_next", self._declared) if name in taken else name
            value = self._define(inside, value, description, unit)
        self._outputs.append((Signal(name, unit, description, group), value))

    def build(self) -> Block:
        """Return the finished block, without the inputs that nothing depends on."""
        for what in (self._inputs, self._outputs):
            names = [signal.name for signal, _ in what]
            if len(set(names)) < len(names):
                raise ValueError(f"{self._name}: two signals of one name among {names}")
        used = set().union(*(d.expression.free_symbols for d in self._definitions))
        inputs = [(signal, symbol) for signal, symbol in self._inputs if symbol in used]
        return Block(
            self._name,
            self._title,
            tuple(signal for signal, _ in inputs),
            tuple(symbol for _, symbol in inputs),
            tuple(self._definitions),
            tuple(signal for signal, _ in self._outputs),
            tuple(symbol for _, symbol in self._outputs),
        )
