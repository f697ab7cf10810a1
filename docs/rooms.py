"""The rooms of this repository and which needs which, as a Mermaid chart made from the imports.

    python docs/rooms.py

The chart stands in the README; a test compares the two. An arrow that follows from others is left
out, so that what is drawn is the order of the house.
"""

from __future__ import annotations

import sys

import grimp

#: Packages whose rooms are drawn one by one; the others are a room each.
_DIVIDED = ("derive", "runtime")
_WHOLE = ("cli", "paper", "benchmarks", "api")


def _room(module: str) -> str:
    """Return the room of a module, `derive.law` or `cli`; empty for what is not drawn."""
    parts = module.split(".")[1:]
    if not parts or parts[0] not in (*_DIVIDED, *_WHOLE):
        return ""
    if parts[0] in _WHOLE:
        return parts[0]
    return ".".join(parts[:2]) if len(parts) > 1 else ""


def arrows() -> dict[str, set[str]]:
    """Return of each room those that it imports."""
    graph = grimp.build_graph("pfaffian")
    found: dict[str, set[str]] = {}
    for module in graph.modules:
        here = _room(module)
        if here:
            there = {_room(m) for m in graph.find_modules_directly_imported_by(module)}
            found.setdefault(here, set()).update(there - {"", here})
    return found


def reduced(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return `graph`, which has no circle, without the arrows that follow from others."""

    def reach(room: str, seen: set[str]) -> set[str]:
        for other in graph.get(room, set()) - seen:
            seen.add(other)
            reach(other, seen)
        return seen

    below = {room: reach(room, set()) for room in graph}
    return {
        room: {o for o in others if not any(o in below[p] for p in others if p != o)}
        for room, others in graph.items()
    }


def chart() -> str:
    """Return the chart, sorted, the same on every machine."""
    graph = arrows()
    lines = ["flowchart TB"]
    for package in _DIVIDED:
        lines.append(f"  subgraph {package}")
        rooms = sorted(r for r in graph if r.startswith(f"{package}."))
        lines += [f"    {r.replace('.', '_')}[{r.partition('.')[2]}]" for r in rooms]
        lines.append("  end")
    for room, others in sorted(reduced(graph).items()):
        lines += [f"  {room.replace('.', '_')} --> {o.replace('.', '_')}" for o in sorted(others)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(chart())
