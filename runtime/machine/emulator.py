"""A target's processor, emulated."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import Any, Literal

import numpy as np
from pfaffian.runtime.base.errors import CheckError, InputError, MissingToolError

_PAGE = 0x1000
_STACK_BASE, _STACK_SIZE = 0x7000_0000, 0x10_0000
_HEAP_BASE, _HEAP_SIZE = 0x4000_0000, 0x400_0000
_RETURN = 0x6000_0000


@dataclass(frozen=True)
class _Family:
    """What the emulator calls a family's parts; names of its constants.

    `floating` are the register and the bits that let it compute with floating point; `thumb` is 1
    where the lowest bit of an address tells the instruction set.
    """

    architecture: str
    mode: tuple[str, ...]
    constants: str
    processor: str
    stack: str
    link: str
    counter: str
    arguments: tuple[str, ...]
    floating: tuple[tuple[str, int], ...]
    byte_order: str
    thumb: int = 0


_FAMILIES = {
    "ppc32": _Family(
        "UC_ARCH_PPC",
        ("UC_MODE_PPC32", "UC_MODE_BIG_ENDIAN"),
        "ppc_const",
        "UC_CPU_PPC32_",
        "UC_PPC_REG_1",
        "UC_PPC_REG_LR",
        "UC_PPC_REG_PC",
        tuple(f"UC_PPC_REG_{k}" for k in range(3, 11)),
        (("UC_PPC_REG_MSR", 0x2000),),
        ">",
    ),
    "thumb": _Family(
        "UC_ARCH_ARM",
        ("UC_MODE_THUMB",),
        "arm_const",
        "UC_CPU_ARM_",
        "UC_ARM_REG_SP",
        "UC_ARM_REG_LR",
        "UC_ARM_REG_PC",
        tuple(f"UC_ARM_REG_R{k}" for k in range(4)),
        (("UC_ARM_REG_C1_C0_2", 0xF << 20), ("UC_ARM_REG_FPEXC", 1 << 30)),
        "<",
        1,
    ),
}


def emulator() -> ModuleType:
    """Return the emulator's module; raise `MissingToolError` where it is not installed."""
    try:
        return import_module("unicorn")
    except ImportError as error:
        raise MissingToolError(
            f"no PowerPC emulator found: the Python package unicorn is missing ({error})",
            remedy="install it: pip install 'pfaffian[target]' (or pip install unicorn)",
        ) from error


class EmulatedMachine:
    """The image in an emulated processor, 32-bit, without an operating system."""

    def __init__(self, image: bytes, processor: str, name: str) -> None:
        """Load the ELF `image` into `processor`, "family:name".

        Raises `MissingToolError` without the emulator, `InputError` for an unknown processor.
        """
        unicorn = emulator()
        family, _, model = processor.partition(":")
        if family not in _FAMILIES:
            raise InputError(
                f"target {name}: unicorn = {processor} names no family",
                remedy=f"known: {', '.join(f'{f}:PROCESSOR' for f in _FAMILIES)}",
            )
        self._family = kind = _FAMILIES[family]
        self._constants = import_module(f"unicorn.{kind.constants}")
        if not hasattr(self._constants, kind.processor + model):
            raise InputError(
                f"target {name}: unicorn = {processor} names no processor",
                remedy=f"the emulator calls them {kind.processor}...",
            )
        self.name, self.byte_order, self._unicorn = name, kind.byte_order, unicorn
        mode = sum(getattr(unicorn, m) for m in kind.mode)
        self._machine = unicorn.Uc(getattr(unicorn, kind.architecture), mode)
        self._machine.ctl_set_cpu_model(getattr(self._constants, kind.processor + model))
        for register, bits in kind.floating:
            self._set(register, self._get(register) | bits)
        self.symbols = _load_elf(self._machine, image)
        for base, size in ((_STACK_BASE, _STACK_SIZE), (_HEAP_BASE, _HEAP_SIZE), (_RETURN, _PAGE)):
            self._machine.mem_map(base, size)

    def _get(self, register: str) -> int:
        return int(self._machine.reg_read(getattr(self._constants, register)))

    def _set(self, register: str, value: int) -> None:
        self._machine.reg_write(getattr(self._constants, register), value)

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
        kind = self._family
        stack = _STACK_BASE + _STACK_SIZE - 256
        self._set(kind.stack, stack)
        self._set(kind.link, _RETURN | kind.thumb)
        for register, word in zip(kind.arguments, words, strict=False):
            self._set(register, word)
        for k, word in enumerate(words[len(kind.arguments) :]):
            # The rest lies on the stack (PowerPC passes eight words in registers, Arm four).
            order: Literal["big", "little"] = "big" if kind.byte_order == ">" else "little"
            self._machine.mem_write(stack + 4 * k, word.to_bytes(4, order))
        try:
            self._machine.emu_start(entry | kind.thumb, _RETURN)
        except self._unicorn.UcError as error:
            where = self._get(kind.counter)
            raise CheckError(f"the target stopped at {where:#x}: {error}") from error
        return self._get(kind.arguments[0])

    def measure(self, entry: str, run: Callable[[], object]) -> tuple[int, int]:
        """Return (instructions, stack bytes) that `run` spends from `entry` to its return."""
        kind = self._family
        start, low = self.symbols[entry] & ~kind.thumb, _STACK_BASE + _STACK_SIZE
        state = {"inside": False, "count": 0, "top": 0, "low": low, "back": 0}

        def each(_machine: Any, address: int, _size: int, _data: object) -> None:
            if address == start:
                state["inside"] = True
                state["top"] = self._get(kind.stack)
                state["back"] = self._get(kind.link) & ~kind.thumb
            elif state["inside"] and address == state["back"]:
                state["inside"] = False
            if state["inside"]:
                state["count"] += 1
                state["low"] = min(state["low"], self._get(kind.stack))

        hook = self._machine.hook_add(self._unicorn.UC_HOOK_CODE, each)
        self._machine.ctl_flush_tb()
        try:
            run()
        finally:
            self._machine.hook_del(hook)
            self._machine.ctl_flush_tb()
        return state["count"], state["top"] - state["low"]


class Ppc750Machine(EmulatedMachine):
    """The image in an emulated PowerPC 750GX, 32-bit big-endian, without an operating system."""

    def __init__(self, image: bytes) -> None:
        """Load the ELF `image`. Raises `MissingToolError` without the emulator."""
        super().__init__(image, "ppc32:750GX_V1_2", "ppc750")


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
