"""A model in Python: what can be done with it, each thing a function that the commands share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.api.design import assignments, joined, pole_text

if TYPE_CHECKING:
    from pfaffian.api.checking import Build, Certificate, Verification
    from pfaffian.api.code import GeneratedFiles
    from pfaffian.api.design import DesignResult, MotionPlan
    from pfaffian.api.equations import Equations
    from pfaffian.api.flights import Trajectory
    from pfaffian.api.loops import Batch, ClosedLoop, Controller, LinearSystem
    from pfaffian.api.main_job import Report
    from pfaffian.api.parameters import Parameters
    from pfaffian.derive.ir.lowered import LoweredModel
    from pfaffian.derive.spec.library import ModelFolder
    from pfaffian.runtime.code.generated_model import GeneratedFolder
    from pfaffian.runtime.flight.scenario import Scenario

Quantities = Mapping[str, Any]


def load(reference: str | Path) -> Model:
    """Return the model called `reference`, or the one in that folder.

    Raises `InputError` naming the known models where there is neither.
    """
    from pfaffian.derive.spec.library import find_model

    return Model(find_model(str(reference)))


@dataclass(frozen=True)
class Model:
    """A plant with its servo-constraint: from `load`.

    Where a parameter set `p` is wanted, give what `parameters` returned, a set's name, its TOML
    file as a path, or nothing: then it is the model's first.
    """

    _folder: ModelFolder

    @property
    def name(self) -> str:
        """Return the model's name."""
        return self._folder.name

    @property
    def folder(self) -> Path:
        """Return the folder of its specification and sets."""
        return self._folder.path

    @property
    def sets(self) -> tuple[str, ...]:
        """Return the names of its parameter sets."""
        return tuple(self._folder.sets())

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Return the scenarios of it that `simulate` takes, by name."""
        return tuple(self._scenario_paths())

    def __repr__(self) -> str:
        """Return one line."""
        return f"<model {self.name}: sets {', '.join(self.sets) or 'none'}>"

    def _repr_latex_(self) -> str:
        return self.derive()._repr_latex_()

    def derive(self) -> Equations:
        """Return M, C, G, B, A, b, ADB, p1 and what was proved, in SymPy."""
        from pfaffian.api.equations import equations_of
        from pfaffian.derive.pipeline import derivation_of

        return equations_of(derivation_of(self._folder))

    def parameters(self, chosen: str | Path | None = None, /, **changes: Any) -> Parameters:
        """Return a set completed and judged, with `changes` such as `m2="0.8 kg"`.

        Changes are what may stand in a TOML file that extends the set: with units, and lumped and
        synthesised values follow. Raises `InputError` as for a file.
        """
        from pfaffian.api.parameters import read_parameters

        return read_parameters(self._lowered, self._folder, chosen, changes)

    def linearisation(self, p: Parameters | str | Path | None = None) -> LinearSystem:
        """Return A, B, C, D of the plant about its setpoint at rest, without control."""
        from pfaffian.api.loops import linear_system

        return linear_system(self._lowered, self._taken(p))

    def linearise(self, p: Parameters | str | Path | None = None) -> Any:
        """Return the plant about its setpoint as a `StateSpace` of python-control.

        Raises `MissingToolError` where that is not installed; `linearisation` does without.
        """
        return self.linearisation(p).to_control()

    def controller(self, p: Parameters | str | Path | None = None) -> Controller:
        """Return a controller that is stepped a period at a time, compiled where a compiler is."""
        from pfaffian.runtime.code.compiled import compiled_model

        parameters = self._taken(p)
        model = compiled_model(self._code.path)
        names = self._code.manifest.structures["params"].names()
        made: Controller = model.Controller(model.Params(**{n: parameters[n] for n in names}))
        return made

    def batch(self, p: Parameters | str | Path | None = None) -> Batch:
        """Return many controllers with states of their own, stepped together."""
        from pfaffian.api.loops import Batch

        return Batch(self._code, self._taken(p))

    def closed_loop(
        self,
        p: Parameters | str | Path | None = None,
        *,
        plant: Mapping[str, float] | None = None,
    ) -> ClosedLoop:
        """Return the plant under the continuous law; its `rhs(t, x)` is for an ODE solver.

        `plant` has, in SI units, what the plant differs in from what the law knows.
        """
        from pfaffian.api.loops import ClosedLoop

        return ClosedLoop(self._code, self._taken(p), plant or {})

    def simulate(
        self,
        scenario: str | Path,
        p: Parameters | str | Path | None = None,
        *,
        controller: Quantities | None = None,
        plant: Quantities | None = None,
        **changes: Any,
    ) -> Trajectory:
        """Fly a scenario on this machine, with the scenario's set or that of `p`.

        `changes` are of the start (`q1="1 rad"`), of `duration` and `plant_substeps`, or of the
        set, as `parameters` has them; `controller` and `plant` change one of the two alone.
        """
        from pfaffian.api.flights import fly_host, trajectory_of

        path = self._scenario_path(str(scenario))
        tables = {"controller": controller or {}, "plant": plant or {}}
        return trajectory_of(fly_host(self._scenario(path, p, changes, tables))[0])

    def design(
        self,
        p: Parameters | str | Path | None = None,
        *,
        poles: Sequence[complex | str] = (),
        riccati: Sequence[float] = (),
        delay: str = "",
        friction: Quantities | None = None,
        box: Quantities | None = None,
        curve: bool = False,
    ) -> DesignResult:
        """Choose gains by `poles` of the zero dynamics in 1/s, or by weights Q1, ..., Q2n[, R].

        `delay` such as "5 ms" proposes kappa; `friction` and `box` are as `pfaffian design` has
        them: {"joint2_viscous": 0.001}, {"theta3": "5%"}. With none of them the set is assessed.
        """
        from pfaffian.api.design import design
        from pfaffian.derive.design.study import Wishes

        wishes = Wishes(
            poles=joined(pole_text(pole) for pole in poles),
            riccati=joined(riccati),
            friction=assignments(friction),
            box=assignments(box),
            delay=delay,
            curve=curve,
        )
        return design(self._lowered, self._raw(p), wishes)

    def plan(
        self,
        p: Parameters | str | Path | None = None,
        *,
        end_time: str = "",
        torque_limit: str = "",
        speed_limit: str = "",
        weights: Quantities | None = None,
        start: Quantities | None = None,
        riccati: Sequence[float] = (),
        seeds: int = 12,
        seed: int = 0,
        coarse: int = 40,
        nodes: int = 150,
    ) -> MotionPlan:
        """Plan a motion from rest to the setpoint, as `pfaffian plan` does, and check it."""
        from pfaffian.api.design import plan
        from pfaffian.derive.pipeline import derivation_of
        from pfaffian.derive.plan.wishes import Wishes

        wishes = Wishes(
            end_time=end_time,
            torque_limit=torque_limit,
            speed_limit=speed_limit,
            weights=assignments(weights),
            start=assignments(start),
            riccati=joined(riccati),
            seeds=seeds,
            seed=seed,
            coarse=coarse,
            nodes=nodes,
        )
        return plan(derivation_of(self._folder), self._taken(p), wishes)

    def generate(
        self,
        folder: str | Path,
        p: Parameters | str | Path | None = None,
        *,
        bake: bool = False,
        jacobians: bool = False,
        batch: bool = False,
        precision: str = "double",
        plan: str | Path | None = None,
    ) -> GeneratedFiles:
        """Write C, Python, the readable derivation and a manifest into `folder`, all or nothing.

        Without `p` all complete sets of the model are generated.
        """
        from pfaffian.api.code import written
        from pfaffian.derive.generate_model import Extras, Sets

        extras = Extras(bake, jacobians, batch, precision, None if plan is None else Path(plan))
        wanted = Sets() if p is None else Sets(given=(self._taken(p)._set,))
        return written(self._folder, Path(folder), wanted, extras)

    def verify(
        self,
        *,
        samples: int = 10_000,
        target_samples: int | None = None,
        sets: Sequence[str] = (),
        generated: str | Path | None = None,
    ) -> Verification:
        """Check generated Python, host C and PowerPC C against the symbolic source at 60 digits.

        `generated` is a folder of its code to check instead of the code that this model runs on.
        """
        from pfaffian.api.checking import verification, verified

        code = self._code.path if generated is None else Path(generated)
        found = verification(self._reference, samples, target_samples, code, sets)
        return verified(self.name, found)

    def build(self, target: str | Path = "ppc750", *, toolchain: str = "auto") -> Build:
        """Compile the controller for a target: its image, and what it costs there."""
        from pfaffian.api.checking import build

        return build(self._code, str(target), toolchain)

    def certify(
        self,
        p: Parameters | str | Path | None = None,
        *,
        scenario: str | Path | None = None,
        region: Quantities | None = None,
        **changes: Any,
    ) -> Certificate:
        """Put Theorem 1 into numbers over a region, beside a flight of the continuous law.

        `scenario` is the model's first unless it is given, `region` such as {"q1": "1:2", "rate":
        8}, in rad and rad/s; `changes` are those of `simulate`.
        """
        from pfaffian.api.checking import certificate_of, certified
        from pfaffian.api.display import keywords
        from pfaffian.derive.pipeline import derivation_of
        from pfaffian.runtime.flight.scenario_files import report_scenarios

        name = scenario or report_scenarios(self.name, self._folder.scenarios())[0]
        flown = self._scenario(self._scenario_path(str(name)), p, changes, {})
        with keywords():
            found = certified(derivation_of(self._folder), flown, assignments(region), "")
        return certificate_of(found)

    def run(
        self,
        p: Parameters | str | Path | None = None,
        *,
        scenario: str | Path | None = None,
        samples: int = 20_000,
    ) -> Report:
        """Generate, verify, build for PowerPC, fly in the loop, and report: the main job.

        It flies `scenario`, or those marked for the report; with `p` that set alone is generated
        and flown, and no scenario on the twin.
        """
        from pfaffian.api.code import fresh_code
        from pfaffian.api.main_job import Job, check_tools, report_of
        from pfaffian.derive.generate_model import Sets
        from pfaffian.runtime.flight.scenario_files import report_scenarios, report_twin

        own = self._folder.scenarios()
        twin = None
        if scenario is None:
            flown = report_scenarios(self.name, own)
            twin = report_twin(self.name, own) if p is None else None
        else:
            flown = [str(self._scenario_path(str(scenario)))]
        wanted, name = Sets(whole=True), None
        if p is not None:
            chosen = self._taken(p)
            wanted, name = Sets(given=(chosen._set,)), chosen.name
        check_tools()
        code = fresh_code(self._folder, self, wanted)
        return report_of(Job(self._reference, flown, twin, samples, name), code.path)

    @property
    def _reference(self) -> str:
        """Return what `find_model` takes to find this model again."""
        from pfaffian.derive.spec.library import library_models

        own = self._folder == library_models().get(self.name)
        return self.name if own else str(self._folder.path)

    @cached_property
    def _lowered(self) -> LoweredModel:
        from pfaffian.derive.pipeline import lowered_model

        return lowered_model(self._folder)

    @cached_property
    def _code(self) -> GeneratedFolder:
        from pfaffian.api.code import current_code

        return current_code(self._folder, self._lowered, self)

    def _taken(
        self, p: Parameters | str | Path | None, changes: Quantities | None = None
    ) -> Parameters:
        from pfaffian.api.parameters import Parameters, changed_parameters

        if isinstance(p, Parameters):
            return changed_parameters(self._lowered, p, changes or {})
        return self.parameters(p, **(changes or {}))

    def _raw(self, p: Parameters | str | Path | None) -> Any:
        from pfaffian.api.parameters import Parameters, raw_set

        return p._raw if isinstance(p, Parameters) else raw_set(self._lowered, self._folder, p, {})

    def _scenario_paths(self) -> dict[str, Path]:
        from pfaffian.runtime.flight.scenario_files import find_scenario, scenarios_of

        documents = scenarios_of(self.name, self._folder.scenarios())
        return {
            find_scenario(n).stem: find_scenario(n) for n in documents if "twin" not in documents[n]
        }

    def _scenario_path(self, scenario: str) -> Path:
        """Return the file of a scenario: one of the model's own by name, or any as a path."""
        from pfaffian.runtime.base.errors import InputError
        from pfaffian.runtime.base.toml import read_toml, suggestion
        from pfaffian.runtime.flight.scenario_files import find_scenario

        own = self._folder.scenarios()
        path = own[scenario] if scenario in own else find_scenario(scenario)
        flown = read_toml(path).get("model")
        if flown != self.name and path not in own.values():
            known = list(self._scenario_paths())
            raise InputError(
                f"scenario {scenario} flies {flown}, not {self.name}",
                remedy=suggestion(scenario, known),
            )
        return path

    def _scenario(
        self,
        path: Path,
        p: Parameters | str | Path | None,
        changes: Quantities,
        tables: Mapping[str, Quantities],
    ) -> Scenario:
        """Return the scenario in `path` with the set `p`, where one is given, and `changes`."""
        from pfaffian.api.flights import changed_scenario, is_of_flight
        from pfaffian.runtime.base.toml import read_toml

        of_flight = {n: v for n, v in changes.items() if is_of_flight(n, self._code)}
        of_set = {n: v for n, v in changes.items() if n not in of_flight}
        chosen = None
        if p is not None or of_set:
            taken = self._taken(str(read_toml(path).get("set", "")) if p is None else p, of_set)
            chosen = taken.name, taken
        return changed_scenario(path, self._code, chosen, of_flight, tables)
