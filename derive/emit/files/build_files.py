"""What builds the emitted C without this package: a Makefile, and CMake's files."""

from __future__ import annotations

import re
from collections.abc import Mapping

from pfaffian.derive.emit.emission import Emission
from pfaffian.derive.emit.templates import fill
from pfaffian.runtime.machine.target_files import TargetFile, read_target, target_paths
from pfaffian.runtime.machine.toolchain import COMMON_FLAGS


def emit_build_files(emission: Emission, files: Mapping[str, str]) -> dict[str, str]:
    """Return the build files for the C files among `files`, by path.

    What includes headers that are not among them needs the C files of this package's runtime.
    """
    c = {p.removeprefix("c/"): t for p, t in files.items() if p.startswith("c/")}
    sources = sorted(name for name in c if name.endswith(".c"))
    outside = [name for name in sources if _reaches_out(name, c, frozenset())]
    sources = [name for name in sources if name not in outside]
    described = [read_target(name) for name in target_paths()]
    context = {
        "header": "\n".join(f"# {line}" for line in emission.banner()),
        "model": emission.model.name,
        "sources": sources,
        "outside": outside,
        "flags": COMMON_FLAGS,
        "targets": [row for row in map(_with_gcc, described) if row],
    }
    return {
        f"c/{name}": fill(f"c/{name}.j2", context)
        for name in ("Makefile", "CMakeLists.txt", "toolchain.cmake")
    }


def _reaches_out(name: str, c: Mapping[str, str], above: frozenset[str]) -> bool:
    """Return whether `name` includes a header that is not emitted, at any depth."""
    if name not in c:
        return True
    included = re.findall(r'^#include "([^"]+)"', c[name], re.MULTILINE)
    return any(_reaches_out(i, c, above | {name}) for i in included if i not in above)


def _with_gcc(target: TargetFile) -> dict[str, object]:
    """Return what the templates need of a target's gcc; nothing where it has none."""
    for tool in target.toolchains:
        if tool.name == "gcc":
            return {
                "name": target.name,
                "title": target.title,
                "command": tool.command,
                "archiver": f"{tool.command.removesuffix('gcc')}ar",
                "package": tool.package,
                "flags": tool.flags,
                "bits": target.bits,
            }
    return {}
