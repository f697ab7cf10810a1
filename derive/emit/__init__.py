"""Emission: a lowered model and its parameter sets become files, one module a language."""
