"""The batch form in C99: structures of arrays, and loops that a compiler vectorises."""

from __future__ import annotations

from dataclasses import replace

from pfaffian.derive.emit.bounds import input_bounds
from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.emit.files.c import Body, body_of, dialect_of, domain, pointers
from pfaffian.derive.emit.finiteness import with_finiteness_checks
from pfaffian.derive.emit.local_names import C_PLANT_LOCALS, C_SAMPLE_LOCALS
from pfaffian.derive.emit.names import comment_text
from pfaffian.derive.emit.precision import DOUBLE, c_literal
from pfaffian.derive.emit.structures import structures_of, witness_of
from pfaffian.derive.emit.templates import fill
from pfaffian.derive.ir.program import Op, Signal
from pfaffian.runtime.contract.manifest import Structure

#: Roles that have a structure of arrays, and whether what they hold is only read.
BATCH_ROLES = {
    "params": True,
    "input": True,
    "state": False,
    "output": False,
    "plant_params": True,
    "plant_state": False,
    "plant_input": True,
    "plant_rate": False,
}
#: No branch and no call: a truth is an int, both sides of every choice are computed.
SAMPLE = replace(
    DOUBLE.inline,
    patterns={
        **DOUBLE.inline.patterns,
        Op.SQRT: "pf_sqrt_lane({0})",
        Op.SIN: "pf_sin_lane({0})",
        Op.COS: "pf_cos_lane({0})",
        Op.ATAN: "pf_atan_lane({0})",
        Op.TANH: "pf_tanh_lane({0})",
        Op.FNMS: "pf_fnms_lane({0}, {1}, {2})",
        Op.AND: "({0} & {1})",
        Op.OR: "({0} | {1})",
    },
    sincos="pf_sincos_lane",
    plain_sincos="pf_sincos_within_lane",
)


def _member_lines(structure: Structure, read_only: bool) -> list[str]:
    kind = "const " if read_only else ""
    return [
        f"{kind}{f.type} *PF_RESTRICT {f.name};"
        + (f" /* [{comment_text(f.unit)}] */" if f.unit else "")
        for f in structure.fields
    ]


def _batch_name(emission: Emission, role: str) -> str:
    return f"{emission.model.name}_batch_{role}_t"


def _step(emission: Emission) -> tuple[Body, list[str]]:
    """Return the body of the step of one sample, and the values that say it is finite."""
    program, checks = with_finiteness_checks(emission.step)
    engaged = emission.model.own("engaged")
    member = pointers(
        input="input", state="state", prepared="state", parameter="params", baked="baked"
    )

    def place(index: int, signal: Signal) -> str:
        return "engaged" if signal.name == engaged else member(index, signal)

    reserved = C_SAMPLE_LOCALS - {engaged}  # the argument itself, unless a person has the name
    dialect = dialect_of(emission.model, SAMPLE, reserved)
    body = body_of(program, place, dialect, input_bounds(emission.model))
    return body, [body.results[name] for name in checks]


def emit_batch(emission: Emission) -> dict[str, str]:
    """Return the C files of the batch form of `emission` by path.

    The bits of every sample are those of the scalar functions: the same programs, with elementary
    functions that choose where the others branch.
    """
    model = emission.model
    structures = structures_of(model, step=emission.step, prepare=emission.prepare)
    step, checked = _step(emission)
    of_plant = dialect_of(model, SAMPLE, C_PLANT_LOCALS)
    plant = pointers(input="state", torque="input", parameter="params")
    header = "\n".join(["/*", *(f" * {line}" for line in emission.banner()), " */"])
    context: dict[str, object] = {
        "header": header,
        "model": model.name,
        "own": model.own,
        "guard": model.name.upper(),
        "further_header": emission.further_header,
        "structures": {
            role: {"name": s.name, "names": s.names()} for role, s in structures.items()
        },
        "names": {role: _batch_name(emission, role) for role in BATCH_ROLES},
        "batch": [
            {"name": _batch_name(emission, role), "members": _member_lines(structures[role], fixed)}
            for role, fixed in BATCH_ROLES.items()
        ],
        "baked": [
            {"name": n, "literal": c_literal(v)}
            for n, v in (emission.baked.constants if emission.baked else ())
        ],
        "domain": domain(model),
        "limits": () if emission.baked else model.limits,
        "coordinates": [c.name for c in model.coordinates],
        "step": step,
        "checked": checked,
        "witness": witness_of(structures, emission.prepare),
        "next_state": [s.name for s in emission.step.outputs if s.group == "next_state"],
        "acceleration": body_of(model.program("acceleration"), plant, of_plant),
    }
    elementary = {"header": header, **model.elementary}
    return {
        "c/pf_elementary_batch.h": fill("c/batch.elementary.h.j2", elementary),
        f"c/{model.name}_batch.h": fill("c/batch.h.j2", context),
        f"c/{model.name}_batch.c": fill("c/batch.c.j2", context),
    }
