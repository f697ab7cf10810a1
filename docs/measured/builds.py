"""The tables of docs/targets.md and docs/single.md: what one step takes on each target.

    python docs/measured/builds.py [targets|single]

A compiler that is not installed leaves its row out.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

PFAFFIAN = str(Path(sys.executable).with_name("pfaffian"))
TARGETS = ("ppc750", "7447a", "e600", "e500mc", "ppc64le", "cortex-m7", "x86-64")
MODELS = ("pendubot", "acrobot", "cart_pole", "chain", "crane", "furuta", "pvtol")
MODELS += ("reaction_wheel", "tora", "two_wheeled")


def said(*command: str) -> dict | None:
    """Return the JSON document of a command, nothing where a tool is missing."""
    done = subprocess.run([PFAFFIAN, *command, "--json"], capture_output=True, text=True)
    if done.returncode == 3:
        return None
    done.check_returncode()
    return json.loads(done.stdout)


def targets() -> None:
    """Print text, stack and instructions of the Pendubot's step, by target and compiler."""
    print("| target | compiler | text B | stack bound B | stack measured B | instructions a step |")
    print("|---|---|---|---|---|---|")
    for target in TARGETS:
        for compiler in ("zig", "gcc"):
            built = said("build", "pendubot", "--target", target, "--toolchain", compiler)
            if built:
                keys = ("text_bytes", "stack_bound_bytes", "stack_bytes", "instructions_per_step")
                cells = ["" if built.get(k) is None else str(built[k]) for k in keys]
                print(f"| {target} | {compiler} | {' | '.join(cells)} |", flush=True)


def single() -> None:
    """Print what a step costs in double and in single on the 750, and the errors of single."""
    heads = ("instructions a step", "in single", "text [B]", "in single", "stack [B]", "in single")
    print(f"| model | worst scaled ulp | {' | '.join(heads)} |\n|{'---|' * 8}")
    for model in MODELS:
        with tempfile.TemporaryDirectory() as folder:
            at = str(Path(folder) / model)
            subprocess.run(
                [PFAFFIAN, "generate", model, "--precision", "single", "-o", at],
                check=True,
                capture_output=True,
            )
            built = [
                said("build", model, "--target", "ppc750", "--toolchain", "zig", *where)
                for where in ((), ("--generated", at))
            ]
            worst = said("verify", model, "--samples", "20000", "--generated", at)
        keys = ("instructions_per_step", "text_bytes", "stack_bytes")
        cells = [str(b[k]) for k in keys for b in built]
        ulp = f"{worst['worst_scaled_ulp']:.2f}"
        print(f"| `{model}` | {ulp} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    {"targets": targets, "single": single}[sys.argv[1]]()
