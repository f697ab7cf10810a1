"""`pfaffian simulate` and `pfaffian pil`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pfaffian.api.flights import BARE_TARGET as BARE_TARGET
from pfaffian.api.flights import EMULATORS as EMULATORS
from pfaffian.api.flights import Emulated as Emulated
from pfaffian.cli import output
from pfaffian.runtime.base.errors import InputError


def fly_scenario(
    reference: str,
    where: Emulated | None,
    set_name: str | None,
    generated: Path | None,
    as_json: bool,
) -> None:
    """Fly a scenario on the host, or in the loop and compare with the host."""
    from pfaffian.api.flights import fly_both, fly_host
    from pfaffian.cli.flight.twin import twin_document
    from pfaffian.runtime.flight.scenario import read_scenario
    from pfaffian.runtime.twin.files.read import is_twin

    if where:
        where.check()
    if is_twin(reference):
        if where and (where.emulator, where.target) != ("unicorn", BARE_TARGET):
            raise InputError(
                f"{reference} flies on the twin, which --emulator {where.emulator} "
                f"--target {where.target} does not drive",
                remedy=f"leave them out: the twin flies {BARE_TARGET} on unicorn",
            )
        mode = where.emulator if where else "host"
        document = twin_document(reference, mode, set_name, generated)
    else:
        scenario = read_scenario(reference, generated, set_name)
        _, document = fly_both(scenario, where, output) if where else fly_host(scenario, output)
    output.deliver(
        document,
        as_json,
        lambda: _print_flight(document),
        _fault(document),
    )


def _fault(document: dict[str, Any]) -> str:
    """Return what a flight found wrong, or nothing."""
    name, differing = document["scenario"], document.get("differing_bits", 0)
    if differing:
        return f"{name}: {differing} bits differ between host and target"
    if document.get("overruns", 0):
        return f"{name}: {document['overruns']} periods ended after the next one was due"
    if document.get("step_ticks", 0) > document.get("budget_ticks", 0):
        spent, budget = document["step_ticks"], document["budget_ticks"]
        return f"{name}: the longest step took {spent} ticks, and the budget is {budget}"
    return ""


def _print_flight(document: dict[str, Any]) -> None:
    rows = [
        (k, output.figure(v) if isinstance(v, float) else v)
        for k, v in document.items()
        if k != "scenario"
    ]
    output.table(f"scenario {document['scenario']}", ("figure", "value"), rows)
