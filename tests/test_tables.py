"""Tables: no word is cut at any width, one row is a column, and every cell is there."""

from __future__ import annotations

import io

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pfaffian.cli import output
from pfaffian.cli.sheet import print_table
from pfaffian.runtime.flight.scenario_files import scenario_paths
from rich.cells import cell_len
from rich.console import Console

WIDTHS = (60, 80, 100)
RULES = frozenset("┏━┳┓┃┡╇┩│└┴┘├┼┤─┌┬┐")


def printed(title, columns, rows, width) -> list[str]:
    """Return the lines of a table at `width`."""
    text = io.StringIO()
    console = Console(file=text, width=width, highlight=False, markup=False, emoji=False)
    print_table(console, title, columns, rows, width)
    return text.getvalue().splitlines()


def without_rules(line: str) -> str:
    return "".join(" " if sign in RULES else sign for sign in line)


def check(title, columns, rows, width) -> None:
    """Check that every word of the table stands whole in it, and no line is wider than it must."""
    lines = printed(title, columns, rows, width)
    found = " ".join(map(without_rules, lines)).replace(":", " ").split()
    texts = [title, *(cell for row in rows for cell in row)]
    if len(columns) != 2:  # of two, the first is the name and the second the value
        texts += columns
    for word in " ".join(texts).replace(":", " ").split():
        assert word in found, (word, width, lines)
    longest = max((cell_len(w) for text in (*texts, *columns) for w in text.split()), default=0)
    boxed = [line for line in lines if RULES & set(line)]
    assert all(cell_len(line) <= width for line in boxed), (width, lines)
    if longest <= width // 2 - 10:
        assert boxed or not rows, (width, lines)  # lines without rules are for long words only


LETTERS = st.text("abcdefgö漢[]/=.-_0123456789", min_size=1, max_size=14)
CELL = st.lists(LETTERS, max_size=6).map(" ".join)
NAME = st.lists(LETTERS, min_size=1, max_size=3).map(" ".join)


@st.composite
def tables(draw):
    count = draw(st.integers(1, 12))
    columns = draw(st.lists(NAME, min_size=count, max_size=count))
    rows = draw(st.lists(st.lists(CELL, min_size=count, max_size=count), max_size=4))
    if draw(st.booleans()) and rows:
        rows[0][0] = "f" * draw(st.integers(40, 130))
    return draw(CELL), columns, rows


@settings(max_examples=40, derandomize=True, deadline=None, database=None)
@given(tables(), st.sampled_from(WIDTHS))
def test_no_word_is_cut_and_no_box_is_wider_than_the_terminal(table, width):
    check(*table, width)


@pytest.mark.parametrize("width", WIDTHS)
def test_a_row_alone_is_a_column_of_names_and_values(width):
    columns = ["rigs", "captured", "capture time median", "sha256"]
    lines = printed("a campaign", columns, [["20", "18", "3.5", "ab" * 16]], width)
    inside = [line.split("│")[1:3] for line in lines if "│" in line]
    assert [[cell.strip() for cell in pair] for pair in inside] == [
        ["rigs", "20"],
        ["captured", "18"],
        ["capture time median", "3.5"],
        ["sha256", "ab" * 16],
    ]


def test_rows_too_wide_for_a_grid_are_columns_with_a_rule_between_them():
    columns = [f"a column numbered {k}" for k in range(9)]
    rows = [[f"{'value':>10}{r}{k}" for k in range(9)] for r in range(2)]
    lines = printed("wide", columns, rows, 60)
    assert sum("├" in line for line in lines) == 1
    assert sum("a column numbered" in line for line in lines) == 18


#: Calls that print tables, quick ones; each table is printed again at all widths.
CALLS = (
    "models",
    "targets",
    "derive pendubot --set sim",
    "audit pendubot",
    "design pendubot --set sim --curve --compare rig --box theta3=5% --delay 5ms",
    "certify pendubot --set rig",
    "simulate short.toml",
    "campaign short-campaign.toml",
)
CAMPAIGN = """
scenario = "rig-balance-twin"
[change]
duration = "0.1 s"
[[axis]]
name = "stiction of the drive"
point = [{name = "as it is"}]
"""


def test_no_table_of_the_commands_cuts_a_word(run, workspace, monkeypatch):
    text = scenario_paths()["section-5.1-paper"].read_text()
    (workspace / "short.toml").write_text(text.replace('"10 s"', '"0.05 s"'))
    (workspace / "short-campaign.toml").write_text(CAMPAIGN)
    seen: list[tuple[str, list[str], list[list[str]]]] = []

    def record(title, columns, rows):
        seen.append((title, list(columns), [[str(c) for c in row] for row in rows]))

    monkeypatch.setattr(output, "table", record)
    for call in CALLS:
        before = len(seen)
        outcome = run(*call.split())
        assert outcome.code == 0, outcome.err
        assert len(seen) > before, call
    for title, columns, rows in seen:
        for width in WIDTHS:
            check(title, columns, rows, width)
    [(_, columns, rows)] = [t for t in seen if "stiction of the drive" in t[1]]
    assert len(rows) == 1
    assert not any("captur ed" in line for line in printed("", columns, rows, 80))


def test_the_width_is_that_of_COLUMNS_or_of_a_pipe(monkeypatch):  # noqa: N802
    monkeypatch.setenv("COLUMNS", "67")
    assert output.width() == 67
    monkeypatch.setenv("COLUMNS", "wide")
    assert output.width() == 110  # a test's output is no terminal
    monkeypatch.delenv("COLUMNS")
    assert output.width() == 110
