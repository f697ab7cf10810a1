"""The table of docs/single.md: flights with controller and plant in double and in single.

python docs/measured/single.py
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from pfaffian.runtime.code.generated_model import host_model, open_generated
from pfaffian.runtime.flight.closed_loop import fly
from pfaffian.runtime.flight.metrics import tracking_metrics
from pfaffian.runtime.flight.scenario import read_scenario

PFAFFIAN = str(Path(sys.executable).with_name("pfaffian"))
FLIGHTS = ("section-5.1-designed", "rig-balance", "pvtol-hover")


def main() -> None:
    """Print the table: IAE and MAE2 of the first coordinate."""
    print("| scenario | controller, plant | IAE [rad s, m s] | MAE2 [rad, m] |")
    print("|---|---|---|---|")
    for name in FLIGHTS:
        double = read_scenario(name)
        model = double.folder.manifest.model
        with tempfile.TemporaryDirectory() as folder:
            at = Path(folder) / model
            command = [PFAFFIAN, "generate", model, "--precision", "single", "-o", str(at)]
            subprocess.run(command, check=True, capture_output=True)
            single = read_scenario(name, at)
            exact, rounded = host_model(double.folder), host_model(open_generated(str(at)))
            flown = (
                (f"`{name}`", "double, double", fly(double, exact, exact, "host")),
                ("", "single, double", fly(single, rounded, exact, "host")),
                ("", "single, single", fly(single, rounded, rounded, "host")),
            )
        first = double.folder.manifest.coordinates[0]
        for cells in flown:
            figures = tracking_metrics(cells[2])
            iae, late = (figures[f"{kind}_{first}"] for kind in ("iae", "mae2"))
            print(f"| {cells[0]} | {cells[1]} | {iae:.6g} | {late:.3g} |", flush=True)


if __name__ == "__main__":
    main()
