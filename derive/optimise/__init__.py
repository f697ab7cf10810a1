"""Optimiser passes on lowered programs: each small, named, and exact or a rounding apart."""
