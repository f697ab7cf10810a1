"""TOML documents: read them, and say what is wrong with them."""

from __future__ import annotations

import difflib
import reprlib
import tomllib
import unicodedata
from pathlib import Path

from pfaffian.runtime.base.errors import InputError


def read_toml(path: Path) -> dict[str, object]:
    """Return the document in `path`; raise `InputError` where it is unreadable or malformed.

    A byte order mark is passed over. Texts with characters that control a terminal or the order of
    what is read are refused: they would get into comments of the generated code.
    """
    remedy = "mend the line named in the message"
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8-sig"))  # editors write the mark
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
    _check_texts(document, f"{path}")
    return document


def unprintable(text: str) -> str:
    """Return the name of the first character of `text` that no document needs, or nothing.

    Those are control and format characters but line feeds and tabs, and halves of surrogates.
    """
    for character in text:
        if character not in "\n\r\t" and unicodedata.category(character) in ("Cc", "Cf", "Cs"):
            return f"U+{ord(character):04X}"
    return ""


def _check_texts(value: object, where: str) -> None:
    if isinstance(value, dict):
        for key, part in value.items():
            _check_texts(key, where)
            _check_texts(part, f"{where}: {key}")
    elif isinstance(value, list):
        for part in value:
            _check_texts(part, where)
    elif isinstance(value, str) and (found := unprintable(value)):
        raise InputError(
            f"{where}: {shown(value)} holds the control character {found}", remedy="leave it out"
        )


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
