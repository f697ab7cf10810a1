"""What the functions of the generated code name themselves, around the values they compute.

A value of the derivation, or of a person, that has one of these names is held in a local variable
called otherwise (`statements.with_local_names`); members of structures keep their names.
"""

from __future__ import annotations

#: Arguments, variables and functions of the files in whose functions the bodies stand, in C.
C_LOCALS = frozenset(
    "acceleration_of_sample baked baked_values balancing checks clear_state encoder finite "  # noqa: SIM905
    "finding_of good input jacobian law limited measurement_is_valid move next number out output "
    "parameters_are_valid params place plant reading ready reference rejected sense state status "
    "step_of_sample valid".split()
)
#: What the functions of the plant name besides.
C_PLANT_LOCALS = frozenset({"rate"})
#: What the step of one sample of the batch form names besides.
C_SAMPLE_LOCALS = frozenset({"engaged", "engaged_next"})
#: Arguments, variables, and what the bodies refer to of their module, in the NumPy modules.
PYTHON_LOCALS = frozenset(
    "BAD_ARITHMETIC BAD_INPUT BAD_PARAMETER ClosedLoopJacobian ContinuousOutput NEAR_SINGULAR "  # noqa: SIM905
    "NOT_READY NUMERIC OK Output PlantJacobian PlantRate SATURATED State StepJacobian "
    "SwingUpOutput advanced applied finite good input limited measured np output params plant "
    "prepared ready reference state status valid".split()
)
