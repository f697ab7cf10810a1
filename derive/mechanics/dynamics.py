"""What the dynamics of a plant are: M, C, G, B and F."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp


@dataclass(frozen=True)
class Dynamics:
    """The matrices of (1): M (n, n), C (n, n), G (n, 1), B (n, m), F (n, 1), and T, V.

    `coriolis_force` is C q' (n, 1), which is all that a control law needs of C. T and V are
    expanded; `kinetic_form` and `potential_form` are the same in the form that is computed.
    """

    mass_matrix: sp.Matrix
    coriolis_matrix: sp.Matrix
    coriolis_force: sp.Matrix
    gravity: sp.Matrix
    input_matrix: sp.Matrix
    uncertain_force: sp.Matrix
    kinetic_energy: sp.Expr
    potential_energy: sp.Expr
    kinetic_form: sp.Expr
    potential_form: sp.Expr


#: Up to so many coordinates the adjugate is written out.
SMALL = 2
