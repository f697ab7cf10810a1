"""The tables of docs/swing-up.md: the generated law on the generated plant, `rig`, from hanging.

python docs/measured/swing_up.py first|starts|limit|rest
"""

import sys

import numpy as np
from pfaffian.runtime.code.generated_model import fill_records, host_model, open_generated

HOST = host_model(open_generated("pendubot"))
RIG = HOST.folder.parameters("rig")
#: kP, kD and kE of section 6; the paper does not print kV.
PAPER = {"kP": 66.35, "kD": 9.45, "kE": 1.0}
GAINS = {"section 6, kV = 1": {**PAPER, "kV": 1.0}, "section 6, kV = 2": {**PAPER, "kV": 2.0}}
GAINS["`rig`"] = {n: RIG[n] for n in ("kP", "kD", "kE", "kV")}
BOX = 0.26


class Flights:
    """N flights side by side, each period held, the plant advanced by Runge-Kutta steps."""

    def __init__(self, gains: dict, starts: np.ndarray, period: float, limit: float) -> None:
        """Start at `starts` (N, 4), q1, q2 [rad] and rates [rad/s]."""
        n = len(starts)
        law = {**RIG, **gains, "torque_limit": limit}
        self.params = fill_records(HOST.records("params", n), law)
        self.plant = fill_records(HOST.records("plant_params", n), RIG)
        self.state, self.seen = (HOST.records(r, n) for r in ("plant_state", "input"))
        self.applied = HOST.records("plant_input", n)
        self.made, self.status = HOST.records("swing_up_output", n), np.zeros(n, np.int32)
        self.step = np.full(n, period / 4)
        for k, name in enumerate(("q1", "q2", "dq1", "dq2")):
            self.state[name] = starts[:, k]

    def advance(self) -> None:
        """Fly one period."""
        for name in ("q1", "q2", "dq1", "dq2"):
            self.seen[name] = self.state[name]
        HOST.swing_up(self.params, self.seen, self.made, self.status)
        self.applied["tau"] = self.made["tau"]
        HOST.plant_step(self.state, self.plant, self.applied, self.step, 4)

    def in_box(self) -> np.ndarray:
        """Return which flights see both links within the paper's box, to whole turns."""
        away = (self.seen["q1"] - np.pi / 2, self.seen["q2"])
        turned = [np.abs(np.remainder(a + np.pi, 2 * np.pi) - np.pi) for a in away]
        return (turned[0] <= BOX) & (turned[1] <= BOX)


def first() -> None:
    """Print when the box is first reached from hanging at rest, and how."""
    print(
        "| gains | held for | torque limit | first in the box | q1' there | q2' there | E~ there |"
    )
    print("|---|---|---|---|---|---|---|")
    rows = (("section 6, kV = 1", 25e-6, 1e3), ("section 6, kV = 1", 100e-6, 1e3))
    rows += (("section 6, kV = 2", 1e-3, 2.0), ("`rig`", 1e-3, 2.0))
    for name, period, limit in rows:
        flights = Flights(GAINS[name], np.array([[-np.pi / 2, 0.0, 0.0, 0.0]]), period, limit)
        for k in range(round(40.0 / period)):  # noqa: B007
            flights.advance()
            if flights.in_box()[0]:
                break
        seen, error = flights.seen[0], flights.made["energy_error"][0]
        bound = "none" if limit > 100 else f"{limit:g} N m"
        print(
            f"| {name} | {1e6 * period:g} us | {bound} | {k * period:.3f} s | "
            f"{seen['dq1']:.3g} rad/s | {seen['dq2']:.3g} rad/s | {error:.2g} J |",
            flush=True,
        )


def starts() -> None:
    """Print how many of 400 starts near hanging reach the box within 40 s, and when."""
    print("| gains | what is reached | of 400 | 10 % by | half of them by | 90 % by |")
    print("|---|---|---|---|---|---|")
    rng = np.random.default_rng(1)
    near = np.array([-np.pi / 2, 0.0, 0.0, 0.0]) + rng.normal(0.0, 0.01, (400, 4))
    for name, gains in GAINS.items():
        flights = Flights(gains, near, 1e-3, 2.0)
        box, calm = np.full(400, np.inf), np.full(400, np.inf)
        for k in range(40_000):
            flights.advance()
            inside, energy = flights.in_box(), np.abs(flights.made["energy_error"])
            box = np.where(inside & np.isinf(box), k * 1e-3, box)
            calm = np.where(inside & (energy < 0.5) & np.isinf(calm), k * 1e-3, calm)
        for what, times in (("the box", box), ("the box with abs(E~) < .5 J", calm)):
            reached = np.sort(times[np.isfinite(times)])
            at = [reached[int(p * (len(reached) - 1))] for p in (0.1, 0.5, 0.9)]
            print(f"| {name} | {what} | {len(reached)} | {' | '.join(f'{t:.2f} s' for t in at)} |")


def limit() -> None:
    """Print what kD/kE must exceed, and what it is."""
    from pfaffian.derive.pipeline import library_sets, lowered_model
    from pfaffian.derive.sets.swing_up_limit import largest_limit
    from pfaffian.derive.spec.library import find_model

    model = lowered_model(find_model("pendubot"))
    print("| set | kD/kE must exceed | at q2 | kD/kE |\n|---|---|---|---|")
    for s in library_sets(model, find_model("pendubot")):
        values = s.as_dict()
        found = largest_limit(model, values, 1e-9)
        where = ", ".join(f"{v:.3f} rad" for v in found.at.values())
        ratio = values["kD"] / values["kE"]
        print(f"| `{s.name}` | {found.most:.5g} s^2 J^2 | {where} | {ratio:.4g} |")


def rest() -> None:
    """Print the poles with link 1 up and link 2 hanging under it: central differences."""
    print("| gains | poles [1/s] |\n|---|---|")
    where, h = np.array([np.pi / 2, np.pi, 0.0, 0.0]), 1e-5
    points = np.concatenate([where + h * np.eye(4), where - h * np.eye(4)])
    for name in ("section 6, kV = 2", "`rig`"):
        flights = Flights(GAINS[name], points, 1e-3, 2.0)
        rate = HOST.records("plant_rate", 8)
        for n in ("q1", "q2", "dq1", "dq2"):
            flights.seen[n] = flights.state[n]
        HOST.swing_up(flights.params, flights.seen, flights.made, flights.status)
        flights.applied["tau"] = flights.made["tau"]
        HOST.acceleration(flights.plant, flights.state, flights.applied, rate)
        rates = np.stack([points[:, 2], points[:, 3], rate["ddq1"], rate["ddq2"]], axis=1)
        poles = np.linalg.eigvals((rates[:4] - rates[4:]).T / (2 * h))
        shown = [f"{p.real:.3f} {'+' if p.imag > 0 else '-'} {abs(p.imag):.2f} i" for p in poles]
        print(f"| {name} | {', '.join(sorted(shown))} |")


if __name__ == "__main__":
    {"first": first, "starts": starts, "limit": limit, "rest": rest}[sys.argv[1]]()
