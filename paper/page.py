"""The page of a reproduction: one HTML file, complete in itself, beside the figures' files."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from importlib.resources import files

import jinja2
from markupsafe import Markup
from pfaffian.paper.results.result import ADDED, FAILS, HOLDS, PARTLY, Claim, SectionResult
from pfaffian.paper.sections import SECTIONS
from pfaffian.runtime.contract.manifest import Manifest

_MARKS = {HOLDS: "holds", FAILS: "fails", PARTLY: "", ADDED: ""}


def render_page(results: Mapping[str, SectionResult], manifest: Manifest, command: str) -> str:
    """Return the page of `results` by the name of the section, as `command` made it."""

    def load(name: str) -> str:
        return files("pfaffian.templates").joinpath(name).read_text(encoding="utf-8")

    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(load),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=True,
    )
    sections = [
        {
            "number": name.removeprefix("section-"),
            "title": SECTIONS[name].title,
            "claims": [(c, _evidence(c, result)) for c in result.claims],
            "tables": result.tables,
            "figures": [
                {
                    "name": f.name,
                    "number": f.number,
                    "title": f.title,
                    "caption": f.caption,
                    "kinds": f.kinds,
                    "data": base64.b64encode(f.image.svg).decode(),
                }
                for f in result.figures
            ],
        }
        for name, result in results.items()
    ]
    return environment.get_template("reproduction/page.html.j2").render(
        css=Markup(load("report/report.css")),
        source=_SOURCE,
        sections=sections,
        marks=_MARKS,
        command=command,
        skipped=[text for r in results.values() for text in r.skipped],
        provenance=f"Model {manifest.model}, SHA-256 {manifest.model_sha256}.",
    )


def claims_markdown(results: Mapping[str, SectionResult]) -> str:
    """Return the claims of `results` as Markdown, a table for each section."""
    parts = []
    for name, result in results.items():
        if not result.claims:
            continue
        section = SECTIONS[name]
        lines = [
            f"## Section {name.removeprefix('section-')}: {section.title}",
            "",
            f"    pfaffian reproduce {name}",
            "",
            "| figures | the paper says | we measured | verdict |",
            "|---|---|---|---|",
        ]
        for c in result.claims:
            numbers = ", ".join(f.removeprefix("figure-").lstrip("0") for f in c.figures)
            cells = (numbers, c.says, c.measured, c.verdict)
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


def _evidence(claim: Claim, result: SectionResult) -> list[tuple[str, str]]:
    """Return what a claim rests on, each with the place on the page where it stands, if there."""
    titles = {t.name: t.title for t in result.tables}
    parts = claim.evidence.split("; ")
    return [(titles[p].lower(), f"#{p}") if p in titles else (p, "") for p in parts]


_SOURCE = (
    "Adaptive robust control for Pendubot with matched–mismatched uncertainty via "
    "constraint-following"
)
