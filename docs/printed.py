"""Printed blocks of the documents: found, run again, compared, renewed.

    python docs/printed.py [--quick] [--write] [PAGE ...]

A page shows what a command printed in one of two ways, each with its command:

- a fence of the language `console`: `$ COMMAND`, then lines of what it printed (several commands
  may follow one another); a comment above it may hold options: `<!-- slow, within 2 % -->`;
- a table or paragraph under `<!-- printed by: COMMAND; slow; within 2 % -->`, up to an empty line;
  the heading of a Markdown table is the page's own.

The lines shown are an excerpt: each must stand in what the command prints now, in this order. White
space, frames of tables and line breaks do not count; words must be the same; numbers are the same,
or within the tolerance stated; ` ... ` stands for words left out of a line. Options: `slow` (only
`make docs` runs it), `within X %` (of every number), `near X` (absolute), `exit N` (the exit code,
else 0), `figures vary` (times on a noisy machine: only the words are compared). A fence under
`<!-- file: NAME -->` is a file that the commands after it find.

Each number in the prose of a page, written with a decimal point, must stand in a printed block of
that page, to the digits shown, or in its comment `<!-- given: ... -->`: what is chosen, quoted or
defined.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))

_NUMBER = r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w])"
_TOKEN = re.compile(rf"{_NUMBER}|[^\W\d_]+|\S")
#: Frames of tables, of the terminal's and of Markdown's; the rule under a Markdown heading.
_FRAME = re.compile(r"[\u2500-\u257f|]|^\s*\|[-| :]+\|\s*$|`", flags=re.MULTILINE)
#: Stands in a line for words of the command's that are not shown.
_LEFT_OUT = " ... "
#: The heading of a Markdown table: it may say more than the command does.
_HEADING = re.compile(r"\|[^\n]*\|\n(?=\|[-| :]+\|\n)")
_FENCE = re.compile(
    r"(?:^<!-- (?P<options>[^>\n]*?) -->\n)?^```(?P<language>\w*)\n(?P<body>.*?)^```$",
    flags=re.DOTALL | re.MULTILINE,
)
_TABLE = re.compile(
    r"^<!-- printed by: (?P<rest>[^\n]*?) -->\n(?P<body>.*?)(?=\n\n|^\n|\Z)",
    flags=re.DOTALL | re.MULTILINE,
)


@dataclass(frozen=True)
class Options:
    """How a block is run and compared."""

    slow: bool = False
    relative: float = 0.0
    absolute: float = 0.0
    exit_code: int = 0
    varies: bool = False


@dataclass(frozen=True)
class Block:
    """A command and the lines that its page shows of what it printed; `start` is their offset.

    A `table` shows something, where a fence may just run a command.
    """

    page: Path
    command: str
    lines: str
    start: int
    options: Options
    table: bool = False


@dataclass(frozen=True)
class Written:
    """A file that a page has its reader write."""

    name: str
    text: str


def options_of(words: Sequence[str], where: str) -> Options:
    """Read options; raise `ValueError` for a word that is none."""
    found: dict[str, float | int | bool] = {}
    for word in (w.strip() for w in words):
        if word == "slow":
            found["slow"] = True
        elif word == "figures vary":
            found["varies"] = True
        elif given := re.fullmatch(r"within ([\d.]+) %", word):
            found["relative"] = float(given[1]) / 100.0
        elif given := re.fullmatch(r"near ([\d.e+-]+)", word):
            found["absolute"] = float(given[1])
        elif given := re.fullmatch(r"exit (\d+)", word):
            found["exit_code"] = int(given[1])
        elif word:
            raise ValueError(f"{where}: {word!r} is not an option of a printed block")
    return Options(**found)  # type: ignore[arg-type]


def parts_of(page: Path, text: str) -> list[Block | Written]:
    """Return the printed blocks and files of a page, in the order they stand there."""
    found: list[tuple[int, Block | Written]] = []
    for fence in _FENCE.finditer(text):
        options = fence["options"] or ""
        if options.startswith("file: "):
            name = options.removeprefix("file: ").strip()
            found.append((fence.start(), Written(name, fence["body"])))
        elif fence["language"] == "console":
            made = options_of(options.split(","), page.name)
            found += [
                (start, Block(page, command, lines, start, made))
                for command, lines, start in _commands(fence["body"], fence.start("body"))
            ]
    for table in _TABLE.finditer(text):
        command, *words = table["rest"].split("; ")
        made = options_of(words, page.name)
        body, start = table["body"], table.start("body")
        if heading := _HEADING.match(body):
            body, start = body[heading.end() :], start + heading.end()
        found.append((start, Block(page, command, body, start, made, table=True)))
    return [part for _, part in sorted(found, key=lambda row: row[0])]


def _commands(body: str, offset: int) -> Iterator[tuple[str, str, int]]:
    """Yield each `$ command` of a fence with the lines under it and where these start."""
    heads = list(
        re.finditer(r"^\$ (?P<command>(?:[^\n]*\\\n)*[^\n]*)\n?", body, flags=re.MULTILINE)
    )
    ends = [*(h.start() for h in heads[1:]), len(body)]
    for head, end in zip(heads, ends, strict=False):
        command = re.sub(r"\s*\\\n\s*", " ", head["command"])
        yield command, body[head.end() : end], offset + head.end()


def run(block: Block, folder: Path) -> str:
    """Run the command of `block` in `folder` and return what it printed; raise on its exit code.

    `make` and scripts of the repository start in the repository.
    """
    at_root = block.command.startswith(("make ", "python docs/"))
    binaries = str(Path(sys.executable).parent)
    environment = dict(
        os.environ, PATH=f"{binaries}{os.pathsep}{os.environ['PATH']}", COLUMNS="110"
    )
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {block.command}"],
        cwd=ROOT if at_root else folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    if done.returncode != block.options.exit_code:
        raise RuntimeError(
            f"{block.page.name}: `{block.command}` ended with {done.returncode}, the page says "
            f"{block.options.exit_code}\n{done.stderr[-2000:]}"
        )
    return f"{done.stdout}\n{done.stderr}"


def tokens(text: str) -> list[re.Match[str]]:
    """Return the words, numbers and signs of `text`, frames of tables left out."""
    return list(_TOKEN.finditer(_FRAME.sub(lambda m: " " * len(m[0]), text)))


def number(token: str) -> float | None:
    """Return the number that `token` is, or None."""
    return float(token) if re.fullmatch(_NUMBER, token) else None


def _agree(shown: str, printed: str, options: Options, words_only: bool) -> bool:
    if shown == printed:
        return True
    a, b = number(shown), number(printed)
    if a is None or b is None:
        return False
    if words_only or options.varies:
        return True
    return abs(a - b) <= max(options.absolute, options.relative * max(abs(a), abs(b)))


def _find(
    row: Sequence[str], stream: Sequence[str], start: int, options: Options, words_only: bool
) -> int | None:
    """Return where `row` stands in `stream` at or after `start`."""
    for k in range(start, len(stream) - len(row) + 1):
        if all(_agree(s, stream[k + j], options, words_only) for j, s in enumerate(row)):
            return k
    return None


def drift(block: Block, printed: str) -> list[str]:
    """Return the lines of `block` that do not stand in `printed`, in order; none where all do."""
    stream, at, missing = [t[0] for t in tokens(printed)], 0, []
    for line in block.lines.splitlines():
        for part in line.split(_LEFT_OUT):
            row = [t[0] for t in tokens(part)]
            found = _find(row, stream, at, block.options, words_only=False)
            if row and found is None:
                missing.append(part.strip())
            elif found is not None:
                at = found + len(row)
    return missing


def renewed(block: Block, printed: str) -> str:
    """Return the lines of `block` with the numbers printed now; lines with other words stay.

    A block that shows nothing yet gets all that is printed.
    """
    if block.table and not block.lines.strip():
        return printed.partition("\n\n")[0].strip() + "\n"
    stream, at, lines = [t[0] for t in tokens(printed)], 0, []
    for line in block.lines.splitlines(keepends=True):
        parts = []
        for part in line.split(_LEFT_OUT):
            shown = tokens(part)
            row = [t[0] for t in shown]
            found = _find(row, stream, at, block.options, words_only=False)
            if found is None:
                found = _find(row, stream, at, block.options, words_only=True)
            if row and found is not None:
                part = _with_numbers(part, shown, stream[found : found + len(row)])
                at = found + len(row)
            parts.append(part)
        lines.append(_LEFT_OUT.join(parts))
    return "".join(lines)


def _with_numbers(line: str, shown: Sequence[re.Match[str]], now: Sequence[str]) -> str:
    """Put the numbers of `now` into `line`; padding gives way, so that columns stay in place."""
    for token, new in reversed(list(zip(shown, now, strict=True))):
        if number(token[0]) is None or token[0] == new:
            continue
        tail, grown = line[token.end() :], len(new) - len(token[0])
        spaces = len(tail) - len(tail.lstrip(" "))
        if grown < 0 and spaces > 1:
            tail = " " * -grown + tail
        elif 0 < grown < spaces:
            tail = tail[grown:]
        line = line[: token.start()] + new + tail
    return line


def check_page(page: Path, quick: bool, write: bool = False) -> list[str]:
    """Run the blocks of `page` and return what no longer holds; with `write` renew the page."""
    text = page.read_text(encoding="utf-8")
    problems, edits = [], []
    parts = parts_of(page, text)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in parts:
            if isinstance(part, Written):
                path = folder / part.name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(part.text, encoding="utf-8")
                continue
            if quick and part.options.slow:
                continue
            try:
                printed = run(part, folder)
            except RuntimeError as error:
                problems.append(str(error))
                continue
            missing = drift(part, printed)
            if part.table and not part.lines.strip():
                missing = ["(nothing is shown)"]
            if missing and write:
                edits.append((part.start, part.lines, renewed(part, printed)))
                missing = drift(Block(page, part.command, edits[-1][2], 0, part.options), printed)
            problems += [f"{page.name}: `{part.command}` does not print: {m}" for m in missing]
    for start, old, new in reversed(edits):
        text = text[:start] + new + text[start + len(old) :]
    if edits:
        page.write_text(text, encoding="utf-8")
    return problems


def unfounded(page: Path) -> list[str]:
    """Return the decimals in the prose of `page` that no printed block and no `given` holds."""
    text = page.read_text(encoding="utf-8")
    blocks = [p for p in parts_of(page, text) if isinstance(p, Block)]
    known = {t[0] for b in blocks for t in tokens(b.lines) if number(t[0]) is not None}
    given = " ".join(re.findall(r"<!-- given: (.*?) -->", text, flags=re.DOTALL))
    known |= {t[0] for t in tokens(given)}
    known |= {t[0] for b in blocks for t in tokens(b.command)}
    prose = _FENCE.sub("", text)
    for block in blocks:
        prose = prose.replace(block.lines, "")
    prose = re.sub(
        r"<!--.*?-->|`[^`]*`|\([^()\s]*\)|^    [^\n]*$", "", prose, flags=re.DOTALL | re.MULTILINE
    )
    shown = [t[0] for t in tokens(prose) if number(t[0]) is not None and re.search(r"\.\d", t[0])]
    values = [float(k) for k in known if number(k) is not None]
    return [s for s in shown if not any(_rounds_to(v, s) for v in values)]


def _rounds_to(value: float, shown: str) -> bool:
    """Return whether `value`, of either sign or in per cent, is written `shown` to its digits."""
    digits = shown.lower().partition("e")[0].partition(".")[2]
    exponent = int(shown.lower().partition("e")[2] or 0)
    half = 0.5000001 * 10.0 ** (exponent - len(digits))
    return any(abs(abs(v) - abs(float(shown))) <= half for v in (value, 100.0 * value))


def main() -> int:
    """Check, or renew, the pages named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="leave slow blocks out")
    parser.add_argument(
        "--write", action="store_true", help="put the numbers printed now into the page"
    )
    parser.add_argument("page", nargs="*", type=Path, default=PAGES)
    given = parser.parse_args()
    problems = []
    for page in given.page:
        found = check_page(page.resolve(), given.quick, given.write)
        found += [f"{page.name}: nothing printed here holds {n}" for n in unfounded(page)]
        print(f"{page.name}: {'as printed' if not found else f'{len(found)} differ'}", flush=True)
        print("".join(f"  {p}\n" for p in found), end="", flush=True)
        problems += found
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
