"""Verification: generated code against the symbolic source at 60 digits."""
