"""The report of a run: one HTML file, complete in itself, that can be forwarded."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any
from xml.etree import ElementTree

import jinja2
from latex2mathml.converter import convert_to_element
from markupsafe import Markup, escape

from pfaffian.runtime.flight import Trajectory
from pfaffian.runtime.generated_model import GeneratedFolder
from pfaffian.runtime.manifest import Field, Manifest
from pfaffian.runtime.metrics import status_counts, tracking_metrics
from pfaffian.runtime.report_figures import (
    animation_data,
    history_figures,
    symbol_text,
    unit_text,
    verification_figure,
)

#: Largest error of generated code that counts as verified, in scaled ulp.
ULP_LIMIT = 4.0
#: A flight tracks when its error in the last two seconds is below this part of its largest error.
SETTLED_PART = 0.1
#: Sections with more equations than this are folded.
_LONG_SECTION = 12
_SAMPLED = "sampled: "


@dataclass(frozen=True)
class ReportData:
    """What a run found out.

    `flights` holds at least one flight, `verification` and `build` what those commands print, and
    `agreement` the bits that differ between host and target over a whole flight, by scenario.
    """

    folder: GeneratedFolder
    flights: tuple[Trajectory, ...]
    verification: Mapping[str, Any]
    build: Mapping[str, Any]
    agreement: Mapping[str, int]


def render_report(data: ReportData) -> str:
    """Return the report as one HTML document that loads nothing."""
    labels = flight_labels(data.flights)
    derivation = json.loads((data.folder.path / "derivation.json").read_text(encoding="utf-8"))
    rows = list(data.verification.get("functions", ()))
    limit = float(data.verification.get("limit", ULP_LIMIT))
    animation = animation_data(data.flights, labels)
    context = {
        "manifest": data.folder.manifest,
        "verification": data.verification,
        "build": data.build,
        "verdicts": _verdicts(data, derivation, limit),
        "limit": limit,
        "worst": max(rows, key=_error_of, default=None),
        "functions": [_function_row(r) for r in rows],
        "flights": [_flight(f, label, data.agreement)
                    for f, label in zip(data.flights, labels, strict=True)],
        "tracking_rows": _tracking_rows(data.flights),
        "animation": None if animation is None else _embedded(animation),
        "histories": history_figures(data.flights, labels),
        "verification_figure": verification_figure(rows, limit),
        "sections": [_section(s, derivation["identities"]) for s in derivation["sections"]],
        "sets": _parameter_table(data.folder.manifest),
    }
    return _environment().get_template("report/report.html.j2").render(context)


def flight_labels(flights: Sequence[Trajectory]) -> list[str]:
    """Return a short name of each flight: its title without what all titles begin with."""
    titles = [f.scenario.title for f in flights]
    common = os.path.commonprefix(titles).rfind(", ") + 2 if len(set(titles)) > 1 else 0
    short = [title[max(common, 0):] if common >= 2 else title for title in titles]
    if len(set(short)) < len(short):
        short = [f"{label} ({f.mode})" for label, f in zip(short, flights, strict=True)]
    if len(set(short)) < len(short):
        short = [f"{label} {k}" for k, label in enumerate(short, 1)]
    return short


def _environment() -> jinja2.Environment:
    def load(name: str) -> str:
        return files("pfaffian.templates").joinpath(name).read_text(encoding="utf-8")

    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(load),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=True,
    )
    environment.filters |= {
        "number": _number, "count": _count, "unit": unit_text, "symbol": symbol_text,
    }
    return environment


def _number(value: object, digits: int = 4) -> str:
    """Return a number to `digits` significant digits, with a typographic power of ten."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return str(value)
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    text = mantissa.replace("-", "−")
    if exponent:
        text += Markup("&#8239;·&#8239;10<sup>{}</sup>").format(str(int(exponent)).replace("-", "−"))
    return text


def _count(value: object) -> str:
    """Return a whole number in groups of three digits."""
    return f"{value:,}".replace(",", "\u202f") if isinstance(value, int) else _number(value)


def _embedded(document: object) -> Markup:
    """Return `document` as JSON that no browser can take for mark-up."""
    text = json.dumps(document, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))


def _error_of(row: Mapping[str, Any]) -> float:
    return float(row["worst_scaled_ulp"])


def _function_row(row: Mapping[str, Any]) -> dict[str, Any]:
    point = row.get("at") or {}
    return {
        "function": row["function"], "language": row["language"], "error": _error_of(row),
        "output": row.get("output", ""), "samples": row.get("samples", ""),
        "at": ", ".join(f"{symbol_text(n)} = {v:.17g}" if isinstance(v, float) else f"{n} = {v}"
                        for n, v in point.items()),
    }


def _verdicts(
    data: ReportData, derivation: Mapping[str, Any], limit: float
) -> dict[str, dict[str, Any]]:
    """Return what was checked, whether it held, and the numbers that say so."""
    identities = derivation["identities"]
    proved = sum(bool(i["proved"]) for i in identities)
    worst = float(data.verification["worst_scaled_ulp"])
    compared = [data.agreement[f.scenario.name] for f in data.flights
                if f.scenario.name in data.agreement]
    mismatches = int(data.verification["target_mismatches"])
    return {
        "derived": {"held": proved == len(identities), "proved": proved, "of": len(identities)},
        "verified": {"held": worst <= limit and mismatches == 0, "worst": worst},
        "identical": {
            "held": mismatches == 0 and len(compared) == len(data.flights) and not any(compared),
            "bits": sum(compared), "mismatches": mismatches, "compared": len(compared),
        },
        "tracking": {"held": all(_settled(f) for f in data.flights)},
    }


def _settled(flight: Trajectory) -> bool:
    figures = tracking_metrics(flight)
    regular = set(status_counts(flight)) <= {"OK", "SATURATED"}
    return regular and all(
        figures[f"mae2_{q}"] <= SETTLED_PART * figures[f"mae_{q}"] for q in flight.scenario.setpoint
    )


def _flight(flight: Trajectory, label: str, agreement: Mapping[str, int]) -> dict[str, Any]:
    """Return one flight's column of the flight table."""
    scenario = flight.scenario
    manifest, figures = scenario.folder.manifest, tracking_metrics(flight)
    fields = _fields(manifest)
    parameters = scenario.folder.parameters(scenario.set_name)
    changed = {n: v for n, v in {**scenario.controller, **scenario.plant}.items()
               if v != parameters.get(n)}
    return {
        "label": label, "scenario": scenario.name, "source": scenario.source, "mode": flight.mode,
        "set": scenario.set_name, "steps": scenario.steps, "sha256": flight.sha256(),
        "settled": _settled(flight), "status": status_counts(flight),
        "last": [(q, figures[f"mae2_{q}"], fields[q].unit) for q in manifest.coordinates],
        "start": _quantities(scenario.initial, fields), "changed": _quantities(changed, fields),
        "differing": agreement.get(scenario.name),
    }


def _quantities(values: Mapping[str, float], fields: Mapping[str, Field]) -> str:
    """Return values with their units on one line."""
    words = (f"{symbol_text(n)} = {_number(v)} {unit_text(fields[n].unit)}".rstrip()
             for n, v in values.items())
    return ", ".join(words)


def _tracking_rows(flights: Sequence[Trajectory]) -> list[dict[str, Any]]:
    """Return the tracking figures: a row each, a value a flight."""
    manifest, figures = flights[0].scenario.folder.manifest, [tracking_metrics(f) for f in flights]
    fields = _fields(manifest)
    rows = []
    for kind, factor in (("iae", "*s"), ("mae2", "")):
        for q in manifest.coordinates:
            rows.append({"kind": kind, "of": q, "unit": f"{fields[q].unit}{factor}",
                         "values": [f[f"{kind}_{q}"] for f in figures]})
    rows.append({"kind": "peak", "of": "", "unit": fields[manifest.actuators[0]].unit,
                 "values": [f["peak_torque"] for f in figures]})
    return rows


def _fields(manifest: Manifest) -> dict[str, Field]:
    """Return every member of the generated structures by name."""
    order = ("plant_params", "params", "plant_state", "input", "output")
    return {f.name: f for role in order for f in manifest.structures[role].fields}


def _parameter_table(manifest: Manifest) -> dict[str, Any]:
    """Return the parameter sets as a table, apart from what is zero in all of them."""
    sets = {name: manifest.parameter_sets[name] for name in sorted(manifest.parameter_sets)}
    fields = _fields(manifest)
    listed = [*(n for n in fields), *sorted({n for s in sets.values() for n in s} - fields.keys())]
    rows, zeros = [], []
    for name in listed:
        values = [s.get(name) for s in sets.values()]
        if all(v is None for v in values):
            continue
        if not any(values):
            zeros.append(name)
            continue
        field = fields.get(name, Field(name, "double", "", ""))
        rows.append({"name": name, "unit": field.unit, "description": field.description,
                     "values": values})
    return {"names": list(sets), "rows": rows, "zeros": zeros}


def _section(
    section: Mapping[str, Any], identities: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Return a section of the derivation in parts: the continuous and the sampled equations."""
    heading, numbers = _numbered(section["heading"])
    proved = {i["name"]: bool(i["proved"]) for i in identities}
    parts: dict[str, list[dict[str, Any]]] = {"continuous": [], "sampled": []}
    for equation in section["equations"]:
        sampled = equation["caption"].startswith(_SAMPLED)
        caption, source = _numbered(equation["caption"].removeprefix(_SAMPLED))
        mark = proved.get(equation["text"])
        if mark is not None:
            caption = caption.removesuffix(": proved").removesuffix(": NOT proved")
            caption, source = _numbered(caption)
        parts["sampled" if sampled else "continuous"].append({
            "caption": _typeset(caption), "source": source, "mark": mark,
            "math": mathml(equation["latex"]),
        })
    return {
        "heading": heading, "numbers": numbers, "parts": {k: v for k, v in parts.items() if v},
        "folded": len(section["equations"]) > _LONG_SECTION,
    }


def _numbered(text: str) -> tuple[str, str]:
    """Split the numbers of the source's equations from the end of a caption."""
    words, numbers = re.fullmatch(r"(.*?)(?:, |^)?((?:(?:, |-)?\(\d+\))*)", text).groups()  # type: ignore[union-attr]
    return words, numbers.replace(")-(", ")–(")


def _typeset(caption: str) -> Markup:
    """Return a caption with its powers and indices raised and lowered."""
    text = str(escape(caption.replace("''", "̈").replace("M^-1", "M^−1")))
    text = re.sub(r"\^(−?\d+)", r"<sup>\1</sup>", text)
    return Markup(re.sub(r"\b([A-Za-z])(\d)\b", r"\1<sub>\2</sub>", text))
