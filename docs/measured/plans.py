"""The table of docs/planning.md: which models have a plan, with which options.

python docs/measured/plans.py
"""

import json
import subprocess
import sys
from pathlib import Path

PLANS = (
    ("acrobot", ""),
    ("cart_pole", ""),
    ("furuta", ""),
    ("chain", ""),
    ("two_wheeled", ""),
    ("two_wheeled", "--torque-limit 0.4"),
    ("crane", "--start x=1"),
    ("pvtol", "--start x=1,y=1"),
    ("tora", "--start x=0.1 --end-time 1:6"),
    ("reaction_wheel", "--end-time 10 --coarse 250 --nodes 500 --seeds 1"),
)


def planned(model: str, options: str) -> dict:
    """Return what `pfaffian plan` says."""
    command = [str(Path(sys.executable).with_name("pfaffian")), "plan", model, "--json"]
    done = subprocess.run([*command, *options.split()], capture_output=True, text=True)
    return json.loads(done.stdout)


def row(model: str, options: str, said: dict) -> list[str]:
    """Return the cells of one plan."""
    peaks = zip(said["peak_torque"], said["torque_limits"], strict=True)
    both = next(f for f in said["following"] if f["case"] == "both")["law"]
    return [
        f"`{model}`, {said['set']}",
        f"`{options}`" if options else "",
        f"{said['end_time']:.4g}",
        ", ".join(f"{peak:.4g} of {limit:g}" for peak, limit in peaks),
        f"{said['energy_used']:.4g}",
        f"{said['defect']:.2g}",
        f"{sum(run['standing'] for run in both)} of {len(both)}",
    ]


def main() -> None:
    """Print the table."""
    print("| model, set | options | end [s] | peak of limit | energy [J] | defect | held |")
    print("|---|---|---|---|---|---|---|")
    for model, options in PLANS:
        print(f"| {' | '.join(row(model, options, planned(model, options)))} |", flush=True)


if __name__ == "__main__":
    main()
