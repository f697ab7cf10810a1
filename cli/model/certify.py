"""`pfaffian certify`."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.cli import output
from pfaffian.runtime.base.errors import CheckError, InputError

if TYPE_CHECKING:
    from pfaffian.derive.certificate.certify import Certificate, Claim
    from pfaffian.derive.certificate.theorem import Ultimate
    from pfaffian.derive.ir.lowered import LoweredModel
    from pfaffian.derive.spec.library import ModelFolder
    from pfaffian.runtime.flight.scenario import Scenario

_CONDITION = (
    "The certificate bounds delta, not q: where the constraint is followed, the zero dynamics "
    "decide what q does. It holds while the state stays in the region, which it does not prove; "
    "the flight is one check that it did."
)


def certify_design(
    reference: str,
    scenario_name: str | None,
    set_name: str | None,
    params: Path | None,
    region: str | None,
    initial: str | None,
    generated: Path | None,
    as_json: bool,
) -> None:
    """Print Theorem 1 in numbers for a scenario, beside a flight of the continuous law.

    A plant of one's own is generated for it, unless `generated` is a folder of its code.
    """
    from pfaffian.api.checking import certified
    from pfaffian.derive.pipeline import derivation_of, lowered_model
    from pfaffian.derive.spec.library import find_model
    from pfaffian.runtime.flight.scenario import read_scenario

    source = find_model(reference)
    _check_choice(set_name, params)
    model, derivation = lowered_model(source), derivation_of(source)
    with tempfile.TemporaryDirectory(prefix="pfaffian-") as scratch:
        name = scenario_name or _first_scenario(source, set_name)
        code = generated or _own_code(source, Path(scratch))
        scenario = _scenario(model, source, read_scenario(name, code, set_name))
        if params:
            scenario = _with_parameters(scenario, model, source, params)
        certificate = certified(derivation, scenario, region or "", initial or "", output)
        document = certificate_document(source.name, certificate)
    output.deliver(
        document,
        as_json,
        lambda: _print(document),
        certificate.failure(),
        "give a --region that keeps the flight, or take other gains",
    )


def _check_choice(set_name: str | None, params: Path | None) -> None:
    if set_name and params:
        raise InputError("--set and --params exclude each other", remedy="give one of them")


def _own_code(source: ModelFolder, scratch: Path) -> Path | None:
    """Return a folder of freshly generated code; nothing for a model whose code is here."""
    from pfaffian.derive.generate_model import Sets, generate_model
    from pfaffian.derive.spec.library import library_models
    from pfaffian.derive.writer import write_generation

    if source in library_models().values():
        return None
    output.note(f"generating the code of {source.name}")
    write_generation(generate_model(source, Sets(whole=True)).generation, scratch / source.name)
    return scratch / source.name


def _scenario(model: LoweredModel, source: ModelFolder, scenario: Scenario) -> Scenario:
    """Return `scenario`; raise where it flies another model, or code of other equations."""
    manifest = scenario.folder.manifest
    if manifest.model != model.name:
        raise InputError(
            f"scenario {scenario.name} flies {manifest.model}, not {model.name}",
            remedy="name a scenario of that model: pfaffian models",
        )
    if manifest.model_sha256 != model.sha256:
        raise CheckError(
            f"{scenario.folder.path}: generated from another {source.name} than the one derived "
            f"now",
            remedy=f"regenerate it: pfaffian generate {source.name} -o {scenario.folder.path}",
        )
    return scenario


def _first_scenario(source: ModelFolder, set_name: str | None) -> str:
    """Return the model's first scenario by name, of those that fly the set if one is named."""
    from pfaffian.runtime.flight.scenario_files import scenarios_of

    documents = scenarios_of(source.name, source.scenarios())
    if not documents:
        raise InputError(
            f"there is no scenario of model {source.name}",
            remedy="write one beside spec.py, scenarios/NAME.toml, or name one with --scenario",
        )
    flown = [n for n, d in documents.items() if d.get("set") == set_name]
    return (flown or list(documents))[0]


def _with_parameters(
    scenario: Scenario, model: LoweredModel, source: ModelFolder, path: Path
) -> Scenario:
    """Return `scenario` with the parameters in `path`; what it changed in its own set stays."""
    from pfaffian.derive.pipeline import parameter_set

    before = scenario.folder.parameters(scenario.set_name)
    given = parameter_set(model, source, path)
    for line in given.notes:
        output.note(line)
    after = given.as_dict()

    def merged(values: Any) -> dict[str, float]:
        kept = {n: v for n, v in values.items() if n not in before or v != before[n]}
        return {n: kept.get(n, after.get(n, v)) for n, v in values.items()}

    return replace(
        scenario,
        set_name=str(path),
        controller=merged(scenario.controller),
        plant=merged(scenario.plant),
    )


def certificate_document(model: str, certificate: Certificate) -> dict[str, Any]:
    """Return the document of a certificate."""
    assumptions, scenario = certificate.assumptions, certificate.scenario
    symbols = _symbols(certificate)
    return {
        "model": model,
        "set": scenario.set_name,
        "scenario": scenario.name,
        "variant": "p1 + p2 + p3" if certificate.theorem else "p1 + p2",
        "region": {n: list(side) for n, side in assumptions.region.box.items()},
        "assumption1": asdict(assumptions.gain),
        "assumption2": {
            "fhat": asdict(assumptions.force),
            "alpha": asdict(assumptions.alpha),
            "pursuit": asdict(assumptions.pursuit),
        },
        "symbols": symbols,
        "units": dict(_units(certificate).legend),
        "flight": {
            "samples": certificate.samples,
            "least_slack": certificate.least_slack,
            "left_region": certificate.left,
            "claims": [asdict(c) for c in certificate.claims],
        },
        "conservative": _conservative(certificate),
        "condition": _CONDITION,
        "holds_in_flight": not certificate.failure(),
    }


@dataclass(frozen=True)
class _Units:
    """Units of beta, of the actuator's force and of ADB.

    With several actuators each stands for several units: `legend` says which, by row or actuator.
    """

    beta: str
    force: str
    gain: str
    legend: Mapping[str, str] = field(default_factory=dict)


def _units(certificate: Certificate) -> _Units:
    manifest = certificate.scenario.folder.manifest
    structures, own = manifest.structures, manifest.own
    given = {f.name: f.unit for f in structures["continuous_output"].fields}
    state = {f.name: f.unit for f in structures["continuous_state"].fields}
    actuators = [f.unit for f in structures["plant_input"].fields]
    if len(actuators) == 1:
        return _Units(given[own("beta")], state[own("bound_estimate")], given[own("adb")])
    rows = [given[name] for name in manifest.numbered("beta")]
    legend = {"[beta]": ", ".join(rows), "[tau]": ", ".join(actuators)}
    return _Units("[beta]", "[tau]", "[beta]/s/[tau]", legend)


def _row(symbol: str, value: float, unit: str, meaning: str, form: str = "") -> dict[str, Any]:
    return {"symbol": symbol, "form": form, "value": value, "unit": unit, "meaning": meaning}


def _symbols(certificate: Certificate) -> list[dict[str, Any]]:
    """Return every symbol with its value, unit and meaning."""
    assumptions, scenario = certificate.assumptions, certificate.scenario
    units, pursuit = _units(certificate), certificate.pursuit
    fields = {f.name: f.unit for f in scenario.folder.manifest.structures["params"].fields}
    names = ("kappa", "epsilon", "k1", "k2")
    rows = [_row(n, scenario.controller[n], fields[n], "gain") for n in names if n in fields]
    several = len(scenario.folder.manifest.structures["plant_input"].fields) > 1
    size = "sigma(ADB)" if several else "|ADB|"
    coarse = "fbar/(kappa min sigma(ADB))" if several else "fbar/(kappa min|ADB|)"
    least = "least eigenvalue of ADB (ADB)^T" if several else "least (ADB)^2"
    rows += [
        _row(f"min {size}", assumptions.gain.bound, units.gain, "least over the region, (10)"),
        _row("lmin", assumptions.lmin, f"({units.gain})^2", f"{least}, assumption 1, (13)"),
        _row("fbar", assumptions.force.bound, units.force, "greatest |Fhat|, (11)"),
        _row("alpha", assumptions.alpha.bound, units.force, "sup |Fhat|/Pi, assumption 2, (14)"),
    ]
    if theorem := certificate.theorem:
        constants = {"printed": theorem.printed(), "scaled": theorem.scaled()}
        for claim in certificate.claims:
            if claim.form in constants:
                rows += _constants(claim, constants[claim.form], units)
    return [
        *rows,
        _row("kappa lmin", pursuit.rate, "1/s", "rate at which |beta| - b falls at least", "p2"),
        _row("b", pursuit.ultimate, units.beta, f"sup |Fhat|/(kappa {size}) bounds |beta|", "p2"),
        _row("b coarse", pursuit.coarse, units.beta, coarse, "p2"),
    ]


def _constants(claim: Claim, c: Ultimate, units: _Units) -> list[dict[str, Any]]:
    """Return the symbols of one form of Theorem 1; the printed one adds unlike units."""
    form, size, square = claim.form, units.beta, f"({units.beta})^2/s"
    per = {"K1": "1/s", "K2": f"{units.beta}/s", "g": ""}
    if form == "printed":
        size = f"{units.beta} and {units.force}"
        per = {"K1": f"1/s and {square}/({units.force})^2", "K2": f"{square}/({units.force})"}
        per["g"] = "1 and 1/k1"
    return [
        _row("K1", c.K1, per["K1"], "(42), rho = 0", form),
        _row("K2", c.K2, per["K2"], "(42), rho = 0", form),
        _row("K3", c.K3, square, "(42), rho = 0", form),
        _row("gm", c.gm, per["g"], "gm |delta|^2 <= V, for (44)", form),
        _row("gM", c.gM, per["g"], "V <= gM |delta|^2, for (44)", form),
        _row("R", c.R, size, "V' < 0 beyond, (43)", form),
        _row("r", claim.start, size, "|delta| at the start", form),
        _row("d(r)", claim.bound, size, "bound of |delta| for all time, (43)", form),
        _row("dunder", c.dunder, size, "dbar must exceed it, (45)", form),
        _row("dbar", claim.ultimate, size, "the ultimate bound taken", form),
        _row("T printed", c.settling_printed(claim.ultimate, claim.start), "s", "(46)", form),
        _row("T", claim.settling, "s", "time to dbar, comparison principle", form),
    ]


def _conservative(certificate: Certificate) -> dict[str, float | None]:
    """Return how many times larger each bound is than what was seen."""
    ratios: dict[str, float | None] = {}
    for c in certificate.claims:
        ratios[f"{c.form}, all time"] = c.bound / c.largest if c.largest else None
        ratios[f"{c.form}, after T"] = c.ultimate / c.late if c.late else None
    beta = next(c.largest for c in certificate.claims if c.form == "p2")
    for c in certificate.claims:
        if c.form != "p2":
            ratios[f"{c.form}, of beta alone"] = c.bound / beta if beta else None
    return ratios


def _print(document: dict[str, Any]) -> None:
    """Print a certificate as tables."""
    box = document["region"].items()
    output.table(
        f"region of {document['scenario']} with {document['set']}, {document['variant']}",
        ("coordinate", "from", "to"),
        [(n, output.figure(a), output.figure(b)) for n, (a, b) in box],
    )
    output.table(
        "Theorem 1 in numbers",
        ("symbol", "form", "value", "unit", "meaning"),
        [
            (s["symbol"], s["form"], output.figure(s["value"]), s["unit"], s["meaning"])
            for s in document["symbols"]
        ],
    )
    for name, units in document["units"].items():
        output.say(f"{name}: {units}, each entry in its own unit")
    output.table(
        "bounds beside a flight of the continuous law",
        ("form", "start", "bound", "dbar", "after s", "largest seen", "largest then"),
        [
            tuple(v if isinstance(v, str) else "-" if v is None else output.figure(v) for v in row)
            for row in (c.values() for c in document["flight"]["claims"])
        ],
    )
    ratios = document["conservative"].items()
    output.table(
        "how conservative: bound / largest seen",
        ("bound", "ratio"),
        [(k, "-" if v is None else output.figure(v)) for k, v in ratios],
    )
    flight = document["flight"]
    stayed = flight["left_region"] or "the flight stayed in the region"
    output.say(
        f"least bound - V' at {flight['samples']} samples: {flight['least_slack']:.3g} 1/s^3 "
        f"(negative is broken); {stayed}",
    )
    output.say(document["condition"])
