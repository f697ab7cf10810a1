"""The stack that a function needs at most, from the compiler's frames and the calls between them.

The frames are what the compiler says of each function; the calls are the relocations of its
object code. There are no function pointers and no recursion in generated code, so the deepest
path of calls bounds what a call can use; `CheckError` where there is recursion after all.
"""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from pfaffian.runtime.base.cache import cached, digest
from pfaffian.runtime.base.errors import CheckError
from pfaffian.runtime.machine.toolchain import COMMON_FLAGS, Target

_FRAME_OF_CLANG = re.compile(r"stack frame size \((\d+)\) exceeds limit \(0\) in '(\w+)'")


def stack_bound(target: Target, sources: Sequence[Path], include: Path, entry: str) -> int:
    """Return the bytes of stack that `entry` of `sources` needs at most on `target`.

    Raises `CheckError` where the compiler refuses, or a function calls itself.
    """
    headers = sorted(include.glob("*.h"))
    key = digest(
        repr((target.command, target.flags, COMMON_FLAGS, entry)).encode(),
        *(p.name.encode() + p.read_bytes() for p in (*sources, *headers)),
    )

    def compute() -> bytes:
        frames: dict[str, int] = {}
        calls: dict[str, set[str]] = {}
        for source in sources:
            more_frames, more_calls = _compile(target, source, include)
            frames |= more_frames
            calls |= more_calls
        return json.dumps(_deepest(entry, frames, calls, ())).encode()

    return int(json.loads(cached("stack", key, compute))) + target.red_zone


def _compile(
    target: Target, source: Path, include: Path
) -> tuple[dict[str, int], dict[str, set[str]]]:
    """Return the frame of each function of `source`, and what each calls."""
    zig = "ziglang" in target.command
    with tempfile.TemporaryDirectory(prefix="pfaffian-") as scratch:
        command = [
            *target.command,
            *COMMON_FLAGS,
            *target.flags,
            "-ffunction-sections",
            "-Wframe-larger-than=0" if zig else "-fstack-usage",
            f"-I{include.resolve()}",
            "-c",
            str(source.resolve()),
            "-o",
            "one.o",
        ]
        # What zig has cached it does not warn of again: a cache of its own.
        environment = {
            **os.environ,
            "ZIG_LOCAL_CACHE_DIR": scratch,
            "ZIG_GLOBAL_CACHE_DIR": scratch,
        }
        done = subprocess.run(
            command, cwd=scratch, env=environment, capture_output=True, text=True, check=False
        )
        path = Path(scratch) / "one.o"
        if done.returncode != 0 or not path.is_file():
            raise CheckError(
                f"{target.command[0]} did not compile {source.name} for {target.name}",
                remedy=(done.stderr or done.stdout).strip()[-4000:],
            )
        if zig:
            frames = {name: int(size) for size, name in _FRAME_OF_CLANG.findall(done.stderr)}
        else:
            rows = [line.split("\t") for line in path.with_suffix(".su").read_text().splitlines()]
            frames = {where.rsplit(":", 1)[1].split(".")[0]: int(n) for where, n, _ in rows}
        return frames, _calls(path.read_bytes())


def _calls(image: bytes) -> dict[str, set[str]]:
    """Return what each function of an object refers to in code: functions, by section or name."""
    from elftools.elf.elffile import ELFFile

    elf = ELFFile(io.BytesIO(image))
    symbols = elf.get_section_by_name(".symtab")
    found: dict[str, set[str]] = {}
    for section in elf.iter_sections():
        if section["sh_type"] not in ("SHT_REL", "SHT_RELA"):
            continue
        place = elf.get_section(section["sh_info"]).name
        if not place.startswith(".text."):
            continue
        names = set()
        for relocation in section.iter_relocations():
            symbol = symbols.get_symbol(relocation["r_info_sym"])
            name = symbol.name
            if symbol["st_info"]["type"] == "STT_SECTION":
                name = elf.get_section(symbol["st_shndx"]).name.removeprefix(".text.")
            names.add(name.split(".")[0])
        found.setdefault(place.removeprefix(".text.").split(".")[0], set()).update(names)
    return found


def _deepest(
    name: str,
    frames: Mapping[str, int],
    calls: Mapping[str, set[str]],
    above: tuple[str, ...],
) -> int:
    if name in above:
        raise CheckError(f"{name} calls itself: its stack has no bound")
    below = [
        _deepest(n, frames, calls, (*above, name))
        for n in sorted(calls.get(name, ()))
        if n in frames or n in calls
    ]
    return frames.get(name, 0) + max(below, default=0)
