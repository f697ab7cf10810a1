"""The experiment of the paper's section 6, on the twin."""
