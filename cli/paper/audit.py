"""`pfaffian audit`: a model's source against its derivation."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pfaffian.cli import output
from pfaffian.runtime.base.errors import InputError

if TYPE_CHECKING:
    from pfaffian.paper.audit.row import Audit, Verdict


def show_audit(reference: str, form: str, as_json: bool) -> None:
    """Print one row for each numbered equation of the source, and the findings around them."""
    from pfaffian.derive.pipeline import derivation_of
    from pfaffian.derive.spec.library import find_model
    from pfaffian.paper.audit.document import audit_data, audit_latex
    from pfaffian.paper.audits import audit, check_audited

    if form not in ("text", "latex"):
        raise InputError(f"--format {form} is unknown", remedy="choose text or latex")
    folder = find_model(reference)
    check_audited(reference)  # of the library: an own model has another source
    output.note(f"auditing {folder.name}")
    result = audit(derivation_of(folder))

    def show() -> None:
        if form == "latex":
            output.write(audit_latex(result))
        else:
            _print_text(result)

    output.deliver(audit_data(result), as_json, show)


def _print_text(result: Audit) -> None:
    rows = [
        (f"({r.number})", f"{r.verdict.status}{' (claim)' * (r.about == 'claim')}", r.verdict.note)
        for r in result.rows
    ]
    output.table(f"{result.model}: equations", ("number", "status", "note"), rows)
    found = [
        (f.name, f.verdict.status, f.place, f"{f.claim}. {f.verdict.note}") for f in result.findings
    ]
    columns = ("finding", "status", "section, place", "claim and note")
    output.table(f"{result.model}: findings", columns, found)
    for row in result.rows:
        _print_difference(f"({row.number})", row.verdict)
    for finding in result.findings:
        _print_difference(finding.name, finding.verdict)
    counts = result.summary()
    for what, by_status in counts.items():
        output.say(f"{what}: {', '.join(f'{n} {status}' for status, n in by_status.items())}")


def _print_difference(name: str, verdict: Verdict) -> None:
    from pfaffian.paper.audit.document import counterexample_text, form_text

    if verdict.counterexample is None:
        return
    output.say(f"{name}")
    output.say(f"  printed: {form_text(verdict.printed)}")
    output.say(f"  derived: {form_text(verdict.derived)}")
    output.say(f"  {counterexample_text(verdict.counterexample)}")
    if verdict.repair:
        output.say(f"  repair: {verdict.repair}")
    if verdict.checks:
        output.say(f"  shown by: {'; '.join(verdict.checks)}")
