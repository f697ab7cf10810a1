"""A parameter set to be filled in: every key of the file, with its unit, bounds and meaning.

What must be filled in is marked with `BLANK`, which `read_set` refuses by the names of all keys
that still have one. What has a default, or an alternative that is filled in, is commented out.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.names import POLES_KEY
from pfaffian.derive.ir.parameter import Parameter
from pfaffian.derive.sets.gains import places_poles, zero_order
from pfaffian.derive.sets.raw_set import BLANK, TABLES, RawSet

REQUIRED, GIVEN, OPTIONAL = "required", "given", "optional"
_WIDEST = 100
_HEADINGS = {
    "parameters": "the plant",
    "gains": "servo-constraint and control law",
    "swing_up": "the energy swing-up law; what is left out keeps its default",
    "target": "what the code runs on",
}


@dataclass(frozen=True)
class Entry:
    """One key of a set: where it stands, what it means and what is written for it.

    `state` is `REQUIRED` where it must be filled in, `GIVEN` where the set has it, and `OPTIONAL`
    where it is commented out: it has a default, or something else stands in for it.
    """

    table: str
    key: str
    unit: str
    description: str
    state: str
    value: str
    heading: str = ""

    def line(self, width: int = 0) -> str:
        """Return its line of TOML, with the comment in column `width`."""
        return f"{self._assignment():<{width}}  # {self.description}"

    def width(self) -> int:
        """Return how long the assignment is."""
        return len(self._assignment())

    def _assignment(self) -> str:
        return f"{'# ' if self.state == OPTIONAL else ''}{self.key} = {self.value}"


@dataclass(frozen=True)
class Template:
    """A set of `model` to be filled in, from the values of a set where one is named."""

    model: str
    entries: tuple[Entry, ...]
    others: tuple[str, ...]

    def required(self) -> tuple[str, ...]:
        """Return the keys that are still to be filled in, as `table.key`."""
        return tuple(
            f"{e.table}.{e.key}" if e.table else e.key for e in self.entries if e.state == REQUIRED
        )

    def text(self) -> str:
        """Return the file."""
        missing = len(self.required())
        head = [
            f"# A parameter set of {self.model}. Quantities carry units: any that convert will do.",
            f'# Still to fill in: {missing} values, marked "{BLANK}".'
            if missing
            else "# Every value is there.",
            "# Lines that begin with # have a default, or something else stands in for them.",
            "",
        ]
        lines = [*head, *_laid_out([e for e in self.entries if not e.table])]
        if self.others:
            lines.append(f"# Sets to extend: {', '.join(self.others)}.")
        for table in dict.fromkeys(e.table for e in self.entries if e.table):
            lines += ["", f"[{table}]  # {_HEADINGS[table]}"]
            lines += _laid_out([e for e in self.entries if e.table == table])
        return "\n".join(lines) + "\n"


def template_of(model: LoweredModel, others: Sequence[str], raw: RawSet | None = None) -> Template:
    """Return the template of `model`, filled with what `raw` says; `others` are sets to extend."""
    written: Mapping[str, object] = raw.written if raw else {}
    entries = [
        _text("title", raw.title if raw else "", "what the set is"),
        _text("source", raw.source if raw else "", "where its values come from"),
    ]
    if others:
        what = "take what is not given below from another set of the model"
        entries.append(Entry("", "extends", "", what, OPTIONAL, _quoted(others[0])))
    for table in dict.fromkeys(TABLES.values()):
        if table == "gains":
            entries += _gains(model, written)
        elif table == "parameters":
            entries += _plant(model, written)
        else:
            entries += [_entry(p, written) for p in _in_groups(model, table)]
    return Template(model.name, tuple(entries), tuple(others))


def _laid_out(entries: Sequence[Entry]) -> list[str]:
    widths = [w for e in entries if (w := e.width()) <= _WIDEST // 2]
    width = max(widths, default=0)
    lines = []
    for entry in entries:
        if entry.heading:
            lines.append(f"# {entry.heading}")
        lines.append(entry.line(width))
    return lines


def _plant(model: LoweredModel, written: Mapping[str, object]) -> list[Entry]:
    """Return the parameters of the plant: all physical or all lumped ones, whichever are given."""
    plant = [_entry(p, written) for p in _grouped(model, "plant")]
    physical, lumped = _grouped(model, "physical"), _grouped(model, "lumped")
    if not (physical and lumped):
        return [*(_entry(p, written) for p in (*physical, *lumped)), *plant]
    by_lumped = any(p.name in written for p in lumped)
    first, second = (lumped, physical) if by_lumped else (physical, lumped)
    names = ("lumped", "physical") if by_lumped else ("physical", "lumped")
    return [
        *_headed([_entry(p, written) for p in first], f"in {names[0]} parameters:"),
        *_headed([_entry(p, {}, spare=True) for p in second], f"or all in {names[1]} ones:"),
        *_headed(plant, "in either case:"),
    ]


def _gains(model: LoweredModel, written: Mapping[str, object]) -> list[Entry]:
    """Return the gains: by poles, where they determine them and the set names none itself."""
    own, law = _grouped(model, "synthesised"), _grouped(model, "gain")
    order = zero_order(model)
    if own and order and places_poles(model):
        by_gains = any(p.name in written for p in own)
        poles = _poles(order, written, spare=by_gains)
        gains = [_entry(p, written, spare=not by_gains) for p in own]
        first, second = (gains, [poles]) if by_gains else ([poles], gains)
        chosen = [*first, *_headed(second, "or instead:")]
    else:
        chosen = [_entry(p, written) for p in own]
    return [*chosen, *_headed([_entry(p, written) for p in law], "the law:")]


def _poles(order: int, written: Mapping[str, object], *, spare: bool) -> Entry:
    number = "1 pole" if order == 1 else f"{order} poles"
    what = f"{number} in 1/s, such as {json.dumps([-6] * order)}; the gains follow from them"
    given = written.get(POLES_KEY)
    state = OPTIONAL if spare else REQUIRED if given is None else GIVEN
    value = _quoted(BLANK) if given is None else json.dumps(given, ensure_ascii=False)
    return Entry("gains", POLES_KEY, "1/s", what, state, value)


def _headed(entries: list[Entry], heading: str) -> list[Entry]:
    if not entries:
        return []
    first, *others = entries
    return [Entry(**{**vars(first), "heading": heading}), *others]


def _grouped(model: LoweredModel, group: str) -> list[Parameter]:
    return [p for p in model.parameters if p.group == group]


def _in_groups(model: LoweredModel, table: str) -> list[Parameter]:
    return [p for p in model.parameters if TABLES.get(p.group) == table]


def _entry(p: Parameter, written: Mapping[str, object], *, spare: bool = False) -> Entry:
    given = written.get(p.name)
    needed = p.default is None and not spare
    state = GIVEN if given is not None else REQUIRED if needed else OPTIONAL
    if given is not None:
        value = _quoted(given) if isinstance(given, str) else repr(given)
    elif p.default is not None:
        value = _quoted(f"{p.default!r} {p.unit}") if p.unit else repr(p.default)
    else:
        value = _quoted(f"{BLANK} {p.unit}".rstrip())
    return Entry(TABLES[p.group], p.name, p.unit, _meaning(p), state, value)


def _meaning(p: Parameter) -> str:
    """Return what a parameter is and within which bounds it lies, on one line."""
    least = f"above {p.lower:g}" if p.lower_open else f"from {p.lower:g}"
    bounds = [least] if p.lower > -math.inf else []
    bounds += [f"to {p.upper:g}"] if p.upper < math.inf else []
    default = ""
    if p.default is not None:
        solved = p.group == "gain"  # a set-point
        default = "; left out: solved for, from its default" if solved else "; has this default"
    what = " ".join(p.description.split())
    unit = f" [{p.unit}]" if p.unit else " [a plain number]"
    return f"{what}{unit}{', ' + ' '.join(bounds) if bounds else ''}{default}"


def _text(key: str, given: str, what: str) -> Entry:
    return Entry("", key, "", what, GIVEN if given else REQUIRED, _quoted(given or BLANK))


def _quoted(text: object) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
