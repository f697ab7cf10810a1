"""The model library: one folder a plant, with `spec.py` and its parameter sets as TOML files."""
