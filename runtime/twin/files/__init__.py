"""Scenarios and campaigns of the twin: read, and flown many at a time."""
