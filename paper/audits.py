"""Which models have an audit, and how it is made."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pfaffian.derive.derivation.derive import Derivation
from pfaffian.paper.audit.check import unchecked
from pfaffian.paper.audit.paper import Paper
from pfaffian.paper.audit.row import Audit, Row
from pfaffian.paper.equations import (
    pendubot_bounds,
    pendubot_constraint,
    pendubot_control,
    pendubot_findings,
    pendubot_numbers,
    pendubot_print,
    pendubot_stability,
)
from pfaffian.paper.equations.pendubot_paper import PAPER
from pfaffian.paper.equations.pendubot_source import Case
from pfaffian.runtime.base.errors import InputError

#: The check of every number.
PENDUBOT: Mapping[int, Callable[[Case], Row]] = {
    int(check.__name__.rpartition("_")[2]): check
    for module in (pendubot_constraint, pendubot_control, pendubot_stability, pendubot_bounds)
    for check in module.EQUATIONS
}


def pendubot_row(number: int, case: Case) -> Row:
    """Return the row of one equation; what cannot be read is not checkable."""
    try:
        return PENDUBOT[number](case)
    except (ValueError, InputError) as error:
        return Row(number, unchecked(f"cannot be read: {error}", str(case.paper.equations[number])))


def audit_pendubot(derivation: Derivation, paper: Paper = PAPER) -> Audit:
    """Return the audit of the Pendubot's source, equations (1)-(48)."""
    case = Case(paper, derivation)
    findings = (*pendubot_findings.FINDINGS, *pendubot_numbers.FINDINGS, *pendubot_print.FINDINGS)
    return Audit(
        model=derivation.spec.name,
        source=derivation.spec.source,
        rows=tuple(pendubot_row(number, case) for number in sorted(PENDUBOT)),
        findings=tuple(finding(case) for finding in findings),
    )


AUDITS: Mapping[str, Callable[[Derivation], Audit]] = {"pendubot": audit_pendubot}


def check_audited(model: str) -> None:
    """Raise `InputError` naming the models with an audit unless `model` is one of them."""
    if model not in AUDITS:
        raise InputError(
            f"model {model} has no audit of a source",
            remedy=f"models with an audit: {', '.join(sorted(AUDITS))}",
        )


def audit(derivation: Derivation) -> Audit:
    """Return the audit of a derivation's source. Raises `InputError` where there is none."""
    check_audited(derivation.spec.name)
    return AUDITS[derivation.spec.name](derivation)
