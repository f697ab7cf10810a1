"""The table of docs/certificate.md: sections 5.1 to 5.3 with adaptation, certified.

python docs/measured/certificate.py
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from pfaffian.paper.simulations.cases import uncertainty
from pfaffian.runtime.code.generated_model import open_generated

SCENARIO = """model = "pendubot"
set = "{name}"
duration = "10 s"
[initial]
q1 = "1 rad"
q2 = "0.5 rad"
dq1 = "1 rad/s"
[plant]
{plant}
"""
#: 5.3 with the set `sim` runs into the certificate's limit of evaluations.
CASES = (("5.1", "sim"), ("5.1", "sim-designed"), ("5.2", "sim"), ("5.2", "sim-designed"))
CASES += (("5.3", "sim-designed"),)
HEAD = (
    "case",
    "set",
    "min abs(ADB)",
    "alpha",
    "dunder",
    "largest abs(delta)",
    "printed dbar / seen",
    "b",
    "largest abs(beta)",
    "b / seen",
    "Theorem 1 / seen, beta",
)


def certified(scenario: str, *options: str) -> dict:
    """Return what `pfaffian certify` says of a scenario's file."""
    command = [str(Path(sys.executable).with_name("pfaffian")), "certify", "pendubot"]
    command += ["--scenario", scenario, "--json", *options]
    return json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)


def row(case: str, name: str, said: dict) -> list[str]:
    """Return the cells of one case."""
    claims = {c["form"]: c for c in said["flight"]["claims"]}
    symbols = {(s["symbol"], s["form"]): s["value"] for s in said["symbols"]}
    ratio = said["conservative"]
    figures = (
        said["assumption1"]["bound"],
        said["assumption2"]["alpha"]["bound"],
        symbols["dunder", "printed"],
        claims["printed"]["largest"],
        ratio["printed, after T"],
        claims["p2"]["bound"],
        claims["p2"]["largest"],
        ratio["p2, all time"],
        ratio["printed, of beta alone"],
    )
    return [case, f"`{name}`", *(f"{f:.4g}" for f in figures)]


def main() -> None:
    """Print the table."""
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    members = open_generated("pendubot").manifest.structures["plant_params"].fields
    units = {f.name: f.unit for f in members}
    with tempfile.TemporaryDirectory() as folder:
        for case, name in CASES:
            plant = "\n".join(f'{n} = "{v!r} {units[n]}"' for n, v in uncertainty(case).items())
            path = Path(folder) / "mine.toml"
            path.write_text(SCENARIO.format(name=name, plant=plant), encoding="utf-8")
            print(f"| {' | '.join(row(case, name, certified(str(path))))} |", flush=True)


if __name__ == "__main__":
    main()
