"""The simulations of the paper's section 5: its cases, flown from the generated code."""
