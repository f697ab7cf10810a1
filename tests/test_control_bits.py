"""No flipped bit or random memory makes the complete controller command what it may not."""

import os
import shutil
import subprocess

import numpy as np
import pytest
from pfaffian.runtime.code.controller import ROLES, host_control, ppc750_control
from pfaffian.runtime.code.supervision import Fault, Reason
from pfaffian.runtime.machine.sources import control_sources, runtime_c
from support_control import (
    BALANCE,
    ENERGY,
    FAULT,
    FOLDER,
    IDLE,
    RESET,
    SWING_UP,
    Board,
    leaves,
    seal_memory,
)
from test_c_safety import garbage

CORRUPT, CHECKSUM, BOUNDS = 1, 2, 3
MODES = (IDLE, SWING_UP, BALANCE, FAULT)
#: How many random memories are tried; `make flips` takes a million.
RANDOM = int(os.environ.get("PFAFFIAN_FLIPS", "200000"))


@pytest.fixture(scope="module", params=["host", pytest.param("ppc750", marks=pytest.mark.target)])
def module(request):
    return host_control(FOLDER) if request.param == "host" else ppc750_control(FOLDER)


@pytest.fixture(scope="module")
def host():
    return host_control(FOLDER)


# --- Every bit -----------------------------------------------------------------------------


def flipped(record, places):
    """Return one copy of `record` for each (byte, bit) of `places`, with that bit inverted."""
    many = np.repeat(record, len(places))
    raw = many.view(np.uint8).reshape(len(many), -1)
    rows, (columns, bits) = np.arange(len(many)), np.array(places).T
    raw[rows, columns] ^= np.left_shift(1, bits).astype(np.uint8)
    return many


def places_of(dtype, every, *without):
    """Return each `every`-th (byte, bit) of the members of a structure, padding left out."""
    found = [
        (offset + k, bit)
        for path, offset, size in leaves(dtype)
        if not path.startswith(without)
        for k in range(size)
        for bit in range(8)
    ]
    return found[::every]


def stepped(board, **records):
    """Step a board's records, one or many of each; return the state and output after it."""
    count = max(len(r) for r in records.values())
    given = board.given.copy()
    given["frame"] += 1
    given["heartbeat"] += 1
    known = {"state": board.state, "params": board.params, "given": given} | records
    rows = {k: np.repeat(r, count) if len(r) == 1 else r for k, r in known.items()}
    rows = {k: np.ascontiguousarray(r).copy() for k, r in rows.items()}
    output = board.module.records("control_output", count)
    board.module.step(rows["state"], rows["params"], rows["given"], output)
    return rows["state"], output


def share(module, fine, coarse):
    return fine if module.machine.name == "host" else coarse


@pytest.mark.parametrize("mode", MODES)
def test_every_flipped_bit_of_the_memory_stops_in_the_same_period(module, mode):
    board = Board(module, swing_up=ENERGY).brought_to(mode)
    first = board.fault()
    places = places_of(board.state.dtype, share(module, 1, 7), "supervisor.log")
    assert len(places) > 500
    state, output = stepped(board, state=flipped(board.state, places))
    assert (output["mode"] == FAULT).all()
    assert not output["tau"].any()
    assert set(output["fault"]) <= {CORRUPT, first or CORRUPT}
    if mode != FAULT:
        assert (output["fault"] == CORRUPT).all()
    again = board.given.copy()
    again["frame"] += 2
    again["heartbeat"] += 2
    again["command"] = RESET
    _, output = stepped(board, state=state, given=again)
    assert (output["mode"] == FAULT).all(), "only init makes it trusted again"
    assert not output["tau"].any()


@pytest.mark.parametrize("mode", [IDLE, SWING_UP, BALANCE])
def test_every_flipped_bit_of_the_parameters_stops_in_the_same_period(module, mode):
    """The supervisor's own bounds come after what the controller found: the checksum is first."""
    board = Board(module, swing_up=ENERGY).brought_to(mode)
    places = places_of(board.params.dtype, share(module, 1, 7))
    _, output = stepped(board, params=flipped(board.params, places))
    assert (output["mode"] == FAULT).all()
    assert not output["tau"].any()
    assert set(output["fault"]) <= {CHECKSUM, BOUNDS}
    outside = output["fault"] == BOUNDS
    own = [k for k, (path, *_) in enumerate(leaves(board.params.dtype)) if "supervisor" in path]
    assert own
    assert outside.mean() < 0.2


# --- Random memory -------------------------------------------------------------------------


def scrambled(rng, records):
    """Return `records` with random bytes in a random share of each record."""
    spoiled = records.copy()
    raw = spoiled.view(np.uint8).reshape(len(spoiled), -1)
    shares = rng.choice([0.0, 0.002, 0.02, 0.3, 1.0], len(records))
    hit = rng.random(raw.shape, np.float32) < shares[:, None]
    raw[hit] = rng.integers(0, 256, int(hit.sum()), np.uint8)
    return spoiled


def strange(rng, records):
    """Return `records` with strange numbers in a share of the members, structures included."""
    spoiled = records.copy()
    for name in records.dtype.names:
        kind = records.dtype[name]
        if kind.names:
            spoiled[name] = strange(rng, records[name])
        elif not kind.shape and kind.kind in "fu":
            spoiled[name] = garbage(rng, records[[name]].copy())[name]
    return spoiled


def wild(rng, module, count):
    """Return (state, params, input): some sealed, some judged already, about what happens."""
    boards = [Board(module, swing_up=s).brought_to(m) for s, m in ((1, 2), (1, 1), (2, 1))]
    which = rng.integers(0, len(boards), count)
    state, params, given = (
        np.concatenate([getattr(b, r) for b in boards])[which] for r in ("state", "params", "given")
    )
    given["frame"] += 1
    given["command"] = rng.integers(0, 5, count)
    half = rng.random(count) < 0.5
    groups = []
    for records in (state, params, given):
        some = np.where(half, scrambled(rng, records), strange(rng, records))
        kept = rng.random(count) < 0.4
        some[kept] = records[kept]
        groups.append(some)
    state, params, given = groups
    sealed = rng.random(count) < 0.7
    params[sealed] = module.seal(params[sealed].copy())
    judged = rng.random(count) < 0.5
    state["checksum"][judged], state["ready"][judged] = params["checksum"][judged], 1
    fits = rng.random(count) < 0.9
    state[fits] = seal_memory(state[fits].copy())
    return state, params, given


def promised(params, output):
    """Check what is promised for every bit pattern; return where a torque was allowed."""
    tau, mode = output["tau"], output["mode"]
    limit = params["law"]["torque_limit"]
    usable = (limit >= 0.0) & (limit <= np.finfo(float).max)
    assert np.isfinite(tau).all()
    assert (np.abs(tau) <= np.where(usable, limit, 0.0)).all()
    assert (mode <= FAULT).all()
    allowed = (mode == SWING_UP) | (mode == BALANCE)
    assert not tau[~allowed].any()
    assert ((output["fault"] != 0) == (mode == FAULT)).all()
    assert (output["fault"] <= max(Fault)).all()
    assert (output["reason"] <= max(Reason)).all()
    assert (output["phase"] <= 2).all()
    return allowed


@pytest.mark.parametrize("part", range(RANDOM // 100_000))
def test_any_random_bit_pattern_keeps_the_promise(host, part):
    """A limit that is no number, or negative, allows no torque at all."""
    rng, count = np.random.default_rng([20, part]), 100_000
    state, params, given = wild(rng, host, count)
    output = host.records("control_output", count)
    host.step(state, params, given, output)
    allowed = promised(params, output)
    assert 0.05 < allowed.mean() < 0.95
    assert len(set(output["fault"])) >= 6
    given["frame"] += 1
    host.step(state, params, given, output)  # and with what it left in its memory
    promised(params, output)


@pytest.mark.target
def test_target_treats_random_bits_as_the_host_does(host):
    """Up to what a number that is none looks like: that differs between processors."""
    rng, count = np.random.default_rng(21), 4_000
    there = ppc750_control(FOLDER)
    rows = wild(rng, host, count)
    ours, theirs = (m.records("control_output", count) for m in (host, there))
    other = [r.astype(there.records(role, 1).dtype) for r, role in zip(rows, _RECORDS, strict=True)]
    host.step(*rows, ours)
    there.step(*other, theirs)
    promised(rows[1], ours)
    for name in ("tau", "mode", "fault", "reason", "phase", "law_status"):
        same = theirs[name].astype(ours[name].dtype)
        assert np.ascontiguousarray(ours[name]).tobytes() == same.tobytes(), name


_RECORDS = ("control_state", "control_params", "control_input")


# --- Sanitizers ----------------------------------------------------------------------------

CHECKS = "address,undefined,float-cast-overflow"
#: A quotient of finite numbers by zero is an answer of a wild sample, which is then refused.
FLOAT_CHECKS = f"{CHECKS},float-divide-by-zero"
PROGRAM = r"""
#include "pendubot_control.h"
#include <stdio.h>
#include <stdlib.h>

int main(void)
{
    struct {
        pendubot_control_state_t state;
        pendubot_control_params_t params;
        pendubot_control_input_t input;
    } *one = malloc(sizeof *one); /* of its own, so that nothing beside it may be touched */
    pendubot_control_output_t output;
    unsigned long allowed = 0;

    while (fread(one, sizeof *one, 1, stdin) == 1) {
        pendubot_control_step(&one->state, &one->params, &one->input, &output);
        allowed += ((output.mode == 1U) || (output.mode == 2U)) ? 1U : 0U;
        (void)pendubot_control_init(&one->state, &one->params);
        pendubot_control_seal(&one->params);
    }
    free(one);
    printf("%lu\n", allowed);
    return 0;
}
"""
COMPILERS = [
    pytest.param(
        name,
        marks=pytest.mark.skipif(
            not shutil.which(name), reason=f"needs {name}: apt-get install {name}"
        ),
    )
    for name in ("gcc", "clang")
]


def sane(rng, module, count):
    """Return records as they happen: any mode, any reading within the encoders' reach."""
    boards = [Board(module, swing_up=s).brought_to(m) for s, m in ((1, 2), (1, 1), (2, 1), (2, 0))]
    which = rng.integers(0, len(boards), count)
    state, params, given = (
        np.concatenate([getattr(b, r) for b in boards])[which] for r in ("state", "params", "given")
    )
    for name in ("q1_raw", "q2_raw"):
        given[name] += rng.integers(-120, 121, count).astype(np.uint32)
    given["frame"] += 1
    given["command"] = rng.integers(0, 4, count)
    return state, params, given


@pytest.mark.parametrize("kind", ["sane", "wild"])
@pytest.mark.parametrize("compiler", COMPILERS)
def test_sanitizers_find_nothing_in_the_control_step(compiler, kind, host, tmp_path):
    count = 20_000
    (tmp_path / "main.c").write_text(PROGRAM)
    checks = FLOAT_CHECKS if kind == "sane" else CHECKS
    command = [compiler, "-std=c99", "-O1", "-g", "-ffp-contract=off", "-fno-math-errno"]
    command += [f"-fsanitize={checks}", "-fno-sanitize-recover=all"]
    command += [f"-I{FOLDER.path / 'c'}", f"-I{runtime_c()}", "main.c"]
    command += [*map(str, control_sources(FOLDER.path, FOLDER.manifest)), "-o", "main", "-lm"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    if done.returncode and "cannot find" in done.stderr + done.stdout:
        pytest.skip(f"needs the sanitizers' library of {compiler}: libclang-rt-14-dev")
    assert done.returncode == 0, done.stderr
    rng = np.random.default_rng(22)
    rows = {"sane": sane, "wild": wild}[kind](rng, host, count)
    layout = [(n, r.dtype) for n, r in zip(("state", "params", "input"), rows, strict=True)]
    packed = np.zeros(count, np.dtype(layout, align=True))
    for (name, _), records in zip(layout, rows, strict=True):
        packed[name] = records
    done = subprocess.run(
        ["./main"], cwd=tmp_path, input=packed.tobytes(), capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()[-3000:]
    assert int(done.stdout) > (0.3 if kind == "sane" else 0.02) * count


def test_every_role_has_a_record(host):
    assert {r.removeprefix("control_") for r in ROLES} == {"params", "input", "state", "output"}
    assert all(host.records(r).dtype.itemsize for r in ROLES)
