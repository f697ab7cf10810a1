"""What a twin is: drives, sampling, encoders, friction, spread, disturbances, pushes, faults."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from pfaffian.runtime.code.sensing import Encoder
from pfaffian.runtime.flight.scenario import Scenario

#: Shapes of a disturbance. A step lasts to the end, a pulse to `end`.
SHAPES = ("constant", "sine", "step", "pulse")
#: Kinds of fault, and whether one without a duration lasts a single period.
FAULTS = {
    "freeze_encoder": False,
    "jump": False,
    "drop_reading": True,
    "nan_elapsed": True,
    "stall_frame": False,
    "stop_heartbeat": False,
    "skip": True,
    "flip": True,
}
#: Longest substep of the plant, seconds.
LONGEST_SUBSTEP = 0.25e-3


@dataclass(frozen=True)
class Drive:
    """One actuator on the way from command to shaft, in its SI units; times in seconds.

    The delay of a rig is uniform within `delay` +- `delay_spread`, rounded to substeps.
    """

    limit: float = math.inf
    time_constant: float = 0.0
    delay: float = 0.0
    delay_spread: float = 0.0
    slew: float = math.inf
    bits: int = 0


@dataclass(frozen=True)
class Sampling:
    """When the controller runs: instant k at (k + u) T, u uniform within +-`jitter`.

    The instants are rounded to substeps of the plant. Each but the first is missed with the
    probability `missed`: the command is held, and the next `elapsed` is the longer.
    """

    jitter: float = 0.0
    missed: float = 0.0


@dataclass(frozen=True)
class Channel:
    """One encoder and what is wrong with it.

    `offset_spread` (in the coordinate's unit) is the half-width of each rig's unknown zero, `noise`
    the largest error in counts, `dropout` the probability of no reading.
    """

    encoder: Encoder = field(default_factory=Encoder)
    offset_spread: float = 0.0
    noise: int = 0
    dropout: float = 0.0


@dataclass(frozen=True)
class DryFriction:
    """Dry friction on `joint` beside the model's own: SI units.

    F(v) = (coulomb + (stiction - coulomb)/(1 + (v/stribeck)^2)) sat(v/layer): stiction is a steep
    slope, under which a joint creeps, and not a set-valued law.
    """

    joint: str
    coulomb: float
    stiction: float
    stribeck: float
    layer: float


@dataclass(frozen=True)
class Disturbance:
    """A generalised force on `joint` of all rigs from `start` until before `end`, in seconds.

    A sine is amplitude sin(2 pi (frequency t + phase)), t from the flight's start; phase in turns.
    """

    joint: str
    shape: str
    amplitude: float
    start: float = 0.0
    end: float = math.inf
    frequency: float = 0.0
    phase: float = 0.0


@dataclass(frozen=True)
class Push:
    """A push on `joint` of all rigs at `time`: an impulse (N m s), or a force of some duration."""

    joint: str
    time: float
    impulse: float = 0.0
    force: float = 0.0
    duration: float = 0.0


@dataclass(frozen=True)
class Fault:
    """Something that breaks at `time` for `duration` seconds, in `rigs` (in all if empty)."""

    kind: str
    time: float
    duration: float
    joint: str = ""
    counts: int = 0
    parameter: str = ""
    bit: int = 0
    rigs: tuple[int, ...] = ()


@dataclass(frozen=True)
class Order:
    """An order of the operator at `time`: `start`, `stop` or `reset`; seen in one period."""

    time: float
    value: str


@dataclass(frozen=True)
class TwinScenario:
    """A scenario on the twin: `base` is the nominal flight, all else is what a rig adds.

    `spread` and `initial_spread` are half-widths of uniform draws, relative ones of parameters of
    the plant and absolute ones (SI) of the start. `channels` holds an encoder by coordinate, and is
    empty where the controller is told the plant's true state. `tolerance` is the largest error by
    coordinate (SI) at which a rig counts as captured. `control` changes members of the complete
    controller, by path, SI units.
    """

    base: Scenario
    rigs: int = 1
    seed: int = 0
    controller: str = "balance"
    drives: Mapping[str, Drive] = field(default_factory=dict)
    sampling: Sampling = field(default_factory=Sampling)
    channels: Mapping[str, Channel] = field(default_factory=dict)
    frictions: tuple[DryFriction, ...] = ()
    spread: Mapping[str, float] = field(default_factory=dict)
    initial_spread: Mapping[str, float] = field(default_factory=dict)
    disturbances: tuple[Disturbance, ...] = ()
    pushes: tuple[Push, ...] = ()
    faults: tuple[Fault, ...] = ()
    orders: tuple[Order, ...] = (Order(0.0, "start"),)
    tolerance: Mapping[str, float] = field(default_factory=dict)
    first_rig: int = 0
    control: Mapping[str, float | int] = field(default_factory=dict)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the names of the coordinates in order."""
        return self.base.folder.manifest.coordinates

    @property
    def actuators(self) -> tuple[str, ...]:
        """Return the names of the actuators in order."""
        return self.base.folder.manifest.actuators

    @property
    def substeps(self) -> int:
        """Return the substeps of a nominal period."""
        return self.base.plant_substeps

    @property
    def substep(self) -> float:
        """Return the plant's step in seconds."""
        return self.base.sample_time / self.base.plant_substeps

    def alone(self, rig: int) -> TwinScenario:
        """Return this scenario with rig `rig` of it alone, which flies with the same bits."""
        return replace(self, rigs=1, first_rig=self.first_rig + rig)

    def instants(self, seconds: float, most: int) -> int:
        """Return the substep nearest to `seconds`, at most `most`."""
        return round(min(seconds / self.substep, float(most)))

    def periods(self, seconds: float) -> int:
        """Return the nominal period nearest to `seconds`, at most the flight's end."""
        return round(min(seconds / self.base.sample_time, float(self.base.steps)))
