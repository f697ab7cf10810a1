"""What stands in print beside the mathematics: units, parameters, references, announcements."""

from __future__ import annotations

from collections.abc import Mapping

import sympy as sp
from pfaffian.derive.symbolic.units import dimension_of
from pfaffian.paper.audit.check import equal, refute, true, unchecked, vanishes
from pfaffian.paper.audit.notation import INTEGRAL
from pfaffian.paper.audit.row import Counterexample, Finding
from pfaffian.paper.equations import pendubot_source as src
from pfaffian.paper.equations.pendubot_source import Case, P
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import unit_registry

#: What the law's own quantities are measured in, for the units of its formulas.
_UNITS = {
    **dict.fromkeys(("q1", "q2", "q10", "q20"), "rad"),
    **dict.fromkeys(("dq1", "dq2", "dq10", "dq20"), "rad/s"),
    **dict.fromkeys(("ddq1", "ddq2", "ds"), "rad/s^2"),
    **dict.fromkeys(("s",), "rad/s"),
}


def unlike(expression: sp.Expr, units: Mapping[str, str]) -> bool:
    """Return whether `expression` adds unlike units, or takes a function of one."""
    try:
        dimension_of(expression, units, "audit")
    except InputError:
        return True
    return False


def unit_of_time(case: Case) -> Finding:
    """Refute that the printed forms mean the same in every unit of time, each by one measure."""
    declared = {p.name: p.unit for p in case.derivation.spec.parameters} | _UNITS
    forms = _forms_with_time(case)
    numbers = tuple(sorted({n for n, form in forms if unlike(form, declared)}))
    s, scale = src.positive("s per_second")
    steps = [
        true("one of them has a function or a sum of unlike units", bool(numbers)),
        true("in (3), (4) units fit", not {3, 4} & set(numbers)),
    ]
    found = Counterexample(
        ((s, sp.S.One), (scale, sp.Integer(60))),
        sp.atan(s * scale),
        sp.atan(s),
        "arctan s for s = 1 rad/s: written per minute, and per second",
    )
    listed = ", ".join(f"({n})" for n in numbers)
    note = (
        f"The arctan of a rate, and 1 added to a rate, hang on the unit of time: {listed}. A scale "
        "of 1 rad/s (and 1 rad in Pi) is implied. All of them are judged alike: as definitions in "
        "SI, which is what the toolchain generates."
    )
    verdict = refute(steps, note, sp.atan(s * scale), sp.atan(s), found)
    claim = "arctan s, and Pi with |e'| + 1, are well defined"
    return Finding("unit-of-time", "2.2, (2), (5)-(7); 5, (47), (48)", claim, verdict, numbers)


def _forms_with_time(case: Case) -> list[tuple[int, sp.Expr]]:
    """Return forms of (2)-(7), (47) and (48) as printed, integrals by their integrands."""
    s, ds = src.real("s ds")
    given = {"e1": src.e1, "e2": src.e2, "de1": src.dq1, "de2": src.dq2}
    wanted = ((2, "right"), (3, "s"), (5, "right"), (6, "right"), (7, "b"), (7, "c"))
    found = [
        (n, case.explicit(n, part, s=s, ds=ds, **(given if n == 3 else {}))) for n, part in wanted
    ]
    found += [(n, case.explicit(n, "Pi")) for n in (47, 48)]
    found.append((4, case.explicit(4, "e1", q1d=sp.pi / 2)))
    return [(n, form.replace(INTEGRAL, lambda x: x)) for n, form in found]


def _unit(case: Case, name: str, symbol: str, where: str, place: str) -> Finding:
    """Refute one printed unit: the energies and lumping relations need another dimension."""
    printed = case.unit(where, symbol)
    wanted = next(p.unit for p in case.derivation.spec.parameters if p.name == symbol)
    registry = unit_registry()
    have, need = (registry.parse_units(u).dimensionality for u in (printed, wanted))
    length = sp.Symbol("per_metre", positive=True)
    # The power of length in each unit, as the factor that a change of scale brings.
    powers = [sp.Integer(int(d.get("[length]", 0))) for d in (have, need)]
    found = Counterexample(
        ((length, sp.Integer(10)),),
        length ** powers[0],
        length ** powers[1],
        "factor on the number when lengths are measured in decimetres",
    )
    steps = [true("the dimensions differ", have != need)]
    note = f"{symbol} is printed in {printed}; the energies need {wanted}. The number is taken so."
    verdict = refute(steps, note, printed, wanted, found)
    return Finding(name, place, f"{symbol} is in {printed}", verdict, (1,))


def unit_of_g(case: Case) -> Finding:
    """Refute the unit of g in section 5."""
    return _unit(case, "unit-g", "g", "plant of section 5", "5, first paragraph")


def unit_of_theta4(case: Case) -> Finding:
    """Refute the unit of theta4 in section 6."""
    return _unit(case, "unit-theta4", "theta4", "plant of section 6", "6, parameters")


def unit_of_theta5(case: Case) -> Finding:
    """Refute the unit of theta5 in section 6."""
    return _unit(case, "unit-theta5", "theta5", "plant of section 6", "6, parameters")


def radius_of_gyration(case: Case) -> Finding:
    """Refute I1 as the inertia of the mass m1 between the ends of link 1.

    For masses at 0 <= x <= l1 with mean lc1, sum m (l1 - x) x >= 0, so that the second moment
    about the mean is at most m1 lc1 (l1 - lc1).
    """
    where = "plant of section 5"
    said = case.paper.said[where]
    mass, length, centre, inertia = (case.value(where, n) for n in ("m1", "l1", "lc1", "I1"))
    radius, largest = sp.sqrt(inertia / mass), sp.sqrt(centre * (length - centre))
    x, mean, second, long = src.real("x mean second long")
    steps = [
        equal("(l1 - x) x summed", (long - x) * x, long * x - x**2),
        equal(
            "so that the second moment about the mean is lc1 (l1 - lc1) less that sum",
            second - mean**2,
            mean * (long - mean) - (long * mean - second),
        ),
        true("the radius exceeds the link itself", radius > length),
    ]
    found = Counterexample(
        ((P.m1, mass), (P.l1, length), (P.lc1, centre), (P.I1, inertia)),
        sp.sqrt(P.lc1 * (P.l1 - P.lc1)),
        sp.sqrt(P.I1 / P.m1),
        "the largest radius of gyration about its centroid of a mass between the ends of link 1, "
        "and that of I1, in m",
    )
    note = (
        f"I1 = {said['I1']} on m1 = {said['m1']} is a radius of gyration of "
        f"{sp.N(radius, 3)} m about the centroid, on a link of {sp.N(length, 3)} m; no "
        f"mass between its ends has more than {sp.N(largest, 2)} m. I1 is "
        f"{sp.N(inertia / (mass * largest**2), 3)} times the largest such inertia: it holds "
        "something else too (the motor?), or is misprinted. The number is taken so."
    )
    verdict = refute(steps, note, radius, largest, found)
    claim = "I1 is the moment of inertia of link 1, of mass m1 and length l1"
    return Finding("radius-of-gyration", "2.1; 5, first paragraph", claim, verdict, (1,))


def limit_of_iae(case: Case) -> Finding:
    """Refute the upper limit of the second integral."""
    end, t = src.positive("t_f t")
    names = {"t_f": end, "t": t}
    first, second = (case.value("IAE of section 5.1", n, **names) for n in ("q1", "q2"))
    steps = [
        true("the first runs over the interval", vanishes(first - end)),
        true("the second does not", second.free_symbols != first.free_symbols),
    ]
    found = Counterexample(
        ((end, sp.Integer(10)), (t, sp.S.One)),
        second,
        first,
        "the integral of an error of 1 rad to t as printed, and to t_f",
    )
    note = (
        f"The IAE of q2 is printed with the limit {second}, which leaves it a function of time; "
        f"with {first}, as for q1, it is a number. Read so."
    )
    verdict = refute(steps, note, second, first, found)
    claim = "the IAE is the integral over [0, t_f] for both angles"
    return Finding("iae-limit", "5.1, below Figure 4", claim, verdict)


def announced_lemma(case: Case) -> Finding:
    """Find what the text announces and nowhere states."""
    stated = {name.partition(" ")[0] for name in case.paper.said["statements"]}
    announced = case.paper.said["announcements"]
    missing = {kind: place for kind, place in announced.items() if kind not in stated}
    kinds = ", ".join(sorted(missing)).lower()
    number, claimed = src.nonnegative("stated announced")
    steps = [true("it is announced and not stated", bool(missing))]
    found = Counterexample(
        (
            (claimed, sp.Integer(len(announced))),
            (number, sp.Integer(len(announced) - len(missing))),
        ),
        claimed,
        number,
        "kinds of statements announced, and stated",
    )
    note = (
        f"The text has {', '.join(case.paper.said['statements'])}, and no {kinds}. What stands in "
        "its place is the definition (2) to (4); what a lemma would have to say, that s to 0 "
        "brings both angles home, is refuted in remark-1-setpoint."
    )
    verdict = refute(steps, note, f"a {kinds} follows", "none follows", found)
    places = "; ".join(missing.values())
    return Finding("announced-lemma", places, "the constraint is given in a lemma", verdict, (2,))


def sources_of_friction(case: Case) -> Finding:
    """Find that one friction model is cited from two sources."""
    (velocity,) = src.real("rate")
    where = [f"friction of section {s}" for s in ("5.2", "5.3")]
    forms = [case.value(w, "f", rate=velocity) for w in where]
    cited = [case.paper.said[w]["source"] for w in where]
    numbers = [sp.Integer(c.strip("[]")) for c in cited]
    first, second = src.positive("source_5_2 source_5_3")
    steps = [
        equal("both sections print the same friction", *forms),
        true("from different sources", cited[0] != cited[1]),
    ]
    found = Counterexample(
        tuple(zip((first, second), numbers, strict=True)),
        first,
        second,
        "the numbers of the references for one formula",
    )
    note = (
        f"Section 5.2 takes the model from {cited[0]}, section 5.3 the same model, number for "
        f"number, from {cited[1]}; at most one is where the numbers come from."
    )
    verdict = refute(steps, note, cited[0], cited[1], found)
    claim = "the friction is that of the reference"
    return Finding("friction-sources", "5.2 and 5.3, beside the friction", claim, verdict)


def initial_rates(case: Case) -> Finding:
    """Say how the initial rates of section 5 were read."""
    said = case.paper.said["start of section 5"]
    note = (
        "Garbled: the line lists q1' = 1 and q2' = 0 in one piece, where both may have been equal "
        f"to 0. Read as q1' = {said['dq1']}, q2' = {said['dq2']}."
    )
    verdict = unchecked(note, "dq1(0) = 1, dq2(0) = 0 rad/s", "")
    claim = "the initial velocities of section 5"
    return Finding("initial-rates", "5, first paragraph", claim, verdict)


FINDINGS = (
    unit_of_g,
    unit_of_theta4,
    unit_of_theta5,
    unit_of_time,
    radius_of_gyration,
    limit_of_iae,
    announced_lemma,
    sources_of_friction,
    initial_rates,
)
