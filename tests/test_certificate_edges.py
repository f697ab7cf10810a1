"""The certificate gives away nothing and claims nothing: enclosures, extrema, and what is used."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest
from pfaffian.derive.certificate import certify as stage
from pfaffian.derive.certificate.theorem import Theorem
from pfaffian.derive.ir.extrema import Objective, greatest, least
from pfaffian.derive.ir.intervals import enclose
from pfaffian.derive.ir.program import Instruction, Op, Program, Signal
from pfaffian.derive.pipeline import derivation_of
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.code.generated_model import host_model, open_generated
from pfaffian.runtime.flight.continuous import fly_continuous
from test_certificate import scenario_of

EXACT = {
    Op.ADD: lambda a, b: a + b,
    Op.SUB: lambda a, b: a - b,
    Op.MUL: lambda a, b: a * b,
    Op.DIV: lambda a, b: a / b,
    Op.SQRT: mpmath.sqrt,
    Op.SIN: mpmath.sin,
    Op.COS: mpmath.cos,
    Op.ATAN: mpmath.atan,
    Op.EXP: mpmath.exp,
    Op.EXPM1: mpmath.expm1,
    Op.TANH: mpmath.tanh,
}


def program_of(*instructions, names="xy"):
    """Return a program of inputs x, y and `instructions`; the last one leaves as `f`."""
    signals = tuple(Signal(n, "", "", "input") for n in names)
    head = tuple(Instruction(Op.INPUT, name=n) for n in names)
    tape = (*head, *instructions)
    return Program("p", "", signals, tape, (Signal("f", "", "", "output"),), (len(tape) - 1,))


@pytest.mark.parametrize("op", EXACT)
def test_enclosures_of_points_hold_the_exact_value_strictly(op):
    """The value of an operation is next to never a double: an enclosure without width is wrong."""
    count = 400
    rng = np.random.default_rng(3)
    x, y = 0.1 + rng.random(count), 0.1 + rng.random(count)
    one = op not in (Op.ADD, Op.SUB, Op.MUL, Op.DIV)
    found = enclose(
        program_of(Instruction(op, (0,) if one else (0, 1))), {"x": (x, x), "y": (y, y)}
    )
    low, high = found["f"]
    with mpmath.workdps(60):
        for k in range(count):
            arguments = [mpmath.mpf(x[k])] if one else [mpmath.mpf(x[k]), mpmath.mpf(y[k])]
            value = EXACT[op](*arguments)
            assert mpmath.mpf(low[k]) <= value <= mpmath.mpf(high[k])
    assert (low < high).all()
    assert (high - low <= 2.1e-12 * np.maximum(1.0, np.abs(high))).all()


def test_a_sum_of_many_terms_keeps_the_exact_value_inside():
    """Sixty additions of 0.1: nearest rounding alone ends 1.4e-15 away from the exact sum."""
    tape = [Instruction(Op.ADD, (0, 1))]
    tape += [Instruction(Op.ADD, (k + 2, 1)) for k in range(59)]
    low, high = enclose(program_of(*tape), {"x": (0.0, 0.0), "y": (0.1, 0.1)})["f"]
    exact = 60 * mpmath.mpf(0.1)
    assert low <= exact <= high
    assert low < 60 * 0.1 < high


def test_a_turn_inside_the_interval_gives_the_extremum_of_the_cosine():
    low, high = enclose(
        program_of(Instruction(Op.COS, (0,))),
        {"x": (np.array([3.0, 6.0, 0.5]), np.array([3.5, 6.5, 1.0])), "y": (0.0, 0.0)},
    )["f"]
    assert low[0] <= -1.0
    assert high[1] >= 1.0
    assert (
        np.cos(1.0) - 1e-11 < low[2] <= np.cos(1.0) < np.cos(0.5) <= high[2] < np.cos(0.5) + 1e-11
    )


def test_a_quotient_by_an_interval_with_zero_has_no_bound_and_a_square_none_below_zero():
    box = {"x": (-1.0, 2.0), "y": (-1.0, 1.0)}
    low, high = enclose(program_of(Instruction(Op.DIV, (0, 1))), box)["f"]
    assert (low, high) == (-np.inf, np.inf)
    low, high = enclose(program_of(Instruction(Op.MUL, (0, 0))), box)["f"]
    assert -1e-300 < low <= 0.0
    assert 4.0 <= high < 4.0 + 1e-14


def test_extrema_are_those_of_calculus_to_half_a_per_cent_and_never_inside():
    """|x - x^2 y| over a box: greatest at (-1, 1), least 0 along x y = 1."""
    tape = [Instruction(Op.MUL, (0, 0)), Instruction(Op.MUL, (2, 1)), Instruction(Op.SUB, (0, 3))]
    objective = Objective(program_of(*tape), "f", "", {}, {})
    most = greatest(objective, {"x": (-1.0, 0.9), "y": (0.0, 1.0)})
    assert most.attained == pytest.approx(2.0, rel=6e-3)
    assert 2.0 <= most.bound <= 2.0 * (1.0 + 5.1e-3)
    fewest = least(objective, {"x": (0.5, 0.9), "y": (0.0, 1.0)})
    assert fewest.attained == pytest.approx(0.9 - 0.81, rel=6e-3)
    assert 0.09 * (1.0 - 6e-3) <= fewest.bound <= 0.09


@pytest.fixture(scope="module")
def certified():
    """The certificate of a flight under a constant load of 2 N m, with a region given."""
    scenario = scenario_of("5.1", "sim-designed")
    flight = fly_continuous(scenario, host_model(open_generated("pendubot")))
    sides = {"q1": (0.8, 2.2), "q2": (-0.6, 0.6), "dq1": (-9.0, 9.0), "dq2": (-9.0, 9.0)}
    derivation = derivation_of(find_model("pendubot"))
    return scenario, stage.certify(derivation, flight, sides)


def test_what_a_certificate_claims_is_no_less_than_what_the_region_holds(certified):
    """alpha = 2/2 at rest at the setpoint; ADB by hand, where |Fhat| = 2 N m everywhere."""
    scenario, certificate = certified
    values = scenario.controller
    cosine = np.cos(np.linspace(-0.6, 0.6, 20_001))
    t1, t2, t3 = (values[f"theta{k}"] for k in (1, 2, 3))
    gain = ((values["lam"] - 1.0) * t2 - t3 * cosine) / (t1 * t2 - (t3 * cosine) ** 2)
    least_gain = np.abs(gain).min()
    assert 1.0 <= certificate.theorem.alpha <= 1.0 + 5.1e-3
    assert 0.98 * least_gain**2 <= certificate.theorem.lmin <= least_gain**2
    ultimate = 2.0 / (values["kappa"] * least_gain)
    assert ultimate <= certificate.pursuit.ultimate <= ultimate * (1.0 + 5.1e-3)
    assert 2.0 <= certificate.pursuit.fbar <= 2.0 * (1.0 + 5.1e-3)
    assert certificate.pursuit.lmin == certificate.theorem.lmin


def test_the_constants_of_the_theorem_are_those_of_the_flown_gains(certified):
    scenario, certificate = certified
    theorem, k = certificate.theorem, scenario.controller
    assert (theorem.kappa, theorem.epsilon) == (k["kappa"], k["epsilon"])
    assert (theorem.k1, theorem.k2) == (k["k1"], k["k2"])
    printed, scaled = theorem.printed(), theorem.scaled()
    leak = 2.0 * k["k2"] / k["k1"]
    assert pytest.approx(min(2.0 * k["kappa"] * theorem.lmin, leak)) == printed.K1
    assert pytest.approx(leak * theorem.alpha) == printed.K2
    assert printed.K3 == scaled.K3 == pytest.approx(0.5 * k["epsilon"])
    assert (printed.gm, printed.gM) == (min(1.0, 1.0 / k["k1"]), max(1.0, 1.0 / k["k1"]))
    assert pytest.approx(min(2.0 * k["kappa"] * theorem.lmin, 2.0 * k["k2"])) == scaled.K1
    assert pytest.approx(2.0 * k["k2"] * theorem.alpha / np.sqrt(k["k1"])) == scaled.K2
    assert (scaled.gm, scaled.gM) == (1.0, 1.0)


def test_every_claim_stands_beside_what_the_flight_showed(certified):
    _, certificate = certified
    assert {c.form for c in certificate.claims} == {"p2", "printed", "scaled"}
    for claim in certificate.claims:
        assert claim.start <= claim.largest <= claim.bound
        assert claim.late is None or claim.late <= claim.ultimate
    assert certificate.least_slack >= 0.0


def test_the_mean_value_form_holds_every_value():
    """x^2 + 3 y over a box, with its slopes given: both sides of the box count."""
    tape = [
        Instruction(Op.MUL, (0, 0)),
        Instruction(Op.CONST, value=3.0),
        Instruction(Op.MUL, (3, 1)),
        Instruction(Op.ADD, (2, 4)),
        Instruction(Op.ADD, (0, 0)),
    ]
    head = program_of(*tape)
    names = ("f", "f_by_x", "f_by_y")
    outputs = tuple(Signal(n, "", "", "output") for n in names)
    whole = Program("p", "", head.inputs, head.instructions, outputs, (5, 6, 3))
    objective = Objective(whole, "f", "", {}, {"x": "f_by_x", "y": "f_by_y"})
    low, high = objective.enclose(["x", "y"], np.array([[1.0, 2.0]]), np.array([[1.5, 2.25]]))
    assert low[0] <= 7.0
    assert 9.0 <= high[0] < 9.0 + 1e-12


def test_what_is_settled_stays_in_the_bound():
    """x - x^2 is greatest, 1/4, where no corner and no middle of a box of [0, 0.9] lies."""
    tape = [Instruction(Op.MUL, (0, 0)), Instruction(Op.SUB, (0, 2))]
    objective = Objective(program_of(*tape), "f", "", {}, {})
    found = greatest(objective, {"x": (0.0, 0.9), "y": (0.0, 0.0)})
    assert found.attained < 0.25 <= found.bound <= 0.25 * (1.0 + 6e-3)


def test_a_claim_that_a_flight_breaks_is_said():
    kept = stage.Claim("p2", 0.5, 2.0, 1.0, 3.0, largest=2.0, late=1.0)
    assert kept.broken() == ""
    assert "bound 2" in replace(kept, largest=2.01).broken()
    assert "ultimate bound 1" in replace(kept, late=1.01).broken()
    assert replace(kept, late=None).broken() == ""


def test_the_rate_bound_is_the_first_line_of_41_in_numbers():
    """-2 kappa lmin beta^2 + eps/2 - 2 (k2/k1) x^2 + 2 (k2/k1) alpha |x| at numbers by hand."""
    theorem = Theorem(kappa=0.5, epsilon=0.25, k1=2.0, k2=3.0, lmin=4.0, alpha=5.0)
    beta, x = np.array([0.0, 1.0, -2.0]), np.array([0.0, -2.0, 1.0])
    wanted = [0.125, -4.0 + 0.125 - 12.0 + 30.0, -16.0 + 0.125 - 3.0 + 15.0]
    assert theorem.rate_bound(beta, x).tolist() == wanted
    rate = theorem.lyapunov_rate(
        beta, np.array([1.0, 3.0, 1.0]), x + 5.0, np.array([7.0, 1.0, 2.0])
    )
    assert rate.tolist() == [0.0, 6.0 - 2.0, -4.0 + 2.0]
