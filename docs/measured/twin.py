"""The table of docs/twin.md: what a flight on the twin costs.

python docs/measured/twin.py
"""

import time
from dataclasses import replace

from pfaffian.runtime.twin import Twin, balance_unit, read_twin

DURATION = 2.0


def main() -> None:
    """Print the table."""
    print("| rigs | threads | flight [s] | took [s] | times real time, all rigs |")
    print("|---|---|---|---|---|")
    for rigs, threads in ((1, 1), (1000, 2)):
        flown = read_twin("rig-balance-twin")
        steps = round(DURATION / flown.base.sample_time)
        scenario = replace(flown, rigs=rigs, base=replace(flown.base, steps=steps))
        twin = Twin(scenario, threads=threads)
        unit = balance_unit(scenario, twin.model)
        start = time.perf_counter()
        twin.fly(unit)
        took = time.perf_counter() - start
        print(f"| {rigs} | {threads} | {DURATION:g} | {took:.3g} | {rigs * DURATION / took:.3g} |")


if __name__ == "__main__":
    main()
