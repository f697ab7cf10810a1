"""Formulas as MathML that every browser shows alike."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from html import unescape
from xml.etree import ElementTree

from latex2mathml.converter import convert_to_element
from markupsafe import Markup

#: Pieces of the printer's LaTeX: kept as they are, a name of the generated code, or bare words.
_WORDS = re.compile(
    r"\\mathrm\{(?P<name>[^}]*)\}"
    r"|(?P<kept>\\(?:begin|end|text|operatorname)\{[^}]*\}|\\\\|\\[a-zA-Z]+)"
    r"|(?P<word>[a-z]{2,}|[a-zA-Z](?=_\{\w+ )|(?=_\{[a-z]{2}))(?:_\{(?P<index>\w+(?: \w+)*)\})?"
)
_GREEK = frozenset(("alpha", "beta", "gamma", "delta", "kappa", "mu", "phi", "psi", "sigma", "tau"))
_FUNCTIONS = {n: n for n in ("sin", "cos", "tan", "tanh", "exp", "max", "min")}
_FUNCTIONS |= {"atan": "arctan", "sign": "sgn"}
LETTERS = {"sigma": "ς", "eta": "η", "pi": "π", "Pi": "Π", "ahat": "â", "bhat": "b̂", "beta": "β"}
_TALL = ("mfrac", "mtable", "msqrt")
_SIGNS = {"plus": "+", "minus": "-"}
_ACCENTS = {"^": "\u02c6", "~": "\u02dc", "\u02d9": "\u02d9", "\u2015": "_"}


def mathml(latex: str) -> Markup:
    """Return an equation in the printer's LaTeX as presentation MathML."""
    root = convert_to_element(_WORDS.sub(_as_text, latex), display="block")
    _mend(root)
    for parent in [e for e in root.iter() if e.tag in ("math", "mrow", "mtd", "mstyle", "msqrt")]:
        _separate_factors(parent)
    root.attrib.pop("xmlns", None)
    return Markup(ElementTree.tostring(root, encoding="unicode"))


def _as_text(found: re.Match[str]) -> str:
    """Return a piece of LaTeX with names of several letters set as words, as in `_WORDS`."""
    if found["kept"]:
        return found["kept"].replace("\\text{for}", "\\text{if}")
    if found["name"]:
        word, *indices = found["name"].replace("\\_", "_").split("_")
        letters, digits = re.fullmatch(r"(.*?)(\d*)", word).groups()  # type: ignore[union-attr]
        return _name_latex(letters, [digits] * bool(digits) + indices)
    return _name_latex(found["word"], (found["index"] or "").split())


def _name_latex(letters: str, indices: Sequence[str]) -> str:
    """Return the LaTeX of a name in the generated code: `bhat`, `next` as b with hat and index."""
    base = letters
    if letters in _GREEK:
        base = f"\\{letters}"
    elif re.fullmatch("[a-z]hat", letters):
        base = f"\\hat{{{letters[0]}}}"
    elif len(letters) > 1:
        base = f"\\text{{{letters}}}"
    return base + "_{" * bool(indices) + _index_latex(letters, indices) + "}" * bool(indices)


def _index_latex(letters: str, indices: Sequence[str]) -> str:
    """Return indices in LaTeX; `q1`, `plus`, `q2` become a sum, and words stay apart."""
    pieces: list[str] = []
    for index in indices:
        symbol = re.fullmatch(r"([a-zA-Z])(\d+)", index)
        if index in _SIGNS:
            pieces.append(_SIGNS[index])
        elif symbol and len(letters) != 1:
            pieces.append(f"{symbol[1]}_{{{symbol[2]}}}")
        elif symbol and symbol[1] == letters:
            pieces.append(symbol[2])
        else:
            pieces.append(f"\\text{{{index}}}" if index.isalpha() and len(index) > 1 else index)
    return "".join(pieces).replace("}\\text{", " ")


def _mend(root: ElementTree.Element) -> None:
    """Repair what the converter sets badly: words, function names and accents."""
    for element in root.iter():
        text = element.text = unescape(element.text or "")
        if element.tag == "mtext" and text not in ("if", "otherwise"):
            element.tag = "mi"
        elif element.tag == "mo" and text.isalpha():
            element.tag, element.text = "mi", _FUNCTIONS.get(text, text)
        elif element.tag == "mo" and text in _ACCENTS:
            element.text = _ACCENTS[text]
            element.set("stretchy", "false")
        elif element.tag in ("mover", "munder"):
            element.set("accent" if element.tag == "mover" else "accentunder", "true")
        elif element.tag == "mrow" and not any(e.tag in _TALL for e in element.iter()):
            for fence in element.findall("mo[@fence]"):
                fence.set("stretchy", "false")


def _separate_factors(parent: ElementTree.Element) -> None:
    """Put a dot between factors of which one is a word, a space before functions; mark signs."""
    children = list(parent)
    for one, other in itertools.pairwise(children):
        if one.tag == other.tag == "mo" and other.text == "−" and one.get("form") != "postfix":
            other.set("form", "prefix")
    for one, other in zip(reversed(children[:-1]), reversed(children[1:]), strict=True):
        first, second = _base(one), _base(other)
        applied = first in _FUNCTIONS.values() and other.tag == "mrow"
        if not (_is_factor(one) and _is_factor(other)) or applied:
            continue
        where = list(parent).index(other)
        if {first, second} & {*_FUNCTIONS.values()}:
            parent.insert(where, ElementTree.Element("mspace", width="0.167em"))
        elif len(first) > 1 or len(second) > 1:
            dot = ElementTree.Element("mo")
            dot.text = "\u22c5"
            parent.insert(where, dot)


def _is_factor(element: ElementTree.Element) -> bool:
    return element.tag not in ("mo", "mspace", "mtext", "mtable")


def _base(element: ElementTree.Element) -> str:
    """Return the name that an element with or without indices belongs to, else nothing."""
    while element.tag in ("msub", "msup", "msubsup") or (
        element.tag == "mrow" and len(element) == 1
    ):
        element = element[0]
    return (element.text or "") if element.tag == "mi" else ""
