"""TOML documents: read them, and say what is wrong with them."""

from __future__ import annotations

import difflib
import reprlib
import tomllib
from pathlib import Path

from pfaffian.runtime.errors import InputError


def read_toml(path: Path) -> dict[str, object]:
    """Return the document in `path`; raise `InputError` where it is unreadable or malformed."""
    remedy = "mend the line named in the message"
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror})", remedy="check the path and its rights"
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text", remedy="save it as UTF-8") from error
    except ValueError as error:  # the parser's own, and an integer of thousands of digits
        raise InputError(f"{path}: is not valid TOML: {error}", remedy=remedy) from error
    except RecursionError as error:
        raise InputError(
            f"{path}: is nested too deeply", remedy="write tables and values one level deep"
        ) from error


def shown(value: object) -> str:
    """Return `value` as a message shows it: short, however long or deeply nested it is."""
    brief = reprlib.Repr()
    brief.maxstring = brief.maxother = 100
    try:
        return brief.repr(value)
    except ValueError:  # Python refuses to print integers of thousands of digits
        return "a number of thousands of digits"


def suggestion(word: str, known: list[str]) -> str:
    """Return a remedy that names the nearest known word, and all of them."""
    near = difflib.get_close_matches(word, known, n=1)
    lead = f"did you mean {near[0]}? " if near else ""
    return f"{lead}known: {', '.join(known)}"
