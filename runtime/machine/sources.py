"""Which C sources an image is made of."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from pfaffian.runtime.contract.manifest import Manifest


def controller_sources(folder: Path, manifest: Manifest) -> list[Path]:
    """Return the C files that a target needs for control alone."""
    c = folder / "c"
    elementary = "pf_elementaryf.c" if manifest.precision == "single" else "pf_elementary.c"
    return [c / f"{manifest.model}.c", c / elementary]


def harness_sources(folder: Path, manifest: Manifest) -> list[Path]:
    """Return the C files of the model with the generic harness."""
    c, name = folder / "c", manifest.model
    parts = ("continuous", "plant", "params", *(("follow", "plan") if manifest.plans else ()))
    harness = Path(str(files("pfaffian.runtime").joinpath("c/pf_harness.c")))
    optional = ("swing_up",) if "swing_up_output" in manifest.structures else ()
    return [
        *controller_sources(folder, manifest),
        *(c / f"{name}_{part}.c" for part in (*parts, *optional)),
        harness,
    ]


def runtime_c() -> Path:
    """Return the folder of the C runtime."""
    return Path(str(files("pfaffian.runtime").joinpath("c")))


def control_sources(folder: Path, manifest: Manifest) -> list[Path]:
    """Return the C files of a complete controller, runtime included, without any harness."""
    c, name = folder / "c", manifest.model
    optional = [c / f"{name}_{part}.c" for part in ("swing_up", "follow", "plan")]
    return [
        *controller_sources(folder, manifest),
        *(path for path in optional if f"c/{path.name}" in manifest.files),
        c / f"{name}_control.c",
        c / f"{name}_control_params.c",
        c / f"{name}_params.c",
        *(runtime_c() / f"pf_{module}.c" for module in ("sensing", "supervisor")),
    ]


def batch_sources(folder: Path, manifest: Manifest) -> list[Path]:
    """Return the C files of the batch form; it is there where `--batch` was given."""
    c = folder / "c"
    return [c / f"{manifest.model}_batch.c", c / "pf_elementary.c"]
