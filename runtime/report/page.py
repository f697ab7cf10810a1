"""The report of a run: one HTML file, complete in itself, that can be forwarded."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import jinja2
from markupsafe import Markup, escape
from pfaffian.runtime.code.generated_model import GeneratedFolder
from pfaffian.runtime.contract.manifest import Field, Manifest
from pfaffian.runtime.flight.closed_loop import Trajectory
from pfaffian.runtime.flight.metrics import status_counts, tracking_metrics
from pfaffian.runtime.report.figures import (
    animation_data,
    count_text,
    history_figures,
    number_text,
    symbol_text,
    unit_text,
    verification_figure,
)
from pfaffian.runtime.report.mathml import LETTERS, mathml

#: Largest error of generated code that counts as verified, in scaled ulp.
ULP_LIMIT = 4.0
#: A flight tracks when its error in the last two seconds is below this part of its largest error.
SETTLED_PART = 0.1
#: Sections with more equations than this are folded.
_LONG_SECTION = 12
_SAMPLED = "sampled: "
_MODES = {"host": "controller on the host", "pil": "processor in the loop"}


@dataclass(frozen=True)
class WholeFlight:
    """A flight of the complete controller: an SVG that moves, and what its command prints."""

    film: bytes
    found: Mapping[str, Any]


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
    whole: WholeFlight | None = None


def render_report(data: ReportData) -> str:
    """Return the report as one HTML document that loads nothing."""
    labels = flight_labels(data.flights)
    derivation = json.loads((data.folder.path / "derivation.json").read_text(encoding="utf-8"))
    rows = list(data.verification.get("functions", ()))
    limit = float(data.verification.get("limit_ulp", ULP_LIMIT))
    animation = animation_data(data.flights, labels)
    context = {
        "manifest": data.folder.manifest,
        "verification": data.verification,
        "build": data.build,
        "verdicts": _verdicts(data, derivation, limit),
        "limit": limit,
        "worst": max(rows, key=_error_of, default=None),
        "functions": rows,
        "flights": [
            _flight(f, label, data.agreement) for f, label in zip(data.flights, labels, strict=True)
        ],
        "tracking_rows": _tracking_rows(data.flights),
        "sample_time": f"{1e3 * data.flights[0].scenario.sample_time:g} ms",
        "animation": None if animation is None else _embedded(animation),
        "whole": data.whole,
        "film": Markup(data.whole.film.decode()) if data.whole else "",
        "histories": history_figures(data.flights, labels),
        "verification_figure": verification_figure(rows, limit),
        "sections": [_section(s, derivation["identities"]) for s in derivation["sections"]],
        "sets": _parameter_table(data.folder.manifest),
    }
    return _environment().get_template("report/report.html.j2").render(context)


def flight_labels(flights: Sequence[Trajectory]) -> list[str]:
    """Return a short name of each flight: its title without what all titles begin with."""
    titles = [f.scenario.title.split(", ") for f in flights]
    while len(titles) > 1 and all(len(t) > 1 and t[0] == titles[0][0] for t in titles):
        titles = [t[1:] for t in titles]
    short = [", ".join(t) for t in titles]
    for ending in ([f.mode for f in flights], range(1, len(flights) + 1)):
        longer = [f"{label} ({end})" for label, end in zip(short, ending, strict=True)]
        if len(set(short)) < len(short) and len(set(longer)) == len(longer):
            short = longer
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
    environment.filters |= {"number": number_text, "count": count_text, "typeset": _typeset}
    environment.filters |= {"unit": unit_text, "symbol": symbol_text}
    return environment


def _embedded(document: object) -> Markup:
    """Return `document` as JSON that no browser can take for mark-up."""
    text = json.dumps(document, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))


def _error_of(row: Mapping[str, Any]) -> float:
    return float(row["worst_scaled_ulp"])


def _verdicts(
    data: ReportData, derivation: Mapping[str, Any], limit: float
) -> dict[str, dict[str, Any]]:
    """Return what was checked, whether it held, and the numbers that say so."""
    identities = derivation["identities"]
    proved = sum(bool(i["proved"]) for i in identities)
    worst = float(data.verification["worst_scaled_ulp"])
    compared = [
        data.agreement[f.scenario.name] for f in data.flights if f.scenario.name in data.agreement
    ]
    mismatches = int(data.verification["target_mismatches"])
    return {
        "derived": {"held": proved == len(identities), "proved": proved, "of": len(identities)},
        "verified": {"held": worst <= limit and mismatches == 0, "worst": worst},
        "identical": {
            "held": mismatches == 0 and len(compared) == len(data.flights) and not any(compared),
            "bits": sum(compared),
            "mismatches": mismatches,
            "compared": len(compared),
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
    changed = {
        n: v for n, v in {**scenario.controller, **scenario.plant}.items() if v != parameters.get(n)
    }
    return {
        "label": label,
        "scenario": scenario.name,
        "source": scenario.source,
        "mode": _MODES.get(flight.mode, flight.mode),
        "set": scenario.set_name,
        "steps": scenario.steps,
        "sha256": flight.sha256(),
        "settled": _settled(flight),
        "status": status_counts(flight),
        "last": [(q, figures[f"mae2_{q}"], fields[q].unit) for q in manifest.coordinates],
        "start": _quantities(scenario.initial, fields),
        "changed": _quantities(changed, fields),
        "differing": agreement.get(scenario.name),
    }


def _quantities(values: Mapping[str, float], fields: Mapping[str, Field]) -> Markup:
    """Return values with their units on one line."""
    return Markup(", ").join(
        Markup("{} = {} {}").format(symbol_text(n), number_text(v), unit_text(fields[n].unit))
        for n, v in values.items()
    )


def _tracking_rows(flights: Sequence[Trajectory]) -> list[dict[str, Any]]:
    """Return the tracking figures: a row each, a value a flight."""
    manifest, figures = flights[0].scenario.folder.manifest, [tracking_metrics(f) for f in flights]
    fields = _fields(manifest)
    kinds = (("iae", "*s"), ("mae2", ""))
    rows = [
        (k, q, f"{k}_{q}", fields[q].unit + by) for k, by in kinds for q in manifest.coordinates
    ]
    rows.append(("peak", "", "peak_torque", fields[manifest.actuators[0]].unit))
    return [
        {"kind": kind, "of": q, "unit": unit, "values": [f[key] for f in figures]}
        for kind, q, key, unit in rows
    ]


def _fields(manifest: Manifest) -> dict[str, Field]:
    """Return every member of the generated structures by name."""
    order = ("plant_params", "params", "plant_state", "input", "output")
    members = {f.name: f for role in order for f in manifest.structures[role].fields}
    return {f.name: f for f in manifest.parameters} | members


def _parameter_table(manifest: Manifest) -> dict[str, Any]:
    """Return the parameter sets as a table, apart from what is zero in all of them."""
    sets = {name: manifest.parameter_sets[name] for name in sorted(manifest.parameter_sets)}
    fields = _fields(manifest)
    rows, zeros = [], []
    for name, field in fields.items():
        values = [s.get(name) for s in sets.values()]
        if all(v is None for v in values):
            continue
        if not any(values):
            zeros.append(name)
            continue
        rows.append({"name": name, "field": field, "values": values})
    return {"names": list(sets), "rows": rows, "zeros": zeros}


def _section(section: Mapping[str, Any], identities: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
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
        part = parts["sampled" if sampled else "continuous"]
        repeated = bool(part) and part[-1]["plain"] == (caption, source) and mark is None
        part.append(
            {
                "plain": (caption, source),
                "caption": _typeset("" if repeated else caption),
                "source": source,
                "mark": mark,
                "math": mathml(equation["latex"]),
            }
        )
    return {
        "heading": heading,
        "numbers": numbers,
        "parts": {k: v for k, v in parts.items() if v},
        "folded": len(section["equations"]) > _LONG_SECTION,
    }


def _numbered(text: str) -> tuple[str, str]:
    """Split the numbers of the source's equations from the end of a caption."""
    words, numbers = re.fullmatch(r"(.*?)(?:, |^)?((?:(?:, |-)?\(\d+\))*)", text).groups()  # type: ignore[union-attr]
    return words, numbers.replace(")-(", ")–(")


def _typeset(caption: str) -> Markup:
    """Return a caption with derivatives dotted, powers raised and indices lowered."""
    text = re.sub(r"\b([A-Za-z])''", "\\1\u0308", caption)
    text = re.sub(r"\b([A-Za-z])'", "\\1\u0307", text).replace(" - ", " − ").replace("^-", "^−")
    text = re.sub(r"[A-Za-z]+", lambda m: LETTERS.get(m[0], m[0]), text)
    text = re.sub(r"\^(−?\d+)", r"<sup>\1</sup>", str(escape(text)))
    return Markup(re.sub(r"\b([A-Za-z])(c?\d)\b", r"\1<sub>\2</sub>", text))
