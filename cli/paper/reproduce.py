"""`pfaffian reproduce`: the paper's figures and tables, as measured here."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfaffian.cli import output

if TYPE_CHECKING:
    from pfaffian.paper.results.result import SectionResult, Update
    from pfaffian.paper.sections import Choice

#: What is read and not imported: generated code, the C of the runtime, files of data, templates.
_DATA = (
    *("generated/pendubot", "derive/models/pendubot", "runtime/c", "runtime/targets"),
    *("runtime/scenarios", "runtime/campaigns", "templates/reproduction", "templates/report"),
)
_TOOLS = ("numpy", "scipy", "casadi", "matplotlib", "mujoco", "jinja2")
PAGE, DOCUMENT, CLAIMS = "reproduction.html", "reproduction.json", "claims.md"


@dataclass(frozen=True)
class Made:
    """A reproduction: the content of its files by name, and the document of `--json`."""

    files: dict[str, bytes]
    document: dict[str, Any]


def reproduce(reference: str, folder: Path, as_json: bool) -> None:
    """Make what `reference` names, write it into `folder`, and print the verdicts."""
    from pfaffian.paper.sections import choices
    from pfaffian.runtime.base.cache import cached
    from pfaffian.runtime.base.files import check_output_folder, write_outputs

    chosen = choices(reference)
    check_output_folder(folder, "-o")
    key = _key(reference)
    made: Made = pickle.loads(
        cached("reproduction", key, lambda: pickle.dumps(_make(reference, chosen)))
    )
    write_outputs({folder / name: content for name, content in made.files.items()})
    document = {**made.document, "folder": str(folder), "page": str(folder / PAGE)}
    failures = document["failures"]
    output.deliver(
        document,
        as_json,
        lambda: _print(document),
        "; ".join(failures),
        "see the table of convergence, or of Theorem 1, on the page",
    )


def _key(reference: str) -> str:
    """Return the digest of all that a reproduction depends on: code, model, templates, tools."""
    from pfaffian.runtime.base.cache import digest
    from pfaffian.runtime.base.import_closure import code_of

    parts = [reference.encode(), *code_of(__name__)]
    for room in _DATA:
        top, _, below = room.partition("/")
        root = Path(str(files(f"pfaffian.{top}"))) / below
        for path in sorted(p for p in root.rglob("*") if p.is_file()):
            if "__pycache__" not in path.parts:
                parts += [str(path.relative_to(root)).encode(), path.read_bytes()]
    for tool in _TOOLS:
        try:
            parts.append(f"{tool} {version(tool)}".encode())
        except PackageNotFoundError:
            parts.append(f"no {tool}".encode())
    return digest(*parts)


def _make(reference: str, chosen: list[Choice]) -> Made:
    from pfaffian.paper.page import claims_markdown, render_page
    from pfaffian.paper.results.result import Request
    from pfaffian.runtime.code.generated_model import open_generated

    results: dict[str, SectionResult] = {}
    for choice in chosen:
        maker: Any = choice.section.maker()
        with _progress() as update:
            results[choice.section.name] = maker(
                choice.section.name, Request(choice.figures, choice.whole, update)
            )
    page = render_page(
        results, open_generated("pendubot").manifest, f"pfaffian reproduce {reference}"
    )
    document = _document(reference, results)
    content = {
        f"figures/{figure.name}.{kind}": data
        for result in results.values()
        for figure in result.figures
        for kind, data in (
            ("svg", figure.image.svg),
            ("pdf", figure.image.pdf),
            ("csv", figure.csv),
        )
        if data is not None
    }
    content |= {PAGE: page.encode(), DOCUMENT: _text(document)}
    if document["claims"]:
        content[CLAIMS] = claims_markdown(results).encode()
    return Made(content, document)


def _text(document: dict[str, Any]) -> bytes:
    import json

    return (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode()


@contextmanager
def _progress() -> Iterator[Update]:
    """Show each label with its share on standard error, a bar at a time."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=output.err) as bars:
        tasks: dict[str, Any] = {}

        def update(label: str, done: int, total: int) -> None:
            if label not in tasks:
                tasks[label] = bars.add_task(label, total=total)
            bars.update(tasks[label], completed=done, total=total)

        yield update


def _document(reference: str, results: dict[str, SectionResult]) -> dict[str, Any]:
    return {
        "reproduced": reference,
        "figures": [
            {
                "name": f.name,
                "number": f.number,
                "section": f.section,
                "title": f.title,
                "files": [f"figures/{f.name}.{kind}" for kind in f.kinds],
            }
            for r in results.values()
            for f in r.figures
        ],
        "claims": [{**asdict(c), "command": c.command} for r in results.values() for c in r.claims],
        "tables": {t.name: asdict(t) for r in results.values() for t in r.tables},
        "skipped": [text for r in results.values() for text in r.skipped],
        "failures": [text for r in results.values() for text in r.failures],
    }


def _print(document: dict[str, Any]) -> None:
    rows = [
        (c["section"], ", ".join(f[7:].lstrip("0") for f in c["figures"]), c["says"], c["verdict"])
        for c in document["claims"]
    ]
    if rows:
        output.table("claims", ("section", "figures", "the paper says", "verdict"), rows)
    for text in document["skipped"]:
        output.say(f"left out: {text}")
    count = len(document["figures"])
    word = "figure" if count == 1 else "figures"
    output.say(f"{count} {word}; page: {document['page']}")
