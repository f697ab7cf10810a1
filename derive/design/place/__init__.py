"""Placing the zero dynamics: the methods."""
