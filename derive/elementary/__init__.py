"""Elementary functions: coefficients, tables, and proofs of every rounding."""
