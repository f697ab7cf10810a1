"""The documents show what the tool prints: their blocks are run again, their figures found."""

import sys

import pytest
from conftest import REPOSITORY

sys.path.insert(0, str(REPOSITORY / "docs"))
import printed

PAGES = [p for p in printed.PAGES if printed.parts_of(p, p.read_text(encoding="utf-8"))]
SAID = """
+--------+---------------+
| poles  | -6.0, -5.0    |
| torque | 1.25 N m      |
+--------+---------------+
done: 3 of 3
"""


def block(lines, *words):
    return printed.Block(REPOSITORY / "x.md", "x", lines, 0, printed.options_of(words, "x"))


@pytest.mark.target
@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_the_quick_blocks_of_a_page_are_printed_again_and_its_figures_stand_in_blocks(page):
    assert printed.check_page(page, quick=True) == []
    assert printed.unfounded(page) == []


def test_lines_are_found_in_order_whatever_their_spaces_and_frames():
    assert printed.drift(block("poles   -6.0, -5.0\ndone: 3 of 3\n"), SAID) == []
    assert printed.drift(block("done: 3 of 3\npoles   -6.0, -5.0\n"), SAID) == [
        "poles   -6.0, -5.0"
    ]
    assert printed.drift(block("poles ... 1.25 N m\n"), SAID) == []
    assert printed.drift(block("poles -6.0\n"), SAID) == []
    assert printed.drift(block("poles -5.0\n"), SAID) == ["poles -5.0"]


def test_another_figure_word_or_sign_is_drift_and_a_tolerance_is_what_it_says():
    for line in ("torque 1.26 N m", "torque 1.25 N", "torque -1.25 N m", "poles 6.0, -5.0"):
        found = printed.drift(block(f"{line}\n"), SAID)
        assert found == ([] if line == "torque 1.25 N" else [line])
    assert printed.drift(block("torque 1.26 N m\n", "within 1 %"), SAID) == []
    assert printed.drift(block("torque 1.26 N m\n", "within 0.5 %"), SAID) == ["torque 1.26 N m"]
    assert printed.drift(block("torque 1.26 N m\n", "near 0.02"), SAID) == []
    assert printed.drift(block("torque 7 N m\n", "figures vary"), SAID) == []
    assert printed.drift(block("torque 7 N\n", "figures vary"), "thrust 7 N") == ["torque 7 N"]


def test_renewing_changes_numbers_alone_and_keeps_the_columns():
    shown = block("| poles | -7.25, -5.0 |\n| torque | 1.2   | N m\n")
    assert printed.renewed(shown, SAID) == "| poles | -6.0, -5.0 |\n| torque | 1.25  | N m\n"
    assert printed.renewed(block("another 7\n"), SAID) == "another 7\n"


def test_a_figure_in_the_prose_that_nothing_prints_is_found(tmp_path):
    page = tmp_path / "page.md"
    fence = "```console\n$ pfaffian x\nrate 0.41472\n```\n"
    page.write_text(f"The rate is .415, or 41.5 %, of 2.5.\n\n{fence}", encoding="utf-8")
    assert printed.unfounded(page) == ["2.5"]
    page.write_text(f"The rate is .416 of 2.5.\n\n{fence}<!-- given: 2.5 -->\n", encoding="utf-8")
    assert printed.unfounded(page) == [".416"]


def test_every_block_of_every_page_can_be_read_and_no_option_is_misspelt():
    for page in PAGES:
        for part in printed.parts_of(page, page.read_text(encoding="utf-8")):
            if isinstance(part, printed.Block):
                assert part.command.split()[0] in ("pfaffian", "make", "python", "cat", "ls"), part
    with pytest.raises(ValueError, match="'slwo' is not an option"):
        printed.options_of(["slwo"], "x.md")
