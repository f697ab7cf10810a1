"""Which models have an audit, and how it is made."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pfaffian.derive.audit import (
    pendubot_bounds,
    pendubot_constraint,
    pendubot_control,
    pendubot_findings,
    pendubot_numbers,
    pendubot_stability,
)
from pfaffian.derive.audit.row import Audit
from pfaffian.derive.derivation import Derivation
from pfaffian.runtime.errors import InputError


def audit_pendubot(derivation: Derivation) -> Audit:
    """Return the audit of the Pendubot's source, equations (1)-(48)."""
    equations = (
        *pendubot_constraint.EQUATIONS,
        *pendubot_control.EQUATIONS,
        *pendubot_stability.EQUATIONS,
        *pendubot_bounds.EQUATIONS,
    )
    findings = (*pendubot_findings.FINDINGS, *pendubot_numbers.FINDINGS)
    return Audit(
        model=derivation.spec.name,
        source=derivation.spec.source,
        rows=tuple(equation(derivation) for equation in equations),
        findings=tuple(finding(derivation) for finding in findings),
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
