"""Programs as statements: expression trees for a dialect, named values on lines of their own.

A value that the derivation names, or that is used more than once, gets a statement; the others are
written into the expression that uses them. The order of operations is that of the program.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from pfaffian.derive.ir.program import LOGICAL, Instruction, Op, Program, without_dead
from pfaffian.derive.ir.ranges import Range, plain_calls

#: What a local variable is called by whose own name means something else in its function.
LOCAL_SUFFIX = "_value"
_SUM, _PRODUCT, _UNARY, _ATOM = 1, 2, 3, 4


@dataclass(frozen=True)
class Dialect:
    """How a language writes operations: call patterns, literals, functions."""

    patterns: Mapping[Op, str]
    literal: Callable[[float], str]
    #: The type of a value, where the language names it.
    real: str = "double"
    #: The function that gives sine and cosine together; none where they are taken apart.
    sincos: str = ""
    #: The same functions where no argument can leave the domain of a plainer form.
    plain: Mapping[Op, str] = field(default_factory=dict)
    plain_sincos: str = ""
    #: Inputs that are truth values, and how their truth is written.
    truths: Mapping[str, str] = field(default_factory=dict)
    #: What the functions around the statements name themselves: no value is held under such a name.
    reserved: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Statement:
    """One assignment: kind `value`, `truth` or `sincos`.

    For the last, `name` is the sine's, and `function` gives both of the angle `expression`.
    """

    kind: str
    name: str
    cosine: str
    expression: str
    comment: str
    function: str = ""


@dataclass(frozen=True)
class _Text:
    text: str
    precedence: int


_INFIX = {
    Op.ADD: ("+", _SUM),
    Op.SUB: ("-", _SUM),
    Op.MUL: ("*", _PRODUCT),
    Op.DIV: ("/", _PRODUCT),
}

#: How many of the first arguments are conditions.
_CONDITIONS = {Op.NOT: 1, Op.AND: 2, Op.OR: 2, Op.SELECT: 1}


class _Writer:
    def __init__(
        self,
        program: Program,
        dialect: Dialect,
        renamed: Mapping[str, str],
        inputs: Mapping[str, str],
        bounds: Mapping[str, Range],
    ) -> None:
        self.program, self.dialect, self.inputs = program, dialect, inputs
        self.plain = plain_calls(program, bounds) if dialect.plain else frozenset()
        self.uses = Counter(a for i in program.instructions for a in i.args)
        self.uses.update(program.results)
        self.results = set(program.results)
        self.texts: list[_Text] = []
        self.statements: list[Statement] = []
        self.renamed = renamed
        self.taken = {i.name for i in program.instructions} | dialect.reserved
        self.paired = self._sine_cosine_pairs() if dialect.sincos else {}
        self.done_pairs: dict[int, tuple[str, str]] = {}

    def _sine_cosine_pairs(self) -> dict[int, dict[Op, str]]:
        """Return the arguments of which both sine and cosine are taken, with their names."""
        seen: dict[int, dict[Op, str]] = {}
        for i in self.program.instructions:
            if i.op in (Op.SIN, Op.COS):
                seen.setdefault(i.args[0], {})[i.op] = i.name
        return {arg: names for arg, names in seen.items() if len(names) == 2}

    def write(self) -> list[Statement]:
        for index, instruction in enumerate(self.program.instructions):
            if instruction.op is Op.INPUT:
                text = self.inputs.get(instruction.name, instruction.name)
                self.texts.append(_Text(text, _ATOM))
            elif instruction.op is Op.CONST:
                text = self.dialect.literal(instruction.value)
                self.texts.append(_Text(text, _UNARY if text.startswith("-") else _ATOM))
            elif instruction.op in (Op.SIN, Op.COS) and instruction.args[0] in self.paired:
                self.texts.append(self._pair(index, instruction))
            else:
                self.texts.append(self._place(index, instruction))
        return self.statements

    def _pair(self, index: int, instruction: Instruction) -> _Text:
        argument = instruction.args[0]
        if argument not in self.done_pairs:
            given, suffix = self.paired[argument], self._suffix(argument)
            names = (
                given[Op.SIN] or self._fresh(f"sin_{suffix}"),
                given[Op.COS] or self._fresh(f"cos_{suffix}"),
            )
            self.done_pairs[argument] = names
            call = self.dialect.plain_sincos if index in self.plain else self.dialect.sincos
            self.statements.append(
                Statement("sincos", names[0], names[1], self.texts[argument].text, "", call)
            )
        sine, cosine = self.done_pairs[argument]
        return _Text(sine if instruction.op is Op.SIN else cosine, _ATOM)

    def _suffix(self, argument: int) -> str:
        """Return a readable name for the argument of a function: `q2`, `q1_q2`."""
        words = re.findall(r"[A-Za-z_]\w*", self.texts[argument].text)
        return "_".join(words) if 0 < len(words) <= 3 else f"t{argument}"

    def _fresh(self, wanted: str) -> str:
        name, k = wanted, 2
        while name in self.taken:
            name, k = f"{wanted}_{k}", k + 1
        self.taken.add(name)
        return name

    def _place(self, index: int, instruction: Instruction) -> _Text:
        text = self._expression(index, instruction)
        name = instruction.name
        if not name and self.uses[index] < 2 and instruction.op not in (Op.SIN, Op.COS):
            return text
        if not name:
            name = self._automatic(index, instruction)
        name = self.renamed.get(name, name)
        kind = "truth" if instruction.op in LOGICAL else "value"
        self.statements.append(Statement(kind, name, "", text.text, instruction.comment))
        return _Text(name, _ATOM)

    def _automatic(self, index: int, instruction: Instruction) -> str:
        if instruction.op in (Op.SIN, Op.COS):
            return self._fresh(f"{instruction.op}_{self._suffix(instruction.args[0])}")
        a, b = (*instruction.args, -1)[:2]
        if self._truth(instruction):
            return self._fresh(f"is_{self.program.instructions[b].name}")
        if instruction.op is Op.MUL and a == b and re.fullmatch(r"\w+", self.texts[a].text):
            return self._fresh(f"{self.texts[a].text}_squared")
        return self._fresh(f"t{index}")

    def _truth(self, instruction: Instruction) -> str:
        """Return how `0 < input` is written where the input is a truth value, else nothing."""
        if instruction.op is not Op.LESS:
            return ""
        zero, value = (self.program.instructions[a] for a in instruction.args)
        if zero.op is not Op.CONST or zero.value != 0.0 or value.op is not Op.INPUT:
            return ""
        return self.dialect.truths.get(value.name, "")

    def _expression(self, index: int, instruction: Instruction) -> _Text:
        truth = self._truth(instruction)
        if truth:
            return _Text(truth, _ATOM)
        conditions = _CONDITIONS.get(instruction.op, 0)
        parts = [
            self.truth_of(a) if k < conditions else self.texts[a]
            for k, a in enumerate(instruction.args)
        ]
        if instruction.op in _INFIX:
            sign, level = _INFIX[instruction.op]
            left = self._wrapped(parts[0], level)
            right = self._wrapped(parts[1], level + 1)
            return _Text(f"{left} {sign} {right}", level)
        if instruction.op is Op.NEG:
            return _Text(f"-{self._wrapped(parts[0], _ATOM)}", _UNARY)
        patterns = self.dialect.plain if index in self.plain else {}
        pattern = patterns.get(instruction.op, self.dialect.patterns[instruction.op])
        atom = pattern.startswith("(") or re.match(r"[\w.]+\(", pattern) is not None
        slots = [
            p.text if self._inside_call(pattern, k) else self._wrapped(p, _ATOM)
            for k, p in enumerate(parts)
        ]
        return _Text(pattern.format(*slots), _ATOM if atom else 0)

    def truth_of(self, index: int) -> _Text:
        """Return value `index` as a condition: a number, such as a flag prepared, is compared."""
        text = self.texts[index]
        if self.program.instructions[index].op in LOGICAL:
            return text
        return _Text(f"({self._wrapped(text, _SUM)} != {self.dialect.literal(0.0)})", _ATOM)

    @staticmethod
    def _inside_call(pattern: str, slot: int) -> bool:
        """Return whether slot stands alone between commas or parentheses of a call."""
        return re.search(r"[(,]\s*\{" + str(slot) + r"\}\s*[,)]", pattern) is not None

    @staticmethod
    def _wrapped(part: _Text, least: int) -> str:
        return part.text if part.precedence >= least else f"({part.text})"


def with_local_names(program: Program, reserved: frozenset[str]) -> Program:
    """Return `program` with no value named as one of `reserved`, or as another value.

    What is held in a variable of its own may have any name; inputs and outputs keep theirs where
    they are members of structures.
    """
    wanted = {i.name for i in program.instructions if i.name}
    taken: set[str] = set()
    instructions = []
    for instruction in program.instructions:
        name = instruction.name
        while name and (
            name in reserved or name in taken or (name != instruction.name and name in wanted)
        ):
            name += LOCAL_SUFFIX
        taken.add(name)
        instructions.append(replace(instruction, name=name))
    return replace(program, instructions=tuple(instructions))


def flags_as_truths(program: Program) -> Program:
    """Return `program` with each flag (c ? 1 : 0) replaced by c itself."""

    def is_constant(index: int, value: float) -> bool:
        i = program.instructions[index]
        return i.op is Op.CONST and i.value == value

    results, instructions = list(program.results), list(program.instructions)
    for k, signal in enumerate(program.outputs):
        flag = program.instructions[results[k]]
        if signal.group == "flag" and flag.op is Op.SELECT:
            condition, one, zero = flag.args
            if is_constant(one, 1.0) and is_constant(zero, 0.0):
                results[k] = condition
                instructions[condition] = replace(
                    instructions[condition], name=signal.name, comment=signal.description
                )
    return without_dead(replace(program, instructions=tuple(instructions), results=tuple(results)))


def statements_of(
    program: Program,
    dialect: Dialect,
    renamed: Mapping[str, str] | None = None,
    inputs: Mapping[str, str] | None = None,
    bounds: Mapping[str, Range] | None = None,
) -> tuple[tuple[Statement, ...], dict[str, str]]:
    """Return the statements of `program`, and for each output the expression that holds it.

    Flags come as truth values. `inputs` says how those inputs are written that are not read into
    a variable of their own name; `bounds` between what bounds inputs lie.
    """
    program = with_local_names(flags_as_truths(program), dialect.reserved)
    writer = _Writer(program, dialect, renamed or {}, inputs or {}, bounds or {})
    statements = tuple(writer.write())
    results = {
        signal.name: (
            writer.truth_of(index) if signal.group == "flag" else writer.texts[index]
        ).text
        for signal, index in zip(program.outputs, program.results, strict=True)
    }
    return statements, results
