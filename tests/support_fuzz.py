"""Inputs as nobody would write them, and what every answer to one must be."""

from __future__ import annotations

import json
import math
from typing import Any

from hypothesis import strategies as st

#: Values of no use: types, sizes, signs, quantities and texts that some reader trips over.
NUMBERS = [0, -1, 1, 2, 10**6, -(10**18), 10**400, 0.0, -0.0, 1e-320, 1e308, -1e308, 0.5, 1e-9]
ODD = [math.nan, math.inf, -math.inf]
QUANTITIES = [
    *("1", "1 kg", "-1 kg", "0 kg", "1e400 kg", "nan kg", "inf m", "1+1 kg", "1 kg*deg", "1 ton"),
    *("(1 kg", "1 kg)", "1 kg^9999999", "1 kg^1e9", "1 kg**0.5", "9**9**9 kg", "1/0 kg", "1 m/0"),
    *("__import__('os') kg", "1 degC", "1 dB", "5 %", "% 5", "1 furlong", "0x10 kg", "1_000 kg"),
    *(
        "∞ m",
        "１ kg",
        "1 kg kg",
        "kg",
        " ",
        "1 s",
        "1e-300 s",
        "1e300 s",
        "1 rad",
        "90 deg",
        "1 N*m",
    ),
    *(
        "1 1/s",
        "1e5 1/s",
        "-5 1/s",
        "1 Hz",
        "1 ms",
        "1 us",
        "1 1/(kg*m^2)",
        "m" * 3000,
        "1 " * 2000,
    ),
    "1" + "0" * 5000 + " kg",
]
TEXTS = [
    "",
    "sim",
    "rig",
    "../../etc",
    "a\0b",
    "\ufeff",
    "é\u0301",
    "\x1b[31m",
    "x" * 5000,
    "\n\n",
    "[a]",
]
SCALARS = st.one_of(
    st.sampled_from([*NUMBERS, *ODD, *QUANTITIES, *TEXTS, True, False]),
    st.integers(-(10**20), 10**20),
    st.floats(),
    st.text(max_size=12),
    st.builds("{} {}".format, st.floats(), st.sampled_from(["kg", "m", "s", "1/s", "N*m", "rad"])),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.text('ab1_-é."', max_size=4), inner, max_size=3),
    ),
    max_leaves=6,
)


def toml(document: dict[str, Any]) -> str:
    """Return `document` as TOML, every table inline: what is written need not be sensible."""
    return "".join(f"{_key(k)} = {_toml(v)}\n" for k, v in document.items())


def _key(key: str) -> str:
    return json.dumps(key, ensure_ascii=False).replace("\x7f", "\\u007f")


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _key(value)
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)} = {_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, float) and value == int(value) if _finite(value) else False:
        return f"{value!r}"
    return str(value)


def _finite(value: Any) -> bool:
    return isinstance(value, float) and math.isfinite(value)


def places(document: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the way to every value in `document`."""
    inside = document.items() if isinstance(document, dict) else enumerate(document)
    found = []
    for key, value in inside:
        found.append((*at, key))
        if isinstance(value, dict | list):
            found += places(value, (*at, key))
    return found


@st.composite
def spoiled(draw: Any, document: dict[str, Any]) -> dict[str, Any]:
    """Return `document` with one to four of its values or keys spoiled."""
    made = json.loads(json.dumps(document))
    for _ in range(draw(st.integers(1, 4))):
        ways = places(made)
        if not ways:
            break
        *above, key = draw(st.sampled_from(ways))
        holder = made
        for step in above:
            holder = holder[step]
        what = draw(st.sampled_from(["value", "value", "value", "delete", "rename", "add"]))
        if what == "value":
            holder[key] = draw(VALUES)
        elif what == "delete":
            del holder[key]
        elif isinstance(holder, dict):
            name = draw(
                st.one_of(st.text(max_size=8), st.sampled_from([*holder, "title", "extends"]))
            )
            holder[name] = holder.pop(key) if what == "rename" else draw(VALUES)
        else:
            holder.insert(0, draw(VALUES))
    return made


@st.composite
def spoiled_text(draw: Any, text: str) -> bytes:
    """Return `text` as bytes with a part of it lost, doubled, or replaced by others."""
    content = text.encode()
    start, length = draw(st.integers(0, len(content))), draw(st.integers(0, 30))
    other = draw(
        st.one_of(st.binary(max_size=6), st.text(max_size=6).map(str.encode), st.just(content))
    )
    made = content[:start] + other + content[start + length :]
    return draw(st.sampled_from([b"", b"\xef\xbb\xbf", b"\xff\xfe"])) + made


def judge(outcome: Any, as_json: bool) -> None:
    """Check what holds for every answer of the command line."""
    assert outcome.code in (0, 1, 2, 3), outcome
    assert "Traceback" not in outcome.err
    lines = outcome.err.splitlines()
    if outcome.code in (2, 3):
        said = [k for k, line in enumerate(lines) if line.startswith("error: ")]
        assert said, outcome
        assert len(lines) > said[-1] + 1, f"no remedy: {outcome}"
        assert lines[-1].strip()
    if as_json:
        document = json.loads(outcome.out, parse_constant=_no_constant)
        assert isinstance(document, dict)
        assert ("error" in document) == (outcome.code != 0)
        if outcome.code:
            assert document["error"]["exit_code"] == outcome.code
            assert document["error"]["message"]


def _no_constant(name: str) -> float:
    raise AssertionError(f"{name} is not JSON")
