"""Machines that run generated C: the host through ctypes, the PowerPC 750GX through an emulator."""

from __future__ import annotations

import ctypes
import io
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from pfaffian.runtime.errors import CheckError, MissingToolError

_PAGE = 0x1000
_STACK_BASE, _STACK_SIZE = 0x7000_0000, 0x10_0000
_HEAP_BASE, _HEAP_SIZE = 0x4000_0000, 0x400_0000
_RETURN = 0x6000_0000
_MSR_FLOATING_POINT = 0x2000


class Machine(Protocol):
    """Runs functions of one image. Arrays are passed by address and come back changed."""

    name: str
    byte_order: str

    def call(self, function: str, *arguments: np.ndarray[Any, Any] | int) -> int:
        """Call `function`; return its integer result."""


class HostMachine:
    """The image loaded into this process."""

    name = "host"
    byte_order = "="

    def __init__(self, image: bytes) -> None:
        """Load the shared library `image`."""
        handle, path = tempfile.mkstemp(prefix="pfaffian-", suffix=".so")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(image)
            self._library = ctypes.CDLL(path)
        finally:
            Path(path).unlink()

    def call(self, function: str, *arguments: np.ndarray[Any, Any] | int) -> int:
        """Call `function` with integers as uint32_t and arrays as pointers."""
        entry = getattr(self._library, function)
        entry.restype = ctypes.c_uint32
        for argument in arguments:
            if not isinstance(argument, int) and not argument.flags.c_contiguous:
                # C would read and write what lies between the records.
                raise CheckError(
                    f"{function}: an array is not contiguous", remedy="pass a copy of the slice"
                )
        passed = [
            ctypes.c_uint32(a) if isinstance(a, int) else ctypes.c_void_p(a.ctypes.data)
            for a in arguments
        ]
        return int(entry(*passed))

    def entry(self, function: str) -> Callable[..., int]:
        """Return `function` itself, which takes ctypes values and returns a C int."""
        entry = self._library[function]  # an object of its own: `call` declares another result
        entry.restype = ctypes.c_int
        return entry


class Ppc750Machine:
    """The image in an emulated PowerPC 750GX, 32-bit big-endian, without an operating system."""

    name = "ppc750"
    byte_order = ">"

    def __init__(self, image: bytes) -> None:
        """Load the ELF `image`. Raises `MissingToolError` without the emulator."""
        try:
            import unicorn
            from unicorn import ppc_const
        except ImportError as error:
            raise MissingToolError(
                f"no PowerPC emulator found: the Python package unicorn is missing ({error})",
                remedy="install it: pip install 'pfaffian[target]' (or pip install unicorn)",
            ) from error
        self._unicorn, self._registers = unicorn, ppc_const
        machine = unicorn.Uc(
            unicorn.UC_ARCH_PPC, unicorn.UC_MODE_PPC32 | unicorn.UC_MODE_BIG_ENDIAN
        )
        machine.ctl_set_cpu_model(ppc_const.UC_CPU_PPC32_750GX_V1_2)
        msr = machine.reg_read(ppc_const.UC_PPC_REG_MSR)
        machine.reg_write(ppc_const.UC_PPC_REG_MSR, msr | _MSR_FLOATING_POINT)
        self.symbols = _load_elf(machine, image)
        for base, size in ((_STACK_BASE, _STACK_SIZE), (_HEAP_BASE, _HEAP_SIZE), (_RETURN, _PAGE)):
            machine.mem_map(base, size)
        self._machine = machine

    def call(self, function: str, *arguments: np.ndarray[Any, Any] | int) -> int:
        """Call `function`; arrays are copied to the target's memory and back."""
        address, placed, words = _HEAP_BASE, [], []
        for argument in arguments:
            if isinstance(argument, int):
                words.append(argument)
                continue
            placed.append((address, argument))
            words.append(address)
            address += (argument.nbytes + 31) & ~31
        if address > _HEAP_BASE + _HEAP_SIZE:
            raise CheckError(
                "a batch is larger than the emulated memory", remedy="use fewer samples"
            )
        for where, argument in placed:
            self._machine.mem_write(where, argument.tobytes())
        result = self._run(self.symbols[function], words)
        for where, argument in placed:
            if argument.flags.writeable:
                raw = self._machine.mem_read(where, argument.nbytes)
                argument[...] = np.frombuffer(bytes(raw), argument.dtype).reshape(argument.shape)
        return result

    def _run(self, entry: int, words: list[int]) -> int:
        registers, machine = self._registers, self._machine
        machine.reg_write(registers.UC_PPC_REG_1, _STACK_BASE + _STACK_SIZE - 256)
        machine.reg_write(registers.UC_PPC_REG_LR, _RETURN)
        for k, word in enumerate(words):
            machine.reg_write(registers.UC_PPC_REG_3 + k, word)
        try:
            machine.emu_start(entry, _RETURN)
        except self._unicorn.UcError as error:
            counter = machine.reg_read(registers.UC_PPC_REG_PC)
            raise CheckError(f"the target stopped at {counter:#x}: {error}") from error
        return int(machine.reg_read(registers.UC_PPC_REG_3))

    def measure(self, entry: str, run: Callable[[], object]) -> tuple[int, int]:
        """Return (instructions, stack bytes) that `run` spends from `entry` to its return."""
        start, low = self.symbols[entry], _STACK_BASE + _STACK_SIZE
        state = {"inside": False, "count": 0, "top": 0, "low": low, "back": 0}
        registers = self._registers

        def each(machine: Any, address: int, _size: int, _data: object) -> None:
            if address == start:
                state["inside"] = True
                state["top"] = machine.reg_read(registers.UC_PPC_REG_1)
                state["back"] = machine.reg_read(registers.UC_PPC_REG_LR)
            elif state["inside"] and address == state["back"]:
                state["inside"] = False
            if state["inside"]:
                state["count"] += 1
                state["low"] = min(state["low"], machine.reg_read(registers.UC_PPC_REG_1))

        hook = self._machine.hook_add(self._unicorn.UC_HOOK_CODE, each)
        self._machine.ctl_flush_tb()
        try:
            run()
        finally:
            self._machine.hook_del(hook)
            self._machine.ctl_flush_tb()
        return state["count"], state["top"] - state["low"]


def _load_elf(machine: Any, image: bytes) -> dict[str, int]:
    """Map the segments of an ELF into `machine` and return its symbols."""
    from elftools.elf.elffile import ELFFile

    elf = ELFFile(io.BytesIO(image))
    mapped: set[int] = set()
    for segment in elf.iter_segments("PT_LOAD"):
        begin, size = segment["p_vaddr"], segment["p_memsz"]
        for page in range(begin & ~(_PAGE - 1), begin + size, _PAGE):
            if page not in mapped:
                machine.mem_map(page, _PAGE)
                mapped.add(page)
        machine.mem_write(begin, segment.data())
    table = elf.get_section_by_name(".symtab")
    return {s.name: s["st_value"] for s in table.iter_symbols() if s.name}


def section_bytes(image: bytes) -> dict[str, int]:
    """Return the size of each allocated section of an ELF image by name."""
    from elftools.elf.elffile import ELFFile

    elf = ELFFile(io.BytesIO(image))
    return {s.name: s["sh_size"] for s in elf.iter_sections() if s["sh_flags"] & 2 and s["sh_size"]}
