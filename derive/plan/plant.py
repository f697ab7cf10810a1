"""The plant in numbers, twice: as a CasADi function to plan with, through NumPy to check with.

The two share the derivation's M, C, G, B and F and nothing else: CasADi evaluates the block
`acceleration`, NumPy solves M q'' = B tau - C q' - G - F with the matrices themselves. Long
simulations evaluate that block too, in plain floats.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray
from pfaffian.derive.derivation.derive import Derivation
from pfaffian.derive.spec.model_spec import symbol_of
from pfaffian.derive.symbolic.numeric import function_of, safe_symbols

Array = NDArray[np.float64]
#: Functions of the derivation that Python's mathematics does not have.
_OWN = {"sign": np.sign, "side": lambda x: -1.0 if x < 0.0 else 1.0}


@dataclass(frozen=True)
class NumericPlant:
    """M, C q' + G + F, B, V and the slope of G as functions of the state, parameters fixed.

    Each takes q or (q, q') as sequences of floats. `setpoint` is q_d (n,).
    """

    n: int
    m: int
    setpoint: tuple[float, ...]
    _dynamics: Callable[..., Any]
    _rest: Callable[..., Any]
    _block: Callable[..., Any]

    def matrices(self, q: Array, dq: Array) -> tuple[Array, Array, Array]:
        """Return M (n, n), C q' + G + F (n,) and B (n, m)."""
        n, m = self.n, self.m
        flat = np.array(self._dynamics(*q, *dq), dtype=np.float64)
        return flat[: n * n].reshape(n, n), flat[n * n : n * n + n], flat[n * n + n :].reshape(n, m)

    def acceleration(self, q: Array, dq: Array, torque: Array) -> Array:
        """Return q'' (n,) of (1)."""
        mass, bias, inputs = self.matrices(q, dq)
        return np.asarray(np.linalg.solve(mass, inputs @ torque - bias), dtype=np.float64)

    def rates(self, state: Array, torque: Array) -> Array:
        """Return (q', q'') (2n,)."""
        q, dq = state[: self.n], state[self.n :]
        return np.concatenate([dq, self.acceleration(q, dq, torque)])

    def quick_rates(self, state: Array, torque: Array) -> Array:
        """Return the same by the block `acceleration`, for long simulations."""
        return np.array([*state[self.n :], *self._block(*state.tolist(), *torque.tolist())])

    def power(self, state: Array, torque: Array) -> Array:
        """Return what each actuator delivers, tau_i (B^T q')_i (m,), in W."""
        q, dq = state[: self.n], state[self.n :]
        delivered: Array = torque * (self.matrices(q, dq)[2].T @ dq)
        return delivered

    def potential(self, q: Array) -> float:
        """Return V in J."""
        return float(self._rest(*q)[0])

    def kinetic(self, state: Array) -> float:
        """Return T in J."""
        q, dq = state[: self.n], state[self.n :]
        return float(dq @ self.matrices(q, dq)[0] @ dq) / 2.0

    def gravity(self, q: Array) -> Array:
        """Return G (n,)."""
        return np.array(self._rest(*q)[1 : self.n + 1], dtype=float)

    def stiffness(self, q: Array) -> Array:
        """Return dG/dq (n, n)."""
        flat = np.array(self._rest(*q)[self.n + 1 :], dtype=float)
        return flat.reshape(self.n, self.n)


def numeric_plant(derivation: Derivation, values: Mapping[str, float]) -> NumericPlant:
    """Return the plant of `derivation` with the parameters `values`, by name in SI units."""
    spec, d = derivation.spec, derivation.dynamics
    known = {symbol_of(p): values[p.name] for p in spec.parameters if p.name in values}
    q, dq = list(spec.positions), list(spec.velocities)
    bias = d.coriolis_matrix * sp.Matrix(dq) + d.gravity + d.uncertain_force
    slope = sp.Matrix(d.gravity).jacobian(q)
    return NumericPlant(
        n=len(q),
        m=len(spec.actuators),
        setpoint=tuple(float(sp.sympify(e).subs(known)) for e in spec.constraint.setpoint),
        _dynamics=_function([*q, *dq], [*d.mass_matrix, *bias, *d.input_matrix], known),
        _rest=_function(q, [d.potential_energy, *d.gravity, *slope], known),
        _block=_block_function(derivation, known),
    )


def _block_function(derivation: Derivation, known: Mapping[sp.Symbol, float]) -> Callable[..., Any]:
    """Return (q, q', tau) -> q'' of the block `acceleration`, its definitions one by one."""
    spec, block = derivation.spec, derivation.block("acceleration")
    torques = [sp.Symbol(a.name, real=True) for a in spec.actuators]
    used = [s for s, i in zip(block.symbols, block.inputs, strict=True) if i.group == "parameter"]
    arguments = [*spec.positions, *spec.velocities, *torques, *used]
    named = safe_symbols([*arguments, *(d.symbol for d in block.definitions)])
    steps = [(d.symbol.xreplace(named), d.expression.xreplace(named)) for d in block.definitions]
    results = [r.xreplace(named) for r in block.results]
    raw = sp.lambdify(
        [a.xreplace(named) for a in arguments],
        results,
        modules=[_OWN, "math"],
        cse=lambda _: (steps, results),
    )
    bound = [known[s] for s in used]
    return lambda *at: raw(*at, *bound)


def _function(
    arguments: list[sp.Symbol], values: list[sp.Expr], known: Mapping[sp.Symbol, float]
) -> Callable[..., Any]:
    """Return a function of the arguments; the parameters are bound by name, not written in."""
    used = sorted(set().union(*(v.free_symbols for v in values)) - set(arguments), key=str)
    bound = [known[s] for s in used]
    raw = function_of([*arguments, *used], values, [_OWN, "math"], cse=True)
    return lambda *at: raw(*at, *bound)


def casadi_rates(derivation: Derivation, values: Mapping[str, float]) -> Any:
    """Return the CasADi function (x, tau) -> x', x = (q, q'), of the block `acceleration`."""
    import casadi as ca
    from pfaffian.derive.lower.to_casadi import ToCasadi

    spec, block = derivation.spec, derivation.block("acceleration")
    n, m = len(spec.coordinates), len(spec.actuators)
    x, tau = ca.SX.sym("x", 2 * n), ca.SX.sym("tau", m)
    known = {s: x[i] for i, s in enumerate([*spec.positions, *spec.velocities])}
    known |= {sp.Symbol(a.name, real=True): tau[i] for i, a in enumerate(spec.actuators)}
    for signal, symbol in zip(block.inputs, block.symbols, strict=True):
        if signal.group == "parameter":
            known[symbol] = ca.SX(values[signal.name])
    convert = ToCasadi(known)
    for definition in block.definitions:
        convert.known[definition.symbol] = convert(definition.expression)
    accelerations = [convert(r) for r in block.results]
    rates = ca.cse(ca.vertcat(x[n:], *accelerations))
    return ca.Function("rates", [x, tau], [rates], ["x", "tau"], ["rates"])
