"""Names and comments as the languages spell them."""

from __future__ import annotations


def comment_text(text: str) -> str:
    """Return `text` on one line, with nothing in it that ends a comment of C or a docstring."""
    line = " ".join(text.split())
    for harmful, harmless in (("*/", "* /"), ("/*", "/ *"), ("??", "? ?"), ('"""', "'''")):
        line = line.replace(harmful, harmless)
    return line.replace("\\", "/")


def snake(name: str) -> str:
    """Return `name` as an identifier: letters, digits and underscores."""
    word = "".join(c if c.isascii() and c.isalnum() else "_" for c in name)
    return f"set_{word}" if not word or word[0].isdigit() else word
