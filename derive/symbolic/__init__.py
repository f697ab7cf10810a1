"""Symbolic blocks: named definitions, their units, forms and functions."""
