"""The audit: every numbered equation of a model's source, checked against its derivation."""
