"""The one family of errors, and the exit codes the command line gives them."""

from __future__ import annotations

from collections.abc import Sequence

EXIT_DONE = 0
EXIT_CHECK_FAILED = 1
EXIT_BAD_INPUT = 2
EXIT_MISSING_TOOL = 3
#: As a shell says that a program was ended by SIGINT or SIGPIPE: 128 and the signal's number.
EXIT_INTERRUPTED = 130
EXIT_BROKEN_PIPE = 141


class PfaffianError(Exception):
    """Base of every error this package raises on purpose.

    The message says what is wrong and where (file and key); `remedy` says what to do about it.
    `about` names the field or symbol at fault, the surest first, for whoever knows the file.
    """

    exit_code = EXIT_CHECK_FAILED

    def __init__(self, message: str, *, remedy: str = "", about: str = "") -> None:
        """Keep the message and the remedy apart, so that the command line can lay them out."""
        super().__init__(message)
        self.message = message
        self.remedy = remedy
        self.about = about

    def __str__(self) -> str:
        """Return the message followed by the remedy."""
        return f"{self.message}\n  {self.remedy}" if self.remedy else self.message


class InputError(PfaffianError):
    """Something the user gave is wrong: a name, a file, a value, a unit, a gain."""

    exit_code = EXIT_BAD_INPUT


def refuse_all(errors: Sequence[InputError]) -> None:
    """Raise one `InputError` that says everything in `errors`, each with its remedy, if any."""
    if len(errors) == 1:
        raise errors[0]
    if errors:
        first, *others = errors
        more = "\n".join(str(error) for error in others)
        raise InputError(first.message, remedy=f"{first.remedy}\n{more}") from first


class MissingToolError(PfaffianError):
    """A compiler or emulator is not installed; the remedy says how to get it."""

    exit_code = EXIT_MISSING_TOOL


class CheckError(PfaffianError):
    """A check that was asked for did not hold: drift, a mismatch, an identity not proved."""
