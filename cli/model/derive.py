"""`pfaffian models` and `pfaffian derive`."""

from __future__ import annotations

import json as json_module
from dataclasses import asdict

from pfaffian.cli import output
from pfaffian.runtime.base.errors import InputError


def show_derivation(reference: str, set_name: str | None, form: str, as_json: bool) -> None:
    """Print the derivation of a model, with the figures of one parameter set if named."""
    from pfaffian.derive.derivation.documents import derivation_text
    from pfaffian.derive.design import assess
    from pfaffian.derive.pipeline import derivation_of, lowered_model, parameter_set
    from pfaffian.derive.spec.library import find_model

    if form not in ("text", "markdown", "latex"):
        raise InputError(f"--format {form} is unknown", remedy="choose text, markdown or latex")
    folder = find_model(reference)
    output.note(f"deriving {folder.name}")
    model = lowered_model(folder)
    design = None
    if set_name:
        values = parameter_set(model, folder, folder.set_path(set_name))
        for line in values.notes:
            output.note(line)
        design = assess(model, values)
    documents = dict(model.documents)
    derivation = json_module.loads(documents["derivation.json"])
    unproved = [i["name"] for i in derivation["identities"] if not i["proved"]]

    def show() -> None:
        if form == "text":
            output.write(derivation_text(derivation_of(folder)))
            if design:
                _print_design(set_name or "", design)
        else:
            output.write(documents["derivation.md" if form == "markdown" else "derivation.tex"])

    output.deliver(
        {**derivation, "design": asdict(design) if design else None},
        as_json,
        show,
        f"not proved: {', '.join(unproved)}" if unproved else "",
    )


def _print_design(set_name: str, design: object) -> None:
    values = vars(design)
    unit = f" [{values['singular_unit']}]" if values["singular_unit"] else ""
    poles = ", ".join(f"{p:.4g}" for p in values["zero_dynamics_poles"])
    rows = [(k, output.figure(v)) for k, v in values["gains"].items()]
    rows += [
        ("zero-dynamics poles [1/s]", poles),
        ("stable", values["stable"]),
        ("Routh's column, 1/s^k", ", ".join(map(output.figure, values["routh_column"]))),
        ("ADB at the setpoint", output.figure(values["input_gain"])),
        (f"distance to ADB = 0{unit}", output.figure(values["singular_distance_rad"])),
        ("along", values["singular_coordinate"] or "-"),
        ("kappa (ADB)^2 [1/s]", output.figure(values["contraction"])),
    ]
    output.table(f"parameter set {set_name}", ("figure", "value"), rows)
    for note in values["cyclic"]:
        output.say(note)
    if values["hurwitz"]:
        margins = [(m.condition, output.figure(m.margin)) for m in values["hurwitz"]]
        title = f"Hurwitz conditions, parameter set {set_name}"
        output.table(title, ("condition", "margin"), margins)
