"""The study of one paper: audit of its equations, its simulations and experiment, the verdicts."""
