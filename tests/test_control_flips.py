"""One flipped bit in the complete controller: what is noticed, and what leaves is limited.

PFAFFIAN_FLIPS says how many in each part; `make flips` sets a million. Every bit of one period a
mode is in test_control_faults.py; here the periods are many, and the rates are printed.
"""

import os

import numpy as np
import pytest
from pfaffian.runtime.code.controller import host_control
from support_control import BALANCE, ENERGY, FAULT, FOLDER, SWING_UP, Board, leaves

COUNT = int(os.environ.get("PFAFFIAN_FLIPS", "20000"))
AT_ONCE = 20_000
PARTS = ("state", "params", "given")


@pytest.fixture(scope="module")
def module():
    return host_control(FOLDER)


@pytest.fixture(scope="module")
def periods(module):
    """Return what stands before 500 periods, half in SWING_UP, half in BALANCE."""
    found = []
    for mode in (SWING_UP, BALANCE):
        board = Board(module, swing_up=ENERGY).brought_to(mode)
        start = list(board.counts)
        for k in range(250):
            board.counts = [start[0] + k // 20, start[1] - k // 15]
            board.step()
            assert board.mode() == mode
            given = board.given.copy()
            given["frame"] += 1
            given["heartbeat"] += 1
            found.append((board.state.copy(), board.params.copy(), given))
    return {p: np.concatenate(r) for p, r in zip(PARTS, zip(*found, strict=True), strict=True)}


def one_bit(rng, records):
    """Return `records` with one bit of each inverted, anywhere but in padding."""
    bytes_ = [at + k for _, at, size in leaves(records.dtype) for k in range(size)]
    many = records.copy()
    raw = many.view(np.uint8).reshape(len(many), -1)
    raw[np.arange(len(many)), rng.choice(bytes_, len(many))] ^= np.left_shift(
        1, rng.integers(0, 8, len(many))
    ).astype(np.uint8)
    return many


def step(module, records):
    output = module.records("control_output", len(records["state"]))
    copies = {part: r.copy() for part, r in records.items()}
    module.step(copies["state"], copies["params"], copies["given"], output)
    return output


@pytest.mark.parametrize("part", PARTS)
def test_one_flipped_bit_leaves_a_torque_that_is_limited_and_allowed(module, periods, part):
    rng = np.random.default_rng(90 + PARTS.index(part))
    seen = {"stopped": 0, "torque the same": 0, "torque changed": 0, "by over 1 %": 0}
    done = 0
    while done < COUNT:
        which = rng.integers(0, len(periods["state"]), min(AT_ONCE, COUNT - done))
        clean = {p: r[which] for p, r in periods.items()}
        wanted = step(module, clean)
        output = step(module, clean | {part: one_bit(rng, clean[part])})
        torque, limit = output["tau"], clean["params"]["law"]["torque_limit"]
        assert np.isfinite(torque).all()
        assert (np.abs(torque) <= limit).all()
        stopped = output["mode"] == FAULT
        assert not torque[stopped].any()
        if part == "params":
            assert stopped.all()
        same = ~stopped & (torque == wanted["tau"])
        far = ~stopped & (np.abs(torque - wanted["tau"]) > 0.01 * limit)
        for name, hit in zip(seen, (stopped, same, ~stopped & ~same, far), strict=True):
            seen[name] += int(hit.sum())
        done += len(which)
    print(f"\n{part}: {done} flips; " + ", ".join(f"{k} {v / done:.2%}" for k, v in seen.items()))
    assert seen["stopped"]
    if part == "state":  # what goes on is a flip in the log, which no decision reads
        assert not seen["torque changed"]
