"""Generated code checked against its source, built for a target, and put into a certificate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.api.display import SILENT, Teller, html_table
from pfaffian.runtime.base.errors import CheckError, InputError

if TYPE_CHECKING:
    from pfaffian.derive.certificate.certify import Certificate as Certified
    from pfaffian.derive.certificate.certify import Claim
    from pfaffian.derive.derivation.derive import Derivation
    from pfaffian.derive.verify.compare import Subject
    from pfaffian.runtime.code.generated_model import GeneratedFolder
    from pfaffian.runtime.flight.scenario import Scenario

_TARGET_SAMPLES = 20_000


@dataclass(frozen=True, kw_only=True)
class Verification:
    """Generated Python, host C and PowerPC C against the symbolic source at 60 digits.

    `worst_scaled_ulp` is the worst error of any output, `target_mismatches` how many of
    `target_samples` differ in any bit between host and target; `document` is what
    `pfaffian verify --json` prints.
    """

    model: str
    passed: bool
    samples: int
    worst_scaled_ulp: float
    target_samples: int
    target_mismatches: int
    document: Mapping[str, Any] = field(repr=False)

    def _repr_html_(self) -> str:
        rows = [
            (f["function"], f["language"], f["samples"], f["worst_scaled_ulp"], f["output"])
            for f in self.document["functions"]
        ]
        columns = ("function", "language", "samples", "scaled ulp", "at output")
        return html_table(f"{self.model}: {'passed' if self.passed else 'FAILED'}", columns, rows)


@dataclass(frozen=True, kw_only=True)
class Build:
    """A controller as an image for a target, and what it costs there: see `pfaffian build`.

    `stack_bytes` and `instructions_per_step` are absent where no emulator counts them.
    """

    model: str
    target: str
    text_bytes: int
    stack_bytes: int | None
    instructions_per_step: int | None
    image: bytes = field(repr=False)
    document: Mapping[str, Any] = field(repr=False)

    def save(self, path: str | Path) -> Path:
        """Write the image; return the path."""
        from pfaffian.runtime.base.files import write_outputs

        write_outputs({Path(path): self.image})
        return Path(path)

    def _repr_html_(self) -> str:
        rows = list(self.document.items())
        return html_table(f"{self.model} on {self.target}", ("figure", "value"), rows)


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Theorem 1 in numbers over a region, beside a flight of the continuous law.

    `region` has the sides by coordinate and rate, `claims` each bound beside what was seen;
    `least_slack` is the least of bound - V' in 1/s^3. `failure` says why the flight does not bear
    it out, and is empty where it does.
    """

    scenario: str
    set_name: str
    region: Mapping[str, tuple[float, float]]
    claims: tuple[Claim, ...]
    least_slack: float
    failure: str

    def _repr_html_(self) -> str:
        rows = [(c.form, c.bound, c.ultimate, c.largest, c.late) for c in self.claims]
        columns = ("form", "bound", "dbar", "largest seen", "largest then")
        return html_table(f"{self.scenario}, {self.set_name}", columns, rows)


def certified(
    derivation: Derivation, scenario: Scenario, region: str, initial: str, tell: Teller = SILENT
) -> Certified:
    """Fly `scenario` under the continuous law, and put Theorem 1 into numbers over a region.

    `region` and `initial` are as `pfaffian certify` takes them; empty they follow from the flight.
    """
    from pfaffian.derive.certificate.certify import certify
    from pfaffian.derive.certificate.region import parse_point, parse_region
    from pfaffian.runtime.code.generated_model import host_model
    from pfaffian.runtime.flight.continuous import fly_continuous

    if initial:
        scenario = replace(scenario, initial=parse_point(initial, scenario.initial))
    coordinates = scenario.folder.manifest.coordinates
    sides = parse_region(region, coordinates, scenario.setpoint) if region else {}
    tell.note(f"flying {scenario.name} under the continuous law")
    flight = fly_continuous(scenario, host_model(scenario.folder))
    tell.note("bounding ADB and Fhat over the region")
    return certify(derivation, flight, sides)


def certificate_of(found: Certified) -> Certificate:
    """Return a certificate as the public face shows it."""
    return Certificate(
        scenario=found.scenario.name,
        set_name=found.scenario.set_name,
        region=dict(found.assumptions.region.box),
        claims=found.claims,
        least_slack=found.least_slack,
        failure=found.failure(),
    )


def verified(model: str, document: Mapping[str, Any]) -> Verification:
    """Return the document of a verification as the public face shows it."""
    return Verification(
        model=model,
        passed=document["passed"],
        samples=document["samples"],
        worst_scaled_ulp=document["worst_scaled_ulp"],
        target_samples=document["target_samples"],
        target_mismatches=document["target_mismatches"],
        document=document,
    )


def build(code: GeneratedFolder, target: str, toolchain: str = "auto") -> Build:
    """Compile the controller in `code` for a target, and measure what it costs there."""
    from pfaffian.runtime.code.firmware import build_controller

    image, report = build_controller(code, target, toolchain)
    return Build(
        model=report["model"],
        target=report["target"],
        text_bytes=report["text_bytes"],
        stack_bytes=report["stack_bytes"],
        instructions_per_step=report["instructions_per_step"],
        image=image,
        document=report,
    )


def verification(
    reference: str,
    samples: int,
    target_samples: int | None,
    generated: Path | None,
    set_names: Sequence[str] = (),
    tell: Teller = SILENT,
) -> dict[str, Any]:
    """Return the document of one verification. Raises where code and source do not belong.

    Half of the samples are drawn around the sets of `set_names`, or all complete ones of the model;
    around the one that is folded into the code where that is so.
    """
    from pfaffian.derive.pipeline import complete_sets, derivation_of, lowered_model
    from pfaffian.derive.spec.library import find_model
    from pfaffian.derive.verify.compare import FOLLOWING, FUNCTIONS, verify
    from pfaffian.derive.verify.subjects import CompiledUnderTest
    from pfaffian.derive.verify.ulp_unit import SINGLE_UNIT, UNITS
    from pfaffian.runtime.code.generated_model import open_generated, ppc750_model

    source = find_model(reference)
    tell.note(f"deriving {source.name}, building the host and PowerPC images")
    model, derivation = lowered_model(source), derivation_of(source)
    code = open_generated(str(generated or reference))
    if code.manifest.model_sha256 != model.sha256:
        raise CheckError(
            f"{code.path}: generated from another {source.name} than the one derived now",
            remedy=f"regenerate it: pfaffian generate {reference} -o {code.path}",
        )
    baked = baked_set(code, set_names)
    found_sets = None if baked else complete_sets(model, source, set_names)
    for line in found_sets.notes(reference) if found_sets else ():
        tell.note(line)
    sets = [s.as_dict() for s in found_sets.sets] if found_sets else [dict(baked or {})]
    unit = UNITS[code.manifest.precision]
    subjects, witness = _subjects(code, unit is SINGLE_UNIT)
    target = CompiledUnderTest(ppc750_model(code), "c-ppc750")
    wanted = min(samples, _TARGET_SAMPLES if target_samples is None else target_samples)
    with tell.progress(f"verifying on {samples} samples") as update:
        found = verify(
            derivation,
            model,
            sets,
            subjects,
            target,
            samples,
            wanted,
            update,
            unit,
            witness,
            (*FUNCTIONS, *(FOLLOWING if code.manifest.plans else ())),
            baked,
        )
    return {
        **found.as_json(),
        "sets": [s.name for s in found_sets.sets] if found_sets else [code.manifest.baked],
        "sets_left_out": dict(found_sets.left_out) if found_sets else {},
    }


def _subjects(code: GeneratedFolder, single: bool) -> tuple[list[Subject], Subject | None]:
    """Return what is compared on this machine, and in single what rounds as the emulator does."""
    from pfaffian.derive.verify.subjects import CompiledUnderTest, PythonUnderTest
    from pfaffian.runtime.code.generated_model import host_model, twice_rounding_model

    host = CompiledUnderTest(host_model(code), "c-host")
    if single:
        return [host], CompiledUnderTest(twice_rounding_model(code), "c-host-rounding-twice")
    return [PythonUnderTest(code), host], None  # the module is of double in any folder


def baked_set(code: GeneratedFolder, set_names: Sequence[str]) -> Mapping[str, float] | None:
    """Return the set that is folded into `code`, if one is; refuse to draw around others."""
    name = code.manifest.baked
    others = sorted(set(set_names) - {name})
    if name and others:
        raise InputError(
            f"{code.path}: set {name} is folded into this code, which takes no other",
            remedy=f"leave --set {others[0]} out",
        )
    return code.manifest.parameter_sets[name] if name else None
