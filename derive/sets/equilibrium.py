"""The equilibrium a parameter set asks for, solved for where its set-point is rounded or left out.

At rest what no actuator reaches of gravity vanishes, and so do the servo-constraints that do not
move: F(q_d) = 0. A set-point counts as an equilibrium where no double next to it is nearer to one,
which is where |F| <= |dF/dq_d| ulp(q_d) and F is exact. Beyond that it is polished:

- what is given may be the equilibrium rounded or cut off after the last digit written, the ones
  with most digits moved first, so that "0.82 rad" is completed and "45 deg" beside it stays;
  a single digit counts as two, and a zero is no rounded value;
- what is left out is solved for, beginning at its default and, of an angle, all around;
- anything farther is refused, with the force that is left and the equilibrium nearest to it.

F is evaluated at 40 digits, its slopes are taken in double: a Newton step then gains 15 digits.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pfaffian.derive.ir.evaluate import apply, evaluate, interpret
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.names import TIME_NAME
from pfaffian.derive.ir.parameter import Parameter
from pfaffian.derive.ir.program import Instruction, Op, Program
from pfaffian.derive.sets.raw_set import RawSet
from pfaffian.runtime.base.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

FORCE, CONSTRAINT, REFERENCE = "rest_force", "rest_constraint", "rest_reference"
#: |F| below this share of what it is elsewhere is the rounding of its own evaluation: at once an
#: equilibrium, without a second look at 40 digits.
_ROUNDING = 4.0 * 2.0**-53
_DIGITS = 40
_MOST_STEPS = 60
#: Starts of an angle that is left out, over a turn.
_A_TURN = 8
_MOST_STARTS = 64
#: A value that was never written is taken to have this many digits.
_UNWRITTEN = 1e-9
#: One unit of the last of two digits, in the worst case.
_MOST_SHARE = 0.1 / 2.0


@dataclass(frozen=True)
class Equilibrium:
    """Values of set-points that were changed, and a sentence about each."""

    values: Mapping[str, float]
    notes: tuple[str, ...] = ()


def setpoint_parameters(model: LoweredModel) -> tuple[Parameter, ...]:
    """Return the parameters that give the set-point, in the order of declaration."""
    return tuple(p for p in model.parameters_of("setpoint") if p.group == "gain")


def solve_setpoint(model: LoweredModel, raw: RawSet, values: Mapping[str, float]) -> Equilibrium:
    """Return the set-points of `raw` that have to change for an equilibrium, out of `values`.

    Raises `InputError` naming coordinate and force where there is no equilibrium to be meant.
    """
    points = setpoint_parameters(model)
    known = {**{p.name: 1.0 for p in model.parameters}, **_finite(values), TIME_NAME: 0.0}
    still = [model.program(n) for n in (FORCE, CONSTRAINT) if model.has_program(n)]
    if not points or _rests(still, known, [p.name for p in points]):
        return Equilibrium({})
    given = [p for p in points if p.name in raw.values]
    free = [p for p in points if p.name not in raw.values]
    problem = _Problem(still, known)
    found = _within_digits(problem, raw, given)
    if found is None and free:
        moving = [model.program(REFERENCE)] if model.has_program(REFERENCE) else []
        found = _solved(_Problem([*still, *moving], known), free)
        if found is None and given:
            found = _solved_and_polished(problem, raw, free, given)
    if found is None:
        _refuse(model, raw, problem, points)
        return Equilibrium({})
    changed = {n: v for n, v in found.items() if v != known[n]}
    return Equilibrium(
        changed, tuple(_note(p, known, changed, raw) for p in points if p.name in changed)
    )


def _note(
    p: Parameter, known: Mapping[str, float], changed: Mapping[str, float], raw: RawSet
) -> str:
    value = f"{p.name} = {changed[p.name]!r} {p.unit}"
    if p.name in raw.values:
        return f"{raw.path}: {value} is the equilibrium that {known[p.name]:.12g} was rounded from"
    return f"{raw.path}: {value} is the equilibrium, solved for as it was left out"


def _finite(values: Mapping[str, float]) -> dict[str, float]:
    """Return the values that are known: a gain that is still to be chosen does not move a zero."""
    return {n: v for n, v in values.items() if math.isfinite(v)}


def _rests(programs: Sequence[Program], known: Mapping[str, float], points: list[str]) -> bool:
    """Return whether F is zero within the rounding of its evaluation in double."""
    for program in programs:
        moved = [{n: known[n] + shift for n in points} for shift in (0.0, 1.0, 2.0)]
        values = [list(evaluate(program, {**known, **at}).values()) for at in moved]
        scale = max((abs(v) for row in values for v in row if math.isfinite(v)), default=0.0)
        if not all(abs(v) <= _ROUNDING * scale for v in values[0]):
            return False
    return True


class _Problem:
    """F of some programs, as a function of some of the values they take."""

    def __init__(self, programs: Sequence[Program], known: Mapping[str, float]) -> None:
        from mpmath import mp  # most sets are equilibria as they are written

        self._programs, self.known = programs, known
        self._mp = mp.clone()
        self._mp.dps = _DIGITS
        self._functions = {
            Op.SQRT: self._mp.sqrt,
            Op.SIN: self._mp.sin,
            Op.COS: self._mp.cos,
            Op.ATAN: self._mp.atan,
            Op.EXP: self._mp.exp,
            Op.EXPM1: self._mp.expm1,
            Op.TANH: self._mp.tanh,
            Op.LOG: self._mp.log,
            Op.ASIN: self._mp.asin,
            Op.ACOS: self._mp.acos,
            Op.SINH: self._mp.sinh,
            Op.COSH: self._mp.cosh,
        }

    def forces(self, at: Mapping[str, Any]) -> list[Any]:
        """Return F with the values in `at` in place of the known ones, as 40-digit numbers."""
        return [v for p in self._programs for v in self._evaluated(p, {**self.known, **at})]

    def _evaluated(self, program: Program, values: Mapping[str, Any]) -> list[Any]:
        number = self._mp.mpf
        slots = interpret(program, lambda n: number(values[n]), number, self._operate)
        return [slots[k] for k in program.results]

    def _operate(self, instruction: Instruction, arguments: list[Any]) -> Any:
        op = instruction.op
        if op in self._functions:
            return self._functions[op](*arguments)
        if op in (Op.FMA, Op.FMS, Op.FNMS):
            a, b, c = arguments
            return {Op.FMA: a * b + c, Op.FMS: a * b - c, Op.FNMS: c - a * b}[op]
        return apply(op, *arguments)

    def slope(self, names: Sequence[str], at: Mapping[str, Any]) -> Array:
        """Return dF by each of `names`, shape (rows, len(names)), by central differences."""
        import numpy as np

        columns = []
        for name in names:
            x = self._mp.mpf({**self.known, **at}[name])
            step = self._mp.mpf(10) ** (-_DIGITS // 3) * (abs(x) if x else 1)
            above, below = (self.forces({**at, name: x + s}) for s in (step, -step))
            columns.append([float((a - b) / (2 * step)) for a, b in zip(above, below, strict=True)])
        return np.array(columns, dtype=np.float64).T

    def root(self, names: Sequence[str], start: Mapping[str, float]) -> dict[str, float] | None:
        """Return the zero of F that damped Newton steps in `names` reach from `start`, or nothing.

        Of fewer equations than unknowns the steps are the shortest.
        """
        import numpy as np

        at = {n: self._mp.mpf(start[n]) for n in names}
        force = self.forces(at)
        scale = max(map(abs, force), default=self._mp.mpf(0))
        for _ in range(_MOST_STEPS):
            slope = self.slope(names, at)
            if not np.all(np.isfinite(slope)) or not scale:
                break
            size = np.maximum(np.abs(slope).max(axis=1), np.finfo(float).tiny)
            right = [float(f / self._mp.mpf(s)) for f, s in zip(force, size, strict=True)]
            step = np.linalg.lstsq(slope / size[:, None], -np.array(right), rcond=1e-10)[0]
            share, least = 1.0, self._length(force, size)
            while True:
                tried = {n: at[n] + share * float(d) for n, d in zip(names, step, strict=True)}
                there = self.forces(tried)
                if self._length(there, size) < least or share < 1e-6:
                    break
                share /= 2.0
            settled = all(abs(tried[n] - at[n]) <= 2.0**-70 * abs(tried[n]) for n in names)
            at, force = tried, there
            if settled:
                break
        found = {n: float(v) for n, v in at.items()}
        return found if self.is_zero(names, found) else None

    def _length(self, force: Sequence[Any], size: Array) -> Any:
        return max(abs(f) / self._mp.mpf(float(s)) for f, s in zip(force, size, strict=True))

    def is_zero(self, names: Sequence[str], at: Mapping[str, float]) -> bool:
        """Return whether |F| is what the rounding of `at` to doubles leaves."""
        slope = self.slope(names, at)
        for force, row in zip(self.forces(at), slope, strict=True):
            left = sum(abs(s) * math.ulp(at[n]) for s, n in zip(row, names, strict=True))
            if not abs(force) <= left:
                return False
        return True

    def carrying(self, names: Sequence[str]) -> Iterator[tuple[str, ...]]:
        """Return the smallest choices of `names` that dF has its whole rank in, the first first."""
        import numpy as np

        slope = self.slope(names, {})
        size = np.abs(slope).max(axis=1, initial=0.0)
        slope = slope / np.where(size > 0.0, size, 1.0)[:, None]
        rank = int(np.linalg.matrix_rank(slope, tol=1e-9))
        for chosen in itertools.combinations(range(len(names)), rank):
            if rank and np.linalg.matrix_rank(slope[:, chosen], tol=1e-9) == rank:
                yield tuple(names[k] for k in chosen)


def _within_digits(
    problem: _Problem, raw: RawSet, given: Sequence[Parameter]
) -> dict[str, float] | None:
    """Return an equilibrium that rounds to what is `given`, those with most digits moved first."""
    if not given:
        return None
    digit = {p.name: _digit(p.name, raw) for p in given}
    names = sorted(digit, key=lambda n: digit[n])
    start = {n: problem.known[n] for n in names}
    for moved in itertools.islice(itertools.chain(problem.carrying(names), [names]), _MOST_STARTS):
        found = problem.root(moved, start)
        if found and all(_is_written(found[n], start[n], digit[n]) for n in moved):
            return found
    return None


def _is_written(value: float, written: float, digit: float) -> bool:
    """Return whether `value`, rounded or cut off after the last `digit`, is what was `written`."""
    off = abs(value - written)
    cut_off = abs(value) > abs(written) and value * written >= 0.0 and off < digit
    return cut_off or 2.0 * off <= digit * (1.0 + 2.0**-40)


def _digit(name: str, raw: RawSet) -> float:
    """Return one unit of the last digit written, of a single digit only a share of the value."""
    value = abs(raw.values[name])
    return min(raw.last_places.get(name, _UNWRITTEN * value), _MOST_SHARE * value)


def _solved(problem: _Problem, free: Sequence[Parameter]) -> dict[str, float] | None:
    """Return the equilibrium nearest to the defaults of what is `free`, from several starts."""
    names = [p.name for p in free]
    default = {n: problem.known[n] for n in names}
    best: dict[str, float] | None = None
    for start in _starts(free, default):
        found = problem.root(names, start)
        if found and (best is None or _apart(found, default) < _apart(best, default)):
            best = found
    return best


def _solved_and_polished(
    problem: _Problem, raw: RawSet, free: Sequence[Parameter], given: Sequence[Parameter]
) -> dict[str, float] | None:
    """Return an equilibrium in all set-points that rounds to those `given`."""
    names = [p.name for p in (*free, *given)]
    found = problem.root(names, {n: problem.known[n] for n in names})
    close = found and all(
        _is_written(found[p.name], raw.values[p.name], _digit(p.name, raw)) for p in given
    )
    return found if close else None


def _apart(a: Mapping[str, float], b: Mapping[str, float]) -> float:
    return math.hypot(*(a[n] - b[n] for n in a))


def _starts(free: Sequence[Parameter], default: Mapping[str, float]) -> Iterator[dict[str, float]]:
    turns = [
        [default[p.name] + 2.0 * math.pi * k / _A_TURN for k in (0, 1, -1, 2, -2, 3, -3, 4)]
        if p.unit == "rad"
        else [default[p.name]]
        for p in free
    ]
    for point in itertools.islice(itertools.product(*turns), _MOST_STARTS):
        yield {p.name: x for p, x in zip(free, point, strict=True)}


def _refuse(
    model: LoweredModel, raw: RawSet, problem: _Problem, points: Sequence[Parameter]
) -> None:
    """Raise for the largest force that is left; a constraint that cannot rest is judged later."""
    program = model.program(FORCE)
    left = [(s, float(f)) for s, f in zip(program.outputs, problem.forces({}), strict=False)]
    worst = max(left, key=lambda row: abs(row[1]))
    names = [p.name for p in points]
    if problem.is_zero(names, problem.known) or _rests([program], problem.known, names):
        return
    signal, force = worst
    number = int(signal.name.removeprefix(FORCE))
    near = problem.root(names, problem.known)
    nearest = (
        ", ".join(f'{p.name} = "{near[p.name]:.17g} {p.unit}"' for p in points) if near else ""
    )
    raise InputError(
        f"{raw.path}: the setpoint is not an equilibrium: gravity leaves {force:.3g} {signal.unit} "
        f"on {model.coordinates[number - 1].name} that no actuator reaches ({signal.name})",
        remedy="choose a setpoint where the unactuated joints are in balance"
        + (f": the nearest is {nearest}" if nearest else "")
        + "; what is left out is solved for",
    )
