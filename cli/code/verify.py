"""`pfaffian verify`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pfaffian.cli import output

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
    """Return the document of one verification, and say how far it is."""
    from pfaffian.api.checking import verification as verify

    return verify(reference, samples, target_samples, generated, set_names, output)


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
