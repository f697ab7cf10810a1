"""`pfaffian bench`: whole processes, medians, ratios in the same run."""

from __future__ import annotations

import json as json_module
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from pfaffian.cli import output
from pfaffian.runtime.base.errors import CheckError


def bench_regeneration(reference: str, runs: int, as_json: bool) -> None:
    """Change one parameter before each run, and time `generate --params` as a whole process."""
    from pfaffian.derive.spec.library import find_model

    source = find_model(reference)
    first = sorted(source.sets())[0]
    warm: list[float] = []
    cold: list[float] = []
    split: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        for k in range(runs):
            cold.append(_timed(reference, first, place, f"cold{k}", k)[0])
        _timed(reference, first, place, "warm", -1)
        for k in range(runs):
            seconds, stages = _timed(reference, first, place, "warm", k)
            warm.append(seconds)
            for stage, value in stages.items():
                split.setdefault(stage, []).append(value)
    document = {
        "model": source.name,
        "runs": runs,
        "warm_s": statistics.median(warm),
        "cold_s": statistics.median(cold),
        "warm_range_s": [min(warm), max(warm)],
        "cold_range_s": [min(cold), max(cold)],
        "warm_split_s": {k: statistics.median(v) for k, v in split.items()},
    }
    if as_json:
        output.emit_json(document)
        return
    output.table(
        "regeneration after a parameter change, whole processes, median",
        ("figure", "value"),
        list(document.items()),
    )


def _timed(
    reference: str, base: str, place: Path, cache: str, k: int
) -> tuple[float, dict[str, float]]:
    params = place / "changed.toml"
    params.write_text(
        f'extends = "{base}"\n[gains]\nsigma = "{2.0 + 0.01 * (k + 2)} 1/s"\n', encoding="utf-8"
    )
    command = [
        sys.executable,
        "-m",
        "pfaffian.cli.entry",
        "generate",
        reference,
        "--params",
        str(params),
        "-o",
        str(place / "out"),
        "--json",
    ]
    since = time.perf_counter()
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PFAFFIAN_CACHE": str(place / cache)},
    )
    seconds = time.perf_counter() - since
    if done.returncode != 0:
        raise CheckError(f"generate failed: {done.stderr.strip()}")
    stages: dict[str, Any] = json_module.loads(done.stdout)["seconds"]
    inside = sum(stages.values())
    return seconds, {"start and imports": seconds - inside, **stages}
