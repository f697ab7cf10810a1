"""Lowering: symbolic blocks become programs, and programs their derivatives."""
