"""Emission of what follows a plan: the law along a reference, and plans as constant tables."""

from __future__ import annotations

from pfaffian.derive.emit.bounds import input_bounds
from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.emit.files.c import body_of, dialect_of, domain, pointers
from pfaffian.derive.emit.finiteness import with_finiteness_checks
from pfaffian.derive.emit.names import comment_text, snake
from pfaffian.derive.emit.structures import structures_of, witness_of
from pfaffian.derive.emit.templates import fill
from pfaffian.derive.sets.plan_table import PlanTable, reference_members


def emit_follow(emission: Emission) -> dict[str, str]:
    """Return the C files of the following law and of the plans of `emission` by path."""
    model, precision = emission.model, emission.precision
    structures = structures_of(model, precision.real, emission.step, emission.prepare, follow=True)
    program, checks = with_finiteness_checks(model.program("follow"))
    reader = pointers(
        input="input",
        state="state",
        prepared="state",
        parameter="params",
        reference="reference",
    )
    body = body_of(program, reader, dialect_of(model, precision.inline), input_bounds(model))
    reference = structures["reference"]
    count, n = len(reference.fields), len(model.coordinates)
    rows = (count - 3 * n) // 2
    names = reference_members(model)
    units = {f.name: (f.unit, f.description) for f in reference.fields}
    context: dict[str, object] = {
        "header": "\n".join(["/*", *(f" * {line}" for line in emission.banner()), " */"]),
        **precision.names(),
        "further_header": emission.further_header,
        "model": model.name,
        "own": model.own,
        "guard": model.name.upper(),
        "reference": reference.name,
        "members": [{"name": m, "text": comment_text(_described(*units[m]))} for m in names],
        "domain": domain(model, precision),
        "limits": model.limits,
        "witness": witness_of(structures, emission.prepare),
        "outputs": structures["output"].names(),
        "step": body,
        "checked": [body.results[name] for name in checks],
        "next_state": [s.name for s in program.outputs if s.group == "next_state"],
        "operations": sum(model.program("follow").op_count().values()),
        # value and slope of each curve; the slope of the last kind leaves as q''
        "held": [*names[: 2 * n], *names[3 * n : 3 * n + rows]],
        "resting": [*names[2 * n : 3 * n], *names[3 * n + rows :]],
        "positions": list(zip(names[:n], names[n : 2 * n], strict=True)),
        "rates": list(zip(names[n : 2 * n], names[2 * n : 3 * n], strict=True)),
        "rows": list(zip(names[3 * n : 3 * n + rows], names[3 * n + rows :], strict=True)),
        "plans": [_plan(emission, plan) for plan in emission.plans],
    }
    name = model.name
    return {
        f"c/{name}_{part}.{kind}": fill(f"c/{part}.{kind}.j2", context)
        for part in ("follow", "plan")
        for kind in ("h", "c")
    }


def _plan(emission: Emission, plan: PlanTable) -> dict[str, object]:
    literal = emission.precision.literal
    small = 0.0 if emission.precision.real == "double" else 2.0**-126

    def text(value: float) -> str:
        return literal(value if abs(value) >= small else 0.0)

    return {
        "name": f"{emission.model.name}_plan_{snake(plan.name)}",
        "set": comment_text(plan.name),
        "count": len(plan.nodes),
        "period": text(plan.period),
        "rate": text(1.0 / plan.period),
        "end_time": text(plan.end_time),
        "scale": repr(plan.scale),
        "missed": [f"{v:.2g}" for v in plan.missed],
        "thinned": [f"{v:.2g}" for v in plan.thinned] if any(plan.thinned) else [],
        "defect": f"{plan.defect:.2g}",
        "nodes": [", ".join(text(v) for v in node) for node in plan.nodes],
    }


def _described(unit: str, description: str) -> str:
    return f"{description} [{unit}]" if unit else description
