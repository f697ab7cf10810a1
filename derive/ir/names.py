"""Names that more than one stage has to know."""

from __future__ import annotations

POLES_KEY = "zero_dynamics_poles"
SWING_UP_PROGRAM, SWING_UP_LIMIT = "swing_up_limit", "limit"
#: Group of the inputs in which everything repeats after a turn.
ANGLE_GROUP = "angle"
#: The programs of the closed-form conditions: of the plant without friction, and with it.
FRICTIONLESS, DAMPED = "hurwitz", "hurwitz_damped"
#: The programs that count the zeros at the origin of cyclic coordinates, and name the momenta that
#: no actuator changes.
CYCLIC, CONSERVED = "cyclic", "conserved"
#: The input that holds the time of a time-varying constraint.
TIME_NAME = "time"
#: Marks the plant's own parameters where controller and plant meet, as the two may differ; their
#: group there.
PLANT_PREFIX = "plant_"
PLANT_PARAMETER = "plant_parameter"
#: Name of the program with the upper triangle of M.
MASS_MATRIX = "mass_matrix"
