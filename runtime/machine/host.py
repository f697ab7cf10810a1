"""Machines that run generated C: the host through ctypes, a target through an emulator."""

from __future__ import annotations

import ctypes
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from pfaffian.runtime.base.errors import CheckError


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
