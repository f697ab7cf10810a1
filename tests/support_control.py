"""What the tests of the complete controller share: a board with good readings, and its seals."""

import math

import numpy as np
from pfaffian.runtime.code.generated_model import open_generated
from support_supervisor import SEALED

IDLE, SWING_UP, BALANCE, FAULT = range(4)
START, STOP, RESET = 1, 2, 3
STARTED, STOPPED, CAPTURED, RELEASED, FAULTED, WAS_RESET = range(1, 7)
NO_SWING_UP, ENERGY, PLAN = range(3)
ROBUST, NOMINAL, FEEDBACK = range(3)
FOLDER = open_generated("pendubot")
QUANTUM = 2.0 * math.pi / 5000.0
HANGING, UPRIGHT = -1250, 1250
_SEED, _PRIME = np.uint32(2166136261), np.uint32(16777619)
#: Members of the control state that no seal runs over, or that are one.
_SEPARATE = ("supervisor", "seal")


class Board:
    """One controller behind good readings, until told otherwise."""

    def __init__(self, module, **changes):
        """Take the generated parameters with `changes`, by member or `group__member`."""
        self.module = module
        self.params = module.params("rig")
        self.change(**changes)
        self.state, status = module.init(self.params)
        assert status[0] == 0
        self.given, self.output = (module.records(f"control_{r}") for r in ("input", "output"))
        self.counts = [HANGING, 0]

    def change(self, **changes):
        """Write `changes` into the parameters, and seal them."""
        for path, value in changes.items():
            *groups, name = path.split("__")
            records = self.params
            for group in groups:
                records = records[group]
            records[name] = value
        self.module.seal(self.params)

    def step(self, **wrong):
        given = self.given
        given["q1_raw"], given["q2_raw"] = (c & 0xFFFFFFFF for c in self.counts)
        given["q1_valid"] = given["q2_valid"] = 1
        given["elapsed"], given["command"] = 1e-3, 0
        given["frame"] += 1
        given["heartbeat"] += 1
        for name, value in wrong.items():
            given[name] = value
        self.module.step(self.state, self.params, given, self.output)
        return self.output

    def started(self):
        self.step()
        self.step(command=START)
        for _ in range(3):
            self.step()
        assert self.mode() == SWING_UP
        return self

    def balancing(self):
        """Stand upright, and be caught there; the energy law or none is to be chosen."""
        self.counts = [UPRIGHT, 0]
        self.step()
        self.step(command=START)
        for _ in range(3):
            self.step()
        assert self.mode() == BALANCE
        return self

    def brought_to(self, mode):
        """Lead it from its first period to `mode`."""
        if mode == IDLE:
            self.step()
        elif mode == SWING_UP:
            self.started()
        elif mode == BALANCE:
            self.balancing()
        else:
            self.step(elapsed=math.nan)
        assert self.mode() == mode
        return self

    def mode(self):
        return int(self.output["mode"][0])

    def fault(self):
        return int(self.output["fault"][0])

    def reason(self):
        return int(self.output["reason"][0])

    def torque(self):
        return float(self.output["tau"][0])

    def is_stopped_by(self, *codes):
        return self.mode() == FAULT and self.fault() in codes and self.torque() == 0.0


def leaves(dtype, start=0, path=""):
    """Yield (path, offset, size) of every number of a structure, arrays entry by entry."""
    for name in dtype.names:
        inner, offset = dtype.fields[name][:2]
        here, offset = f"{path}{name}", start + offset
        if inner.names:
            yield from leaves(inner, offset, f"{here}.")
        else:
            size = inner.base.itemsize
            for k in range(inner.itemsize // size):
                entry = f"{here}[{k}]" if inner.shape else here
                yield entry, offset + k * size, size


def _words(column):
    """Return the 32-bit words of a column of numbers, (N, 1 or 2), the high one first."""
    kind = column.dtype.newbyteorder("=")
    native = np.ascontiguousarray(column.astype(kind))
    if kind.itemsize == 4:
        return native.view(np.uint32)[:, None]
    bits = native.view(np.uint64)
    return np.stack([bits >> np.uint64(32), bits & np.uint64(0xFFFFFFFF)], 1).astype(np.uint32)


def _scalars(records, *without):
    """Yield the words of every number of `records`, structure after structure."""
    for name in records.dtype.names:
        if name in without:
            continue
        if records.dtype[name].names:
            yield from _scalars(records[name])
        else:
            yield _words(records[name])


def _checksum(columns):
    """Return the checksum over words (N, k), N at once."""
    found = None
    for column in columns:
        for word in column.T:
            found = np.full(len(word), _SEED) if found is None else found
            found = (found ^ word) * _PRIME
            found = found ^ (found >> np.uint32(15))
    return found


def seal_memory(state):
    """Write into `state` the seals that fit what stands there, the complements included."""
    supervisor = state["supervisor"]
    for name in ("mode", "fault", "ready"):
        supervisor[f"{name}_inverse"] = ~supervisor[name]
    supervisor["seal"] = _checksum(_words(supervisor[n]) for n in SEALED)
    structures = [n for n in state.dtype.names if state.dtype[n].names]
    own = [n for n in state.dtype.names if n not in (*structures, *_SEPARATE)]
    columns = [w for n in structures if n not in _SEPARATE for w in _scalars(state[n])]
    state["seal"] = _checksum([*columns, *(_words(state[n]) for n in own)])
    return state
