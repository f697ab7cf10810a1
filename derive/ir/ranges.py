"""Between what bounds the values of a program lie, where its inputs lie within theirs.

The emitter calls the plain form of an elementary function where no argument can leave its domain.
The bounds are rough and hold in floating point too: every operation is widened by a rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from pfaffian.derive.ir.evaluate import interpret
from pfaffian.derive.ir.program import Instruction, Op, Program

Range = tuple[float, float]
EVERYTHING: Range = (-math.inf, math.inf)
#: Arguments for which an elementary function has a plain form, which looks at nothing first: the
#: domain of the emitted sine and cosine, and what single precision can hold for the square root.
PLAIN_DOMAINS: dict[Op, Range] = {
    Op.SIN: (-1e5, 1e5),
    Op.COS: (-1e5, 1e5),
    Op.SQRT: (2.0**-125, 2.0**127),
}
_SLACK = 1.0 + 2.0**-50


def ranges(program: Program, bounds: Mapping[str, Range]) -> list[Range]:
    """Return (least, most) of each instruction, given those of inputs by name; else unbounded."""
    return interpret(
        program,
        lambda name: bounds.get(name, EVERYTHING),
        lambda value: (value, value),
        lambda instruction, arguments: _widened(_range(instruction, arguments)),
    )


def plain_calls(program: Program, bounds: Mapping[str, Range]) -> frozenset[int]:
    """Return the calls of elementary functions that can take the plain form, by index."""
    found = ranges(program, bounds)

    def inside(instruction: Instruction) -> bool:
        least, most = PLAIN_DOMAINS[instruction.op]
        low, high = found[instruction.args[0]]
        return least <= low and high <= most

    return frozenset(
        k for k, i in enumerate(program.instructions) if i.op in PLAIN_DOMAINS and inside(i)
    )


def unbounded(program: Program, bounds: Mapping[str, Range]) -> tuple[str, ...]:
    """Return the prepared outputs that need not be finite, given bounds of inputs by name."""
    found = ranges(program, bounds)
    pairs = zip(program.outputs, program.results, strict=True)
    return tuple(
        s.name for s, r in pairs if s.group == "prepared" and not all(map(math.isfinite, found[r]))
    )


def _widened(r: Range) -> Range:
    low, high = r
    if math.isnan(low) or math.isnan(high):
        return EVERYTHING
    return (
        low * _SLACK if low < 0.0 else low / _SLACK,
        high * _SLACK if high > 0.0 else high / _SLACK,
    )


def _product(a: Range, b: Range) -> Range:
    corners = [x * y for x in a for y in b]
    return EVERYTHING if any(map(math.isnan, corners)) else (min(corners), max(corners))


def _square(a: Range) -> Range:
    low, high = a
    least = 0.0 if low <= 0.0 <= high else min(low * low, high * high)
    return least, max(low * low, high * high)


def _sum(a: Range, b: Range) -> Range:
    return a[0] + b[0], a[1] + b[1]


def _minus(a: Range) -> Range:
    return -a[1], -a[0]


def _fused(i: Instruction, a: list[Range]) -> Range:
    product = _square(a[0]) if i.args[0] == i.args[1] else _product(a[0], a[1])
    if i.op is Op.FNMS:
        return _sum(a[2], _minus(product))
    return _sum(product, a[2] if i.op is Op.FMA else _minus(a[2]))


_RULES: dict[Op, Callable[[Instruction, list[Range]], Range]] = {
    Op.ADD: lambda _, a: _sum(a[0], a[1]),
    Op.SUB: lambda _, a: _sum(a[0], _minus(a[1])),
    Op.MUL: lambda i, a: _square(a[0]) if i.args[0] == i.args[1] else _product(a[0], a[1]),
    Op.FMA: _fused,
    Op.FMS: _fused,
    Op.FNMS: _fused,
    Op.NEG: lambda _, a: _minus(a[0]),
    Op.MAX: lambda _, a: (max(a[0][0], a[1][0]), max(a[0][1], a[1][1])),
    Op.MIN: lambda _, a: (min(a[0][0], a[1][0]), min(a[0][1], a[1][1])),
    Op.SELECT: lambda _, a: (min(a[1][0], a[2][0]), max(a[1][1], a[2][1])),
    Op.SIN: lambda *_: (-1.0, 1.0),
    Op.COS: lambda *_: (-1.0, 1.0),
}


def _range(instruction: Instruction, arguments: list[Range]) -> Range:
    rule = _RULES.get(instruction.op)
    return rule(instruction, arguments) if rule else EVERYTHING
