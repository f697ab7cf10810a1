"""Arbitrary documents as parameter sets: the loader may refuse them, but never stumbles."""

from __future__ import annotations

import string
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pfaffian.derive.pipeline import lowered_model, parameter_set
from pfaffian.derive.sets.gains import is_hurwitz, zero_polynomial
from pfaffian.derive.sets.raw_set import TABLES
from pfaffian.derive.spec.library import find_model
from pfaffian.runtime.base.errors import InputError

SOURCE = find_model("pendubot")
NAMES = ("title", "extends", "parameters", "gains", "target", "m1", "lam", "zero_dynamics_poles")
keys = st.sampled_from(NAMES) | st.text(max_size=5)
units = st.sampled_from(["kg", "m/s^2", "1/s", "kg*m^2", "rad", "deg", "N*m", "dB", "degC", "1/0"])
numbers = st.floats() | st.integers() | st.sampled_from([10**400, 5e-324, -0.0, 1e308, 2**63])
quantities = st.builds(lambda n, u: f"{n!r} {u}" if abs(n) < 1e300 else u, st.floats(), units)
loose_units = st.text(alphabet=string.ascii_letters + string.digits + " */^().+-_²", max_size=12)
scalars = (
    numbers
    | quantities
    | st.booleans()
    | st.text(max_size=12)
    | loose_units.map("1 ".__add__)
    | st.dates()
    | st.sampled_from(["sim", "rig", "nowhere"])
)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(keys, inner, max_size=4),
    max_leaves=8,
)
poles = st.lists(st.floats(-1e3, 0.1) | st.sampled_from(["-4+2j", "-4-2j"]), max_size=4)


DECLARED = [p for p in lowered_model(SOURCE).parameters if p.group in TABLES]


@st.composite
def likely(draw: st.DrawFn) -> dict[str, object]:
    """Return a set that extends a good one by a few fair values, and perhaps an odd one."""
    form = draw(st.sampled_from(["physical", "lumped"]))
    pool = [p for p in DECLARED if p.group in (form, "plant", "gain", "synthesised", "target")]
    document: dict[str, dict[str, object]] = {t: {} for t in TABLES.values()}
    for p in draw(st.lists(st.sampled_from(pool), max_size=3, unique=True)):
        value = draw(st.floats(max(p.lower, -10.0), min(p.upper, 10.0)))
        document[TABLES[p.group]][p.name] = f"{value!r} {p.unit}" if p.unit else value
    if draw(st.booleans()):
        document["gains"]["zero_dynamics_poles"] = draw(poles)
    if draw(st.integers(0, 3)) == 0:
        odd = draw(st.sampled_from(pool))
        document[TABLES[odd.group]][odd.name] = draw(values)
    base = "rig" if form == "lumped" else "sim"
    return {"extends": base, **{t: v for t, v in document.items() if v}}


documents = likely() | likely() | st.dictionaries(keys, values, max_size=4)


def toml(value: object) -> str:
    """Return `value` in TOML, tables inline."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return hex(value) if value >= 0 else f"-{10**30}"
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, str):
        return '"' + "".join(f"\\U{ord(c):08x}" for c in value) + '"'
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(k)} = {toml(v)}" for k, v in value.items()) + "}"
    return str(value)


@pytest.fixture(scope="module")
def judge(tmp_path_factory):
    model, path = lowered_model(SOURCE), tmp_path_factory.mktemp("any") / "any.toml"

    def check(raw: bytes) -> str:
        path.write_bytes(raw)
        try:
            values = parameter_set(model, SOURCE, path).as_dict()
        except InputError as error:
            refusal = error
        else:
            assert is_hurwitz(zero_polynomial(model, values))  # what is accepted must work
            return ""
        assert "any.toml" in refusal.message
        assert refusal.remedy
        return refusal.message

    return check


@settings(
    derandomize=True,
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@example({"extends": "sim", "gains": {"lam": 10**400}})
@example({"extends": "sim", "gains": {"zero_dynamics_poles": [-1e300, -1e300, -1e300]}})
@example({"extends": "rig", "gains": {"zero_dynamics_poles": ["-1+nanj", "-1-nanj", -1]}})
@example({"extends": "rig", "gains": {"kappa": "5e-324 N*m*kg*m^2*s"}})
@given(documents)
def test_no_document_makes_the_loader_stumble(judge, document):
    judge("\n".join(f"{toml(k)} = {toml(v)}" for k, v in document.items()).encode())


@settings(
    derandomize=True,
    max_examples=100,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.binary(max_size=60) | st.text(max_size=60).map(str.encode))
def test_no_bytes_make_the_loader_stumble(judge, raw):
    assert judge(raw)


@settings(
    derandomize=True,
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.sampled_from(["m1", "lc2", "I2", "g"]), st.floats(1e-300, 1e300), units)
def test_no_value_of_a_physical_parameter_makes_the_loader_stumble(judge, name, value, unit):
    judge(f'extends = "sim"\n[parameters]\n{name} = "{value!r} {unit}"\n'.encode())


def test_the_judge_accepts_what_is_good(judge):
    for path in SOURCE.sets().values():
        assert judge(Path(path).read_bytes()) == ""
