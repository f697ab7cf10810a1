"""`pfaffian generate`."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.cli import output
from pfaffian.derive.generate_model import Extras as Extras
from pfaffian.runtime.base.errors import InputError

if TYPE_CHECKING:
    from pfaffian.derive.pipeline import StageClock


def generate_files(
    reference: str,
    set_name: str | None,
    params: Path | None,
    folder: Path | None,
    check: bool,
    extras: Extras,
    as_json: bool,
) -> None:
    """Generate a model's files into `folder`, or compare them with what is there."""
    from pfaffian.derive.emit.precision import DOUBLE, precision_named
    from pfaffian.derive.generate_model import Sets, generate_model
    from pfaffian.derive.pipeline import StageClock
    from pfaffian.derive.spec.library import find_model
    from pfaffian.derive.writer import check_target, drift, write_generation

    if set_name and params:
        raise InputError("--set and --params are both given", remedy="give one of them")
    extras.check()
    precision = precision_named(extras.precision)
    source = find_model(reference)
    suffix = "" if precision is DOUBLE else "_single"
    target = folder or Path("generated") / f"{source.name}{suffix}"
    if not check:
        check_target(target)
    clock = StageClock()
    wanted = Sets(params=params, named=set_name)
    made = generate_model(
        source, wanted, extras, reference=reference, clock=clock, note=output.note
    )
    model, sets, generation = made.model, made.sets, made.generation
    if check:
        _report_drift(drift(generation, target), target, source.name, as_json)
        return
    since = time.perf_counter()
    changed = write_generation(generation, target)
    clock.record("write", since)
    document = {
        "model": model.name,
        "precision": precision.name,
        "folder": str(target),
        "model_sha256": model.sha256,
        "sets": [s.name for s in sets],
        "sets_left_out": dict(made.left_out),
        "notes": [n for s in sets for n in s.notes],
        "files": len(generation.files),
        "changed": changed,
        "passes": [asdict(p) for p in model.passes],
        "seconds": {k: round(v, 4) for k, v in clock.seconds.items()},
    }
    output.deliver(document, as_json, lambda: _say_what_was_written(document, clock))


def _say_what_was_written(document: dict[str, Any], clock: StageClock) -> None:
    split = ", ".join(f"{k} {v:.3f} s" for k, v in clock.seconds.items())
    names = ", ".join(document["sets"]) or "no complete set"
    output.say(
        f"{document['model']} ({names}): {document['files']} files in {document['folder']}, "
        f"{len(document['changed'])} changed ({split})",
    )
    counts = [p for p in document["passes"] if p["program"] == "step"]
    saved = ", ".join(f"{p['name']} {p['after']}" for p in counts)
    output.say(f"operations a step: {counts[0]['before']}; after {saved}")


def _report_drift(difference: str, target: Path, name: str, as_json: bool) -> None:
    def show() -> None:
        if difference:
            output.write(difference)
        else:
            output.say(f"{target} is what pfaffian generates now")

    output.deliver(
        {"drift": bool(difference), "diff": difference},
        as_json,
        show,
        f"{target} has drifted from what pfaffian generates for {name} now" if difference else "",
        f"look at the difference, then: pfaffian generate {name} -o {target}",
    )
