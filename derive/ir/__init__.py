"""The intermediate representation: programs, their evaluation in any arithmetic, shared names."""
