"""`pfaffian verify`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.cli import output
from pfaffian.runtime.errors import CheckError, InputError

if TYPE_CHECKING:
    from pfaffian.derive.verify.compare import Subject
    from pfaffian.runtime.generated_model import GeneratedFolder

_TARGET_SAMPLES = 20_000
_NEAR = ("worst_scaled_ulp_near_sets", "worst_input_scaled_ulp_near_sets")


def verify_generated(
    reference: str,
    samples: int,
    target_samples: int | None,
    generated: Path | None,
    as_json: bool,
    set_names: Sequence[str] = (),
) -> None:
    """Verify a model's generated code and print what was found."""
    document = verification(reference, samples, target_samples, generated, set_names)
    failure = (
        f"{reference}: worst scaled error {document['worst_scaled_ulp']:.3g} ulp, "
        f"{document['target_mismatches']} samples with other bits on the target"
    )
    output.deliver(
        document,
        as_json,
        lambda: print_verification(document),
        "" if document["passed"] else failure,
        "see where in the table; the generated code is not fit for use",
    )


def verification(
    reference: str,
    samples: int,
    target_samples: int | None,
    generated: Path | None,
    set_names: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the document of one verification. Raises where code and source do not belong.

    Half of the samples are drawn around the sets of `set_names`, or all complete ones of the model;
    around the one that is folded into the code where that is so.
    """
    from pfaffian.derive.library import find_model
    from pfaffian.derive.pipeline import complete_sets, derivation_of, lowered_model
    from pfaffian.derive.verify.compare import FOLLOWING, FUNCTIONS, verify
    from pfaffian.derive.verify.unit import SINGLE_UNIT, UNITS
    from pfaffian.runtime.generated_model import open_generated, ppc750_model
    from pfaffian.runtime.subjects import MachineSubject

    source = find_model(reference)
    output.note(f"deriving {source.name}, building the host and PowerPC images")
    model, derivation = lowered_model(source), derivation_of(source)
    code = open_generated(str(generated or reference))
    if code.manifest.model_sha256 != model.sha256:
        raise CheckError(
            f"{code.path}: generated from another {source.name} than the one derived now",
            remedy=f"regenerate it: pfaffian generate {reference} -o {code.path}",
        )
    baked = _baked_set(code, set_names)
    found_sets = None if baked else complete_sets(model, source, set_names)
    for line in found_sets.notes(reference) if found_sets else ():
        output.note(line)
    sets = [s.as_dict() for s in found_sets.sets] if found_sets else [dict(baked or {})]
    unit = UNITS[code.manifest.precision]
    subjects, witness = _subjects(code, unit is SINGLE_UNIT)
    target = MachineSubject(ppc750_model(code), "c-ppc750")
    wanted = min(samples, _TARGET_SAMPLES if target_samples is None else target_samples)
    with output.progress(f"verifying on {samples} samples") as update:
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
    from pfaffian.runtime.generated_model import host_model, twice_rounding_model
    from pfaffian.runtime.subjects import MachineSubject, PythonSubject

    host = MachineSubject(host_model(code), "c-host")
    if single:
        return [host], MachineSubject(twice_rounding_model(code), "c-host-rounding-twice")
    return [PythonSubject(code), host], None  # the module is of double in any folder


def _baked_set(code: GeneratedFolder, set_names: Sequence[str]) -> Mapping[str, float] | None:
    """Return the set that is folded into `code`, if one is; refuse to draw around others."""
    name = code.manifest.baked
    others = sorted(set(set_names) - {name})
    if name and others:
        raise InputError(
            f"{code.path}: set {name} is folded into this code, which takes no other",
            remedy=f"leave --set {others[0]} out",
        )
    return code.manifest.parameter_sets[name] if name else None


def print_verification(document: Mapping[str, Any]) -> None:
    """Print a verification as a table."""
    rows = [
        (
            f["function"],
            f["language"],
            f["samples"],
            output.figure(f["worst_scaled_ulp"]),
            f["output"],
            *(output.figure(f[key]) if document["sets"] else "-" for key in _NEAR),
            output.figure(f["worst_input_scaled_ulp"]),
        )
        for f in document["functions"]
    ]
    output.table(
        f"worst error against the symbolic source at 60 digits, in ulp of {document['precision']}",
        (
            "function",
            "language",
            "samples",
            "scaled ulp",
            "at output",
            "near the sets",
            "by inputs alone, near the sets",
            "everywhere",
        ),
        rows,
    )
    output.out.print(
        f"worst {document['worst_scaled_ulp']:.3g} scaled ulp (limit {document['limit_ulp']:g}); "
        f"{document['target_mismatches']} of {document['target_samples']} samples differ in any "
        f"bit between host and target",
        soft_wrap=True,
    )
    if document["precision"] == "single":
        output.out.print(
            "inputs are singles, drawn until every value on the way is zero or from 2^-126 to "
            "2^128, every named one larger than the error the limit allows it, and angles that "
            "are sums within 2^13 rad: "
            f"{document['beyond']} draws were given up, {document['beyond_near']} of them near "
            f"the sets; {document['undecided']} samples on a comparison too close to call left "
            f"out; {document['emulator_roundings']} more samples differ between host and target "
            "because the emulator rounds a multiply-add of singles twice",
            soft_wrap=True,
        )
