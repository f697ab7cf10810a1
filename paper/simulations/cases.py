"""The runs behind the paper's Figures 2-16: who controls which plant from where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from pfaffian.runtime.code.generated_model import GeneratedFolder

#: Columns: the paper's equations literally, the derived law with its gains, with synthesised
#: gains; beside them its baseline.
PRINTED, DERIVED, DESIGNED, LQR = "printed", "derived", "designed", "lqr"
COLUMNS = (PRINTED, DERIVED, DESIGNED)
#: Parts of the law (16) that act.
TERMS = ("p1", "p1+p2", "p1+p2+p3")
#: The friction of sections 5.2 and 5.3 as printed, by parameter of a joint.
FRICTION = {
    "friction1": 4.18,
    "friction2": 1.59,
    "friction3": 3.15,
    "friction4": 0.09,
    "friction5": 3.52,
    "friction6": 0.021,
}
#: q1, q2 [rad] and their rates [rad/s] at the start of all simulations, as printed.
START = (1.0, 0.5, 1.0, 0.0)
#: Ours: the paper calls the length t_f and gives no number.
DURATION = 10.0


@dataclass(frozen=True)
class Case:
    """One run: `controller` and `plant` hold parameters by name, `start` (q1, q2, q1', q2'), all in
    SI units; `feedback` is the row K of an LQR, tau = -K (e, q'), in N m per rad and rad/s. With
    `adaptation_printed` (48) stands for (15), and all else is as derived. With `softened`, a period
    T in s, p2 is divided by 1 + T kappa (ADB)^2, as the sampled law of that period has it."""

    name: str
    section: str
    column: str
    terms: str
    controller: Mapping[str, float]
    plant: Mapping[str, float]
    start: tuple[float, ...] = START
    duration: float = DURATION
    feedback: tuple[float, ...] = ()
    adaptation_printed: bool = False
    softened: float = 0.0


def case_of(
    folder: GeneratedFolder, section: str, column: str, terms: str, feedback: tuple[float, ...] = ()
) -> Case:
    """Return the case of `section` ("5.1", "5.2", "5.3") in `column` with `terms` of (16)."""
    chosen = folder.parameters("sim-designed" if column == DESIGNED else "sim")
    structures = folder.manifest.structures
    controller = {n: chosen[n] for n in structures["params"].names()}
    plant = {n: chosen[n] for n in structures["plant_params"].names()}
    if terms != TERMS[2]:
        controller |= {"k1": 0.0, "bound_initial": 0.0}
    if terms == TERMS[0]:
        controller["kappa"] = 0.0
    return Case(
        name="-".join((section, column, terms) if column != LQR else (section, column)),
        section=section,
        column=column,
        terms=terms,
        controller=controller,
        plant=plant | uncertainty(section),
        feedback=feedback if column == LQR else (),
    )


def uncertainty(section: str) -> dict[str, float]:
    """Return the plant's parameters that make F of `section`: a load, or friction as printed."""
    if section == "5.1":
        return {"joint1_load": 2.0}
    joints = (1,) if section == "5.2" else (1, 2)
    return {f"joint{j}_{name}": value for j in joints for name, value in FRICTION.items()}


def changed(case: Case, mark: str, start: tuple[float, ...] = (), **gains: float) -> Case:
    """Return `case` named with `mark`, from another start or with other gains of the law."""
    return replace(
        case,
        name=f"{case.name}-{mark}",
        start=start or case.start,
        controller={**case.controller, **gains},
    )


def scaled_friction(case: Case, mark: str, factor: float, joint: int = 2) -> Case:
    """Return `case` with the whole friction of `joint` multiplied by `factor`."""
    names = [f"joint{joint}_friction{k}" for k in (1, 4, 6)]
    plant = {**case.plant, **{n: factor * case.plant[n] for n in names}}
    return replace(case, name=f"{case.name}-{mark}", plant=plant)


def damping(case: Case, joints: tuple[int, ...] = (1, 2)) -> Case:
    """Return `case` with the two slopes of the friction model exchanged, so that it damps."""
    swapped = {}
    for j in joints:
        swapped[f"joint{j}_friction2"] = case.plant[f"joint{j}_friction3"]
        swapped[f"joint{j}_friction3"] = case.plant[f"joint{j}_friction2"]
    return replace(case, name=f"{case.name}-damping", plant={**case.plant, **swapped})


def with_printed_adaptation(case: Case) -> Case:
    """Return `case` with (48) in place of (15) and all else as derived."""
    return replace(case, name=f"{case.name}-48", adaptation_printed=True)


def softened(case: Case, period: float) -> Case:
    """Return `case` with p2 as weak as in the sampled law of `period` [s], but still continuous."""
    return replace(case, name=f"{case.name}-softened-{period:g}", softened=period)


def lasting(case: Case, duration: float) -> Case:
    """Return `case` flown for `duration` [s]."""
    return replace(case, name=f"{case.name}-{duration:g}-s", duration=duration)
