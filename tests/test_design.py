"""`pfaffian design`: theory's figures, synthesis, intervals, the curve, the files, bad input."""

from __future__ import annotations

import math
import struct
from itertools import pairwise

import numpy as np
import pytest
from pfaffian.derive.design.place.poles import gains_for_poles, numeric_gains
from pfaffian.derive.design.place.riccati import riccati_row
from pfaffian.derive.design.proposal import propose
from pfaffian.derive.design.worst_case import friction_limits, moved, read_box, worst_case
from pfaffian.derive.pipeline import lowered_model, parameter_set
from pfaffian.derive.sets.gains import polynomial_of, zero_polynomial
from pfaffian.derive.sets.raw_set import read_set
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.base.errors import InputError

SOURCE = find_model("pendubot")
#: The paper's gains on the rig's plant.
PAPER_ON_RIG = 'extends = "rig"\n[gains]\nlam = 2.25\nlam1 = "0.55 1/s"\nlam2 = "0.7 1/s"\n'
POLES = {
    "triple": (-6, -6, -6),
    "apart": (-2, -5, -11),
    "a pair": (-6, -4 + 2j, -4 - 2j),
    "slow": (-0.5, -0.5, -0.5),
    "fast": (-20, -20, -20),
}


@pytest.fixture(scope="module")
def model():
    return lowered_model(SOURCE)


def values_of(model, name):
    return parameter_set(model, SOURCE, SOURCE.set_path(name)).as_dict()


def complex_poles(document):
    return [complex(*pole) for pole in document["zero_dynamics_poles"]]


def abscissa(model, values):
    return max(r.real for r in np.roots(zero_polynomial(model, values)))


# Figures of the theory


def test_the_papers_gains_have_the_poles_and_the_singular_set_of_the_theory(run):
    """Sections 3.1 and 3.2."""
    found = run("design", "pendubot", "--set", "sim", "--json").document()
    assert found["gains"] == {"lam": 2.25, "lam1": 0.55, "lam2": 0.7}
    pair, conjugate, real = sorted(complex_poles(found), key=lambda p: (abs(p.imag) < 1, p.imag))
    assert round(real.real, 3) == -0.431
    assert (round(pair.real, 3), round(pair.imag, 2)) == (-0.423, -15.98)
    assert conjugate == pair.conjugate()
    assert round(found["singular_distance_rad"], 4) == 0.8218
    assert found["singular_coordinate"] == "q2"
    assert found["stable"] is True
    assert found["contraction"] == pytest.approx(9.8e3, rel=5e-3)  # section 5
    assert found["sampled_contraction"] == pytest.approx(9.8, rel=5e-3)


def test_poles_at_minus_six_give_the_closed_form_of_the_theory(run, model):
    """Section 3.3, written out here by hand."""
    found = run("design", "pendubot", "--set", "sim", "--poles", "-6,-6,-6", "--json").document()
    v = values_of(model, "sim")
    c2, c1, c0 = 18.0, 108.0, 216.0
    weight = v["g"] * v["theta5"]
    both = v["theta2"] + v["theta3"]
    wanted = {
        "lam": (weight + c1 * both) / (weight + c1 * v["theta2"]),
        "lam1": (c0 * both + c2 * weight) / (weight + c1 * both),
        "lam2": (c0 * v["theta2"] + c2 * weight) / (weight + c1 * v["theta2"]),
    }
    assert found["gains"] == pytest.approx(wanted, rel=1e-13)
    edge = math.acos((found["gains"]["lam"] - 1.0) * v["theta2"] / v["theta3"])
    assert found["singular_distance_rad"] == pytest.approx(edge, abs=1e-10)
    assert found["contraction"] == pytest.approx(2.7e4, rel=0.02)  # section 5


def test_poles_in_the_document_are_the_roots_of_the_polynomial(run, model):
    found = run("design", "pendubot", "--set", "rig", "--poles", "-7,-4+2j,-4-2j", "--json")
    values = values_of(model, "rig") | found.document()["gains"]
    roots = sorted(np.roots(zero_polynomial(model, values)), key=lambda r: (r.real, r.imag))
    assert complex_poles(found.document()) == roots
    assert roots == pytest.approx([-7, -4 - 2j, -4 + 2j], rel=1e-9)


def test_the_papers_gain_is_refused_on_the_rig_with_the_bound_it_breaks(run, params):
    file = params(PAPER_ON_RIG)
    found = run("design", "pendubot", "--params", file, "--json")
    assert found.code == 1
    document = found.document()
    assert document["stable"] is False
    assert max(p.real for p in complex_poles(document)) == pytest.approx(14.04, abs=0.01)
    assert document["violated"] == ["1 + theta3/theta2 > lam (off by 0.3981)"]
    assert "1 + theta3/theta2 > lam (off by 0.3981)" in document["error"]["message"]
    assert document["error"]["message"].startswith("mine.toml: ")
    plain = run("design", "pendubot", "--params", file)
    assert plain.code == 1
    assert "14.04" in plain.out
    assert "violated" in plain.err


# Synthesis


@pytest.mark.parametrize("name", ["sim", "rig"])
@pytest.mark.parametrize("poles", POLES.values(), ids=POLES)
def test_numeric_synthesis_finds_the_closed_form(model, name, poles):
    values = values_of(model, name)
    poles = tuple(map(complex, poles))
    closed = gains_for_poles(model, values, poles, "--poles")
    without = {n: v for n, v in values.items() if n not in closed}
    for start in (values, without):
        assert numeric_gains(model, start, poles, "--poles") == pytest.approx(closed, rel=1e-7)


@pytest.mark.parametrize("viscous", [0.001, 0.01, -0.001])
def test_with_friction_the_poles_are_those_of_the_plant_with_it(run, model, viscous):
    arguments = ("--poles", "-6,-5,-4", "--friction", f"joint2_viscous={viscous}", "--json")
    found = run("design", "pendubot", "--set", "sim", *arguments).document()
    values = values_of(model, "sim") | found["gains"] | {"joint2_viscous": viscous}
    have = np.array(zero_polynomial(model, values))
    wanted = polynomial_of((-6, -5, -4))
    assert have / have[0] == pytest.approx(wanted, rel=1e-8)
    assert sorted(p.real for p in complex_poles(found)) == pytest.approx([-6, -5, -4], rel=1e-6)


def test_poles_that_friction_puts_out_of_reach_are_refused(refused):
    refused(
        *("design", "pendubot", "--set", "rig", "--poles", "-0.1,-0.1,-0.1"),
        *("--friction", "joint2_viscous=1"),
        says=("--poles: no gains lam, lam1, lam2 within their bounds", "choose other poles"),
    )


def test_a_model_without_a_closed_form_is_synthesised_numerically(workspace, run):
    """Cubic in a gain, with no gains in the set to start from."""
    folder = workspace / "cubic"
    folder.mkdir()
    text = SOURCE.spec_file.read_text()
    changed = text.replace(
        "residual=Matrix([p.lam * (dq1", "residual=Matrix([(p.lam**5 + p.lam) * (dq1"
    )
    assert changed != text
    (folder / "spec.py").write_text(changed)
    plant = SOURCE.set_path("rig").read_text().replace("zero_dynamics_poles", "# ")
    (folder / "rig.toml").write_text(plant)
    found = run("design", folder, "--poles", "-5,-5,-5", "--json").document()
    same = run("design", "pendubot", "--set", "rig", "--json").document()["gains"]
    lam = found["gains"]["lam"]
    assert lam**5 + lam == pytest.approx(same["lam"], rel=1e-8)
    assert found["gains"]["lam2"] == pytest.approx(same["lam2"], rel=1e-8)
    assert lowered_model(find_model(str(folder))).has_program("gain_synthesis") is False


# Intervals

BOXES = {
    "the paper's, friction and mass": ("sim", "joint2_viscous=0:0.0005,m2=5%"),
    "rig, three lumped": ("rig", "theta2=5%,theta3=5%,theta5=10%"),
    "rig with friction": ("rig", "theta3=5%,joint2_viscous=0:0.002"),
    "designed, lengths": ("sim-designed", "l1=2%,lc2=5%,I2=30%,m2=2%"),
    "one alone": ("rig", "theta2=0.005:0.006"),
}


@pytest.mark.parametrize("box", BOXES.values(), ids=BOXES)
def test_no_random_plant_of_the_box_is_worse_than_the_worst_case(model, box):
    name, text = box
    values = values_of(model, name)
    intervals = read_box(model, values, text, "--box")
    worst = worst_case(model, values, intervals)
    rng = np.random.default_rng(11)
    for sample in rng.random((2000, len(intervals))):
        at = {
            i.name: i.lower + (i.upper - i.lower) * u
            for i, u in zip(intervals, sample, strict=True)
        }
        assert -abscissa(model, moved(model, values, at)) >= worst.margin - 1e-7
    assert -abscissa(model, moved(model, values, worst.at)) == pytest.approx(worst.margin)
    assert all(i.lower <= worst.at[i.name] <= i.upper for i in intervals)
    assert worst.margin <= worst.nominal_margin


def test_a_box_in_which_adb_changes_sign_has_no_margin(model):
    """lam = 1 + theta3/theta2 lies inside: a pole runs through infinity on the way."""
    values = values_of(model, "sim")
    worst = worst_case(model, values, read_box(model, values, "theta3=0.005:0.009", "--box"))
    assert worst.margin == -math.inf
    assert not worst.stable


def test_an_unstable_box_fails_the_check_and_says_where(run):
    arguments = ("--set", "sim", "--box", "joint2_viscous=0:0.002", "--json")
    found = run("design", "pendubot", *arguments)
    assert found.code == 1
    document = found.document()
    assert document["stable"] is True
    assert document["box"]["stable"] is False
    assert document["box"]["at"] == {"joint2_viscous": 0.002}
    assert "within the box" in document["error"]["message"]


@pytest.mark.parametrize("name", ["sim", "sim-designed", "rig"])
def test_the_friction_limit_is_where_a_pole_crosses(model, name):
    values = values_of(model, name)
    limit = friction_limits(model, values)["joint2_viscous"]
    assert abscissa(model, values | {"joint2_viscous": limit * (1 - 1e-9)}) < 0.0
    assert abscissa(model, values | {"joint2_viscous": limit * (1 + 1e-9)}) > 0.0
    for part in np.linspace(0.0, 0.999, 50):
        assert abscissa(model, values | {"joint2_viscous": limit * part}) < 0.0


def test_the_papers_gains_lose_stability_before_a_coefficient_changes_sign(model):
    """Routh by hand from the polynomial of theory 3.2.

    Its 0.0016 N m s/rad is where the coefficient of p^2 vanishes; Routh's a2 a1 = a3 a0 comes
    earlier, at a third less.
    """
    v = values_of(model, "sim")
    lam, lam1, lam2 = v["lam"], v["lam1"], v["lam2"]
    t2, both, weight = v["theta2"], v["theta2"] + v["theta3"], v["g"] * v["theta5"]
    a3, a0 = lam * t2 - both, weight * (lam2 - lam * lam1)
    still2, still1 = lam * lam1 * t2 - lam2 * both, weight * (1 - lam)
    # (still2 + lam d)(still1 + lam lam1 d) = a3 a0
    roots = np.roots(
        [lam * lam * lam1, still1 * lam + still2 * lam * lam1, still2 * still1 - a3 * a0]
    )
    limit = min(r.real for r in roots if r.real > 0.0)
    assert friction_limits(model, v)["joint2_viscous"] == pytest.approx(limit, rel=1e-9)
    assert round(limit, 6) == 0.001050
    assert round(-still2 / lam, 4) == 0.0016


# Trade-off


def test_faster_poles_come_closer_to_the_singular_set(run):
    found = run("design", "pendubot", "--set", "sim", "--curve", "--json").document()["curve"]
    poles = [p for p in found if p["family"] == "poles"]
    rows = [p for p in found if p["family"] == "riccati"]
    assert len(poles) == len(rows) == 25
    for before, after in pairwise(poles):
        assert after["decay_rate"] > before["decay_rate"]
        assert after["singular_distance_rad"] < before["singular_distance_rad"]
    assert poles[0]["singular_distance_rad"] < math.pi / 2  # theory 3.2: inside 90 degrees
    for before, after in pairwise(rows):  # heavier weights of the rates: slower, farther
        assert after["decay_rate"] < before["decay_rate"]
        assert after["singular_distance_rad"] > before["singular_distance_rad"]


def test_fast_poles_push_the_singular_set_to_the_setpoint(run):
    found = run("design", "pendubot", "--set", "sim", "--poles", "-400,-400,-400", "--json")
    assert found.document()["singular_distance_rad"] < 0.03


def test_the_plot_is_the_same_svg_each_time(run, workspace):
    for name in ("one.svg", "two.svg"):
        done = run(
            "design", "pendubot", "--set", "sim", "--compare", "sim-designed,rig", "--plot", name
        )
        assert done.code == 0, done.err
    one, two = ((workspace / n).read_bytes() for n in ("one.svg", "two.svg"))
    assert one == two
    assert one.startswith(b"<?xml")
    assert b"<dc:date>" not in one


def test_sets_are_compared_side_by_side(run):
    found = run("design", "pendubot", "--set", "sim", "--compare", "sim-designed,rig", "--json")
    rows = found.document()["compare"]
    assert [row["set"] for row in rows] == ["sim", "sim-designed", "rig"]
    alone = run("design", "pendubot", "--set", "rig", "--json").document()
    assert rows[2]["zero_dynamics_poles"] == alone["zero_dynamics_poles"]
    table = run("design", "pendubot", "--set", "sim", "--compare", "sim-designed,rig").out
    assert "compared" in table


# Files


@pytest.mark.parametrize(
    "choice",
    [
        ("--poles", "-6,-4+2j,-4-2j"),
        ("--riccati", "10,10,.1,.1"),
        ("--poles", "-3,-4,-7", "--delay", "5 ms"),
        ("--delay", "12 ms"),
    ],
    ids=["poles", "riccati", "poles and delay", "delay alone"],
)
@pytest.mark.parametrize("base", ["sim", "sim-designed", "mine.toml"])
def test_the_set_written_reads_back_to_the_bit_and_generates(run, model, params, base, choice):
    mine = params('extends = "rig"\ntitle = "mine"\n[gains]\nsigma = "3 1/s"\n')
    start = ("--params", mine) if base == "mine.toml" else ("--set", base)
    arguments = ("design", "pendubot", *start, *choice, "-o", "made.toml", "--json")
    document = run(*arguments).document()
    assert document["written"] == "made.toml"
    path = mine.with_name("made.toml")
    read = parameter_set(model, SOURCE, path).as_dict()
    proposed = document["proposal"]["gains"] if document["proposal"] else {}
    for name, value in {**document["gains"], **proposed}.items():
        assert struct.pack(">d", read[name]) == struct.pack(">d", value), name
    base_path = mine if base == "mine.toml" else SOURCE.set_path(base)
    before = parameter_set(model, SOURCE, base_path).as_dict()
    changed = {n for n in read if read[n] != before[n]}
    assert changed <= {*document["gains"], "kappa", "epsilon"}
    done = run("generate", "pendubot", "--params", path, "-o", "code")
    assert done.code == 0, done.err
    again = run("design", "pendubot", "--params", path, "--json").document()
    assert again["gains"] == document["gains"]


def test_a_set_without_gains_can_be_designed(run, model, params):
    """A plant, and everything but what the design is to choose."""
    text = SOURCE.set_path("rig").read_text().replace("zero_dynamics_poles", "# ")
    found = run("design", "pendubot", "--params", params(text), "--riccati", "1,1,1,1", "--json")
    wanted = riccati_row(model, values_of(model, "rig"), (1.0,) * 4, 1.0, "").gains
    assert found.document()["gains"] == wanted
    found = run("design", "pendubot", "--params", params(text), "--poles", "-5,-5,-5", "--json")
    raw = parameter_set(model, SOURCE, SOURCE.set_path("rig")).as_dict()
    assert found.document()["gains"] == {n: raw[n] for n in ("lam", "lam1", "lam2")}


def test_an_existing_file_is_replaced_only_by_force(run, workspace, refused):
    (workspace / "made.toml").write_text("a diary")
    arguments = ("design", "pendubot", "--set", "sim", "--poles", "-6,-6,-6", "-o", "made.toml")
    refused(*arguments, says=("-o made.toml: exists already", "--force"))
    assert run(*arguments, "--force").code == 0
    assert 'extends = "sim"' in (workspace / "made.toml").read_text()


def test_an_unstable_design_is_not_written(run, params, workspace):
    file = params(PAPER_ON_RIG)
    arguments = ("design", "pendubot", "--params", file, "--delay", "5 ms", "-o", "made.toml")
    done = run(*arguments)
    assert done.code == 1
    assert "no set was written" in done.err
    assert not (workspace / "made.toml").exists()


def test_a_set_that_generate_would_refuse_is_not_written(params, refused):
    file = params('extends = "rig"\n[target]\nsingular_threshold = "66 1/(kg*m^2)"\n')
    refused(
        *("design", "pendubot", "--params", file, "--poles", "-9,-9,-9", "-o", "made.toml"),
        says=("made.toml: the setpoint lies in the singular set", "lower the threshold"),
    )


# Proposal


@pytest.mark.parametrize(("delay", "rate"), [(0.0, 50.0), (0.005, 50.0), (0.015, 10.0)])
def test_kappa_and_epsilon_follow_from_the_delay(model, delay, rate):
    values = values_of(model, "sim")
    made = propose(model, values, delay, "--delay")
    adb = -69.95
    assert made.rate == rate
    assert made.gains["kappa"] * adb**2 == pytest.approx(rate, rel=1e-3)
    effort = values["bound_initial"] * 2.0  # Pi at the setpoint at rest
    assert (effort * adb) ** 2 / made.gains["epsilon"] == pytest.approx(rate, rel=1e-3)


def test_a_delay_that_nothing_held_is_refused(model):
    with pytest.raises(InputError, match="more than any rate"):
        propose(model, values_of(model, "sim"), 0.03, "--delay")


# Bad input

REFUSED = {
    "two poles": (("--poles", "-6,-6"), "2 poles for zero dynamics of order 3", "give 3 poles"),
    "an unstable pole": (("--poles", "-6,-6,1"), "--poles: 1", "negative real parts"),
    "half a pair": (("--poles", "-6,-4+2j,-5-2j"), "conjugate pairs", "add the conjugate"),
    "words for poles": (("--poles", "fast,-6,-6"), "'fast' is not a finite pole", "[-6, "),
    "an empty pole": (("--poles", "-6,,-6"), "'' is not a finite pole", "[-6, "),
    "poles beyond floats": (("--poles", "-1e200,-1,-1"), "-1e+200+0j is no pole", "1e-06 to"),
    "poles of nothing": (("--poles", "-1,-1,-1e-200"), "-1e-200+0j is no pole", "1e-06 to"),
    "weights beyond floats": (("--riccati", "1e300,1,1,1"), "no stabilising solution", "closer"),
    "two ways": (("--poles", "-6,-6,-6", "--riccati", "1,1,1,1"), "both given", "one of them"),
    "three weights": (("--riccati", "1,1,1"), "3 weights for 4 states", "4 positive weights"),
    "a weight of zero": (("--riccati", "1,1,0,1"), "0 is not a positive weight", "positive"),
    "a weight in words": (("--riccati", "a,b,c,d"), "'a,b,c,d' is no list", "4 positive"),
    "an endless weight": (("--riccati", "1,inf,1,1"), "inf is not a positive weight", "positive"),
    "a box without value": (("--box", "theta3"), "'theta3' is no NAME=VALUE", "known: m1"),
    "an unknown interval": (("--box", "theta9=5%"), "unknown parameter theta9", "mean theta"),
    "an interval reversed": (("--box", "theta3=2:1"), "2 is not below 1", "LOWER:UPPER"),
    "a word for a percentage": (("--box", "theta3=x%"), "is no percentage", "5%"),
    "a percentage of nothing": (("--box", "joint2_viscous=5%"), "of 0 is no interval", "LOWER"),
    "both forms": (("--box", "theta3=5%,m2=5%"), "theta3 follows from the physical", "one form"),
    "twice": (("--box", "m2=5%,m2=6%"), "m2 is given twice", "once"),
    "beyond its bounds": (("--box", "m2=-1:1"), "m2 = -1 kg is out of bounds", "greater than 0"),
    "another unit": (("--box", "m2=1 m:2 m"), "m has dimension [length]", "converts to kg"),
    "unknown friction": (("--friction", "theta3=1"), "unknown parameter theta3", "known: joint1"),
    "endless friction": (("--friction", "joint2_viscous=nan"), "nan is not finite", "finite"),
    "a delay without unit": (("--delay", "5"), "dimensionless has dimension", "converts to s"),
    "a negative delay": (("--delay", "-5 ms"), "-0.005 s is negative", "0 s or more"),
    "a long delay": (("--delay", "1 s"), "more than any rate", "shorten the delay"),
    "nothing to write": (("-o", "made.toml"), "no gains are chosen", "give --poles"),
    "a set of another suffix": (("--poles", "-6,-6,-6", "-o", "made.txt"), "no .toml file", "*.t"),
    "a plot of another suffix": (("--plot", "made.png"), "is no .svg file", "name it *.svg"),
    "a folder that is not": (("--plot", "no/made.svg"), "there is no folder no", "make it first"),
    "a set to compare": (("--compare", "sym"), "has no parameter set sym", "did you mean sim?"),
    "an unknown set": (("--set", "sym"), "has no parameter set sym", "did you mean sim?"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_request_that_cannot_be_met_is_refused(what, refused):
    arguments, *says = REFUSED[what]
    start = () if "--set" in arguments else ("--set", "sim")
    refused("design", "pendubot", *start, *arguments, says=tuple(says))


def test_a_folder_that_cannot_be_written_is_named(workspace, refused, monkeypatch):
    def full(path, content):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("pfaffian.runtime.base.files._written_beside", full)
    refused(
        *("design", "pendubot", "--set", "sim", "--poles", "-6,-6,-6", "-o", "made.toml"),
        says=("-o made.toml: cannot be written (No space left", "another place"),
    )


def test_a_set_reads_without_its_stability_judged_only_where_asked(model, params):
    from pfaffian.derive.sets.parameter_set import resolve_set

    raw = read_set(params(PAPER_ON_RIG), model.parameters, SOURCE.sets())
    assert resolve_set(model, raw, judge=False).as_dict()["lam"] == 2.25
    with pytest.raises(InputError, match="unstable"):
        resolve_set(model, raw)
