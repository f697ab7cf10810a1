"""The derivation: every block of a specification, and its documents."""
