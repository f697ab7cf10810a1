"""The closed loop a second time, typed in from the paper's (1)-(8) and (15)-(23), under CVODES.

It shares neither equations nor solver with the generated code: M, C and G are those printed, M is
inverted by elimination, and ADB is the product of its factors.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from pfaffian.paper.simulations.cases import DERIVED, DESIGNED, Case
from pfaffian.paper.simulations.fly import Run, Task
from pfaffian.paper.simulations.loop import SIGNALS
from pfaffian.runtime.base.errors import CheckError, InputError

_MOST_STEPS = 50_000_000


def plant_terms(q: Any, v: Any, plant: dict[str, float]) -> tuple[Any, Any, Any, Any]:
    """Return M (2, 2), C (2, 2), G (2, 1) and F (2, 1) of (1) as printed, in SI units."""
    th1, th2, th3, th4, th5 = (plant[f"theta{k}"] for k in range(1, 6))
    g, c2, s2 = plant["g"], ca.cos(q[1]), ca.sin(q[1])
    mass = ca.blockcat(
        [[th1 + th2 + 2 * th3 * c2, th2 + th3 * c2], [th2 + th3 * c2, th2]],
    )
    coriolis = s2 * ca.blockcat([[-th3 * v[1], -th3 * (v[1] + v[0])], [th3 * v[0], 0]])
    lower = th5 * g * ca.cos(q[0] + q[1])
    gravity = ca.vertcat(th4 * g * ca.cos(q[0]) + lower, lower)
    forces = [_force(plant, k + 1, v[k]) for k in range(2)]
    return mass, coriolis, gravity, ca.vertcat(*forces)


def _force(plant: dict[str, float], joint: int, rate: Any) -> Any:
    """Return f of one joint: the load of section 5.1, the friction of 5.2 and 5.3."""
    f = {n: plant[f"joint{joint}_{n}"] for n in ("load", "viscous")}
    a1, a2, a3, a4, a5, a6 = (plant[f"joint{joint}_friction{k}"] for k in range(1, 7))
    stribeck = a1 * (ca.tanh(a2 * rate) - ca.tanh(a3 * rate))
    return f["load"] + f["viscous"] * rate + stribeck + a4 * ca.tanh(a5 * rate) + a6 * rate


def closed_loop(case: Case) -> tuple[Any, Any, Any]:
    """Return the symbols of the state (6,), its rate, and the signals of `loop.SIGNALS`."""
    if case.column not in (DERIVED, DESIGNED):
        raise InputError(f"{case.name}: has no second formulation", remedy="fly it with scipy")
    x, k = ca.SX.sym("x", 6), case.controller
    q, v, integral, bound = x[:2], x[2:4], x[4], x[5]
    mass, coriolis, gravity, uncertain = plant_terms(q, v, dict(case.plant))
    own = plant_terms(q, v, {**case.plant, **case.controller})
    row = ca.horzcat(k["lam"], 1.0)
    e = q - ca.DM([k["q1d"], k["q2d"]])

    def residual(error: Any, rate: Any) -> Any:
        return k["lam"] * (rate[0] + k["lam1"] * error[0]) + rate[1] + k["lam2"] * error[1]

    s = residual(e, v)
    start = np.array(case.start)
    s0 = residual(start[:2] - np.array([k["q1d"], k["q2d"]]), start[2:])
    drift = k["sigma"] * s + 2 * k["eta"] / ca.pi * ca.atan(s)
    b = -k["lam"] * k["lam1"] * v[0] - k["lam2"] * v[1] - drift
    inverse = ca.solve(own[0], ca.SX.eye(2))
    ad = row @ inverse
    adb = ad[0]
    p1 = (b + ad @ (own[1] @ v + own[2])) / adb
    beta = s - s0 + integral
    following = adb * beta
    p2 = -k["kappa"] * following
    regressor = (ca.norm_2(v) + 1) ** 2 + (ca.norm_2(e) + 1) ** 2
    mu = following * bound * regressor
    p3 = -mu * bound * regressor / ca.fmax(ca.fabs(mu), k["epsilon"])
    tau = p1 + p2 + p3
    acceleration = ca.solve(mass, ca.vertcat(tau, 0) - coriolis @ v - gravity - uncertain)
    grown = k["k1"] * regressor * ca.fabs(following) - k["k2"] * bound
    return x, ca.vertcat(v, acceleration, drift, grown), ca.vertcat(tau, p1, p2, p3, beta, adb, s)


def fly_independent(task: Task) -> Run:
    """Fly `task` with CVODES; raise `CheckError` where it gives up."""
    case = task.case
    x, rate, signals = closed_loop(case)
    times = np.arange(round(case.duration / task.record) + 1) * task.record
    options = {
        "reltol": task.relative,
        "abstol": task.absolute,
        "max_num_steps": _MOST_STEPS,
        "disable_internal_warnings": True,
    }
    solver = ca.integrator("loop", "cvodes", {"x": x, "ode": rate}, 0.0, times[1:], options)
    start = np.array([*case.start, 0.0, case.controller["bound_initial"]])
    try:
        found = np.array(solver(x0=start)["xf"]).T
    except RuntimeError as error:
        raise CheckError(
            f"{case.name}: CVODES gave up: {str(error).splitlines()[-1]}",
            remedy="the case may end in the singular set: fly it with scipy",
        ) from error
    state = np.vstack([start, found])
    values = np.array(ca.Function("signals", [x], [signals]).map(len(state))(state.T))
    evaluations = int(solver.stats().get("nfevals", 0))
    named = dict(zip(SIGNALS, values, strict=True))
    return Run(task, times, state, named, "", case.duration, None, evaluations)
