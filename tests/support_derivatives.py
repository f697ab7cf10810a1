"""Two ways to exact derivatives: the emitted program in 50 digits, and SymPy's chain rule."""

import mpmath as mp
import sympy as sp
from pfaffian.derive.ir.program import Op

DIGITS = 50
_MP = {
    Op.ADD: lambda a, b: a + b,
    Op.SUB: lambda a, b: a - b,
    Op.MUL: lambda a, b: a * b,
    Op.DIV: lambda a, b: a / b,
    Op.FMA: lambda a, b, c: a * b + c,
    Op.FMS: lambda a, b, c: a * b - c,
    Op.FNMS: lambda a, b, c: c - a * b,
    Op.NEG: lambda a: -a,
    Op.ABS: abs,
    Op.SIGN: mp.sign,
    Op.MIN: min,
    Op.MAX: max,
    Op.SQRT: mp.sqrt,
    Op.SIN: mp.sin,
    Op.COS: mp.cos,
    Op.ATAN: mp.atan,
    Op.TANH: mp.tanh,
    Op.LESS: lambda a, b: a < b,
    Op.LESS_EQUAL: lambda a, b: a <= b,
    Op.NOT: lambda a: not a,
    Op.AND: lambda a, b: a and b,
    Op.OR: lambda a, b: a or b,
    Op.SELECT: lambda c, a, b: a if c else b,
}


def at_50_digits(program, values):
    """Run `program` in 50 digits; its constants are decimals or pi, rounded."""
    slots = []
    names = iter(program.inputs)
    exact = {float(mp.pi): mp.pi, 1.0 / float(mp.pi): 1 / mp.pi}
    for i in program.instructions:
        if i.op is Op.INPUT:
            slots.append(mp.mpf(values[next(names).name]))
        elif i.op is Op.CONST:
            slots.append(exact.get(i.value, mp.mpf(i.value)))
        else:
            slots.append(_MP[i.op](*(slots[a] for a in i.args)))
    return {s.name: slots[k] for s, k in zip(program.outputs, program.results, strict=True)}


def smooth(expression):
    """Write corners as branches, which SymPy differentiates one by one."""

    def chosen(a, b, first):
        return sp.Piecewise((a, first), (b, True))

    def larger(*args):
        return args[0] if len(args) == 1 else chosen(args[0], larger(*args[1:]), args[0] > args[1])

    def smaller(*args):
        return args[0] if len(args) == 1 else chosen(args[0], smaller(*args[1:]), args[0] < args[1])

    written = expression.replace(sp.Max, larger).replace(sp.Min, smaller)
    written = written.replace(sp.Abs, lambda x: chosen(-x, x, x < 0))
    return written.replace(
        lambda e: getattr(e.func, "__name__", "") == "side",
        lambda e: chosen(sp.S.NegativeOne, sp.S.One, e.args[0] < 0),
    )


class Forward:
    """Values and derivatives of a block by the chain rule, definition by definition, in SymPy."""

    def __init__(self, block):
        self.block, self.steps = block, []
        for d in block.definitions:
            e = smooth(d.expression)
            needs = sorted(e.free_symbols, key=lambda s: s.name)
            parts = [sp.lambdify(needs, sp.diff(e, s), "mpmath") for s in needs]
            self.steps.append((d.symbol, sp.lambdify(needs, e, "mpmath"), needs, parts))

    def __call__(self, values, seeds):
        """Return {output: (value, [derivative by each variable])}; seeds start the inputs."""
        width = len(next(iter(seeds.values())))
        zero = [mp.mpf(0)] * width
        known = {
            symbol: (values[s.name], seeds.get(s.name, zero))
            for s, symbol in zip(self.block.inputs, self.block.symbols, strict=True)
        }
        for symbol, value, needs, parts in self.steps:
            arguments = [known[s][0] for s in needs]
            slopes = list(zero)
            for s, part in zip(needs, parts, strict=True):
                if any(known[s][1]):
                    slope = part(*arguments)
                    slopes = [a + slope * b for a, b in zip(slopes, known[s][1], strict=True)]
            known[symbol] = (mp.mpf(value(*arguments)), slopes)
        return {
            s.name: known[symbol]
            for s, symbol in zip(self.block.outputs, self.block.results, strict=True)
        }


def unit(k, n):
    return [mp.mpf(int(i == k)) for i in range(n)]
