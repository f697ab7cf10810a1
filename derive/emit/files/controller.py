"""Emission of the complete controller: the glue around laws, sensing and supervision, in C."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pfaffian.derive.emit.bounds import measured_bounds
from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.emit.files.c import Body, body_of, member_lines, pointers
from pfaffian.derive.emit.names import comment_text, snake
from pfaffian.derive.emit.precision import DOUBLE, c_literal
from pfaffian.derive.emit.structures import structures_of
from pfaffian.derive.emit.templates import fill
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.names import TIME_NAME
from pfaffian.derive.sets.controller_set import ControllerSettings, form_names, state_names
from pfaffian.runtime.base.checksum import checksum_of
from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.contract.manifest import ABI_VERSION, MEMBER_TYPES, Field, Structure
from pfaffian.runtime.contract.runtime_structs import SENSING, SUPERVISOR

_U32, _REAL = "uint32_t", "double"
_KINDS = {_U32: "u4", _REAL: "f8"}
#: Members of an encoder's parameters that say where the plant is: they may change at rest only.
FIXED_ENCODER = ("counts_per_turn", "offset", "counter_bits", "counter_zero", "direction")
#: Endings of the same place in other turns.
_TURNS = ("_near", "_place")


def control_structures(model: LoweredModel) -> dict[str, Structure]:
    """Return the structures of the complete controller by role; some members are structures."""
    law = structures_of(model)
    members = {
        "control_params": _params(model, law),
        "control_input": _input(model),
        "control_state": _state(model, law),
        "control_output": _output(model, law),
    }
    made = {
        role: Structure(f"{model.name}_{role}_t", tuple(fields)) for role, fields in members.items()
    }
    for structure in made.values():
        _check_members(model, structure.names())
    places = (f"{c.name}{end}" for c in model.coordinates for end in ("", "_goal", *_TURNS))
    _check_members(model, tuple(places))
    return made


def _check_members(model: LoweredModel, names: tuple[str, ...]) -> None:
    """Refuse names of the plant that make two members of the complete controller one."""
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError(
            f"model {model.name}: the complete controller would have two members {twice[0]}",
            remedy="rename a coordinate or an actuator",
        )


def _params(model: LoweredModel, law: Mapping[str, Structure]) -> Iterable[Field]:
    yield Field("law", law["params"].name, "", "parameters of every law")
    for c in model.coordinates:
        yield Field(f"{c.name}_encoder", "pf_sensing_params_t", "", f"encoder of {c.name}")
    yield Field("supervisor", "pf_supervisor_params_t", "", "modes, capture and faults")
    for a in model.actuators:
        for name, unit in zip(state_names(model), _units(model), strict=True):
            text = f"state feedback of {a.name} on {name}"
            yield Field(f"feedback_{a.name}_{name}", _REAL, f"{a.unit} per {unit}", text)
        yield Field(f"rest_{a.name}", _REAL, a.unit, "torque at rest, with state feedback")
    for name, one, other in form_names(model):
        yield Field(name, _REAL, "", f"weight of {one} {other} in the capture form")
    for c in model.coordinates:
        yield Field(f"plan_start_{c.name}", _REAL, c.unit, "largest distance from a plan's start")
        yield Field(f"plan_start_d{c.name}", _REAL, f"{c.unit}/s", "the same of its rate")
        yield Field(f"plan_error_{c.name}", _REAL, c.unit, "beyond it the plan is left")
    yield Field("plan_patience", _REAL, "s", "time after the plan's end until it is left")
    for c in model.coordinates:
        yield Field(f"home_{c.name}", _REAL, c.unit, f"{c.name} at the known place of REZERO")
    for c in model.coordinates:
        yield Field(f"{c.name}_turns", _U32, "", "1 where a whole turn is the same place")
    yield Field(
        "rezero_periods", _U32, "", "at rest before REZERO is obeyed; 0 where no place is known"
    )
    yield Field("plan", _U32, "", "number of the plan, from 1; 0 for none")
    yield Field("swing_up", _U32, "", "law of SWING_UP")
    yield Field("balance", _U32, "", "law of BALANCE")
    yield Field("checksum", _U32, "", "of all the members above")


def _input(model: LoweredModel) -> Iterable[Field]:
    for c in model.coordinates:
        yield Field(f"{c.name}_raw", _U32, "", f"counter of the encoder of {c.name}")
        yield Field(f"{c.name}_valid", _U32, "", "0 where there was no reading")
    yield Field("elapsed", _REAL, "s", "since the last period, as the platform measured it")
    yield Field("frame", _U32, "", "counts up with each new set of readings")
    yield Field("heartbeat", _U32, "", "changes while the operator's side is alive")
    yield Field("command", _U32, "", "one of pf_command_t")


def _state(model: LoweredModel, law: Mapping[str, Structure]) -> Iterable[Field]:
    yield Field("law", law["state"].name, "", "integrals, s(0) and ahat of the law in use")
    for c in model.coordinates:
        yield Field(f"{c.name}_encoder", "pf_sensing_state_t", "", f"encoder of {c.name}")
    yield Field("supervisor", "pf_supervisor_state_t", "", "mode, fault and log")
    for c in model.coordinates:
        yield Field(f"{c.name}_shift", _REAL, c.unit, "whole turns added while the mode lasts")
    for a in model.actuators:
        yield Field(f"{a.name}_applied", _REAL, a.unit, "commanded in the last period")
    yield Field("periods", _U32, "", "since the law was engaged")
    yield Field("phase", _U32, "", "what SWING_UP does")
    yield Field("checksum", _U32, "", "of the parameters last judged")
    yield Field("fixed", _U32, "", "of those among them that may change at rest only")
    yield Field("ready", _U32, "", "1 where init found the parameters good, 2 bad arithmetic")
    yield Field("seal", _U32, "", "checksum of all but the supervisor's memory")


def _output(model: LoweredModel, law: Mapping[str, Structure]) -> Iterable[Field]:
    for a in model.actuators:
        yield Field(a.name, _REAL, a.unit, "torque, slew and limit kept")
    for name, unit in zip(state_names(model), _units(model), strict=True):
        yield Field(name, _REAL, unit, "as the law was given it")
    yield Field(
        "law", law["output"].name, "", "of the law in use, else of the balance law on trial"
    )
    yield Field(model.own("energy_error"), _REAL, "J", "energy less that of the goal")
    yield Field("form", _REAL, "", "quadratic form of the capture set")
    for name, text in (
        ("mode", "one of pf_mode_t"),
        ("fault", "one of pf_fault_t"),
        ("reason", "of the last transition, one of pf_reason_t"),
        ("phase", "what SWING_UP does"),
        ("position", "PF_POSITION_ bits: what is known of it, what became of REZERO"),
        ("law_status", "status of the law in use, also where it is the reason of a fault"),
    ):
        yield Field(name, _U32, "", text)


def _units(model: LoweredModel) -> list[str]:
    units = [c.unit for c in model.coordinates]
    return [*units, *(f"{u}/s" for u in units)]


def emit_control(emission: Emission) -> dict[str, str]:
    """Return header and source of the complete controller, where the model has one."""
    model = emission.model
    if not emission.controls or emission.precision is not DOUBLE:
        return {}
    context = _context(emission)
    return {
        f"c/{model.name}_control.{ending}": fill(f"c/controller.{ending}.j2", context)
        for ending in ("h", "c")
    } | {f"c/{model.name}_control_params.c": fill("c/controller_params.c.j2", context)}


def _reference(model: LoweredModel) -> dict[str, str]:
    """Return the member of a reference that is wanted of q, q' and q'', by their names."""
    names = [c.name for c in model.coordinates]
    motion = [f"{d}{c}" for d in ("", "d", "dd") for c in names]
    return dict(zip(motion, model.own.reference(names), strict=False))


def _context(emission: Emission) -> dict[str, object]:
    model = emission.model
    law, own = structures_of(model), control_structures(model)
    states = law["state"].names()
    setpoint = body_of(model.program("setpoint"), pointers(parameter="law"), DOUBLE.dialect)
    members = [f for f in own["control_params"].fields if f.name not in ("law", "checksum")]
    doubles = [f.name for f in members if f.type == _REAL]
    return {
        "header": "\n".join(["/*", *(f" * {line}" for line in emission.banner()), " */"]),
        "abi": ABI_VERSION,
        "model": model.name,
        "own": model.own,
        "guard": model.name.upper(),
        "title": comment_text(model.title),
        "structures": {
            role: {"name": s.name, "members": member_lines(s), "names": s.names()}
            for role, s in (law | own).items()
        },
        "coordinates": [c.name for c in model.coordinates],
        "ref": _reference(model),
        "actuators": [a.name for a in model.actuators],
        "bounds": {n: DOUBLE.literal(b) for n, b in measured_bounds(model)},
        "plans": [snake(p.name) for p in emission.plans],
        "has_swing_up": model.has_program("swing_up"),
        "has_time": TIME_NAME in law["input"].names(),
        "setpoint": _setpoint(setpoint),
        "encoder_checksum": _sums("encoder", SENSING["params"]),
        "supervisor_checksum": _sums("supervisor", SUPERVISOR["params"]),
        "law_memory_checksum": _sums("law", _kinds(law["state"].fields)),
        "encoder_memory_checksum": _sums("encoder", SENSING["state"]),
        "own_memory_checksum": _sums(
            "state", _kinds(f for f in own["control_state"].fields if f.name != "seal")
        ),
        "own_doubles": doubles,
        "own_words": [f.name for f in members if f.type == _U32],
        "tolerances": [n for n in doubles if n.startswith("plan_")],
        "fixed_encoder": _sums("encoder", [m for m in SENSING["params"] if m[0] in FIXED_ENCODER]),
        "form": form_names(model),
        "residuals": model.own.numbered("s"),
        "threshold": "singular_threshold",
        "sample_time": "sample_time",
        "nominal": dict(
            zip((a.name for a in model.actuators), model.own.of_actuators("p1"), strict=True)
        ),
        "previous": [
            (name, a.name)
            for a in model.actuators
            if (name := model.own.previous(a.name)) in states
        ],
        "limits": [
            (a.name, limit, slew)
            for a, limit, slew in zip(model.actuators, model.limits, _slews(model), strict=True)
        ],
        "control_sets": [_constants(emission, c) for c in emission.controls],
    }


def _setpoint(body: Body) -> dict[str, object]:
    text = " ".join((*body.lines, *body.results.values()))
    return {"lines": body.lines, "results": body.results, "reads_parameters": "law->" in text}


def _slews(model: LoweredModel) -> tuple[str, ...]:
    return model.slews or ("",) * len(model.actuators)


def _sums(pointer: str, members: Iterable[tuple[Any, ...]]) -> list[str]:
    """Return one statement a scalar member: it enters the checksum."""
    lines = []
    for name, kind, *length in members:
        if length:
            continue  # arrays come first, in a loop of their own
        if kind == "f8":
            lines.append(f"sum = pf_checksum_double(sum, {pointer}->{name});")
        elif kind == "i8":
            whole = f"(uint64_t){pointer}->{name}"
            for half in (f"({whole} >> 32)", f"({whole} & 0xffffffffU)"):
                lines.append(f"sum = pf_checksum_word(sum, (uint32_t){half});")
        elif kind in ("u4", "i4"):
            cast = "(uint32_t)" if kind == "i4" else ""
            lines.append(f"sum = pf_checksum_word(sum, {cast}{pointer}->{name});")
    return lines


def _kinds(fields: Iterable[Field]) -> list[tuple[str, str]]:
    """Return (name, NumPy type) of the members that are no structures."""
    return [(f.name, MEMBER_TYPES[f.type]) for f in fields if f.type in MEMBER_TYPES]


def _constants(emission: Emission, control: ControllerSettings) -> dict[str, object]:
    """Return the initialiser of one constant controller, its checksum included."""
    model = emission.model
    values = control_constants(emission, control)
    return {
        "name": f"{model.name}_control_{snake(control.name)}",
        "title": comment_text(control.title),
        "source": textwrap.wrap(comment_text(control.source), 90),
        "groups": [
            (g, [(n, _literal(n, v)) for n, v in rows.items()])
            for g, rows in values.items()
            if isinstance(rows, dict)
        ],
        "own": [(n, _literal(n, v)) for n, v in values.items() if not isinstance(v, dict)],
    }


def control_constants(emission: Emission, control: ControllerSettings) -> dict[str, Any]:
    """Return the values of one complete controller as its structure nests them, checksum last."""
    model = emission.model
    law = next(s for s in emission.sets if s.name == control.name).as_dict()
    names = structures_of(model)["params"].names()
    values: dict[str, Any] = {"law": {n: law[n] for n in names}}
    for coordinate, encoder in control.encoders.items():
        values[f"{coordinate}_encoder"] = {n: _typed(k, encoder[n]) for n, k in SENSING["params"]}
    values["supervisor"] = {
        n: _typed(k, control.supervisor[n]) for n, k, *_ in SUPERVISOR["params"]
    }
    for member in control_structures(model)["control_params"].fields:
        if member.name in control.own:
            values[member.name] = _typed(_KINDS[member.type], control.own[member.name])
    return {**values, "checksum": checksum_of(_words(values))}


def _typed(kind: str, value: Any) -> Any:
    if isinstance(value, list):
        return [float(v) for v in value]
    return float(value) if kind == "f8" else int(value)


def _words(values: Mapping[str, Any]) -> Iterator[float | int]:
    """Yield every value in the order in which the C code sums them up."""
    ordered = [v for v in values.items() if not isinstance(v[1], dict)]
    for group in [v for v in values.values() if isinstance(v, dict)]:
        rows = [v for v in group.values() if isinstance(v, list)]
        for together in zip(*rows, strict=True):
            yield from together
        yield from (v for v in group.values() if not isinstance(v, list))
    yield from (v for _, v in ordered if isinstance(v, float))
    yield from (v for _, v in ordered if isinstance(v, int))


def _literal(name: str, value: Any) -> str:
    if isinstance(value, list):
        return "{" + ", ".join(c_literal(float(v)) for v in value) + "}"
    if isinstance(value, int):
        return str(value) if name == "direction" else f"{value}U"
    return c_literal(float(value))
