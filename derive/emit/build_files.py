"""What builds the emitted C without this package: a Makefile, and CMake's files."""

from __future__ import annotations

from collections.abc import Iterable

from pfaffian.derive.emit.emitter import Emission, fill
from pfaffian.runtime.target_files import TargetFile, read_target, target_paths
from pfaffian.runtime.toolchain import COMMON_FLAGS


def emit_build_files(emission: Emission, paths: Iterable[str]) -> dict[str, str]:
    """Return the build files for the C files among `paths`, by path."""
    sources = sorted(p.removeprefix("c/") for p in paths if p.startswith("c/") and p[-2:] == ".c")
    described = [read_target(name) for name in target_paths()]
    context = {
        "header": "\n".join(f"# {line}" for line in emission.banner()),
        "model": emission.model.name,
        "sources": sources,
        "flags": COMMON_FLAGS,
        "targets": [row for row in map(_with_gcc, described) if row],
    }
    return {
        f"c/{name}": fill(f"c/{name}.j2", context)
        for name in ("Makefile", "CMakeLists.txt", "toolchain.cmake")
    }


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
