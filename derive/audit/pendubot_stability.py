"""Equations (24)-(40): the Lyapunov function and its derivative, step by step.

From (29) on everything is scalar: adb is ADB = B^T D A^T, beta and Fhat are real, the estimate
ahat, its true value alpha and Pi are positive. `size` is |bhat|, `excess` a nonnegative difference.
"""

from __future__ import annotations

import sympy as sp
from pfaffian.derive.audit import pendubot_source as src
from pfaffian.derive.audit.check import Step, at_most, decide, equal, true
from pfaffian.derive.audit.pendubot_source import (
    P,
    adb,
    alpha,
    beta,
    estimate,
    fhat,
    lower,
    nominal_gain,
    regressor,
)
from pfaffian.derive.audit.row import Row
from pfaffian.derive.derivation import Derivation
from pfaffian.derive.dimensions import dimension_of

_P2, _P3, _MU, _GAMMA = src.real("p2 p3 mu gamma")
(size, excess) = src.nonnegative("size excess")
#: |mu|, for the two cases of (23).
(layer,) = src.positive("mu_abs")
K1, K2, EPS = P.k1, P.k2, P.epsilon
DECAY = -2 * P.kappa * lower * beta**2
CROSS = 2 * size * (alpha - estimate) * regressor


def equation_24(derivation: Derivation) -> Row:
    """Check that V is positive definite, and that its two terms have one unit."""
    gap = estimate - alpha
    (rate,) = src.positive("k1")
    form = sp.Matrix([[1, 0], [0, 1 / rate]])
    units = {p.name: p.unit for p in derivation.spec.parameters}
    declared = units | {"beta": "rad/s", "ahat": "N*m", "alpha": "N*m"}
    value = beta**2 + gap**2 / K1
    dimension_of(value, declared, "(24)")
    steps = [
        true("V is positive definite", form.is_positive_definite),
        equal("its Hessian", sp.hessian(value, (beta, estimate)), 2 * form.subs(rate, K1)),
    ]
    note = "A definition; positive definite for k1 > 0, and its terms agree in unit with (15)."
    return Row(24, decide(steps, note, value, value))


def equation_25(derivation: Derivation) -> Row:
    """Check V' by the chain rule, alpha constant."""
    t = sp.Symbol("t", real=True)
    moving, guess = sp.Function("beta")(t), sp.Function("ahat")(t)
    value = moving**2 + (guess - alpha) ** 2 / K1
    printed = 2 * moving * moving.diff(t) + 2 / K1 * (guess - alpha) * guess.diff(t)
    steps = [true("V' by the chain rule", sp.expand(value.diff(t) - printed) == 0)]
    return Row(25, decide(steps, "Holds for constant alpha.", printed, value.diff(t)))


def equation_26(derivation: Derivation) -> Row:
    """Check the three lines with the derived matrices."""
    p1, p2, p3 = src.real("p1 p2 p3")
    dynamics, row = derivation.dynamics, derivation.constraint.jacobian
    force, bias = sp.Matrix([src.f1, src.f2]), src.bias(derivation)
    ad, _ = nominal_gain(derivation)
    inverse = dynamics.mass_matrix.adjugate() / dynamics.mass_matrix.det()
    acceleration = inverse * (dynamics.input_matrix * (p1 + p2 + p3) - bias - force)
    b = src.upright(derivation.constraint.acceleration[0])
    first = 2 * beta * ((row * acceleration)[0] - b)
    inside = -bias + dynamics.input_matrix * (p1 + p2) - force + dynamics.input_matrix * p3
    third = 2 * beta * ((ad * inside)[0] - b)
    reached = {src.ddq1: acceleration[0], src.ddq2: acceleration[1]}
    rate = src.rate((src.ROW * sp.Matrix([src.dq1, src.dq2]))[0] - src.FIRST_INTEGRAL)
    steps = [
        equal("2 beta beta' with q'' of (1)", 2 * beta * rate.subs(reached), first),
        equal("last line", third, first),
    ]
    shown = sp.Symbol("beta_dot")
    note = "beta' = A q'' - b by (7), (8), with q'' from (1); the sum is only regrouped."
    return Row(26, decide(steps, note, 2 * beta * shown, third))


def equation_27(derivation: Derivation) -> Row:
    """Check that p1 of (17) cancels the nominal part."""
    ad, gain = nominal_gain(derivation)
    bias = src.bias(derivation)
    p1 = (src.RIGHT + (ad * bias)[0]) / gain
    b = src.upright(derivation.constraint.acceleration[0])
    left = (ad * (derivation.dynamics.input_matrix * p1 - bias))[0] - b
    zero = sp.S.Zero
    steps = [equal("AD[(-C q' - G) + B p1] - b", left, zero)]
    return Row(27, decide(steps, "Identically zero where ADB is not.", zero, zero))


def equation_28(derivation: Derivation) -> Row:
    """Check ADF = ADB Fhat."""
    ad, gain = nominal_gain(derivation)
    split = derivation.decomposition
    left = (ad * split.force)[0]
    right = gain * split.matched[0]
    steps = [
        equal("ADF = ADB Fhat + AD dF", left, right + (ad * split.mismatched)[0]),
        equal("ADF = ADB Fhat", left, right),
    ]
    return Row(28, decide(steps, "By (9) and (12).", left, right))


def equation_29(derivation: Derivation) -> Row:
    """Check the sum that is left when (27) and (28) are put in."""
    nominal, b = src.real("nominal b")  # AD(-C q' - G) + ADB p1, and b
    printed = -2 * beta * adb * fhat + 2 * beta * adb * _P2 + 2 * beta * adb * _P3
    whole = 2 * beta * (nominal + adb * _P2 - adb * fhat + adb * _P3 - b)
    steps = [equal("(26) with (27), (28)", whole.subs(nominal, b), printed)]
    return Row(29, decide(steps, "Substitution.", printed, whole.subs(nominal, b)))


def _case_of_signs(first: int, second: int) -> Step:
    """Return -2 x y <= 2 |x| |y| for one choice of the signs of x and y."""
    x, y = src.nonnegative("x y")
    left, right = -2 * (first * x) * (second * y), 2 * x * y
    return at_most(f"signs {first:+d}, {second:+d}", left, right, 2 * x * y * (1 + first * second))


def equation_30(derivation: Derivation) -> Row:
    """Check the norm inequality for all signs, then the bound (14)."""
    (known,) = src.nonnegative("fhat_abs")
    steps = [_case_of_signs(a, b) for a in (1, -1) for b in (1, -1)]
    # (14): alpha Pi = |Fhat| + excess
    steps.append(
        at_most("with (14)", 2 * size * known, 2 * size * (known + excess), 2 * size * excess)
    )
    note = "Holds given Assumption 2, (14); bhat = ADB beta because ADB is its own transpose."
    return Row(30, decide(steps, note, -2 * beta * adb * fhat, 2 * size * alpha * regressor))


def equation_31(derivation: Derivation) -> Row:
    """Check the substitution of p2."""
    printed = 2 * beta * adb * (-P.kappa * adb * beta)
    (bhat,) = src.real("bhat")
    p2 = src.law(derivation, "p2").subs(bhat, adb * beta)
    derived = 2 * beta * adb * p2
    steps = [equal("2 beta ADB p2", printed, derived)]
    return Row(31, decide(steps, "Substitution of (18), (20).", printed, derived))


def equation_32(derivation: Derivation) -> Row:
    """Check Rayleigh's bound, with (ADB)^2 = lambda_min + excess."""
    left = 2 * beta * adb * (-P.kappa * adb * beta)
    square = -2 * P.kappa * (lower + excess) * beta**2
    steps = [
        equal("regrouped", left, -2 * P.kappa * adb**2 * beta**2),
        at_most("Rayleigh", square, DECAY, 2 * P.kappa * excess * beta**2),
    ]
    note = (
        "Holds where Assumption 1 does: with one constraint the matrix is the number (ADB)^2, its "
        "own eigenvalue, and the bound is its minimum over the operating region."
    )
    return Row(32, decide(steps, note, left, DECAY))


def equation_33(derivation: Derivation) -> Row:
    """Check that (33) is (31) followed by (32)."""
    chained = equation_32(derivation)
    start = 2 * beta * adb * (-P.kappa * adb * beta)
    joined = equal("(31) ends where (32) starts", start, -2 * P.kappa * adb**2 * beta**2)
    steps = [joined, true("(32) is proved", chained.verdict.status == "proved")]
    return Row(33, decide(steps, "(31) and (32), given Assumption 1.", start, DECAY))


def equation_34(derivation: Derivation) -> Row:
    """Check the substitution of p3."""
    mu = adb * beta * estimate * regressor
    left = 2 * beta * adb * (-_GAMMA * mu * estimate * regressor)
    right = -2 * _GAMMA * mu**2
    steps = [equal("2 beta ADB p3 = -2 gamma mu^2", left, right)]
    return Row(34, decide(steps, "Substitution of (19), (20), (22).", left, right))


def equation_35(derivation: Derivation) -> Row:
    """Check the outer branch of gamma."""
    left = -2 * (1 / layer) * layer**2
    steps = [equal("gamma = 1/|mu|", left, -2 * layer)]
    return Row(35, decide(steps, "The outer branch of (23).", left, -2 * layer))


def equation_36(derivation: Derivation) -> Row:
    """Check the inner branch of gamma."""
    left, right = -2 * _GAMMA * layer**2, -2 * layer**2 / EPS
    steps = [equal("gamma = 1/eps", left.subs(_GAMMA, 1 / EPS), right)]
    return Row(36, decide(steps, "The inner branch of (23).", left.subs(_GAMMA, 1 / EPS), right))


_MU_ABS = size * estimate * regressor  # |mu|, as ahat Pi > 0


def equation_37(derivation: Derivation) -> Row:
    """Check the chain outside the layer."""
    bound = 2 * size * alpha * regressor
    lines = (DECAY - 2 * layer + bound, DECAY - 2 * _MU_ABS + bound, DECAY + CROSS)
    sign = sp.Abs(adb * beta * estimate * regressor)
    steps = [
        equal("|mu| = |bhat| ahat Pi", sign, sp.Abs(adb * beta) * estimate * regressor),
        equal("first equality", lines[0].subs(layer, _MU_ABS), lines[1]),
        equal("second equality", lines[1], lines[2]),
    ]
    note = "The sum of (30), (33), (35); needs ahat >= 0, which remark 4 supplies."
    return Row(37, decide(steps, note, lines[0], lines[2]))


def equation_38(derivation: Derivation) -> Row:
    """Check the chain inside the layer: complete the square."""
    bound, share = 2 * size * alpha * regressor, 2 * size * estimate * regressor
    inner = DECAY - 2 * layer**2 / EPS
    lines = (
        inner + bound,
        inner + share - share + bound,
        inner + 2 * layer + CROSS,
        DECAY - 2 * (layer**2 / EPS - layer) + CROSS,
        DECAY + 2 / (4 / EPS) + CROSS,
        DECAY + EPS / 2 + CROSS,
    )
    steps = [
        equal("a term added and taken away", lines[0], lines[1]),
        equal("|mu| put in", lines[1].subs(layer, _MU_ABS), lines[2].subs(layer, _MU_ABS)),
        equal("regrouped", lines[2], lines[3]),
        at_most("the square completed", lines[3], lines[4], 2 * (layer - EPS / 2) ** 2 / EPS),
        equal("2/(4/eps) = eps/2", lines[4], lines[5]),
    ]
    note = (
        "mu - mu^2/eps is eps/4 - (mu - eps/2)^2/eps, so its double is at most eps/2: the odd "
        "2 * 1/(4/eps) is right. The left-hand side lacks a transpose, harmless for one constraint."
    )
    return Row(38, decide(steps, note, lines[3], lines[5]))


def equation_39(derivation: Derivation) -> Row:
    """Check that (39) covers both cases."""
    union = DECAY + EPS / 2 + CROSS
    inside = equation_38(derivation).verdict
    steps = [
        at_most("covers (37)", DECAY + CROSS, union, EPS / 2),
        equal("is the end of (38)", union, inside.derived),
        true("(38) is proved", inside.status == "proved"),
    ]
    return Row(39, decide(steps, "The larger of (37) and (38).", union, union))


def equation_40(derivation: Derivation) -> Row:
    """Check the chain of the adaptation term, Cauchy-Schwarz last."""
    gap, ratio = estimate - alpha, K2 / K1
    lines = (
        2 / K1 * gap * (K1 * regressor * size - K2 * estimate),
        2 * gap * regressor * size - 2 / K1 * gap * K2 * estimate,
        2 * gap * regressor * size - 2 * ratio * gap * (gap + alpha),
        2 * gap * regressor * size - 2 * ratio * gap**2 - 2 * ratio * gap * alpha,
    )
    steps = [equal(f"line {k + 2}", lines[k], lines[k + 1]) for k in range(3)]
    rho = sp.Symbol("ratio", positive=True)
    for sign in (1, -1):  # gap = +-size
        certificate = 2 * rho * size * alpha * (1 + sign)
        left, right = -2 * rho * sign * size * alpha, 2 * rho * size * alpha
        steps.append(at_most(f"Cauchy-Schwarz, sign {sign:+d}", left, right, certificate))
    note = "Line 3 writes a third argument t of Pi that no other line has; nothing depends on it."
    return Row(40, decide(steps, note, lines[0], lines[3]))


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
