"""Gappa proves that sine, cosine and arctangent stay below one unit in the last place.

Measuring finds the worst of the points it tries; a proof holds for all of them.
"""

from __future__ import annotations

import itertools
import math
import re
import shutil
import subprocess

import gmpy2
import pytest
from pfaffian.derive.elementary.coefficients import SINCOS_MAX, ULP_BOUNDS, elementary_coefficients
from pfaffian.derive.elementary.further import FURTHER_ULP_BOUNDS
from pfaffian.derive.elementary.further_proofs import further_proofs
from pfaffian.derive.elementary.proofs import LEAST, PROVED_ULP, Proof, proofs
from pfaffian.derive.elementary.tables import ATAN_ROWS, atan_edges
from pfaffian.derive.emit.templates import fill

TEMPLATE = "gappa/row.g.j2"
needs_gappa = pytest.mark.skipif(
    shutil.which("gappa") is None, reason="gappa is missing: apt-get install gappa"
)


def prove(script: str) -> str:
    """Return nothing where Gappa proves the script, or else what it says."""
    command = ["gappa"]
    done = subprocess.run(
        command, input=script, capture_output=True, text=True, check=False, timeout=120
    )
    return "" if done.returncode == 0 else done.stderr or done.stdout


def scripts(proof: Proof) -> list[str]:
    return [fill(TEMPLATE, context) for context in proof.contexts()]


@needs_gappa
@pytest.mark.parametrize("family", ["angle", "sin", "cos", "atan"])
def test_every_row_is_proved(family: str) -> None:
    chosen = [p for p in proofs() if p.name.split("_")[0] == family]
    assert chosen
    for proof in chosen:
        for script in scripts(proof):
            assert prove(script) == "", f"{proof.name}\n{script}"


@needs_gappa
@pytest.mark.parametrize("name", [p.name for p in further_proofs()])
def test_every_branch_of_the_further_functions_is_proved(name: str) -> None:
    (proof,) = [p for p in further_proofs() if p.name == name]
    for script in scripts(proof):
        assert prove(script) == "", script
    # And a claim a thousand times as strong is not.
    tighter = re.sub(r"(<= 0x[\d.]+[\da-f]*p)-(\d+) }", r"\1-7\2 }", scripts(proof)[-1])
    assert tighter != scripts(proof)[-1]
    assert prove(tighter) != ""


@needs_gappa
def test_a_bound_that_is_too_small_is_not_proved() -> None:
    (proof,) = [p for p in proofs() if p.name == "sin_3"]
    script = scripts(proof)[0]
    tighter = re.sub(r"(\|t - Mt\| <= 0x1\.\w+p)-(\d+)", r"\1-6\2", script)
    assert tighter != script
    assert prove(tighter) != ""


def test_rows_leave_no_gap() -> None:
    """The pieces of each row meet, and the rows do: a quarter turn, and every size of x."""
    pieces = {p.name: [(case.low, case.high) for case in p.cases] for p in proofs()}
    for name, row in pieces.items():
        for before, after in itertools.pairwise(row):
            assert before[1] == after[0], name
    c = elementary_coefficients()
    for name in ("sin", "cos"):
        rows = [pieces[f"{name}_{row}"] for row in range(1, 8)]
        centres = [row * c.step[0] + c.sincos_rows[row].offset for row in range(1, 8)]
        ends = [(m + r[0][0], m + r[-1][1]) for m, r in zip(centres, rows, strict=True)]
        edges = [(k + 0.5) * c.step[0] for k in range(8)]
        for (low, high), start, stop in zip(ends, edges[:-1], edges[1:], strict=True):
            assert low <= start
            assert high >= stop
    assert pieces["atan_0"][0][1] >= pieces["atan_3"][0][0]
    for row in range(4, ATAN_ROWS):
        assert pieces[f"atan_{row}"][0][0] == pieces[f"atan_{row - 1}"][-1][1]
    assert 1 / pieces["atan_far"][-1][1] <= atan_edges(ATAN_ROWS)[0]


def test_no_argument_comes_closer_to_a_multiple_of_half_pi_than_assumed() -> None:
    with gmpy2.context(precision=250):
        half_pi = gmpy2.const_pi() / 2
        count = int(SINCOS_MAX / (math.pi / 2))
        least = min(abs(float(k * half_pi) - k * half_pi) for k in range(1, count + 1))
    assert least >= LEAST


def test_stated_bounds_are_within_what_is_proved() -> None:
    assert all(
        ULP_BOUNDS[name] <= PROVED_ULP for name in ("sin", "cos", "atan", *FURTHER_ULP_BOUNDS)
    )
