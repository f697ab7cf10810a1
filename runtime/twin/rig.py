"""N rigs between two samples: the generated plant behind its drives, in `runtime/c/pf_twin.c`."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import numpy as np
from pfaffian.runtime.base.arrays import Array
from pfaffian.runtime.base.errors import CheckError, InputError
from pfaffian.runtime.code.generated_model import GeneratedFolder, GeneratedModel, fill_records
from pfaffian.runtime.machine.compile import compile_image
from pfaffian.runtime.machine.host import HostMachine
from pfaffian.runtime.machine.sources import harness_sources
from pfaffian.runtime.machine.toolchain import host_target
from pfaffian.runtime.twin.draws import Purpose, uniform
from pfaffian.runtime.twin.places import Place, place_of, response
from pfaffian.runtime.twin.settings import Drive, TwinScenario

_DRIVE = np.dtype(
    [
        *((n, "f8") for n in ("limit", "quantum", "codes", "slew", "keep", "mean", "held")),
        *((n, "f8") for n in ("slewed", "torque", "applied")),
        *((n, "u4") for n in ("delay", "lags")),
    ],
    align=True,
)
_FORCE = np.dtype(
    [
        *((n, "f8") for n in ("amplitude", "frequency", "phase")),
        *((n, "u4") for n in ("kind", "first", "last", "is_load", "index", "pad")),
    ],
    align=True,
)
_FRICTION = np.dtype(
    [
        *((n, "f8") for n in ("coulomb", "excess", "inverse_stribeck", "inverse_layer")),
        *((n, "u4") for n in ("is_load", "index", "rate", "pad")),
    ],
    align=True,
)
_HELD, _SINE, _IMPULSE = range(3)
_LAST = 2**32 - 1
#: What a drive without a limit makes of an infinite command.
_LARGEST_TORQUE = 1e300


def plant_model(folder: GeneratedFolder, toolchain: str = "auto") -> GeneratedModel:
    """Build the plant of `folder` with the twin's loop for this machine, and load it.

    Raises `InputError` for a model of single precision: a plant is not rounded so.
    """
    if folder.manifest.precision != "double":
        raise InputError(
            f"{folder.path}: a plant of single precision cannot be a twin",
            remedy=f"generate it in double: pfaffian generate {folder.manifest.model}",
        )
    twin = Path(str(files("pfaffian.runtime"))) / "c" / "pf_twin.c"
    sources = [*harness_sources(folder.path, folder.manifest), twin]
    image = compile_image(host_target(toolchain, fma=True), sources, folder.path / "c")
    model = GeneratedModel(folder, HostMachine(image))
    for number, kind in enumerate((_DRIVE, _FORCE, _FRICTION)):
        if model.machine.call("pf_twin_sizeof", number) != kind.itemsize:
            raise CheckError(
                f"pf_twin.c and Python differ about structure {number}",
                remedy="keep runtime/twin/rig.py and pf_twin.c alike",
            )
    return model


class Rigs:
    """The plants and drives of N rigs; `state` and `params` are records (N,) of the model."""

    def __init__(self, scenario: TwinScenario, model: GeneratedModel, threads: int = 1) -> None:
        """Draw the rigs of `scenario`; raise `InputError` where a force finds no way in."""
        self.scenario, self.model = scenario, model
        count = scenario.rigs
        self.numbers = range(scenario.first_rig, scenario.first_rig + count)
        self.params = fill_records(model.records("plant_params", count), dict(scenario.base.plant))
        self.state = fill_records(model.records("plant_state", count), dict(scenario.base.initial))
        self._draw_plants()
        self.lost = np.zeros(count, np.uint32)
        self._drive = self._drives()
        self._length = int(self._drive["delay"].max()) + 1
        self._line = np.zeros((*self._drive.shape, self._length))
        self._step = np.array([scenario.substep])
        self._forces = np.array(self._force_rows(), _FORCE)
        self._frictions = np.array(self._friction_rows(), _FRICTION)
        self._from, self._count = (np.zeros(count, np.uint32) for _ in range(2))
        self._torque = np.zeros(self._drive.shape)
        edges = np.linspace(0, count, max(1, min(threads, count)) + 1).astype(int).tolist()
        self._calls = [self._call_of(slice(a, b)) for a, b in pairwise(edges)]
        self._pool = ThreadPoolExecutor(len(self._calls)) if len(self._calls) > 1 else None

    @property
    def delays(self) -> Array:
        """Return the delay of every rig's drives, whole substeps in seconds, shape (N, m)."""
        return np.asarray(self._drive["delay"] * self.scenario.substep)

    def _call_of(self, part: slice) -> Callable[[], object]:
        """Return the call that advances the rigs in `part`: its arrays keep their addresses."""
        machine = self.model.machine
        if not isinstance(machine, HostMachine):
            raise InputError("a twin's plant runs on this machine", remedy="take plant_model")
        arrays: list[Array] = [self._from, self._count, self._torque, self.state, self.params]
        arrays += [self._drive, self._line, self.lost]
        given: list[Array | int] = [part.stop - part.start, *(a[part] for a in arrays)]
        given += [self._step, self._length, self._forces, len(self._forces)]
        given += [self._frictions, len(self._frictions)]
        arguments = [
            ctypes.c_uint32(a) if isinstance(a, int) else ctypes.c_void_p(a.ctypes.data)
            for a in given
        ]
        return partial(machine.entry("pf_twin_advance"), *arguments)

    def _draw_plants(self) -> None:
        of = self.scenario
        draws = uniform(of.seed, self.numbers, Purpose.PLANT, len(of.spread))
        for column, (name, share) in enumerate(of.spread.items()):
            self.params[name] *= 1.0 + share * (2.0 * draws[:, column] - 1.0)
        draws = uniform(of.seed, self.numbers, Purpose.START, len(of.initial_spread))
        for column, (name, width) in enumerate(of.initial_spread.items()):
            self.state[name] += width * (2.0 * draws[:, column] - 1.0)

    def _drives(self) -> Array:
        """Return the drives, (N, m) of `_DRIVE`."""
        of = self.scenario
        drives = [of.drives.get(a, Drive()) for a in of.actuators]
        records = np.zeros((of.rigs, len(drives)), _DRIVE)
        draws = uniform(of.seed, self.numbers, Purpose.DELAY, len(drives))
        for column, drive in enumerate(drives):
            of_one = records[:, column]
            of_one["limit"] = min(drive.limit, _LARGEST_TORQUE)
            of_one["slew"] = drive.slew * of.substep
            if drive.bits:
                of_one["codes"] = 2.0 ** (drive.bits - 1)
                of_one["quantum"] = drive.limit / 2.0 ** (drive.bits - 1)
            spread = drive.delay_spread * (2.0 * draws[:, column] - 1.0)
            delay = np.maximum(drive.delay + spread, 0.0) / of.substep
            of_one["delay"] = np.floor(delay + 0.5).astype(np.uint32)
            if drive.time_constant:
                keep, mean = np.zeros(1), np.zeros(1)
                ratio = np.array([of.substep / drive.time_constant])
                self.model.machine.call("pf_twin_decay", 1, ratio, keep, mean)
                of_one["keep"], of_one["mean"], of_one["lags"] = keep, mean, 1
        return records

    def _place(self, joint: str, what: str) -> Place:
        return place_of(self.scenario, self.model, joint, what)

    def _force_rows(self) -> list[tuple[float | int, ...]]:
        of = self.scenario
        rows: list[tuple[float | int, ...]] = []
        for one in of.disturbances:
            place = self._place(one.joint, "disturbance")
            kind = _SINE if one.shape == "sine" else _HELD
            turns, ends = one.frequency * of.substep, (one.start, one.end)
            first, last = (of.instants(t, _LAST) for t in ends)
            rows.append((one.amplitude, turns, one.phase, kind, first, last, *place.entry, 0))
        for push in of.pushes:
            place = self._place(push.joint, "push")
            first = of.instants(push.time, _LAST - 1)
            if push.impulse:
                rows.append((push.impulse, 0.0, 0.0, _IMPULSE, first, first + 1, *place.entry, 0))
            else:
                last = max(of.instants(push.time + push.duration, _LAST), first + 1)
                rows.append((push.force, 0.0, 0.0, _HELD, first, last, *place.entry, 0))
        return rows

    def _friction_rows(self) -> list[tuple[float | int, ...]]:
        of, names = self.scenario, self.model.records("plant_state").dtype.names or ()
        rows: list[tuple[float | int, ...]] = []
        for one in of.frictions:
            place = self._place(one.joint, "friction")
            mobility = response(of, self.model, place)[of.coordinates.index(one.joint)]
            if of.substep * mobility * one.stiction > one.layer:
                least = of.substep * mobility * one.stiction
                raise InputError(
                    f"friction.{one.joint}: layer = {one.layer:g} is too thin for a substep of "
                    f"{of.substep:g} s: the friction would shake the joint",
                    remedy=f"take a layer above {least:.3g}, or more plant_substeps",
                )
            inverses = (1.0 / one.stribeck, 1.0 / one.layer)
            excess = one.stiction - one.coulomb
            rows.append(
                (one.coulomb, excess, *inverses, *place.entry, names.index(f"d{one.joint}"), 0)
            )
        return rows

    @property
    def truth(self) -> Array:
        """Return q and q' of all rigs, a view of shape (N, 2n)."""
        return self.state.view(np.float64).reshape(len(self.state), -1)

    @property
    def applied(self) -> Array:
        """Return the torque on the shafts in the last substep, (N, m)."""
        return np.asarray(self._drive["applied"])

    def advance(self, start: Array, count: Array, command: Array) -> None:
        """Give `command` (N, m) out at substep `start`, and advance by `count` of them (N,)."""
        if command.shape != self._torque.shape:
            raise CheckError(
                f"a command of shape {command.shape}", remedy=f"give shape {self._torque.shape}"
            )
        self._from[:], self._count[:], self._torque[:] = start, count, command
        if self._pool is None:
            self._calls[0]()
            return
        for done in [self._pool.submit(call) for call in self._calls]:
            done.result()

    def energy(self, chosen: Array) -> Array:
        """Return T + V of the rigs with indices `chosen`, in joule."""
        energy = np.zeros(len(chosen))
        self.model.energy(self.params[chosen], self.state[chosen], energy)
        return energy

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()
