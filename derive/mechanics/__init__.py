"""Mechanics: dynamics, servo-constraint, linearisation and zero dynamics of a model."""
