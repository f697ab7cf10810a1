"""Hurwitz conditions of the zero dynamics in closed form, up to degree 4.

The polynomial a_n p^n + ... + a_0 has all its roots left of the imaginary axis if and only if its
coefficients have one sign and, for n = 3, a2 a1 - a3 a0 > 0 or, for n = 4, the Hurwitz determinant
a3 a2 a1 - a4 a1^2 - a3^2 a0 has the sign of a4 (Lienard and Chipart; Gantmacher, Theory of
Matrices, chapter XV). Only signs matter, which leaves room to write the conditions shortly:

- a coefficient may be compared with any higher one in place of a_n, as that has the sign of a_n
  by its own condition: here with the one that most cancels with;
- the determinant may be divided by a product of as many coefficients as it has in each term;
- factors known to be positive are dropped, powers reduced to 1 or 2.

All this holds where a_n is not 0; elsewhere the polynomial has lost its degree.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp
from pfaffian.derive.ir.names import DAMPED, FRICTIONLESS
from pfaffian.derive.ir.own_names import OwnNames
from pfaffian.derive.mechanics.block_terms import take_parameters
from pfaffian.derive.mechanics.cyclic import trailing_zeros
from pfaffian.derive.mechanics.zero_dynamics import ZeroDynamics, without_friction
from pfaffian.derive.spec.model_spec import ModelSpec
from pfaffian.derive.symbolic.block import Block, BlockBuilder

#: Highest degree with conditions in closed form.
CLOSED_DEGREE = 4
#: A condition longer than this, in characters, is left in named coefficients.
LONGEST = 600
#: One longer than this is put in named coefficients where a message quotes it.
BRIEF = 200
#: A determinant of more products of terms is left in named coefficients without being expanded,
#: and one of more terms without being factored: that could take longer than the derivation.
MOST_PRODUCTS, MOST_TERMS = 1500, 24

#: Powers of the irreducible factors whose sign is not known, and the sign of all others.
_Factors = dict[sp.Expr, int]


@dataclass(frozen=True)
class HurwitzCondition:
    """`margin > 0`, in the parameters and slopes; `in_names > 0` says it of the coefficients.

    The two have the same sign, not the same value. `in_names` is in a0, a1 ..., and so is `margin`
    where it would be too long otherwise.
    """

    in_names: sp.Expr
    margin: sp.Expr

    @property
    def named(self) -> bool:
        """Return whether `margin` is left in named coefficients."""
        return bool(self.margin == self.in_names)

    @property
    def never(self) -> bool:
        """Return whether no values of the parameters can meet the condition."""
        return bool(self.margin.is_nonpositive)

    @property
    def says(self) -> str:
        """Return what is asked of the coefficients, as plain text."""
        return _written(self.in_names)

    @property
    def text(self) -> str:
        """Return the condition as plain text."""
        return f"{self.says}, which never holds" if self.never else _written(self.margin)

    @property
    def brief(self) -> HurwitzCondition:
        """Return the condition as a message has room for it: in names where it is long."""
        short = self.never or len(self.text) <= BRIEF
        return self if short else HurwitzCondition(self.in_names, self.in_names)


def relation(margin: sp.Expr) -> tuple[sp.Expr, str, sp.Expr]:
    """Return `margin > 0` as (left, > or <, right) with no minus sign in front of a term."""
    terms = sp.Add.make_args(margin)
    minus = [t for t in terms if t.could_extract_minus_sign()]
    if not minus:
        return margin, ">", sp.S.Zero
    if len(minus) == len(terms):
        return -margin, "<", sp.S.Zero
    return sp.Add(*(t for t in terms if t not in minus)), ">", -sp.Add(*minus)


def _written(margin: sp.Expr) -> str:
    left, sign, right = relation(margin)
    return f"{left} {sign} {right}"


@dataclass(frozen=True)
class HurwitzConditions:
    """The conditions that together say that the zero dynamics are stable, where a_n is not 0.

    `frictionless` holds with all uncertainty at zero, `damped` with friction in the named slopes
    of `ZeroDynamics`; it is empty where friction does not enter. Above degree 4 both are empty.
    """

    degree: int
    frictionless: tuple[HurwitzCondition, ...]
    damped: tuple[HurwitzCondition, ...]

    @property
    def closed(self) -> bool:
        """Return whether the conditions are given in closed form."""
        return self.degree <= CLOSED_DEGREE


def hurwitz_conditions(spec: ModelSpec, zeros: ZeroDynamics) -> HurwitzConditions:
    """Return the Hurwitz conditions of `zeros`, those at the origin of cyclic coordinates apart.

    The latter are divided out; with friction there may be fewer of them.
    """
    order = len(zeros.coefficients) - 1
    degree = order - zeros.at_origin
    if degree > CLOSED_DEGREE:
        return HurwitzConditions(degree, (), ())
    still = without_friction(spec, zeros.coefficients)
    enters = still != zeros.coefficients
    conditions = named_conditions if zeros.entries else closed_conditions
    names = coefficient_symbols(order, spec.own)
    left = order - min(zeros.at_origin, trailing_zeros(zeros.coefficients))
    damped = zeros.in_slopes[: left + 1] if enters and left <= CLOSED_DEGREE else ()
    return HurwitzConditions(
        degree,
        conditions(still[: degree + 1], names[: degree + 1]),
        conditions(damped, names[: left + 1]) if damped else (),
    )


def coefficient_symbols(degree: int, own: OwnNames | None = None) -> tuple[sp.Symbol, ...]:
    """Return the symbols a_n ... a_0; their names give way as `own` has it."""
    names = (f"a{k}" for k in reversed(range(degree + 1)))
    return tuple(sp.Symbol(own(n) if own else n, real=True) for n in names)


def closed_conditions(
    coefficients: Sequence[sp.Expr], symbols: Sequence[sp.Symbol] | None = None
) -> tuple[HurwitzCondition, ...]:
    """Return the conditions on a polynomial of degree 0 to 4, highest power first.

    `symbols` are the names of the coefficients, a_n ... a_0 unless given.

    Those that always hold, because only positive factors are left, are dropped.
    """
    names, values = _named([sp.factor(c) for c in coefficients], symbols)
    factors = [_factors(v) for v in values]
    found = [_same_sign(k, names, factors) for k in range(1, len(values))]
    if len(values) in (4, 5):
        found.append(_determinant(names, values, factors))
    kept: dict[sp.Expr, HurwitzCondition] = {}
    for condition in found:
        if not condition.margin.is_positive:
            kept.setdefault(condition.margin, condition)
    return tuple(kept.values())


def _named(
    values: Sequence[sp.Expr], symbols: Sequence[sp.Symbol] | None
) -> tuple[tuple[sp.Symbol, ...], list[sp.Expr]]:
    """Return names and values of the coefficients from the first that is not zero on."""
    names = tuple(symbols or coefficient_symbols(len(values) - 1))
    first = next((k for k, value in enumerate(values) if value != 0), len(values))
    return names[first:], list(values[first:])


def named_conditions(
    coefficients: Sequence[sp.Expr], symbols: Sequence[sp.Symbol] | None = None
) -> tuple[HurwitzCondition, ...]:
    """Return the conditions in the names of the coefficients, where these are too long to read."""
    names, values = _named(coefficients, symbols)
    margins = [name / names[0] for name in names[1:]]
    if len(values) in (4, 5):
        whole = sp.Add(*_determinant_terms(names))
        margins.append(whole if len(values) == 4 else whole / names[0])
    return tuple(HurwitzCondition(m, m) for m in margins)


def _same_sign(
    k: int, names: Sequence[sp.Symbol], factors: Sequence[tuple[int, _Factors]]
) -> HurwitzCondition:
    """Return the shortest a_k/a_j > 0 among the higher coefficients a_j."""
    if factors[k][0] == 0:
        return HurwitzCondition(names[k] / names[0], sp.S.Zero)
    choices = [j for j in range(k) if factors[j][0]]
    margins = {j: _margin([(factors[k], 1), (factors[j], -1)]) for j in choices}
    best = min(choices, key=lambda j: (len(str(margins[j])), j))
    return _shown(names[k] / names[best], margins[best])


def _shown(in_names: sp.Expr, margin: sp.Expr) -> HurwitzCondition:
    long = len(str(margin)) > LONGEST
    return HurwitzCondition(in_names, in_names if long else margin)


def _determinant(
    names: Sequence[sp.Symbol],
    values: Sequence[sp.Expr],
    factors: Sequence[tuple[int, _Factors]],
) -> HurwitzCondition:
    """Return the condition on the last Hurwitz determinant but one, of degree 3 or 4."""
    terms = _determinant_terms(names)
    named = sp.Add(*terms) if len(names) == 4 else sp.Add(*terms) / names[0]
    known = dict(zip(names, values, strict=True))
    if _products(terms, known) > MOST_PRODUCTS:
        return HurwitzCondition(named, named)
    expanded = sp.expand(sp.Add(*terms).xreplace(known))
    if len(sp.Add.make_args(expanded)) > MOST_TERMS:
        return HurwitzCondition(named, named)
    whole = _factors(sp.factor(expanded))
    if whole[0] == 0:
        return HurwitzCondition(named, sp.S.Zero)
    there = [f for f in factors if f[0]]
    nonzero = {base for _, powers in there for base in powers}
    choices = [
        _margin([(whole, 1), *((f, -1) for f in chosen)], nonzero)
        for chosen in itertools.combinations_with_replacement(there, len(names) - 2)
    ]
    margin = min(choices, key=lambda m: (len(str(m)), str(m)))
    return _shown(named, margin)


def _products(terms: Sequence[sp.Expr], known: Mapping[sp.Symbol, sp.Expr]) -> int:
    """Return how many products of terms of the coefficients the determinant multiplies out to."""
    size = {n: len(sp.Add.make_args(sp.expand(v))) for n, v in known.items()}
    return sum(math.prod(size[n] ** int(t.as_powers_dict()[n]) for n in known) for t in terms)


def _determinant_terms(names: Sequence[sp.Symbol]) -> tuple[sp.Expr, ...]:
    if len(names) == 4:
        a3, a2, a1, a0 = names
        return a2 * a1, -a3 * a0
    a4, a3, a2, a1, a0 = names
    return a3 * a2 * a1, -a4 * a1**2, -(a3**2) * a0


def _factors(factored: sp.Expr) -> tuple[int, _Factors]:
    """Return the sign of the factors that have one, and the powers of all others.

    Of a factor and its negative only one occurs, so that they cancel. The sign of 0 is 0.
    """
    sign = 1
    powers: _Factors = {}
    for factor in sp.Mul.make_args(factored):
        if factor.is_zero:
            return 0, {}
        base, power = factor.as_base_exp()
        if not power.is_Integer:
            base, power = factor, sp.S.One
        odd = int(power) % 2
        if base.is_number or base.is_positive or base.is_negative:
            sign *= -1 if odd and base.is_negative else 1
            continue
        if base.could_extract_minus_sign():
            base, sign = -base, -sign if odd else sign
        powers[base] = powers.get(base, 0) + int(power)
    return sign, powers


def _margin(
    parts: Iterable[tuple[tuple[int, _Factors], int]], nonzero: Iterable[sp.Expr] = ()
) -> sp.Expr:
    """Return an expression with the sign of a product of (factors, power).

    Even powers of what is `nonzero`, or stands in the denominator, have no say and are dropped.
    """
    sign = 1
    powers: _Factors = {}
    for (own, factors), power in parts:
        sign *= own if power % 2 else 1
        for base, exponent in factors.items():
            powers[base] = powers.get(base, 0) + exponent * power
    known = set(nonzero)
    left: _Factors = {}
    for base, exponent in powers.items():
        if exponent % 2:
            left[base] = 1 if exponent > 0 else -1
        elif exponent > 0 and base not in known:
            left[base] = 2
    if all(exponent < 0 for exponent in left.values()):
        left = dict.fromkeys(left, 1)  # 1/x > 0 is x > 0
    return _product(sign, left)


def _product(sign: int, powers: Mapping[sp.Expr, int]) -> sp.Expr:
    """Return the product; a minus goes into its shortest sum, where that reads better."""
    bases = sorted(powers, key=lambda b: (len(str(b)), str(b)))
    sums = [b for b in bases if b.is_Add and powers[b] != 2]
    flipped = sums[0] if sign < 0 and sums else None
    rest = -1 if sign < 0 and flipped is None else 1
    return sp.Mul(rest, *((-b if b == flipped else b) ** powers[b] for b in bases))


def hurwitz_blocks(
    spec: ModelSpec, zeros: ZeroDynamics, hurwitz: HurwitzConditions
) -> tuple[Block, ...]:
    """Return the margins of the derived conditions, of the plant without friction and with it."""
    found = (
        _block(
            spec,
            FRICTIONLESS,
            hurwitz.frictionless,
            without_friction(spec, zeros.coefficients),
            zeros,
        ),
        _block(spec, DAMPED, hurwitz.damped, zeros.coefficients, zeros),
    )
    return tuple(block for block in found if block is not None)


def _block(
    spec: ModelSpec,
    name: str,
    conditions: tuple[HurwitzCondition, ...],
    coefficients: tuple[sp.Expr, ...],
    zeros: ZeroDynamics,
) -> Block | None:
    if not conditions:
        return None
    builder = BlockBuilder(name, f"{spec.title}: derived Hurwitz conditions", spec.own)
    take_parameters(builder, spec, "lumped", "plant", "synthesised", "gain", "uncertainty")
    for symbol, entry in zeros.entries:
        builder.define(symbol.name, entry, "entry of the linearisation")
    slopes = dict(zeros.slopes)
    known = dict(
        zip(coefficient_symbols(len(coefficients) - 1, spec.own), coefficients, strict=True)
    )
    for k, condition in enumerate(c.brief for c in conditions):
        margin = condition.margin.xreplace(known if condition.named else slopes)
        builder.give(f"margin{k + 1}", margin, "", condition.text)
    return builder.build()
