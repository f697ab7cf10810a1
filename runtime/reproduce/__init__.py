"""The simulations of the Pendubot's source, figure by figure, from the generated code."""
