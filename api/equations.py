"""What follows from a specification, as SymPy matrices and expressions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import sympy as sp
    from pfaffian.derive.derivation.derive import Derivation


@dataclass(frozen=True, kw_only=True)
class Equations:
    """M q'' + C q' + G + F = B tau, (1), and A q'' = b of the servo-constraint, (8), in SymPy.

    `M` and `C` are (n, n), `G` and `F` (n, 1), `B` (n, m), `A` (m, n), `b` (m, 1), for n
    coordinates and m actuators. `ADB` is A M^-1 B, (10), or its determinant for m > 1. `p1` is the
    nominal part of the control law, (17), shape (m, 1): the torque under which A q'' = b holds.
    `T` and `V` are the energies. Symbols are those of the specification: `q1`, `dq1`, ...
    """

    model: str
    M: sp.Matrix
    C: sp.Matrix
    G: sp.Matrix
    F: sp.Matrix
    B: sp.Matrix
    A: sp.Matrix
    b: sp.Matrix
    ADB: sp.Expr
    T: sp.Expr
    V: sp.Expr
    proved: tuple[str, ...]
    unproved: tuple[str, ...]
    _derivation: Derivation = field(repr=False)

    @property
    def p1(self) -> sp.Matrix:
        """Return the nominal part of the law, (17): (ADB)^-1 (b + A D (C q' + G)), D = M^-1.

        It is worked out when it is asked for: written out it is long for larger plants.
        """
        from pfaffian.derive.spec.model_spec import Matrix

        bias = self._derivation.dynamics.coriolis_force + self.G
        rows = self.A * self.M.adjugate()  # A D det M: no inverse is expanded twice
        found = (rows * self.B).LUsolve(self.M.det() * self.b + rows * bias)
        return Matrix(found)

    def text(self) -> str:
        """Return the whole derivation as text, as `pfaffian derive` prints it."""
        from pfaffian.derive.derivation.documents import derivation_text

        return derivation_text(self._derivation)

    def latex(self) -> str:
        """Return the whole derivation as LaTeX, as `pfaffian derive --format latex` prints it."""
        from pfaffian.derive.derivation.documents import derivation_latex

        return derivation_latex(self._derivation)

    def __repr__(self) -> str:
        """Return one line."""
        count = len(self.proved)
        shape = f"M {self.M.rows}x{self.M.cols}, B {self.B.rows}x{self.B.cols}"
        proved = f"{count} of {count + len(self.unproved)} identities proved"
        return f"<equations of {self.model}: {shape}, {proved}>"

    def _repr_latex_(self) -> str:
        from pfaffian.derive.derivation.documents import symbol_printer

        shown = symbol_printer(self._derivation).doprint
        lines = [f"{n} &= {shown(getattr(self, n))}" for n in ("M", "C", "G", "B", "A", "b")]
        lines.append(f"A M^{{-1}} B &= {shown(self.ADB)}")
        return "$\\displaystyle \\begin{aligned}" + " \\\\ ".join(lines) + "\\end{aligned}$"


def equations_of(derivation: Derivation) -> Equations:
    """Return the equations in `derivation`."""
    dynamics, constraint = derivation.dynamics, derivation.constraint
    return Equations(
        model=derivation.spec.name,
        M=dynamics.mass_matrix,
        C=dynamics.coriolis_matrix,
        G=dynamics.gravity,
        F=dynamics.uncertain_force,
        B=dynamics.input_matrix,
        A=constraint.jacobian,
        b=constraint.acceleration,
        ADB=derivation.input_gain,
        T=dynamics.kinetic_energy,
        V=dynamics.potential_energy,
        proved=tuple(i.name for i in derivation.identities if i.proved),
        unproved=tuple(i.name for i in derivation.identities if not i.proved),
        _derivation=derivation,
    )
