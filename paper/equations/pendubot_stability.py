"""Equations (24)-(40): the Lyapunov function and its derivative, step by step.

Identities of matrices are shown with free matrices, inequalities with numbers: with one constraint
A D B is one. Every sign of ADB, beta, Fhat and ahat is tried. What the assumptions give is put in
with a slack: (ADB)^2 = lower + slack for (13), alpha Pi = |Fhat| + slack for (14).
"""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.symbolic.units import dimension_of
from pfaffian.paper.audit.check import Step, at_most, decide, equal, repaired, true
from pfaffian.paper.audit.notation import read
from pfaffian.paper.audit.row import Counterexample, Row
from pfaffian.paper.equations import pendubot_source as src
from pfaffian.paper.equations.pendubot_control import layer_cases, nominal_torque
from pfaffian.paper.equations.pendubot_source import Case, P, adb, beta, estimate, fhat

_SLACK_13, _SLACK_14 = src.nonnegative("slack_13 slack_14")
SIGNS = (adb, beta, fhat)
#: Assumptions 1 and 2 with their slack.
ASSUMED = {
    src.lower: adb**2 - _SLACK_13,
    src.alpha: (sp.Abs(fhat) + _SLACK_14) / src.regressor,
}
_MU = adb * beta * estimate * src.regressor


def equation_24(case: Case) -> Row:
    """Check that V is positive definite, and that its terms fit one another and (15)."""
    ahat, alpha = (sp.Matrix(src.real(f"{n}1 {n}2")) for n in ("ahat", "alpha"))
    value = case.scalar(24, "V", ahat=ahat, alpha=alpha)
    (rate,) = src.positive("k1")
    hessian = sp.hessian(value, (beta, *ahat)).subs(P.k1, rate)
    units = {p.name: p.unit for p in case.derivation.spec.parameters}
    declared = units | {"beta": "rad/s", "ahat": "N*m", "alpha": "N*m"}
    dimension_of(sp.expand(case.scalar(24, "V", alpha=estimate / 2)), declared, "(24)")
    steps = [
        true("V is positive definite", hessian.is_positive_definite),
        equal("V is zero with its arguments", value.subs({beta: 0, **_same(ahat, alpha)}), sp.S(0)),
        equal("|bhat| Pi leaves V' for p3 = -ahat Pi sign bhat, Fhat = alpha Pi", _cross(case), 0),
    ]
    note = "A definition; positive definite for k1 > 0, and its terms agree in unit with (15)."
    return Row(24, decide(steps, note, value, value))


def _same(one: sp.Matrix, other: sp.Matrix) -> dict[sp.Symbol, sp.Expr]:
    return dict(zip(one, other, strict=True))


def _cross(case: Case) -> sp.Expr:
    """Return what V' has in |bhat| Pi: at Fhat = -alpha Pi, p3 = -ahat Pi, all else zero."""
    (size,) = src.positive("size")
    value = case.scalar(24, "V")
    moved = size * (src.alpha - estimate) * src.regressor  # beta beta' with |bhat| = size
    law = case.in_terms("bound_estimate_rate", bhat=size, regressor=src.regressor)
    adapted = law.coeff(src.regressor) * src.regressor
    return sp.expand(value.diff(beta) / beta * moved + value.diff(estimate) * adapted)


def equation_25(case: Case) -> Row:
    """Check V' by the chain rule, alpha constant."""
    t = sp.Symbol("t", real=True)
    moving, guess = sp.Function("beta")(t), sp.Function("ahat")(t)
    value = case.scalar(24, "V", beta=moving, ahat=guess)
    rates = {"dbeta": moving.diff(t), "dahat": guess.diff(t)}
    printed = case.scalar(25, "rate", beta=moving, ahat=guess, **rates)
    steps = [true("V' by the chain rule", sp.expand(value.diff(t) - printed) == 0)]
    return Row(25, decide(steps, "Holds for constant alpha.", printed, value.diff(t)))


def equation_26(case: Case) -> Row:
    """Check the first line against beta' of the derived law, the others for any matrices."""
    lines = [case.general(26, f"line{k}") for k in (1, 2, 3)]
    reached = 2 * beta * src.rate(case.following())
    steps = [
        equal("line 1 is 2 beta beta'", case.explicit(26, "line1"), reached),
        equal("line 2 with q'' of (1)", lines[1], lines[0]),
        equal("line 3, D = M^-1", lines[2], lines[1]),
    ]
    note = "beta' = A q'' - b by (7), (8), with q'' from (1); the sum is only regrouped."
    return Row(26, decide(steps, note, case.explicit(26, "line1"), reached))


def equation_27(case: Case) -> Row:
    """Check that the derived p1 cancels the nominal part."""
    left = case.explicit(27, "zero", p1=nominal_torque(case))
    zero = sp.S.Zero
    steps = [equal("AD[(-C q' - G) + B p1] - b", left, zero)]
    return Row(27, decide(steps, "Identically zero where ADB is not.", left, zero))


def equation_28(case: Case) -> Row:
    """Check ADF = ADB Fhat with the derived decomposition."""
    left, first, second = (case.explicit(28, n) for n in ("left", "line1", "line2"))
    steps = [
        equal("ADF", left, (case.reach[0] * case.derivation.decomposition.force)[0]),
        equal("ADF = ADB Fhat + AD dF", left, first),
        equal("ADF = ADB Fhat", left, second),
    ]
    return Row(28, decide(steps, "By (9) and (12).", left, second))


def equation_29(case: Case) -> Row:
    """Check what beta' is with the nominal torque of (17) and F of (9), for any matrices."""
    names = case.free_names
    weight = read("A*D", names)
    gain, b = read("A*D*B", names), read("b", names)
    # AD dF = 0, (12), fixes one component of dF.
    (second,) = src.real("dF2")
    mismatch = sp.Matrix([-weight[1] * second / weight[0], second])
    nominal = read("(A*D*B)**-1*(b + A*D*(C*dq + G))", names)
    torque = {"torque": nominal + src.p2 + src.p3 - fhat, "dF": mismatch}
    moved = read("A*D*(B*torque - dF - C*dq - G)", {**names, **torque})
    steps = [equal("A D B of them", gain, (weight * read("B", names))[0])]
    derived = 2 * beta * (moved - b)
    printed = case.general(29, "rate", Fhat=fhat)
    steps.append(equal("2 beta beta' with (17), (9), (12)", printed, derived))
    return Row(29, decide(steps, "Substitution.", printed, 2 * beta * src.dbeta))


def equation_30(case: Case) -> Row:
    """Check the norm inequality for all signs, then the bound (14)."""
    left, first, second = (case.scalar(30, n) for n in ("left", "line1", "line2"))
    free = read("A*D*B", case.free_names)
    steps = [
        equal("it is -2 beta ADB Fhat", left, -2 * beta * adb * fhat),
        equal("so for free matrices", case.general(30, "left", Fhat=fhat), left.subs(adb, free)),
        equal(
            "|B^T D A^T beta| |Fhat| too",
            case.general(30, "line1", Fhat=fhat) ** 2,
            (2 * beta * free * fhat) ** 2,
        ),
        at_most("the norms", left, first, signs=SIGNS),
        at_most("with (14)", first, second.subs(ASSUMED), signs=SIGNS),
    ]
    note = "Holds given Assumption 2, (14); bhat = ADB beta because ADB is its own transpose."
    return Row(30, decide(steps, note, left, second))


def _p2(case: Case) -> sp.Expr:
    return case.in_terms("p2", bhat=adb * beta)


def equation_31(case: Case) -> Row:
    """Check the substitution of p2."""
    left, printed = case.scalar(31, "left", p2=_p2(case)), case.scalar(31, "right")
    steps = [equal("2 beta ADB p2", printed, left)]
    return Row(31, decide(steps, "Substitution of (18), (20).", printed, left))


def equation_32(case: Case) -> Row:
    """Check Rayleigh's bound, with (ADB)^2 = lower + slack."""
    left, first, second = (case.scalar(32, n) for n in ("left", "line1", "line2"))
    steps = [
        equal("it is 2 beta ADB p2", left, 2 * beta * adb * _p2(case)),
        equal("regrouped", case.general(32, "left"), case.general(32, "line1")),
        at_most("Rayleigh", first, second.subs(ASSUMED), signs=SIGNS),
    ]
    note = (
        "Holds where Assumption 1 does: with one constraint the matrix is the number (ADB)^2, its "
        "own eigenvalue, and the bound is its minimum over the operating region."
    )
    return Row(32, decide(steps, note, left, second))


def equation_33(case: Case) -> Row:
    """Check the ends of (31) and (32) against one another."""
    left, right = case.scalar(33, "left", p2=_p2(case)), case.scalar(33, "right")
    steps = [
        equal("it is beta's share of p2", case.scalar(33, "left"), 2 * beta * adb * src.p2),
        at_most("(31) and (32)", left, right.subs(ASSUMED), signs=SIGNS),
    ]
    return Row(33, decide(steps, "(31) and (32), given Assumption 1.", left, right))


def equation_34(case: Case) -> Row:
    """Check the substitution of p3, mu in it as (22) has it."""
    p3 = case.in_terms("p3", mu=src.mu, effort=estimate * src.regressor)
    left = case.scalar(34, "left", p3=p3).subs(src.mu, _MU)
    gamma = case.layer
    lines = [case.scalar(34, f"line{k}", gamma=gamma).subs(src.mu, _MU) for k in (1, 2, 3)]
    steps = [equal(f"line {k}", line, left) for k, line in enumerate(lines, 1)]
    return Row(34, decide(steps, "Substitution of (19), (20), (22).", lines[2], left))


def _branch(case: Case, number: int, place: str) -> Row:
    """Check one branch of gamma against the derived law, for both signs of mu."""
    right = case.scalar(number, "right")
    steps = [
        equal(
            f"gamma {name}",
            case.scalar(number, "left", gamma=gamma).subs(at),
            right.subs(at),
        )
        for name, gamma, at in layer_cases(case)
        if name.startswith(place)
    ]
    note = f"The {'outer' if place == 'outside' else 'inner'} branch of (23)."
    left = case.scalar(number, "left")
    return Row(number, decide(steps, note, left, right))


def equation_35(case: Case) -> Row:
    """Check the outer branch of gamma."""
    return _branch(case, 35, "outside")


def equation_36(case: Case) -> Row:
    """Check the inner branch of gamma."""
    return _branch(case, 36, "inside")


def beta_rate(case: Case, outside: bool) -> sp.Expr:
    """Return beta' of (29) with the derived p2 and p3, out of the layer or in it."""
    gamma = case.layer.replace(sp.Max, lambda *_: sp.Abs(src.mu) if outside else P.epsilon)
    p3 = -gamma.subs(src.mu, _MU) * _MU * estimate * src.regressor
    return -adb * fhat + adb * _p2(case) + adb * p3


def _chain(case: Case, number: int, parts: tuple[str, ...], outside: bool) -> list[sp.Expr]:
    found = [case.scalar(number, n, mu=_MU) for n in parts]
    return [f.subs(src.dbeta, beta_rate(case, outside)).subs(ASSUMED) for f in found]


def equation_37(case: Case) -> Row:
    """Check the chain outside the layer, its first inequality from (29) on."""
    parts = ("left", "line1", "line2", "line3")
    left, first, second, third = _chain(case, 37, parts, True)
    every = (*SIGNS, estimate)
    (size,) = src.positive("ahat_size")
    known = {estimate: size}
    steps = [
        at_most("(29), (30), (33), (35): line 1", left, first, signs=every),
        *_both_ways("|mu| = |bhat| ahat Pi: line 2", first.subs(known), second.subs(known)),
        equal("line 3", second, third),
        at_most("line 3 bounds it for any sign of ahat Pi", left, third, signs=every),
    ]
    found = Counterexample(
        ((adb, sp.S.One), (beta, sp.S.One), (src.effort, -sp.S.One)),
        case.scalar(37, "line2", ahat=src.effort, Pi=1).subs(_QUIET),
        case.scalar(37, "line1", mu=adb * beta * src.effort, Pi=1).subs(_QUIET),
        "lines 2 and 1, said to be equal, with kappa = alpha = 0 and ahat^T Pi = -1",
    )
    repair = "ahat^T Pi >= 0, which follows from Pi_i >= 0, is assumed"
    note = (
        "The sum of (30), (33), (35). Line 2 puts |mu| = |bhat| ahat^T Pi, which for k > 1 needs "
        "ahat^T Pi >= 0: see (15). Without it line 2 is an upper bound, and line 3 holds."
    )
    return Row(37, repaired(found, repair, steps, note, first, third))


#: Leaves |mu| and |bhat| ahat Pi of (37) alone.
_QUIET = {P.kappa: sp.S.Zero, src.alpha: sp.S.Zero}


def _both_ways(name: str, one: sp.Expr, other: sp.Expr) -> list[Step]:
    """Show an equality of magnitudes for every sign."""
    return [at_most(name, one, other, signs=SIGNS), at_most(name, other, one, signs=SIGNS)]


def _square(case: Case) -> sp.Expr:
    """Return 2 (|mu| - eps/2)^2/eps."""
    return 2 * (sp.Abs(_MU) - P.epsilon / 2) ** 2 / P.epsilon


def equation_38(case: Case) -> Row:
    """Check the chain inside the layer: complete the square."""
    parts = ("left", *(f"line{k}" for k in range(1, 7)))
    left, *lines = _chain(case, 38, parts, False)
    every = (*SIGNS, estimate)
    steps = [
        at_most("(29), (30), (33), (36): line 1", left, lines[0], signs=every),
        equal("line 2: a term added and taken away", lines[0], lines[1]),
        at_most("line 3: |mu| put in", lines[1], lines[2], signs=every),
        equal("line 4: regrouped", lines[2], lines[3]),
        at_most("line 5: the square completed", lines[3], lines[4], _square(case), every),
        equal("line 6: 2/(4/eps) = eps/2", lines[4], lines[5]),
    ]
    note = (
        "mu - mu^2/eps is eps/4 - (mu - eps/2)^2/eps, so its double is at most eps/2: the odd "
        "2 * 1/(4/eps) is right. The left-hand side lacks a transpose, harmless for one constraint."
    )
    return Row(38, decide(steps, note, lines[3], lines[5]))


def equation_39(case: Case) -> Row:
    """Check (39) outside the layer and in it, from (29) on."""
    every = (*SIGNS, estimate)
    outer, right = _chain(case, 39, ("left", "right"), True)
    inner, _ = _chain(case, 39, ("left", "right"), False)
    steps = [
        at_most("outside the layer", outer, right, signs=every),
        at_most("in the layer", inner, right, _square(case), every),
        equal("the end of (38)", right, _chain(case, 38, ("line6",), False)[0]),
    ]
    return Row(39, decide(steps, "The larger of (37) and (38).", case.scalar(39, "right"), right))


def equation_40(case: Case) -> Row:
    """Check the chain of the adaptation term for two components, Cauchy-Schwarz last."""
    ahat, alpha, pi = (sp.Matrix(src.real(f"{n}1 {n}2")) for n in ("ahat", "alpha", "Pi"))
    (size,) = src.nonnegative("size")
    law = [
        case.in_terms("bound_estimate_rate", bhat=size, regressor=p, bound_estimate=a)
        for a, p in zip(ahat, pi, strict=True)
    ]
    given = {"ahat": ahat, "alpha": alpha, "Pi": pi, "bhat": size, "dahat": sp.Matrix(law)}
    left, *lines = (
        case.scalar(40, n, **given) for n in ("left", *(f"line{k}" for k in range(1, 6)))
    )
    steps = [
        equal(f"line {k}", one, other)
        for k, (one, other) in enumerate(zip((left, *lines[:3]), lines[:4], strict=True), 1)
    ]
    steps.append(_cauchy_schwarz(lines[4] - lines[3], ahat - alpha, alpha))
    note = "Line 3 writes a third argument t of Pi that no other line has; nothing depends on it."
    return Row(40, decide(steps, note, left, lines[4]))


def _cauchy_schwarz(gained: sp.Expr, gap: sp.Matrix, alpha: sp.Matrix) -> Step:
    """Show that what the last line gains is |x| |y| + x^T y times a positive factor.

    (|x| |y|)^2 - (x^T y)^2 is a square, (x1 y2 - x2 y1)^2.
    """
    x, y = gap, alpha
    sizes = sp.sqrt(x[0] ** 2 + x[1] ** 2) * sp.sqrt(y[0] ** 2 + y[1] ** 2)
    inner = (x.T * y)[0]
    factor = 2 * P.k2 / P.k1
    lagrange = (x[0] ** 2 + x[1] ** 2) * (y[0] ** 2 + y[1] ** 2) - inner**2
    square = equal("", lagrange, (x[0] * y[1] - x[1] * y[0]) ** 2)
    form = equal("line 5: Cauchy-Schwarz", gained, factor * (sizes + inner))
    return form if square.holds else square


EQUATIONS = (
    equation_24,
    equation_25,
    equation_26,
    equation_27,
    equation_28,
    equation_29,
    equation_30,
    equation_31,
    equation_32,
    equation_33,
    equation_34,
    equation_35,
    equation_36,
    equation_37,
    equation_38,
    equation_39,
    equation_40,
)
