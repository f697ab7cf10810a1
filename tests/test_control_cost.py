"""What one period of the complete controller costs on the 750: the table of docs/control.md."""

import re
from pathlib import Path

import pytest
from pfaffian.runtime.code.controller import ppc750_control
from support_control import BALANCE, ENERGY, FAULT, FOLDER, IDLE, PLAN, SWING_UP, Board

ROWS = {
    "IDLE": (PLAN, IDLE),
    "SWING_UP, plan": (PLAN, SWING_UP),
    "SWING_UP, energy law": (ENERGY, SWING_UP),
    "BALANCE": (ENERGY, BALANCE),
    "FAULT": (ENERGY, FAULT),
}


def cost(swing_up, mode):
    """Return (instructions, stack bytes) of a period in `mode`, the most of 20."""
    board = Board(ppc750_control(FOLDER, "zig"), swing_up=swing_up).brought_to(mode)
    machine = board.module.machine
    found = []
    for k in range(20):
        board.counts[1] += (-1) ** k
        found.append(machine.measure("pendubot_control_step", board.step))
        assert board.mode() == mode
    return tuple(max(column) for column in zip(*found, strict=True))


@pytest.mark.target
def test_the_document_says_what_a_period_costs():
    text = (Path(__file__).parent.parent / "docs" / "control.md").read_text(encoding="utf-8")
    told = {
        name: (int(count), int(stack))
        for name, count, stack in re.findall(
            r"\| ([A-Z_]+(?:, [a-z ]+)?) \| (\d+) \| (\d+) \|", text
        )
    }
    assert told == {name: cost(*row) for name, row in ROWS.items()}
