"""The structures of the generated code: one declaration that C, Python and the manifest share."""

from __future__ import annotations

from collections.abc import Mapping

from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.names import TIME_NAME
from pfaffian.derive.ir.program import Op, Program, Signal
from pfaffian.runtime.contract.manifest import Field, Structure

STATUS = (
    *("OK", "SATURATED", "NEAR_SINGULAR", "BAD_INPUT", "BAD_PARAMETER", "NUMERIC"),
    *("NOT_READY", "BAD_ARITHMETIC"),
)
STATUS_TEXT = {
    "OK": "the law was applied as derived",
    "SATURATED": "the torque is at its limit; integral and adaptation are held",
    "NEAR_SINGULAR": "|ADB| is below its threshold; the nominal part is scaled down",
    "BAD_INPUT": "a measurement is not inside its bound or no number; torque 0, state kept",
    "BAD_PARAMETER": "a parameter is not finite or out of its bounds",
    "NUMERIC": "a result was not finite or beyond the limit; torque 0, state kept",
    "NOT_READY": "init has not prepared the state, or has refused it; torque 0, state kept",
    "BAD_ARITHMETIC": "of init alone: this build or processor does not compute as IEEE 754 demands",
}


def witness_of(structures: Mapping[str, Structure], prepare: Program) -> str:
    """Return the member of the state that says whether it was prepared; empty where none can.

    That is half the sample time, which is positive wherever `init` accepts the parameters.
    """
    for signal, index in zip(prepare.outputs, prepare.results, strict=True):
        made = prepare.instructions[index]
        given = [prepare.instructions[a] for a in made.args]
        halves = made.op is Op.MUL and any(i.op is Op.CONST and i.value > 0.0 for i in given)
        if halves and any(i.op is Op.INPUT and i.name == "sample_time" for i in given):
            return signal.name if signal.name in structures["state"].names() else ""
    return ""


def _fields(signals: list[Signal], real: str, truth: str = "") -> tuple[Field, ...]:
    """Return the members that hold `signals`; the one called `truth` is no real number."""
    unique: dict[str, Signal] = {}
    for s in signals:
        if unique.setdefault(s.name, s) != s:
            raise ValueError(f"two members called {s.name}: {unique[s.name]} and {s}")
    return tuple(
        Field(s.name, "uint32_t" if s.name == truth else real, s.unit, s.description)
        for s in unique.values()
    )


def _group(program: Program, *groups: str) -> list[Signal]:
    return [s for s in program.inputs if s.group in groups]


def structures_of(
    model: LoweredModel,
    real: str = "double",
    step: Program | None = None,
    prepare: Program | None = None,
    *,
    follow: bool = False,
) -> dict[str, Structure]:
    """Return the structures of `model` by role, members of type `real` in order of declaration.

    With `follow` there is the reference of the following law as well. `step` and `prepare` replace
    the model's own where a parameter set is folded into them.
    """
    whole = (model.program("step"), model.program("prepare"))
    step, prepare = step or whole[0], prepare or whole[1]
    continuous, acceleration = model.program("continuous"), model.program("acceleration")
    swing_up = [model.program("swing_up")] if model.has_program("swing_up") else []
    declared = [p.name for p in model.parameters]

    def parameters(*programs: Program) -> tuple[Field, ...]:
        taken = {s.name: s for p in programs for s in _group(p, "parameter")}
        return _fields([taken[n] for n in declared if n in taken], real)

    # What init prepares keeps the unit and the meaning that the preparing program gives it.
    prepared = {s.name: s for s in prepare.outputs if s.group == "prepared"}
    state = [prepared.get(s.name, s) for s in _group(step, "state", "prepared")]
    outputs = [s for s in step.outputs if s.group == "output"]
    # Every coordinate, also one on which nothing but its own integral depends (a cart's position).
    motion = tuple(Field(c.name, real, c.unit, c.description) for c in model.coordinates) + tuple(
        Field(f"d{c.name}", real, f"{c.unit}/s", f"rate of {c.name}") for c in model.coordinates
    )
    # The caller supplies the time of a time-varying constraint with each measurement.
    timed = [s for s in (*step.inputs, *continuous.inputs) if s.name == TIME_NAME]
    roles = {
        "params": parameters(*whole, continuous, *swing_up),
        "input": motion + _fields(timed, real),
        "state": _fields(state, real, model.own("engaged")),
        "output": _fields(outputs, real),
        "continuous_state": _fields(_group(continuous, "state"), real),
        "continuous_output": _fields(list(continuous.outputs), real),
        "plant_params": parameters(acceleration, model.program("energy")),
        "plant_state": motion,
        "plant_input": tuple(Field(a.name, real, a.unit, a.description) for a in model.actuators),
        "plant_rate": _fields(list(acceleration.outputs), real),
    }
    for program in swing_up:
        leaving = [s for s in program.outputs if s.group == "output"]
        roles["swing_up_output"] = _fields(leaving, real)
    if follow:  # the row's entries too that the law does not read
        roles["reference"] = _fields(_group(model.program("follow"), "reference"), real)
    return {role: Structure(f"{model.name}_{role}_t", fields) for role, fields in roles.items()}
