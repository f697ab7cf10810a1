"""The audit of the Pendubot's source: its rows, its refutations, and whether its checks bite."""

import math
import subprocess
import sys
from pathlib import Path

import mpmath
import pytest
import sympy as sp
from conftest import REPOSITORY
from pfaffian.derive.audit import check, pendubot_bounds, pendubot_control, pendubot_numbers
from pfaffian.derive.audit import pendubot_source as src
from pfaffian.derive.audit.document import audit_data, audit_latex
from pfaffian.derive.audit.library import audit
from pfaffian.derive.audit.row import DIFFERS, NOT_CHECKABLE, PROVED, STATUSES, Counterexample
from pfaffian.derive.derivation import derive
from pfaffian.derive.models.pendubot.spec import model

P = src.P
#: Equations that the theory or this audit found wrong; every other one has to be proved.
WRONG = {2, 9, 10, 13, 14, 42, 44, 47, 48}
CLAIMS = {2, 9}
#: Findings that do not refute the source, with their status.
MILD = dict.fromkeys(("theorem-1-ii", "initial-rates"), NOT_CHECKABLE)
MILD |= dict.fromkeys(("sim-gains", "constant-load", "units-of-the-law"), PROVED)
#: What the theory says must be found.
OF_THE_THEORY = (
    "adb-changes-sign",
    "remark-1-brackets",
    "remark-1-setpoint",
    "stable-gains",
    "rig-gains",
    "friction-threshold",
    "friction-slope",
    "mismatch-returns",
    "theorem-1-i",
    "theorem-1-ii",
    "unit-g",
    "unit-theta4",
    "unit-theta5",
)


@pytest.fixture(scope="module")
def derivation():
    return derive(model())


@pytest.fixture(scope="module")
def result(derivation):
    return audit(derivation)


@pytest.fixture(scope="module")
def named(result):
    return {f.name: f for f in result.findings}


def verdicts(result):
    return [(f"({r.number})", r.verdict) for r in result.rows] + [
        (f.name, f.verdict) for f in result.findings
    ]


def test_every_equation_has_one_row_with_a_reason(result):
    assert [r.number for r in result.rows] == list(range(1, 49))
    for name, verdict in verdicts(result):
        assert verdict.status in STATUSES, name
        assert len(verdict.note) > 10, name
        assert (verdict.counterexample is not None) == (verdict.status == DIFFERS), name
        assert bool(verdict.checks) == (verdict.status != NOT_CHECKABLE), name


def test_the_equations_that_differ_are_the_known_ones(result):
    assert {r.number for r in result.rows if r.verdict.status == DIFFERS} == WRONG
    assert {r.number for r in result.rows if r.verdict.status == PROVED} == (
        set(range(1, 49)) - WRONG
    )
    assert {r.number for r in result.rows if r.about == "claim"} == CLAIMS


def test_the_findings_of_the_theory_are_there(named):
    for name in OF_THE_THEORY:
        assert named[name].verdict.status == MILD.get(name, DIFFERS), name
    for name, finding in named.items():
        assert finding.verdict.status == MILD.get(name, DIFFERS), name
        assert finding.claim


def test_every_counterexample_evaluates_to_two_numbers_that_differ(result):
    """With mpmath through lambdify: another evaluator than the one that found the point."""
    seen = 0
    for name, verdict in verdicts(result):
        found = verdict.counterexample
        if found is None:
            continue
        symbols = [s for s, _ in found.point]
        values = [mpmath.mpf(sp.N(v, 40)) for _, v in found.point]
        printed, derived = (
            sp.lambdify(symbols, e, "mpmath")(*values) for e in (found.printed, found.derived)
        )
        assert abs(mpmath.mpf(printed) - mpmath.mpf(derived)) > 1e-6, name
        seen += 1
    assert seen >= len(WRONG) + 15


def test_counterexamples_keep_the_mass_matrix_positive_definite(result):
    for name, verdict in verdicts(result):
        at = dict(verdict.counterexample.point) if verdict.counterexample else {}
        if {P.theta1, P.theta2, P.theta3} <= set(at):
            assert at[P.theta1] * at[P.theta2] > at[P.theta3] ** 2, name


# Do the checks bite? ---------------------------------------------------------------------------


def test_the_true_form_in_place_of_equation_10_is_proved(derivation):
    row = pendubot_control.equation_10(derivation, printed=derivation.input_gain)
    assert row.verdict.status == PROVED
    theta = P.theta1 * P.theta2 - (P.theta3 * sp.cos(src.q2)) ** 2
    other = (P.theta2 * (P.lam - 1) - P.theta3 * sp.cos(src.q2)) / theta
    assert pendubot_control.equation_10(derivation, printed=other).verdict.status == PROVED


def test_a_wrong_equation_17_differs(derivation):
    right = pendubot_control.printed_nominal(derivation)
    ad, gain = src.nominal_gain(derivation)
    for wrong in (right + 2 * (ad * src.bias(derivation))[0] / gain, -right, right * gain):
        verdict = pendubot_control.equation_17(derivation, printed=wrong).verdict
        assert verdict.status == DIFFERS
        assert verdict.counterexample is not None
        assert verdict.counterexample.disagrees()


@pytest.mark.parametrize(
    ("name", "broken", "numbers"),
    [
        ("RESIDUAL", src.RESIDUAL + src.q2, {3, 5}),
        ("SECOND_ORDER", src.SECOND_ORDER - 2 * P.lam2 * src.dq2, {5, 21}),
        ("INTEGRAL", src.INTEGRAL - P.sigma * P.lam2 * src.J2, {6}),
        ("RIGHT", -src.RIGHT, {7, 8, 17, 27}),
        ("FIRST_INTEGRAL", src.FIRST_INTEGRAL + src.J1, {7, 8, 21, 26}),
        ("CORIOLIS", src.CORIOLIS.T, {1}),
        ("GRAVITY", src.GRAVITY * 2, {1}),
        ("MASS", src.MASS + sp.eye(2) * P.theta3, {1}),
    ],
)
def test_a_misprint_in_the_source_is_found(derivation, monkeypatch, name, broken, numbers):
    from pfaffian.derive.audit import pendubot_constraint, pendubot_stability

    monkeypatch.setattr(src, name, broken)
    modules = (pendubot_constraint, pendubot_control, pendubot_stability)
    checks = {int(e.__name__.split("_")[1]): e for m in modules for e in m.EQUATIONS}
    for number in numbers:
        assert checks[number](derivation).verdict.status == DIFFERS, number


def test_an_inequality_needs_a_certificate_that_fits_and_is_not_negative():
    x, y = src.nonnegative("x y")
    (z,) = src.real("z")
    assert check.at_most("fits", x, x + y, y).holds
    assert not check.at_most("does not fit", x, x + y, 2 * y).holds
    assert not check.at_most("unknown sign", x, x + z, z).holds
    verdict = check.decide([check.at_most("false", x + 1, x, -sp.S.One)], "", x + 1, x)
    assert verdict.status == DIFFERS
    assert verdict.counterexample is not None


def test_a_refutation_that_does_not_stand_is_an_error():
    same = Counterexample(((P.lam, sp.S.One),), P.lam, P.lam)
    with pytest.raises(ValueError, match="does not stand"):
        check.refute([], "", P.lam, P.lam, same)
    other = Counterexample(((P.lam, sp.S.One),), P.lam, 2 * P.lam)
    with pytest.raises(ValueError, match="does not stand"):
        check.refute([check.true("false", False)], "", P.lam, P.lam, other)


# Against independent figures -------------------------------------------------------------------


def test_gains_lose_stability_where_the_roots_say_so(derivation, named):
    numpy = pytest.importorskip("numpy")
    threshold = float(named["friction-threshold"].verdict.derived)
    t2, t3, weight, lam, lam1, lam2 = 0.004772, 0.00876, 0.0584 * 9.8, 2.25, 0.55, 0.7

    def slowest(d2):
        a2 = lam * d2 + lam * lam1 * t2 - lam2 * (t2 + t3)
        a1 = lam * lam1 * d2 + weight * (1 - lam)
        roots = numpy.roots([lam * t2 - t2 - t3, a2, a1, weight * (lam2 - lam * lam1)])
        return max(roots.real)

    assert slowest(0.99 * threshold) < 0.0 < slowest(1.01 * threshold)
    assert threshold == pytest.approx(0.00105, abs=1e-5)


def test_friction_slope_by_a_difference_quotient():
    h = 1e-6
    value = 4.18 * (math.tanh(1.59 * h) - math.tanh(3.15 * h)) + 0.09 * math.tanh(3.52 * h)
    slope = sp.diff(src.friction(src.dq1), src.dq1).subs(src.dq1, 0)
    assert float(slope) == pytest.approx((value + 0.021 * h) / h, rel=1e-6)
    assert float(slope) == pytest.approx(-6.183)
    assert pendubot_numbers.GAINS[P.lam] == sp.Rational(9, 4)


def test_time_bound_and_radius_by_integration():
    """V' = -L1 d^2 + L2 d + L3 with V = d^2: the time of (46) is never too short."""
    l1, l2, l3 = 2.0, 1.0, 0.5
    at = {pendubot_bounds.L1: l1, pendubot_bounds.L2: l2, pendubot_bounds.L3: l3}
    radius = float(pendubot_bounds.RADIUS.subs(at))
    assert -l1 * radius**2 + l2 * radius + l3 == pytest.approx(0.0)
    start, wanted = 3.0, 1.2 * radius
    bound = (start**2 - wanted**2) / (l1 * wanted**2 - l2 * wanted - l3)
    value, elapsed, step = start**2, 0.0, 1e-4
    while value > wanted**2:
        value += step * (-l1 * value + l2 * math.sqrt(value) + l3)
        elapsed += step
    assert 0.0 < elapsed < bound


# The command -----------------------------------------------------------------------------------


def test_json_is_the_contract(run):
    outcome = run("audit", "pendubot", "--json")
    document = outcome.document()
    assert outcome.code == 0
    assert {"model", "equations", "findings", "summary"} <= set(document)
    assert len(document["equations"]) == 48
    keys = {"number", "status", "note", "printed", "derived", "counterexample"}
    for row in document["equations"]:
        assert keys <= set(row)
        assert row["printed"]
        if row["status"] == DIFFERS:
            found = row["counterexample"]
            assert found["printed_value"] != pytest.approx(found["derived_value"])
            assert found["point"]
    counts = document["summary"]["equations"]
    assert counts == {PROVED: 48 - len(WRONG), DIFFERS: len(WRONG), NOT_CHECKABLE: 0}


def test_text_and_latex_come_out_whole(run, result):
    text = run("audit", "pendubot").out
    assert all(f"({n})" in text for n in range(1, 49))
    latex = run("audit", "pendubot", "--format", "latex").out
    assert latex == audit_latex(result)
    assert latex.count("\\begin{") == latex.count("\\end{")
    assert latex.count("\\[") == latex.count("\\]")
    body = latex.replace("\\{", "").replace("\\}", "")
    assert body.count("{") == body.count("}")
    assert body.count("\\left") == body.count("\\right")


def test_output_is_the_same_twice(derivation, result):
    assert audit_data(audit(derivation)) == audit_data(result)


def test_bad_input_is_refused(refused):
    refused("audit", "nothing", says=("unknown model nothing",))
    refused("audit", "pendubot", "--format", "html", says=("--format html", "text or latex"))


def test_a_model_without_an_audit_is_refused_by_name(refused, workspace):
    folder = workspace / "mybot"
    folder.mkdir()
    (folder / "spec.py").write_text("")
    refused("audit", "mybot", says=("mybot has no audit", "pendubot"))
    # Nor does a folder of the user's own have the library's source because of its name.
    folder.rename(workspace / "pendubot")
    refused("audit", "./pendubot", says=("./pendubot has no audit", "pendubot"))


def test_the_page_of_the_docs_holds_the_output_of_the_command():
    page = (REPOSITORY / "docs" / "audit.md").read_text(encoding="utf-8")
    script = Path(sys.executable).with_name("pfaffian")
    made = subprocess.run(
        [str(script), "audit", "pendubot"], capture_output=True, text=True, check=True, timeout=120
    )
    assert made.stdout.rstrip() in page, "renew docs/audit.md: see its first paragraph"
