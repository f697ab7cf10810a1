"""What leaves the command line: JSON, tables, files, exit codes, each by its rule."""

import io
import json
import math

import pytest
from pfaffian.cli import output
from pfaffian.cli.sheet import print_table
from pfaffian.runtime.base import errors
from pfaffian.runtime.base.files import write_outputs
from pfaffian.runtime.base.toml import suggestion
from rich.console import Console


def test_json_is_json_whatever_the_numbers_are(capsys):
    output.emit_json({"a": math.nan, "b": [math.inf, -math.inf, 1.5], "c": {"d": 1 + 2j}, 3: None})
    said = capsys.readouterr().out

    def none_of_it(word):
        raise AssertionError(f"{word} is not JSON")

    found = json.loads(said, parse_constant=none_of_it)
    assert found == {"a": "nan", "b": ["inf", "-inf", 1.5], "c": {"d": [1.0, 2.0]}, "3": None}


def test_each_kind_of_error_has_the_exit_code_of_the_contract():
    """0 done, 1 a check failed, 2 bad input, 3 a tool is missing."""
    kinds = {errors.CheckError: 1, errors.InputError: 2, errors.MissingToolError: 3}
    assert {k: k("x").exit_code for k in kinds} == kinds
    assert errors.EXIT_DONE == 0


COLUMNS = ("equation", "status", "what was compared")
ROWS = [
    ("(12)", "not-checkable", "the decomposition of uncertainties over the actuators"),
    ("(45)", "proved", "boundedness, incomprehensibly"),
]


#: One long word beside short ones: the column that could give way is not the widest.
SHORT = (("what", "how"), [("incomprehensibilities", "a b c d e f g h"), ("x", "y")])


@pytest.mark.parametrize("width", range(32, 121, 4))
@pytest.mark.parametrize(("columns", "rows"), [(COLUMNS, ROWS), SHORT], ids=["long", "short"])
def test_no_table_cuts_a_word_at_any_width(columns, rows, width):
    console = Console(width=width, record=True, file=io.StringIO())
    print_table(console, "equations", columns, rows, width)
    text = console.export_text()
    for word in " ".join([*columns, *(cell for row in rows for cell in row)]).split():
        assert word in text
    if columns != COLUMNS or width >= 44:
        assert max(map(len, text.splitlines())) <= width


def test_all_outputs_are_written_or_none(tmp_path):
    one, other = tmp_path / "one.txt", tmp_path / "made" / "other.txt"
    one.write_text("old")
    write_outputs({one: b"new", other: b"more"})
    assert (one.read_text(), other.read_text()) == ("new", "more")
    blocked = tmp_path / "one.txt" / "below"
    with pytest.raises(errors.InputError, match="below"):
        write_outputs({one: b"newer", blocked: b"never"})
    assert one.read_text() == "new"
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["made", "one.txt", "other.txt"]


def test_a_remedy_names_the_nearest_word_and_all():
    assert suggestion("kapa", ["eta", "kappa"]) == "did you mean kappa? known: eta, kappa"
    assert suggestion("zzz", ["eta", "kappa"]) == "known: eta, kappa"
