"""`pfaffian verify`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.cli import output
from pfaffian.runtime.errors import CheckError

if TYPE_CHECKING:
    from pfaffian.derive.verify.compare import Subject

_TARGET_SAMPLES = 20_000


def verify_generated(
    reference: str, samples: int, target_samples: int | None, generated: Path | None, as_json: bool
) -> None:
    """Verify a model's generated code and print what was found."""
    document = verification(reference, samples, target_samples, generated)
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
    reference: str, samples: int, target_samples: int | None, generated: Path | None
) -> dict[str, Any]:
    """Return the document of one verification. Raises where code and source do not belong."""
    from pfaffian.derive.library import find_model
    from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
    from pfaffian.derive.verify.compare import FOLLOWING, FUNCTIONS, verify
    from pfaffian.derive.verify.unit import SINGLE_UNIT, UNITS
    from pfaffian.runtime.generated_model import (
        host_model,
        open_generated,
        ppc750_model,
        twice_rounding_model,
    )
    from pfaffian.runtime.subjects import MachineSubject, PythonSubject

    source = find_model(reference)
    output.note(f"deriving {source.name}, building the host and PowerPC images")
    model, derivation = lowered_model(source), derivation_of(source)
    code = open_generated(str(generated or source.name))
    if code.manifest.model_sha256 != model.sha256:
        raise CheckError(
            f"{code.path}: generated from another {source.name} than the one derived now",
            remedy=f"regenerate it: pfaffian generate {reference} -o {code.path}",
        )
    sets = [s.as_dict() for s in library_sets(model, source)]
    unit = UNITS[code.manifest.precision]
    subjects: list[Subject] = [MachineSubject(host_model(code), "c-host")]
    witness = None
    if unit is SINGLE_UNIT:
        witness = MachineSubject(twice_rounding_model(code), "c-host-rounding-twice")
    else:  # the module is of double in any folder
        subjects.insert(0, PythonSubject(code))
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
        )
    return found.as_json()


def print_verification(document: Mapping[str, Any]) -> None:
    """Print a verification as a table."""
    rows = [
        (
            f["function"],
            f["language"],
            f["samples"],
            output.figure(f["worst_scaled_ulp"]),
            f["output"],
            output.figure(f["worst_input_scaled_ulp_near_sets"]),
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
