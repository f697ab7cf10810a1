"""Compile time: from a model's energies and servo-constraint to generated controller code."""
