"""Gains, polynomials and their roots, of a parameter set."""

from __future__ import annotations

from collections.abc import Mapping

from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.lowered import LoweredModel
from pfaffian.derive.ir.names import CYCLIC
from pfaffian.derive.sets.routh import is_stable_column, routh_column, without_origin
from pfaffian.runtime.base.errors import InputError


def gain_names(model: LoweredModel) -> tuple[str, ...]:
    """Return the names of the gains that a design chooses."""
    return tuple(p.name for p in model.parameters if p.group == "synthesised")


def zero_polynomial(model: LoweredModel, values: Mapping[str, float]) -> tuple[float, ...]:
    """Return the characteristic polynomial of the zero dynamics, highest power first.

    The zeros at the origin that cyclic coordinates account for are divided out.
    """
    defaults = {p.name: p.default for p in model.parameters if p.default is not None}
    found = evaluate(model.program("zero_polynomial"), {**defaults, **values}).values()
    return without_origin(tuple(found), zeros_at_origin(model))


def zero_order(model: LoweredModel) -> int:
    """Return how many poles the zero dynamics have, without friction, that gains can place."""
    return len(model.program("zero_polynomial").outputs) - 1 - zeros_at_origin(model)


def zeros_at_origin(model: LoweredModel) -> int:
    """Return how many zeros at the origin cyclic coordinates account for, without friction."""
    if not model.has_program(CYCLIC):
        return 0
    return round(sum(evaluate(model.program(CYCLIC), {}).values()))


def is_hurwitz(coefficients: tuple[float, ...]) -> bool:
    """Return whether all roots lie strictly left of the imaginary axis (Routh's array)."""
    return is_stable_column(routh_column(coefficients))


def polynomial_of(poles: tuple[complex, ...]) -> tuple[float, ...]:
    """Return the monic polynomial with these roots, highest power first."""
    coefficients: list[complex] = [1.0 + 0.0j]
    for pole in sorted(poles, key=lambda p: (p.real, p.imag)):
        shifted = [*coefficients, 0.0j]
        scaled = [0.0j, *(pole * c for c in coefficients)]
        coefficients = [a - b for a, b in zip(shifted, scaled, strict=True)]
    return tuple(c.real for c in coefficients)


def roots_of(coefficients: tuple[float, ...]) -> tuple[complex, ...]:
    """Return the roots of a polynomial, sorted by real then imaginary part."""
    import numpy as np  # only errors and reports need roots: a plain set is read without NumPy

    return tuple(
        sorted((complex(r) for r in np.roots(coefficients)), key=lambda r: (r.real, r.imag))
    )


def places_poles(model: LoweredModel) -> bool:
    """Return whether poles determine the gains: in closed form, or through the row of s."""
    return model.has_program("gain_synthesis") or model.has_program("row_gains")


def synthesise_gains(
    model: LoweredModel, values: Mapping[str, float], poles: tuple[complex, ...], where: str
) -> dict[str, float]:
    """Return the gains that place the zero dynamics at `poles`.

    The closed form, where a model has one, is that of the frictionless plant; the row of s takes
    the friction in `values` into account. Raises `InputError` naming `where` if the number of poles
    is not the order of the zero dynamics, or poles do not determine the gains of this model.
    """
    if not places_poles(model):
        raise InputError(
            f"{where}: the gains of model {model.name} do not follow from poles alone",
            remedy="give the gains themselves; pfaffian design finds some",
        )
    order = zero_order(model)
    if len(poles) != order:
        raise InputError(
            f"{where}: {len(poles)} poles for zero dynamics of order {order}",
            remedy=f"give {order} poles",
        )
    wanted = polynomial_of(poles)
    if model.has_program("gain_synthesis"):
        named = {f"c{order - 1 - k}": c for k, c in enumerate(wanted[1:])}
        return evaluate(model.program("gain_synthesis"), {**values, **named})
    return _gains_of_row(model, values, wanted, where)


def _gains_of_row(
    model: LoweredModel, values: Mapping[str, float], wanted: tuple[float, ...], where: str
) -> dict[str, float]:
    from pfaffian.derive.sets.gains_from_poles import row_for_polynomial  # most sets do without

    n = len(model.coordinates)
    own = dict.fromkeys((p.name for p in model.parameters if p.group == "synthesised"), 1.0)
    defaults = {p.name: p.default for p in model.parameters if p.default is not None}
    known = {**own, **defaults, **values}
    whole = (*wanted, *(0.0,) * zeros_at_origin(model))
    row = row_for_polynomial(evaluate(model.program("linearisation"), known), n, whole)
    if row is None:
        raise InputError(
            f"{where}: the plant is not controllable at the setpoint: no row of s places its poles",
            remedy="choose another setpoint, or give the gains themselves",
        )
    names = [f"row_{kind}_{i + 1}" for kind in ("position", "rate") for i in range(n)]
    return evaluate(model.program("row_gains"), {**known, **dict(zip(names, row, strict=True))})
