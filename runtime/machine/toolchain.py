"""Compilers: find them, and build generated code into an image, once for each content."""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from pfaffian.runtime.base.errors import InputError, MissingToolError
from pfaffian.runtime.machine.target_files import TOOLCHAINS, Toolchain, read_target

#: Flags every build needs for the same bits: no contraction, no library of the compiler's own.
COMMON_FLAGS = (
    "-std=c99",
    "-O2",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-g0",
    "-fomit-frame-pointer",
)
#: The same processor under an operating system's ABI, without its start-up code.
PPC750_LIBM_FLAGS = (
    "-target",
    "powerpc-linux-musleabihf",
    "-mcpu=750",
    "-fno-sanitize=all",
    "-nostartfiles",
    "-static",
    "-Wl,--image-base=0x10000",
)
GCC_PPC = "powerpc-linux-gnu-gcc"


@dataclass(frozen=True)
class Target:
    """A machine to build for: compiler command, flags, byte order and how it is run.

    `link` are the flags that only an image needs, `unicorn` the emulator's family and processor,
    `red_zone` the bytes below the stack pointer that a function may use unasked.
    """

    name: str
    command: tuple[str, ...]
    flags: tuple[str, ...]
    byte_order: str
    link: tuple[str, ...] = ()
    unicorn: str = ""
    red_zone: int = 0

    @property
    def description(self) -> str:
        """Return the compiler and the flags that decide the code, without any path."""
        words = "zig cc" if "ziglang" in self.command else Path(self.command[0]).name
        return " ".join((words, *COMMON_FLAGS, *self.flags, *self.link))


def host_target(toolchain: str = "auto", fma: bool = False) -> Target:
    """Return the host as a target; raise `MissingToolError` where it has no C compiler.

    With `fma` the fused multiply-add becomes an instruction where the processor has one, instead
    of a call of the C library: the same bits, much faster, but an image for processors like it.
    """
    flags = ("-fPIC", "-shared", *(("-mfma",) if fma and processor_has_fma() else ()))
    if toolchain in ("auto", "gcc"):
        names = [os.environ.get("CC", ""), "gcc", "cc"] if toolchain == "auto" else ["gcc"]
        for name in names:
            if name.strip() and shutil.which(name.split()[0]):
                return Target("host", tuple(name.split()), flags, "=")
    if toolchain in ("auto", "zig") and importlib.util.find_spec("ziglang"):
        return Target("host", _zig(), (*flags, "-fno-sanitize=all"), "=")
    wanted = "C compiler" if toolchain == "auto" else toolchain
    raise MissingToolError(
        f"no {wanted} found for the host",
        remedy="install one: apt-get install gcc, or pip install ziglang",
    )


def find_target(reference: str, toolchain: str = "auto") -> Target:
    """Return a target of `target_files`, or the host, with the first of its compilers there is.

    Raises `InputError` for an unknown target or toolchain, `MissingToolError` without a compiler.
    """
    if toolchain not in ("auto", *TOOLCHAINS):
        raise InputError(f"unknown toolchain {toolchain}", remedy="choose auto, zig or gcc")
    if reference == "host":
        return host_target(toolchain)
    described = read_target(reference)
    fitting = [t for t in described.toolchains if toolchain in ("auto", t.name)]
    for tool in fitting:
        command = _zig() if tool.name == "zig" else (tool.command,)
        if importlib.util.find_spec("ziglang") if tool.name == "zig" else shutil.which(command[0]):
            return Target(
                described.name,
                command,
                tool.flags,
                described.byte_order,
                tool.link,
                described.unicorn,
                described.red_zone,
            )
    if not fitting:
        raise InputError(
            f"target {described.name} has no toolchain {toolchain}",
            remedy=f"choose one of {', '.join(t.name for t in described.toolchains)}",
        )
    raise MissingToolError(
        f"no compiler found for target {described.name} (toolchain {toolchain}): {described.title}",
        remedy="install one: " + " or ".join(_how_to_get(t) for t in fitting),
    )


def program_target(reference: str) -> tuple[Target, tuple[str, ...]]:
    """Return `reference` as a target of whole Linux programs, and what runs them here.

    Raises `InputError` where its file names no such programs, `MissingToolError` without the
    compiler, its C library or the emulator.
    """
    described = read_target(reference)
    tool = next((t for t in described.toolchains if t.program), None)
    if tool is None or not described.qemu_user:
        raise InputError(
            f"target {described.name} runs no Linux programs",
            remedy="give its file qemu_user, and [toolchain.gcc] program",
        )
    for command, package in (
        (tool.command, tool.package),
        (described.qemu_user[0], "qemu-user"),
    ):
        if not shutil.which(command):
            raise MissingToolError(
                f"no {command} found for target {described.name}",
                remedy=f"install it: apt-get install {package}",
            )
    asked = [tool.command, "-print-file-name=libc.a"]  # answers with a path where there is one
    answer = subprocess.run(asked, capture_output=True, text=True, check=False, timeout=60).stdout
    if not Path(answer.strip()).is_absolute():
        raise MissingToolError(
            f"no C library found for target {described.name}",
            remedy=f"install it: apt-get install {tool.program_package}",
        )
    name = f"{described.name}-program"
    return (
        Target(name, (tool.command,), tool.flags, described.byte_order, tool.program),
        described.qemu_user,
    )


def _how_to_get(tool: Toolchain) -> str:
    if tool.name == "zig":
        return "pip install 'pfaffian[target]' for zig"
    return f"apt-get install {tool.package}"


def ppc750_target(toolchain: str = "auto") -> Target:
    """Return the PowerPC 750 as a target; raise `MissingToolError` without a compiler for it."""
    return find_target("ppc750", toolchain)


def ppc750_libm_target() -> Target:
    """Return the PowerPC 750 with musl's libm, for code that calls a C library.

    Only zig brings that library along; it builds it at the first use, which takes a minute. Raises
    `MissingToolError` without zig.
    """
    if not importlib.util.find_spec("ziglang"):
        raise MissingToolError(
            "no C library for PowerPC found: it comes with zig",
            remedy="install it: pip install 'pfaffian[target]' (or pip install ziglang)",
        )
    return Target("ppc750-libm", _zig(), PPC750_LIBM_FLAGS, ">")


def processor_has_fma() -> bool:
    """Return whether this is an x86-64 processor that is known to have a fused multiply-add."""
    return _processor_has("fma")


def vector_flags() -> tuple[str, ...]:
    """Return the flags that let a compiler work on several samples at once on this machine.

    None of them changes a bit: there are no traps to keep, and AVX2 rounds as SSE2 does.
    """
    wide = ("-mavx2",) if _processor_has("fma") and _processor_has("avx2") else ()
    return ("-O3", "-fno-trapping-math", *wide)


def _processor_has(feature: str) -> bool:
    if platform.machine() not in ("x86_64", "AMD64"):
        return False  # the others have it, or no option for it
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return any(line.startswith("flags") and feature in line.split() for line in text.splitlines())


def _zig() -> tuple[str, ...]:
    return (sys.executable, "-m", "ziglang", "cc")
