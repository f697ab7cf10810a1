"""The table of docs/sampled-law.md: what a limit withholds, and the integral of the constraint.

    python docs/measured/limits.py

The rig with a slow drift (sigma 2, kappa .0045), where the integral matters most, at 1 kHz, with
viscous friction. The generated step runs without limits; torque limit and slew limit act outside,
and the integral is held, back-calculated or runs on where one of them binds.
"""

from collections.abc import Callable

import numpy as np
from pfaffian.runtime.code.generated_model import fill_records, host_model, open_generated

HOST = host_model(open_generated("pendubot"))
RIG = HOST.folder.parameters("rig") | {"sigma": 2.0, "kappa": 0.0045}
WIDE = RIG | {"torque_limit": 1e4, "slew_limit": 1e9}
PLANT = RIG | {"joint1_viscous": 0.001, "joint2_viscous": 0.0002}
PERIOD, UPRIGHT = RIG["sample_time"], np.pi / 2
Array = np.ndarray
Rule = Callable[[Array, Array, Array, Array], Array]
#: The next integral where a limit binds, of (held, moved, ADB, withheld torque).
RULES: dict[str, Rule] = {
    "held": lambda held, moved, gain, withheld: held,
    "back-calculated": lambda held, moved, gain, withheld: moved - PERIOD * gain * withheld,
    "runs on": lambda held, moved, gain, withheld: moved,
}


def fly(rule: Rule, start: dict[str, Array], limit: Array, slew: float, load: Callable, steps: int):
    """Return (IAE, recovered, whether a limit has bound), each (N,); `load(k)` is on joint 1."""
    n = len(limit)
    state, measured, output = (HOST.records(r, n) for r in ("state", "input", "output"))
    params = fill_records(HOST.records("params", n), WIDE)
    constants = fill_records(HOST.records("plant_params", n), PLANT)
    at, applied, status = HOST.records("plant_state", n), HOST.records("plant_input", n), None
    for name, value in start.items():
        at[name] = value
    status, before, area, late = np.zeros(n, np.int32), np.zeros(n), np.zeros(n), np.zeros(n)
    lost, bound, substep = np.zeros(n, bool), np.zeros(n, bool), np.full(n, PERIOD / 5)
    HOST.init(state, params, status)
    for k in range(steps):
        constants["joint1_load"] = load(k)
        for name in measured.dtype.names:
            measured[name] = at[name]
        held, estimate = state["constraint_offset"].copy(), state["bound_estimate"].copy()
        HOST.step(state, params, measured, output, status)
        reach = PERIOD * slew
        command = np.clip(np.clip(output["tau"], before - reach, before + reach), -limit, limit)
        withheld, moved = command - output["tau"], output["beta"] - output["s"]
        binding = withheld != 0.0
        if k == 0:  # the law takes up s(0) when it engages
            held = moved
        chosen = rule(held, moved, output["adb"], withheld)
        state["constraint_offset"] = np.where(binding, chosen, moved)
        state["bound_estimate"] = np.where(binding, estimate, state["bound_estimate"])
        applied["tau"] = before = command
        errors = np.abs(at["q1"] - UPRIGHT), np.abs(at["q2"])
        area += PERIOD * (errors[0] + errors[1])
        late = np.where(k >= steps - 1000, np.maximum(late, np.maximum(*errors)), 0.0)
        lost |= np.maximum(*errors) > 3.0
        bound |= binding & ~lost
        HOST.plant_step(at, constants, applied, substep, 5)
        for name in at.dtype.names:
            at[name][lost] = 0.0
    return area, ~lost & (late < 0.1), bound


def starts(slew: float) -> tuple:
    """300 random starts for each of three torque limits, 5 s."""
    rng = np.random.default_rng(5)
    draws = rng.normal(0.0, 1.0, (300, 4)) * (0.2, 0.3, 1.0, 1.0)
    limit = np.repeat([0.5, 1.0, 2.0], 300)
    names = ("q1", "q2", "dq1", "dq2")
    start = {n: np.tile(draws[:, k], 3) for k, n in enumerate(names)}
    start["q1"] = start["q1"] + UPRIGHT
    return start, limit, slew, lambda k: 0.0, 5000


def pushes(slew: float) -> tuple:
    """Push joint 1 with .1 to 3 times the limit for .02 to .8 s, two torque limits, 6 s."""
    sizes, lengths = np.linspace(0.1, 3.0, 12), np.geomspace(0.02, 0.8, 10)
    push, length, limit = (g.ravel() for g in np.meshgrid(sizes, lengths, [0.5, 1.0]))

    def load(k: int) -> Array:
        return np.where((k >= 100) & (k * PERIOD < 0.1 + length), push * limit, 0.0)

    return {"q1": np.full(len(push), UPRIGHT + 0.01)}, limit, slew, load, 6000


def main() -> None:
    """Print the table."""
    names = list(RULES)
    print(
        f"| flights | of | {' | '.join(names)} | IAE {names[1]} | IAE {names[2]} |\n|{'---|' * 7}"
    )
    for what, study, slew, said in (
        ("random starts", starts, 1e9, "limit alone"),
        ("random starts", starts, 400.0, "limit and 400 N m/s"),
        ("random starts", starts, 50.0, "limit and 50 N m/s"),
        ("pushes on joint 1", pushes, 1e9, "limit alone"),
        ("pushes on joint 1", pushes, 400.0, "limit and 400 N m/s"),
    ):
        flown = [fly(rule, *study(slew)) for rule in RULES.values()]
        where = flown[0][2] | flown[1][2] | flown[2][2]
        counts = [int((stands & where).sum()) for _, stands, _ in flown]
        every = np.logical_and.reduce([stands for _, stands, _ in flown]) & where
        areas = [area[every].sum() for area, _, _ in flown]
        ratios = [f"{a / areas[0]:.3f}" for a in areas[1:]]
        cells = [f"{what}, {said}", where.sum(), *counts, *ratios]
        print(f"| {' | '.join(str(c) for c in cells)} |", flush=True)


if __name__ == "__main__":
    main()
