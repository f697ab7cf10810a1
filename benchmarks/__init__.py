"""Benchmarks: other tools at the same work, and what is measured of them and of ours."""
