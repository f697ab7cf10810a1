"""An audit as a document: plain data for JSON, and LaTeX."""

from __future__ import annotations

from typing import Any

import sympy as sp
from pfaffian.paper.audit.row import Audit, Counterexample, Form, Verdict

_SPECIAL = {
    "\\": "\\textbackslash{}",
    "_": "\\_",
    "^": "\\^{}",
    "&": "\\&",
    "%": "\\%",
    "#": "\\#",
    "$": "\\$",
    "{": "\\{",
    "}": "\\}",
    "~": "\\~{}",
    "<": "\\textless{}",
    ">": "\\textgreater{}",
    "|": "\\textbar{}",
}
#: Longer formulas do not fit a line of the page.
_LONGEST = 400


def form_text(form: Form) -> str:
    """Return a form on one line."""
    if isinstance(form, sp.MatrixBase):
        return str(form.tolist())
    return str(form)


def audit_data(audit: Audit) -> dict[str, Any]:
    """Return the audit as plain data, rows and findings in order."""
    return {
        "model": audit.model,
        "source": audit.source,
        "equations": [
            {"number": r.number, "about": r.about, **_verdict_data(r.verdict)} for r in audit.rows
        ],
        "findings": [
            {
                "name": f.name,
                "place": f.place,
                "claim": f.claim,
                "equations": list(f.equations),
                **_verdict_data(f.verdict),
            }
            for f in audit.findings
        ],
        "summary": audit.summary(),
    }


def _verdict_data(verdict: Verdict) -> dict[str, Any]:
    found = verdict.counterexample
    return {
        "status": verdict.status,
        "note": verdict.note,
        "printed": form_text(verdict.printed),
        "derived": form_text(verdict.derived),
        "repair": verdict.repair or None,
        "checks": list(verdict.checks),
        "counterexample": _counterexample_data(found) if found else None,
    }


def _counterexample_data(found: Counterexample) -> dict[str, Any]:
    printed, derived = found.values()
    return {
        "meaning": found.meaning,
        "point": {s.name: str(v) for s, v in found.point},
        "printed": str(printed),
        "derived": str(derived),
        "printed_value": float(printed),
        "derived_value": float(derived),
    }


def counterexample_text(found: Counterexample) -> str:
    """Return a counter-example as one sentence."""
    at = ", ".join(f"{s.name} = {v}" for s, v in found.point)
    printed, derived = (_number(v) for v in found.values())
    return f"{found.meaning}: {printed} against {derived} at {at}"


def _number(value: sp.Expr) -> str:
    if value.is_Rational:
        return str(value)
    return f"{value} = {float(value):.6g}" if len(str(value)) < 30 else f"{float(value):.6g}"


def audit_latex(audit: Audit) -> str:
    """Return the audit as a LaTeX document."""
    lines = [
        "\\documentclass{article}",
        "\\usepackage{amsmath,longtable}",
        "\\allowdisplaybreaks",
        "\\begin{document}",
        f"\\section*{{{escaped(audit.model)}: audit}}",
        f"Source: {escaped(audit.source)}.",
        "\\begin{longtable}{rlp{.72\\textwidth}}",
        "number & status & note \\\\ \\hline",
    ]
    for row in audit.rows:
        about = " (claim)" if row.about == "claim" else ""
        lines.append(
            f"({row.number}) & {row.verdict.status}{about} & {escaped(row.verdict.note)} \\\\"
        )
    lines += ["\\end{longtable}", "\\section*{Equations that differ or are repaired}"]
    for row in audit.rows:
        if row.verdict.counterexample:
            lines += [f"\\subsection*{{({row.number})}}", *_difference(row.verdict)]
    lines.append("\\section*{Findings}")
    for finding in audit.findings:
        verdict = finding.verdict
        lines += [f"\\subsection*{{{escaped(finding.name)}: {verdict.status}}}"]
        said = f"The source, {escaped(finding.place)}: {escaped(finding.claim)}."
        lines += [said, "", escaped(verdict.note)]
        if verdict.counterexample:
            lines += _difference(verdict)
    lines.append("\\end{document}")
    return "\n".join(lines) + "\n"


def _difference(verdict: Verdict) -> list[str]:
    assert verdict.counterexample is not None
    shown = []
    for what, form in (("printed", verdict.printed), ("derived", verdict.derived)):
        shown.append(f"\\[ \\text{{{what}: }} {_latex(form)} \\]")
    shown.append(f"{escaped(counterexample_text(verdict.counterexample))}.")
    if verdict.repair:
        shown += ["", f"Proved with this repair: {escaped(verdict.repair)}."]
    return [*shown, ""]


def _latex(form: Form) -> str:
    if isinstance(form, str) or len(str(form)) > _LONGEST:
        return f"\\text{{{escaped(form_text(form))}}}"
    return str(sp.latex(form))


def escaped(text: str) -> str:
    """Return `text` with LaTeX's special characters escaped."""
    return "".join(_SPECIAL.get(c, c) for c in text)
