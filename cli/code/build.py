"""`pfaffian build`."""

from __future__ import annotations

from pathlib import Path

from pfaffian.cli import output


def build_image(
    reference: str,
    target_name: str,
    toolchain: str,
    folder: Path | None,
    generated: Path | None,
    as_json: bool,
) -> None:
    """Compile a generated controller and report what it costs."""
    from pfaffian.api.checking import build
    from pfaffian.runtime.base.files import check_output_folder, write_outputs
    from pfaffian.runtime.code.generated_model import open_generated

    check_output_folder(folder, "-o")
    source = open_generated(str(generated or reference))
    output.note(f"building {source.manifest.model} for {target_name}")
    built = build(source, target_name, toolchain)
    report = dict(built.document)
    if folder:
        suffix = "so" if target_name == "host" else "elf"
        path = folder / f"{source.manifest.model}-{report['target']}.{suffix}"
        write_outputs({path: built.image})
        report = {**report, "image": str(path)}
    if as_json:
        output.emit_json(report)
    else:
        output.table(
            f"{source.manifest.model} on {report['target']}",
            ("figure", "value"),
            list(report.items()),
        )
