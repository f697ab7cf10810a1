"""The plant linearised, the closed loop as a right-hand side, and many controllers at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from pfaffian.runtime.base.errors import InputError, MissingToolError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike
    from pfaffian.api.parameters import Parameters
    from pfaffian.derive.ir.lowered import LoweredModel
    from pfaffian.runtime.code.generated_model import GeneratedFolder

    Array = np.ndarray[Any, np.dtype[Any]]


class Controller(Protocol):
    """One controller of one plant, stepped a period at a time; compiled where a compiler is."""

    compiled: bool

    def step(self, *measured: float, **named: float) -> Any:
        """Return the torque of one period: a float, or a tuple for several actuators."""

    @property
    def status(self) -> str:
        """Return the name of the last step's status."""

    def reset(self) -> None:
        """Go back to before the first period."""

    def prepare(self, **changes: float) -> None:
        """Change parameters, in SI units, between two periods."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearSystem:
    """x' = A x + B u, y = C x + D u about the setpoint at rest, without control.

    x = (q - q_d, q') of shape (2n,), u the torques beside those that hold the setpoint, (m,); y is
    x. `states` and `inputs` name them.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]

    def to_control(self) -> Any:
        """Return it as a `StateSpace` of python-control.

        Raises `MissingToolError` where that is not installed.
        """
        try:
            import control
        except ImportError as error:
            raise MissingToolError(
                "python-control is not installed, which a StateSpace is of",
                remedy="pip install control, or pfaffian[notebook]; linearisation() returns "
                "A, B, C and D without it",
            ) from error
        names = {"states": list(self.states), "inputs": list(self.inputs)}
        return control.ss(self.A, self.B, self.C, self.D, outputs=list(self.states), **names)


def linear_system(model: LoweredModel, parameters: Parameters) -> LinearSystem:
    """Linearise the plant of `parameters`: M x2' + D x2 + K x1 = B u at the setpoint."""
    import numpy as np
    from pfaffian.derive.ir.evaluate import evaluate

    found = evaluate(model.program("linearisation"), dict(parameters))
    n, m = len(model.coordinates), len(model.actuators)

    def matrix(name: str, columns: int) -> Array:
        rows = range(1, n + 1)
        return np.array([[found[f"{name}_{i}_{j + 1}"] for j in range(columns)] for i in rows])

    parts = [-matrix("stiffness", n), -matrix("damping", n), matrix("input", m)]
    solved = np.linalg.solve(matrix("mass", n), np.hstack(parts))
    names = tuple(c.name for c in model.coordinates)
    return LinearSystem(
        A=np.block([[np.zeros((n, n)), np.eye(n)], [solved[:, : 2 * n]]]),
        B=np.vstack([np.zeros((n, m)), solved[:, 2 * n :]]),
        C=np.eye(2 * n),
        D=np.zeros((2 * n, m)),
        states=(*names, *(f"d{name}" for name in names)),
        inputs=tuple(a.name for a in model.actuators),
    )


class ClosedLoop:
    """The plant under the continuous law (15)-(23), as a right-hand side for an ODE solver."""

    def __init__(
        self, code: GeneratedFolder, parameters: Parameters, plant: Mapping[str, float]
    ) -> None:
        """Close the loop; `plant` has what the plant differs in, or has besides, in SI units."""
        from pfaffian.runtime.code.generated_model import host_model
        from pfaffian.runtime.flight.continuous import ContinuousLoop
        from pfaffian.runtime.flight.scenario import Scenario

        structures = code.manifest.structures
        names = {r: structures[r].names() for r in ("params", "plant_params", "plant_state")}
        controller = {n: parameters[n] for n in names["params"]}
        module = code.python_module()
        setpoint = module.setpoint(module.Params(**controller))
        self.setpoint = {n: float(v) for n, v in setpoint.items()}
        scenario = Scenario(
            name=f"the loop of {parameters.name}",
            title="",
            source="",
            folder=code,
            set_name=parameters.name,
            steps=1,
            plant_substeps=1,
            initial=dict.fromkeys(names["plant_state"], 0.0) | self.setpoint,
            controller=controller,
            plant={n: plant.get(n, parameters.get(n, 0.0)) for n in names["plant_params"]},
            setpoint=self.setpoint,
            in_report=False,
        )
        self._loop = ContinuousLoop(scenario, host_model(code))
        #: Names of the entries of a whole state, in order.
        self.states = (
            *self._loop.channels,
            *self._loop.numbered("drift_integral"),
            self._loop.own("bound_estimate"),
        )
        self._short, self._rest = len(self._loop.channels), self._loop.start[len(self.channels) :]

    @property
    def channels(self) -> tuple[str, ...]:
        """Return the names of (q, q')."""
        return tuple(self._loop.channels)

    def start(self, x: ArrayLike) -> Array:
        """Return the whole state in which the law is engaged at `x` = (q, q'), shape (2n,)."""
        import numpy as np

        return np.concatenate([self._checked(x, (self._short,)), self._rest])

    def rhs(self, t: float, x: ArrayLike) -> Array:
        """Return dx/dt at `t` in s, for x = (q, q') or the whole state, as `start` returns it.

        The whole state holds integrals of the drift and the estimate ahat besides. For (q, q')
        alone the law counts as engaged where it is: beta = 0 and the torque is p1, which is the
        whole law as long as nothing disturbs the plant.
        """
        self._loop.evaluations = 0
        whole = self._checked(x, (self._short, len(self.states)))
        if len(whole) == len(self.states):
            return self._loop(t, whole)
        started = self.start(whole)
        self._loop.engage(started, t)
        return self._loop(t, started)[: self._short]

    def engage(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Engage the law at `x` = (q, q'): return the whole state to integrate from there."""
        whole = self.start(x)
        self._loop.engage(whole, t)
        return whole

    def _checked(self, x: ArrayLike, sizes: tuple[int, ...]) -> Array:
        import numpy as np

        array = np.asarray(x, float)
        if array.ndim != 1 or len(array) not in sizes:
            raise InputError(
                f"a state has shape {array.shape}, not {' or '.join(f'({n},)' for n in sizes)}",
                remedy=f"give {', '.join(self.channels)}"
                + (" or the whole state, from engage(x)" if len(sizes) > 1 else ""),
            )
        return array

    def __repr__(self) -> str:
        """Return one line."""
        return f"<closed loop with {self._loop.scenario.set_name}: {', '.join(self.states)}>"


class Batch:
    """Many controllers of one plant, each with a state of its own, stepped together."""

    def __init__(self, code: GeneratedFolder, parameters: Parameters) -> None:
        """Start controllers with `parameters`; how many there are the first step says."""
        from pfaffian.runtime.code.compiled import compiled_model

        self._model = compiled_model(code.path)
        names = code.manifest.structures["params"].names()
        self._params = self._model.Params(**{n: parameters[n] for n in names})
        self._signals = code.manifest.structures["input"].names()
        self._actuators = code.manifest.actuators
        #: Whether C runs behind the call.
        self.compiled = self._model.compiled
        #: The statuses of the last step, int32 of shape (k,), empty before it.
        self.status: Array
        self.reset()

    def reset(self) -> None:
        """Go back to before the first period; the next step may have another number of them."""
        import numpy as np

        self._state = self._model.init(self._params)[0]
        self._count = 0
        self.status = np.zeros(0, np.int32)

    def step(self, measured: ArrayLike) -> Array:
        """Return the torques (k, m) of one period for measurements (k, 2n), in SI units.

        The columns are those of `Controller.step`, in order. Raises `InputError` for another
        shape; a value out of range is a status, with torque 0.
        """
        import numpy as np

        array = np.asarray(measured, float)
        wanted = (self._count or "k", len(self._signals))
        if array.ndim != 2 or array.shape[1] != wanted[1] or wanted[0] not in ("k", len(array)):
            raise InputError(
                f"measurements have shape {array.shape}, not ({wanted[0]}, {wanted[1]})",
                remedy=f"give a row of {', '.join(self._signals)} for each controller; reset() "
                "begins with another number of them",
            )
        columns = dict(zip(self._signals, array.T, strict=True))
        given = self._model.Input(**columns)
        self._state, output, status = self._model.step(self._state, self._params, given)
        self._count, self.status = len(array), np.broadcast_to(status, len(array))
        torques = [np.broadcast_to(getattr(output, a), len(array)) for a in self._actuators]
        return np.stack(torques, axis=1)
