"""Compilers: find them, and build generated code into an image, once for each content."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from pfaffian.runtime.cache import cached, digest
from pfaffian.runtime.errors import CheckError, MissingToolError
from pfaffian.runtime.manifest import Manifest

#: Flags every build needs for the same bits: no contraction, no library of the compiler's own.
COMMON_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno")
#: Build for a 32-bit big-endian PowerPC 750 without an operating system.
PPC750_FLAGS = (
    "-target", "powerpc-freestanding-eabihf", "-mcpu=750", "-fno-sanitize=all",
    "-ffreestanding", "-fno-builtin", "-nostdlib", "-static", "-Wl,--image-base=0x10000",
)


@dataclass(frozen=True)
class Target:
    """A machine to build for: compiler command, flags, byte order and how it is run."""

    name: str
    command: tuple[str, ...]
    flags: tuple[str, ...]
    byte_order: str


def host_target(toolchain: str = "auto") -> Target:
    """Return the host as a target; raise `MissingToolError` where it has no C compiler."""
    flags = ("-fPIC", "-shared")
    if toolchain in ("auto", "gcc"):
        names = [os.environ.get("CC", ""), "gcc", "cc"] if toolchain == "auto" else ["gcc"]
        for name in names:
            if name and shutil.which(name.split()[0]):
                return Target("host", tuple(name.split()), flags, "=")
    if toolchain in ("auto", "zig") and importlib.util.find_spec("ziglang"):
        return Target("host", _zig(), (*flags, "-fno-sanitize=all"), "=")
    wanted = "C compiler" if toolchain == "auto" else toolchain
    raise MissingToolError(
        f"no {wanted} found for the host",
        remedy="install one: apt-get install gcc, or pip install ziglang",
    )


def ppc750_target() -> Target:
    """Return the PowerPC 750 as a target; raise `MissingToolError` without the compiler."""
    if importlib.util.find_spec("ziglang") is None:
        raise MissingToolError(
            "no compiler for PowerPC found: the Python package ziglang is missing",
            remedy="install it: pip install 'pfaffian[target]' (or pip install ziglang)",
        )
    return Target("ppc750", _zig(), PPC750_FLAGS, ">")


def _zig() -> tuple[str, ...]:
    return (sys.executable, "-m", "ziglang", "cc")


def controller_sources(folder: Path, manifest: Manifest) -> list[Path]:
    """Return the C files that a target needs for control alone."""
    c = folder / "c"
    return [c / f"{manifest.model}.c", c / "pf_elementary.c"]


def harness_sources(folder: Path, manifest: Manifest) -> list[Path]:
    """Return the C files of the model with the generic harness."""
    c, name = folder / "c", manifest.model
    harness = Path(str(files("pfaffian.runtime").joinpath("c/pf_harness.c")))
    return [
        *controller_sources(folder, manifest),
        *(c / f"{name}_{part}.c" for part in ("continuous", "plant", "params")), harness,
    ]


def compile_image(
    target: Target, sources: Sequence[Path], include: Path, extra: Sequence[str] = ()
) -> bytes:
    """Return the linked image of `sources` for `target`, from the cache where it is known.

    Raises `CheckError` with the compiler's own words where it refuses.
    """
    headers = sorted(include.glob("*.h"))
    version = subprocess.run(
        [*target.command, "--version"], capture_output=True, check=False, timeout=120
    ).stdout
    key = digest(
        version, repr((target.name, target.flags, COMMON_FLAGS, tuple(extra))).encode(),
        *(p.name.encode() + p.read_bytes() for p in (*sources, *headers)),
    )
    return cached(f"image-{target.name}", key, lambda: _compile(target, sources, include, extra))


def _compile(
    target: Target, sources: Sequence[Path], include: Path, extra: Sequence[str]
) -> bytes:
    with tempfile.TemporaryDirectory(prefix="pfaffian-") as scratch:
        image = Path(scratch) / "image"
        libraries = ["-lm"] if target.name == "host" else []
        command = [
            *target.command, *COMMON_FLAGS, *target.flags, *extra, f"-I{include}",
            *map(str, sources), "-o", str(image), *libraries,
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
        if done.returncode != 0 or not image.is_file():
            raise CheckError(
                f"{target.command[0]} did not build the {target.name} image",
                remedy=(done.stderr or done.stdout).strip()[-4000:],
            )
        return image.read_bytes()
