"""`pfaffian design`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.cli import output
from pfaffian.runtime.base.errors import InputError

if TYPE_CHECKING:
    from pfaffian.derive.design import Design
    from pfaffian.derive.design.study import Study, Wishes
    from pfaffian.derive.ir.lowered import LoweredModel
    from pfaffian.derive.sets.raw_set import RawSet
    from pfaffian.derive.spec.library import ModelFolder


@dataclass(frozen=True)
class Compared:
    """One column of the comparison; `same_plant` says whether it belongs to the study's curve."""

    name: str
    design: Design
    same_plant: bool


@dataclass(frozen=True)
class DesignFiles:
    """Where a study reads and writes: the set by name or file, sets to compare, new files."""

    set_name: str | None = None
    params: Path | None = None
    compare: str = ""
    written: Path | None = None
    plot: Path | None = None
    force: bool = False


def design_gains(reference: str, wishes: Wishes, files: DesignFiles, as_json: bool) -> None:
    """Assess or choose gains, print what they amount to, and write a set or a plot if asked."""
    from pfaffian.derive.design.study import study
    from pfaffian.derive.pipeline import lowered_model
    from pfaffian.derive.spec.library import find_model
    from pfaffian.runtime.base.files import write_outputs

    folder = find_model(reference)
    _check_files(files, wishes)
    output.note(f"deriving {folder.name}")
    model = lowered_model(folder)
    raw, base = _base(model, folder, files)
    output.note(f"designing from parameter set {raw.name}")
    found = study(model, raw, wishes)
    compared = _compared(model, folder, files.compare, found)
    failure = found.failure()
    outputs: dict[Path, bytes] = {}
    if files.written and not failure:
        outputs[files.written] = _set_text(model, raw, base, found, files.written)
    if files.plot:
        outputs[files.plot] = _plot(found, compared)
    write_outputs(outputs)
    document = {
        **found.as_json(),
        "notes": list(found.parameters.notes),
        "compare": [{"set": c.name, **asdict(c.design)} for c in compared],
        "written": str(files.written) if files.written and not failure else None,
        "plot": str(files.plot) if files.plot else None,
    }
    output.deliver(
        document,
        as_json,
        lambda: _print(found, compared, document),
        failure,
        "choose slower or other poles with --poles, or weights with --riccati"
        + ("; no set was written" if files.written else ""),
    )


def _check_files(files: DesignFiles, wishes: Wishes) -> None:
    """Raise `InputError` for files that cannot be meant, before anything is computed."""
    from pfaffian.runtime.base.files import check_output

    if files.set_name and files.params:
        raise InputError("--set and --params are both given", remedy="give one of them")
    if files.written and not (wishes.poles or wishes.riccati or wishes.delay):
        raise InputError(
            f"-o {files.written}: no gains are chosen to be written",
            remedy="give --poles, --riccati or --delay",
        )
    if files.written and files.written == files.plot:
        raise InputError(
            f"-o and --plot are both {files.plot}", remedy="give each a file of its own"
        )
    check_output(files.written, "-o", ".toml", force=files.force)
    check_output(files.plot, "--plot", ".svg", force=files.force)


def _base(model: LoweredModel, folder: ModelFolder, files: DesignFiles) -> tuple[RawSet, str]:
    """Return the set to start from, and its name if it is one of the model's own."""
    from pfaffian.derive.sets.raw_set import read_set

    sets = folder.sets()
    if files.params:
        return read_set(files.params, model.parameters, sets), ""
    if not sets and not files.set_name:
        raise InputError(
            f"model {folder.name} has no parameter set",
            remedy=f"write one beside {folder.spec_file}, or name a file with --params; "
            "pfaffian template prints one to fill in",
        )
    name = files.set_name or next(iter(sets))
    return read_set(folder.set_path(name), model.parameters, sets), name


def _compared(model: LoweredModel, folder: ModelFolder, names: str, found: Study) -> list[Compared]:
    """Return the named sets with the study's friction, and the study itself first."""
    from pfaffian.derive.design.assess import assess, base_set, with_values
    from pfaffian.derive.sets.raw_set import read_set

    if not names:
        return []
    label = found.parameters.name if found.method == "set" else f"by {found.method}"
    columns = [Compared(label, found.design, True)]
    plant = [p.name for p in model.parameters if p.group in ("lumped", "plant")]
    own = found.parameters.as_dict()
    for name in (part.strip() for part in names.split(",")):
        path = Path(name) if name.endswith(".toml") else folder.set_path(name)
        raw = read_set(path, model.parameters, folder.sets())
        other = with_values(base_set(model, raw, False), found.friction)
        same = all(other.as_dict().get(n) == own.get(n) for n in plant)
        if name != label:
            columns.append(Compared(name, assess(model, other), same))
    return columns


def _set_text(model: LoweredModel, raw: RawSet, base: str, found: Study, path: Path) -> bytes:
    from pfaffian.derive.design.set_file import gain_set_toml

    title = f"{found.model} {raw.name} with gains {_origin(found)}"
    return gain_set_toml(model, raw, base, found.changed(), title, str(path)).encode()


def _plot(found: Study, compared: Sequence[Compared]) -> bytes:
    from pfaffian.derive.design.plot import tradeoff_svg

    title = f"{found.model}, plant of set {found.parameters.name}"
    marked = [(c.name, c.design) for c in compared if c.same_plant]
    marked = marked or [(f"gains {_origin(found)}", found.design)]
    return tradeoff_svg(title, found.curve, marked)


def _origin(found: Study) -> str:
    """Return where the gains come from, in words."""
    from pfaffian.derive.design.study import pole_text

    if found.riccati:
        weights = ", ".join(f"{w:g}" for w in found.riccati.weights)
        return f"of the Riccati row for Q = diag({weights}), R = {found.riccati.effort:g}"
    if found.wanted_poles:
        return f"for poles at {', '.join(pole_text(p) for p in found.wanted_poles)}"
    return "of the set"


def _print(found: Study, compared: Sequence[Compared], document: dict[str, Any]) -> None:
    title = f"{found.model} {found.parameters.name}, gains {_origin(found)}"
    output.table(title, ("figure", "value"), [*_figures(found.design), *_extras(found)])
    for note in (*found.parameters.notes, *found.design.cyclic):
        output.say(note)
    if found.worst_case:
        _print_worst_case(found)
    if compared:
        columns = [_figures(c.design) for c in compared]
        rows = [(line[0][0], *(cell[1] for cell in line)) for line in zip(*columns, strict=True)]
        output.table("compared", ("figure", *(c.name for c in compared)), rows)
    if found.curve:
        _print_curve(found)
    for key in ("written", "plot"):
        if document[key]:
            output.say(f"wrote {document[key]}")


def _figures(design: Design) -> list[tuple[str, object]]:
    from pfaffian.derive.design.study import pole_text

    return [
        *((name, f"{value:.6g}") for name, value in design.gains.items()),
        ("zero-dynamics poles [1/s]", ", ".join(map(pole_text, design.zero_dynamics_poles))),
        ("stable", "yes" if design.stable else "no"),
        ("Routh's column, 1/s^k", ", ".join(map(output.figure, design.routh_column))),
        ("ADB at the setpoint", output.figure(design.input_gain)),
        ("offset to ADB = 0", _distance(design)),
        ("nearest point of ADB = 0", _nearest(design)),
        ("kappa (ADB)^2 [1/s]", output.figure(design.contraction)),
        ("T kappa (ADB)^2", output.figure(design.sampled_contraction)),
    ]


def _distance(design: Design) -> str:
    distance = design.singular_distance_rad
    if not math.isfinite(distance):
        return "none: ADB keeps its sign"
    degrees = f" ({math.degrees(distance):.1f} deg)" if design.singular_unit == "rad" else ""
    return f"{design.singular_coordinate}: {distance:.4g} {design.singular_unit}{degrees}"


def _nearest(design: Design) -> str:
    point = design.nearest_singular_point
    if point is None:
        return "-"
    if not math.isfinite(point.distance):
        return f"none within {_rounded_down(point.least)} {point.unit}".rstrip()
    offset = ", ".join(f"{n}: {v:+.4g}" for n, v in point.offset.items())
    within = _rounded_down(point.least)
    return f"{point.distance:.4g} {point.unit} away ({offset}); none within {within}"


def _rounded_down(bound: float) -> str:
    """Return a positive bound with four digits that do not exceed it."""
    if not (math.isfinite(bound) and bound > 0.0):
        return f"{bound:g}"
    step = 10.0 ** (math.floor(math.log10(bound)) - 3)
    return f"{math.floor(bound / step) * step:.4g}"


def _extras(found: Study) -> list[tuple[str, object]]:
    rows: list[tuple[str, object]] = [
        (f"with {name}", output.figure(value)) for name, value in found.friction.items()
    ]
    rows += [
        (f"stable up to {name}", output.figure(value))
        for name, value in found.friction_limits.items()
    ]
    if found.riccati:
        rows += [("row B^T P", _row_text(row)) for row in found.riccati.rows]
        rows.append(("largest V'/V on s = 0 [1/s]", output.figure(found.riccati.lyapunov_rate)))
    if found.placement and found.placement.row_gap is not None:
        rows.append(("gains found by", found.placement.by))
    if found.proposal:
        p = found.proposal
        rows += [
            ("delay with half a sample [ms]", output.figure(1e3 * p.total_delay)),
            ("rate proposed [1/s]", f"{p.rate:g} (held {1e3 * p.held_delay:g} ms)"),
            *((f"{name} proposed", f"{value:.6g}") for name, value in p.gains.items()),
            ("rate of p3's layer [1/s]", output.figure(p.layer_rate)),
        ]
    return rows


def _row_text(row: Sequence[float]) -> str:
    """Return a row with four digits, and 0 for what is rounding beside its largest entry."""
    least = 1e-12 * max(map(abs, row))
    return ", ".join(f"{r:.4g}" if abs(r) > least else "0" for r in row)


def _print_worst_case(found: Study) -> None:
    from pfaffian.derive.design.study import pole_text

    case = found.worst_case
    if case is None:
        return
    rows: list[tuple[str, object]] = [
        (f"{i.name} in [{i.lower:.6g}, {i.upper:.6g}]", f"worst at {case.at[i.name]:.6g}")
        for i in case.box
    ]
    rows += [
        ("worst poles found [1/s]", ", ".join(map(pole_text, case.poles))),
        ("margin [1/s]", f"{case.margin:.4g} (nominal {case.nominal_margin:.4g})"),
        ("stable in the box", "yes, as far as searched" if case.stable else "no"),
    ]
    output.table("worst case in the box", ("figure", "value"), rows)


def _print_curve(found: Study) -> None:
    names = list(found.design.gains)
    rows = [
        (
            p.family,
            output.figure(p.knob),
            output.figure(p.decay_rate),
            output.figure(p.singular_distance_rad),
            *(output.figure(p.gains[n]) for n in names),
        )
        for p in found.curve
    ]
    columns = (
        "family",
        "pole, or rate weights times",
        "decay rate [1/s]",
        "offset to ADB = 0",
        *names,
    )
    output.table("decay rate against distance to the singular set", columns, rows)
