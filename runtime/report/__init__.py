"""The report of a run: one page, its figures, formulas and animation."""
