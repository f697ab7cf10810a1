"""Target files: what a compiler is told to build for a machine. A new target is a new file.

title = "what it is"
byte_order = "big"            or "little"
bits = 32                     or 64
machine = "EM_PPC"            what the ELF header has to say
unicorn = "ppc32:750GX_V1_2"  where unicorn emulates it: family and processor
qemu_user = ["qemu-ppc", "-cpu", "750gx"]     where qemu runs Linux programs of it
red_zone = 288                bytes below the stack pointer that a function may use unasked

[toolchain.gcc]               or zig; the first that is installed is taken
command = "powerpc-linux-gnu-gcc"     zig needs none
package = "gcc-powerpc-linux-gnu"     where apt-get finds it
flags = ["-mcpu=750"]         of every compilation
link = ["-nostdlib"]          besides, where an image is linked
program = ["-static"]         instead, where a Linux program is linked
program_package = "libc6-dev-powerpc-cross"   the C library for that
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.toml import read_toml, shown, suggestion

TOOLCHAINS = ("zig", "gcc")
BYTE_ORDERS = {"big": ">", "little": "<"}
_REQUIRED = ("title", "byte_order", "bits", "machine", "toolchain")
_OPTIONAL = ("unicorn", "qemu_user", "red_zone")
_TOOLCHAIN_KEYS = ("command", "package", "flags", "link", "program", "program_package")


@dataclass(frozen=True)
class Toolchain:
    """A compiler for one target; `command` is empty for zig, which comes as a Python package."""

    name: str
    command: str
    package: str
    flags: tuple[str, ...]
    link: tuple[str, ...]
    program: tuple[str, ...]
    program_package: str


@dataclass(frozen=True)
class TargetFile:
    """A machine as its file describes it; `byte_order` as NumPy writes it."""

    name: str
    title: str
    byte_order: str
    bits: int
    machine: str
    unicorn: str
    qemu_user: tuple[str, ...]
    red_zone: int
    toolchains: tuple[Toolchain, ...]


def target_paths() -> dict[str, Path]:
    """Return the target files that come with this package, by name."""
    root = Path(str(files("pfaffian.runtime"))) / "targets"
    return {p.stem: p for p in sorted(root.glob("*.toml"))}


def read_target(reference: str) -> TargetFile:
    """Return the target called `reference`, or the one in that TOML file.

    Raises `InputError` for an unknown name and for a file that is not as this module says.
    """
    known = target_paths()
    path = known.get(reference, Path(reference))
    if reference not in known and path.suffix != ".toml":
        raise InputError(
            f"unknown target {reference}",
            remedy=f"known targets: {', '.join(('host', *known))}; or name a target file, *.toml",
        )
    document = read_toml(path)
    _check_keys(document, _REQUIRED, _OPTIONAL, f"{path}")
    order = _text(document, "byte_order", f"{path}")
    if order not in BYTE_ORDERS:
        raise InputError(f"{path}: byte_order is {order}", remedy="write big or little")
    bits = document["bits"]
    if not isinstance(bits, int) or bits not in (32, 64):
        raise InputError(f"{path}: bits is {shown(bits)}", remedy="write 32 or 64")
    return TargetFile(
        name=path.stem,
        title=_text(document, "title", f"{path}"),
        byte_order=BYTE_ORDERS[order],
        bits=bits,
        machine=_text(document, "machine", f"{path}"),
        unicorn=_text(document, "unicorn", f"{path}") if "unicorn" in document else "",
        qemu_user=_words(document, "qemu_user", f"{path}"),
        red_zone=_size(document, "red_zone", f"{path}"),
        toolchains=_toolchains(document["toolchain"], path),
    )


def _toolchains(tables: object, path: Path) -> tuple[Toolchain, ...]:
    if not isinstance(tables, Mapping) or not tables:
        raise InputError(f"{path}: has no toolchain", remedy="write a table [toolchain.gcc]")
    found = []
    for name, table in tables.items():
        where = f"{path}: [toolchain.{name}]"
        if name not in TOOLCHAINS or not isinstance(table, Mapping):
            raise InputError(
                f"{where} is no toolchain", remedy=suggestion(str(name), list(TOOLCHAINS))
            )
        required = ("flags",) if name == "zig" else ("command", "package", "flags")
        optional = tuple(k for k in _TOOLCHAIN_KEYS if k not in required)
        _check_keys(table, required, optional, where)
        keys = [k for k in ("command", "package", "program_package") if k in table]
        words = {k: _text(table, k, where) for k in keys}
        found.append(
            Toolchain(
                name,
                words.get("command", ""),
                words.get("package", ""),
                _words(table, "flags", where),
                _words(table, "link", where),
                _words(table, "program", where),
                words.get("program_package", ""),
            )
        )
    return tuple(found)


def _check_keys(
    table: Mapping[str, object], required: tuple[str, ...], optional: tuple[str, ...], where: str
) -> None:
    for key in required:
        if key not in table:
            raise InputError(f"{where}: has no {key}", remedy=f"a target needs {key}")
    for key in table:
        if key not in (*required, *optional):
            raise InputError(
                f"{where}: unknown key {key}", remedy=suggestion(key, [*required, *optional])
            )


def _text(table: Mapping[str, object], key: str, where: str) -> str:
    value = table[key]
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"{where}: {key} is {shown(value)}", remedy="write a text")
    return value


def _words(table: Mapping[str, object], key: str, where: str) -> tuple[str, ...]:
    value = table.get(key, [])
    if not isinstance(value, list) or not all(isinstance(w, str) and w for w in value):
        raise InputError(
            f"{where}: {key} is {shown(value)}", remedy='write a list of texts: ["-mcpu=750"]'
        )
    return tuple(value)


def _size(table: Mapping[str, object], key: str, where: str) -> int:
    value = table.get(key, 0)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= 4096:
        raise InputError(f"{where}: {key} is {shown(value)}", remedy="write bytes, 0 to 4096")
    return value
