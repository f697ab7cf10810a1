"""Sources and a target become an image, once for each content."""

from __future__ import annotations

import functools
import os
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path

from pfaffian.runtime.base.cache import cached, digest
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.machine.toolchain import COMMON_FLAGS, Target


def compile_image(
    target: Target,
    sources: Sequence[Path],
    include: Path,
    extra: Sequence[str] = (),
    also: Sequence[Path] = (),
) -> bytes:
    """Return the linked image of `sources` for `target`, from the cache where it is known.

    `also` are further folders of headers and linker scripts. Raises `CheckError` with the
    compiler's own words where it refuses.
    """
    folders = (include, *also)
    headers = sorted(p for f in folders for p in (*f.glob("*.h"), *f.glob("*.ld")))
    key = digest(
        _version(
            target.command, os.environ.get("PATH", "")
        ),  # and the words: `gcc -m32` calls itself what `gcc` does
        repr((*astuple(target), COMMON_FLAGS, tuple(extra))).encode(),
        b"absolute paths",  # images of relative ones may hold another folder's headers
        *(p.name.encode() + p.read_bytes() for p in (*sources, *headers)),
    )
    return cached(f"image-{target.name}", key, lambda: _compile(target, sources, folders, extra))


@functools.cache
def _version(command: tuple[str, ...], _: str) -> bytes:
    """Return what a compiler says of itself, asked once a process for each search path."""
    return subprocess.run(
        [*command, "--version"], capture_output=True, check=False, timeout=120
    ).stdout


def _compile(
    target: Target, sources: Sequence[Path], folders: Sequence[Path], extra: Sequence[str]
) -> bytes:
    with tempfile.TemporaryDirectory(prefix="pfaffian-") as scratch:
        image = Path(scratch) / "image"
        libraries = ["-lm"] if target.name == "host" else []
        command = [
            *target.command,
            *COMMON_FLAGS,
            *target.flags,
            *target.link,
            *extra,
            # Absolute: zig's own cache takes the same words for the same headers in any folder.
            *(f"-I{folder.resolve()}" for folder in folders),
            *(str(s.resolve()) for s in sources),
            "-o",
            str(image),
            *libraries,
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
        if done.returncode != 0 or not image.is_file():
            raise CheckError(
                f"{target.command[0]} did not build the {target.name} image",
                remedy=(done.stderr or done.stdout).strip()[-4000:],
            )
        return image.read_bytes()
