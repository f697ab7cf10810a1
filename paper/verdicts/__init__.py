"""What the simulations say of the paper: figures, tables, claims and verdicts of section 5."""
